"""What happens to the service's processes and its disk."""
import contextlib
import itertools
import os
import shutil
import signal
import time

from actor import Actor, Gone
from protocol_client import Refused
from support import processes_of

FILLING = "filling"  # a folder that takes all the room there is


class Stops(Actor):
    expects = "a rank, mpirun or the supervisor that stands still for 10 ms to 3 s delays answers and does nothing else"
    pause_seconds = 1.5

    def turn(self):
        kinds = ["rank"] * 6 + ["supervisor"] + ["mpirun"]
        kind = self.random.choice(kinds)
        if kind == "rank":
            pids = self.world.rank_pids()
        else:
            pids = [pid for pid, line in processes_of(self.world.data) if self.is_a(kind, line)]
        if not pids:
            return
        pid = self.random.choice(pids)
        seconds = 10 ** self.random.uniform(-2, 0.48)
        try:
            os.kill(pid, signal.SIGSTOP)
            time.sleep(max(0, min(seconds, self.world.left())))
        except ProcessLookupError:
            self.expect(self.excused(), kind, pid, "is gone")
        finally:
            try:
                os.kill(pid, signal.SIGCONT)
            except ProcessLookupError:
                self.expect(self.excused(), kind, pid, "is gone")
        self.count("stopped " + kind)

    def is_a(self, kind, line):
        program = os.path.basename(line.split()[0])
        return program == ("mpirun" if kind == "mpirun" else "rcbctl")


class Disk(Actor):
    """The data directory is a small file system of its own, see `stress.py`."""

    expects = "a data directory without room delays nothing and loses nothing"
    pause_seconds = 4

    def turn(self):
        try:
            self.fill()
            with self.connect(keep=False) as client:
                scene = self.create(client, parts=2)
                self.ask(client, "scene.drop", scene=scene)
                self.scenes.remove(scene)
            time.sleep(max(0, min(self.random.uniform(0.1, 3), self.world.left())))
        finally:
            shutil.rmtree(self.path(), ignore_errors=True)

    def end(self):
        """The service is also stopped with a full disk."""
        super().end()
        self.fill()

    def path(self):
        return os.path.join(self.world.data, FILLING)

    def fill(self):
        """Takes every byte, then every inode."""
        with contextlib.suppress(OSError):  # where the service has taken all, there is nothing left to take
            os.mkdir(self.path())
        with contextlib.suppress(OSError), open(os.path.join(self.path(), "bytes"), "wb", buffering=0) as file:
            for size in (1 << 16, 1):
                with contextlib.suppress(OSError):
                    while file.write(b"\0" * size):
                        pass
        with contextlib.suppress(OSError):
            for k in itertools.count():
                open(os.path.join(self.path(), str(k)), "x").close()
        self.count("filled")


class Kills(Actor):
    expects = "a rank that is killed takes the service down for seconds; everybody goes on"
    pause_seconds = 20

    def turn(self):
        pids = self.world.rank_pids()
        pid = self.random.choice(pids)
        with self.world.deaths.get_lock():
            self.world.deaths.value += 1
        os.kill(pid, signal.SIGKILL)
        self.count("killed")
        end = time.monotonic() + 120 * self.world.patience
        while True:
            try:
                now = self.world.rank_pids()
                if len(now) == self.world.ranks and not set(now) & set(pids):
                    with self.connect(keep=False) as client:
                        client.ask("status")
                    break
            except (OSError, EOFError, Refused):
                pass
            if time.monotonic() > end:
                raise Gone("the service is not started again after a rank was killed")
            time.sleep(0.2)
        with self.world.deaths.get_lock():
            self.world.deaths.value += 1
        self.known_deaths = self.world.deaths.value
