"""The example solvers, which speak by the C++ library, run again and again."""
import json
import os
import signal
import subprocess

from actor import Actor
from support import MPIRUN

CHANGING = ("seconds", "bytes", "scene", "searched", "rounds", "reductions", "way")


class Solver(Actor):
    """Each arguments' first run tells what every later one must report."""

    steps = 60

    def start(self):
        self.known = getattr(self, "known", {})

    def command(self, choice):
        raise NotImplementedError

    def excused(self):
        """A solver outlives the service."""
        return False

    def turn(self):
        choice = int(self.rng.integers(3))
        scene = f"{self.name}-{choice}"
        if scene not in self.scenes:
            self.scenes.append(scene)
        command = [*self.command(choice), "--steps", str(self.steps), "--scene", scene, "--json",
                   "--endpoint", self.world.endpoint, "--deadline", str(round(self.world.answer_seconds))]
        code, out, errors = self.run(command)
        if code is None:
            return
        self.expect(code == 0, " ".join(command), "ended with", code, out[-2000:], errors[-2000:])
        reports = json.loads(out)["reports"]
        self.expect(len(reports) == self.steps + 1, len(reports), "reports")
        for report in reports:
            for name in CHANGING:
                report.pop(name, None)
        first = self.known.setdefault(choice, reports)
        self.expect(first == reports, "another run's reports differ")
        self.count("steps", self.steps + 1)

    def run(self, command):
        """(exit code, output, errors), or nothing where the time is over first."""
        running = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                                   text=True, start_new_session=True)
        limit = 120 * self.world.patience
        try:
            out, errors = running.communicate(timeout=max(0, min(limit, self.world.left())))
            return running.returncode, out, errors
        except subprocess.TimeoutExpired:
            os.killpg(running.pid, signal.SIGTERM)
            try:
                running.communicate(timeout=20 * self.world.patience)
            except subprocess.TimeoutExpired:
                os.killpg(running.pid, signal.SIGKILL)
                running.communicate()
            self.expect(self.world.left() <= 0, " ".join(command), f"did not end within {limit:.0f} s")
            return None, "", ""


class TwoSpheres(Solver):
    expects = "two_spheres runs to its end, and reports the same every time"

    def command(self, choice):
        return [os.path.join(self.world.programs, "two_spheres"), "--points", str((200, 700, 1500)[choice]), "--parts",
                str((8, 3, 13)[choice]), "--tolerance", ("0.1", "0.02", "inf")[choice]]


class SlopeSeats(Solver):
    expects = "slope_mpi, seats of one scene, runs to its end, and reports the same every time"
    steps = 20

    def command(self, choice):
        return [MPIRUN, str((2, 3, 4)[choice]), os.path.join(self.world.programs, "slope_mpi"), "--points", "1500",
                "--parts", str((8, 6, 5)[choice]), "--tolerance", "0.02", "--positions", "every-step"]
