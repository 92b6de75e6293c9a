"""What the scripted tests share: running the real programs, a service of one's own, scenes that are hard."""
import contextlib
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
import unittest

import numpy as np
import protocol_client
from ranks import kill

BIN = os.environ.get("RCBD_BIN_DIR") or os.path.join(os.path.dirname(__file__), "..", "..", "build", "release", "bin")
RCBCTL = os.path.join(BIN, "rcbctl")
MPIRUN = os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "support", "mpirun")


def run(*args, endpoint=None, timeout=120, program=RCBCTL, cwd=None, env=None, check=False):
    """Runs a program to its end; a hang is a failure, with `check` any exit code but 0 too. Returns the finished process
    with text output."""
    environment = dict(os.environ, **(env or {}))
    environment.pop("RCBD_ENDPOINT", None)
    if endpoint:
        environment["RCBD_ENDPOINT"] = endpoint
    done = subprocess.run([program, *map(str, args)], capture_output=True, text=True, timeout=timeout,
                          cwd=cwd, env=environment, stdin=subprocess.DEVNULL)
    if check and done.returncode != 0:
        raise AssertionError(f"{done.args}: exit {done.returncode}: {done.stdout}{done.stderr}")
    return done


class Service:
    """A real rcbd under mpirun on a socket of its own."""

    def __init__(self, ranks, tcp=None, options=(), cwd=None, env=None):
        self.dir = tempfile.mkdtemp(prefix="rcb-e2e-")
        self.endpoint = tcp or "unix:" + os.path.join(self.dir, "s")
        self.data = os.path.join(self.dir, "data")
        self.ranks = ranks
        run("up", "-n", ranks, "--data-dir", self.data, *options, endpoint=self.endpoint, cwd=cwd, env=env, check=True)

    def ctl(self, *args, **kwargs):
        return run(*args, endpoint=self.endpoint, **kwargs)

    def json(self, *args, **kwargs):
        return json.loads(self.ctl(*args, "--json", check=True, **kwargs).stdout)

    def failure(self, *args, **kwargs):
        """The failure document of a command that must fail, with its exit code checked against the document."""
        done = self.ctl(*args, "--json", **kwargs)
        if done.returncode == 0:
            raise AssertionError(f"rcbctl {args} should have failed: {done.stdout}")
        failure = json.loads(done.stdout)["failure"]
        if failure["exit"] != done.returncode:
            raise AssertionError(f"exit {done.returncode}, document says {failure}")
        if not failure["message"] or failure["message"] not in done.stderr:
            raise AssertionError(f"stderr doesn't say {failure['message']!r}: {done.stderr!r}")
        return failure

    def processes(self, name):
        """The service's running processes of that name: rcbd-supervisor, mpirun, rcbd; the lowest number first."""
        return sorted(pid for pid, _ in processes_of(self.dir) if process_name(pid) == name)

    def assert_nothing_left(self):
        if not wait_for(lambda: not processes_of(self.dir)):
            raise AssertionError(f"left: {processes_of(self.dir)}")
        if left := [name for name in os.listdir(self.dir) if name.startswith("s")]:
            raise AssertionError(f"left: {left}")

    def stop(self):
        down = self.ctl("down")
        if down.returncode not in (0, 3):  # nothing is left running, whatever the test has found
            for pid, _ in processes_of(self.dir):
                kill(pid)
        shutil.rmtree(self.dir, ignore_errors=True)
        return down

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.stop()


class PreparedService(Service):
    """Before its rcbd starts, each rank runs a line of shell."""

    def __init__(self, ranks, line, **kwargs):
        self.programs = tempfile.mkdtemp(prefix="rcb-e2e-bin-")
        program = os.path.join(self.programs, "rcbd")
        real = os.path.abspath(os.path.join(BIN, "rcbd"))
        write_text(program, f"#!/bin/sh\n{line.format(programs=self.programs)}\nexec {real} \"$@\"\n")
        os.chmod(program, 0o755)
        super().__init__(ranks, env={"RCBD_BIN_DIR": self.programs}, **kwargs)

    def stop(self):
        down = super().stop()
        shutil.rmtree(self.programs)
        return down


class ServiceTest(unittest.TestCase):
    """Tests that share one service and a folder of files."""
    ranks = 2

    @classmethod
    def setUpClass(cls):
        cls.dir = tempfile.mkdtemp(prefix="rcb-e2e-files-")
        cls.addClassCleanup(shutil.rmtree, cls.dir)
        cls.service = Service(cls.ranks)
        cls.addClassCleanup(cls.service.stop)  # also where the rest of a set-up fails
        cls.path = cls.service.endpoint[5:]

    @classmethod
    def save(cls, name, array):
        path = os.path.join(cls.dir, name)
        np.save(path, array)
        return path


class Refusals:
    """For tests that speak the protocol."""

    def refused(self, code, call, *args, **kwargs):
        """The message of the refusal that the call must meet."""
        with self.assertRaises(protocol_client.Refused) as caught:
            call(*args, **kwargs)
        self.assertEqual(caught.exception.args[0], code, caught.exception.args)
        return caught.exception.args[1]


def random_walk(seed, n):
    """Five steps of n points, shape (5, n, 3); in the second they have hardly moved."""
    rng = np.random.default_rng(seed)
    walk = rng.random((5, n, 3)).cumsum(axis=0) * [1, 2, 1]
    walk[1] = walk[0] + rng.normal(0, 1e-3, walk[0].shape)
    return walk


def hard_scenes(seed=1):
    """Small point sets that break partitioners, by name; shape (n, dims)."""
    rng = np.random.default_rng(seed)
    lattice = np.stack(np.meshgrid(*[np.arange(10.0)] * 3, indexing="ij"), -1).reshape(-1, 3)
    scenes = {
        "uniform": rng.random((1000, 3)),
        "lattice": rng.permutation(lattice),
        "coincident": np.full((500, 3), 0.25),
        "half_coincident": np.concatenate([np.full((400, 3), 0.5), rng.random((401, 3))]),
        "decades": 10.0 ** rng.uniform(-6, 6, (900, 3)) * rng.choice([-1.0, 1.0], (900, 3)),
        "offset": 1e12 + 1e-3 * rng.random((777, 3)),
        "denormals": rng.integers(0, 50, (600, 3)) * 5e-324,
        "huge": rng.choice([-1.0, 1.0], (500, 3)) * rng.uniform(1.5e308, 1.7e308, (500, 3)),
        "signed_zeros": rng.choice([-0.0, 0.0, 1.0], (400, 3)),
        "line": rng.random((500, 1)),
        "plane": rng.integers(0, 9, (501, 2)).astype(float),
        "few": rng.random((5, 3)),
        "one": rng.random((1, 3)),
    }
    return scenes


ANOTHER_USER = 12345  # a user that nobody is


def only_root(test):
    """Skips aloud where this user can't make what belongs to another one."""
    def run_test(self):
        if os.geteuid() != 0:
            print(f"SKIPPED: {test.__name__} needs root", file=sys.stderr)
            self.skipTest("needs root")
        test(self)
    return run_test


def processes_of(text):
    """Command lines of running processes that contain the text, this one excepted."""
    found = []
    for pid in filter(str.isdigit, os.listdir("/proc")):
        try:
            with open(f"/proc/{pid}/cmdline", "rb") as file:
                line = file.read().replace(b"\0", b" ").decode(errors="replace")
        except OSError:
            continue
        if text in line and int(pid) != os.getpid():
            found.append((int(pid), line))
    return found


def process_name(pid):
    try:
        with open(f"/proc/{pid}/comm") as file:
            return file.read().strip()
    except OSError:
        return ""


def text_of(*path):
    with open(os.path.join(*path)) as file:
        return file.read()


def write_text(path, text):
    with open(path, "w") as file:
        file.write(text)


def token_of(data):
    return text_of(data, "token").strip()


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def wait_for(condition, seconds=30):
    """Until the condition holds; False where it doesn't within the time, which is a limit and no claim."""
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        if condition():
            return True
        time.sleep(0.05)
    return False


def awaited(condition, seconds=20, not_yet=()):
    """What the condition gives once that is true; exceptions of the kinds `not_yet` are no failures. A hang is one."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        with contextlib.suppress(*not_yet):
            if found := condition():
                return found
        time.sleep(0.02)
    raise AssertionError(f"not within {seconds} s")


def lammps_melt(dump, cells, steps):
    """A LAMMPS run of 4 cells^3 atoms, with this command for its dump."""
    return f"""units lj
lattice fcc 0.8442
region box block 0 {cells} 0 {cells} 0 {cells}
create_box 1 box
create_atoms 1 box
mass 1 1.0
velocity all create 3.0 87287
pair_style lj/cut 2.5
pair_coeff 1 1 1.0 1.0 2.5
fix 1 all nve
{dump}
run {steps}
"""


def fill_disk(folder, files=0):
    """Takes every byte that is left there, then with up to so many empty files the inodes as well."""
    with contextlib.suppress(OSError), open(os.path.join(folder, "fill"), "ab", buffering=0) as file:
        while file.write(bytes(4096)):
            pass
    with contextlib.suppress(OSError):
        for i in range(files):
            open(os.path.join(folder, f"fill.{i}"), "a").close()


__all__ = ["ANOTHER_USER", "BIN", "MPIRUN", "PreparedService", "RCBCTL", "Refusals", "Service", "ServiceTest", "awaited",
           "fill_disk", "free_port", "hard_scenes", "json", "kill", "lammps_melt", "np", "only_root", "os", "process_name",
           "processes_of", "random_walk", "run", "shutil", "signal", "subprocess", "sys", "tempfile", "text_of", "time",
           "token_of", "unittest", "wait_for", "write_text"]
