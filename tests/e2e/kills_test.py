"""Solvers outlive their service: ranks, mpirun and the supervisor are killed at random moments, and every solver ends as it
would have. After its supervisor's death a service is started again by hand (`rcbctl up`), while the solver waits.

What a solver computed is the same to the last bit, but for slope_mpi, whose sums are rounded in an order that depends on
which process holds which point when. Every step has one report, and the history that the service keeps has it, too. It is
that of a scene which was pushed the same positions, undisturbed: all that doesn't measure time, or how particles travel, is
equal. Nothing is left running.

kills_test.py --kills 20 [--ranks 8] [--seed S] is the long form: so many kills in each test, 100 in all. A service is given
at most four.
"""
import argparse
import random
import threading

import ranks
from outliving_client import OutlivingClient
from protocol_client import Client, Refused
from shared_memory_client import SharedClient
from support import *

KILLS_EACH = 4  # of one service: its supervisor waits twice as long after each quick failure
OPTIONS = argparse.Namespace(kills=4, ranks=4, seed=random.randrange(1 << 32))
SECONDS = 240  # for one run of a solver


class Killer(threading.Thread):
    """Kills processes of a service: each at a step of the scene, or some time after the last kill, up or not."""

    def __init__(self, service, scene, kills, steps, rng):
        super().__init__(daemon=True)
        self.service, self.path, self.scene, self.rng = service, service.endpoint[5:], scene, rng
        self.supervisor = ranks.supervisor(self.path)
        self.at = sorted(rng.randrange(1, steps - 1) for _ in range(kills))
        self.victims = rng.sample(["rank", "rank", "mpirun", "supervisor"], kills)
        self.killed, self.stopped, self.fault = [], threading.Event(), None

    def step(self):
        """The last step of the scene; -1 where the service, or the scene, isn't there."""
        try:
            with Client(self.path, timeout=5) as client:
                return client.ask("error", scene=self.scene)[0]["step"]
        except (OSError, EOFError, Refused):
            return -1

    def run(self):
        try:
            for at, victim in zip(self.at, self.victims):
                self.await_moment(at)
                if self.kill(victim):
                    self.killed.append(victim)
                    if victim == "supervisor":
                        self.start_by_hand()
        except Exception as fault:  # the test's thread tells it
            self.fault = fault

    def await_moment(self, at):
        if self.killed and self.rng.random() < 0.3:
            self.stopped.wait(self.rng.uniform(0, 2))  # perhaps while it is started again
            return
        while self.step() < at and not self.stopped.is_set():
            self.stopped.wait(0.001)
        self.stopped.wait(self.rng.uniform(0, 0.02))

    def kill(self, victim):
        """Whether there was one to kill."""
        running = []
        while not running and not self.stopped.is_set():
            running = {"rank": ranks.ranks, "mpirun": ranks.children}.get(victim, lambda pid: [pid])(self.supervisor)
            self.stopped.wait(0.01)
        return not self.stopped.is_set() and ranks.kill(self.rng.choice(running))

    def start_by_hand(self):
        """As a user would: where the killed service is still ending, `rcbctl up` says so, and is called again."""
        awaited(lambda: run("up", "-n", self.service.ranks, "--data-dir", self.service.data,
                            endpoint=self.service.endpoint).returncode == 0, 60)
        self.supervisor = awaited(lambda: ranks.supervisor(self.path), 60, (OSError, EOFError))


class Kills(unittest.TestCase):
    def setUp(self):
        self.rng = random.Random(f"{OPTIONS.seed} {self.id()}")
        self.judge = Service(2)
        self.addCleanup(self.judge.stop)

    def disturbed(self, scene, steps, solve):
        """Runs solve(service) until all kills are done; each run on a service of its own. Gives what they gave."""
        results, killed, undisturbed = [], 0, 0
        while killed < OPTIONS.kills:
            with Service(OPTIONS.ranks) as service:
                killer = Killer(service, scene, min(KILLS_EACH, OPTIONS.kills - killed), steps, self.rng)
                killer.start()
                try:
                    result = solve(service)
                finally:
                    killer.stopped.set()
                    killer.join()
                if killer.fault:
                    raise killer.fault
                awaited(lambda: service.ctl("status").returncode == 0, 60)
                result = (*result, service.json("history", scene), service.json("scene", "show", scene)["hash"])
                service.ctl("down", check=True)
                service.assert_nothing_left()
            killed += len(killer.killed)
            print(f"{self.id()}: kills at steps {killer.at}: {killer.killed}, {killed} of {OPTIONS.kills}", flush=True)
            if killer.killed:
                results.append(result)
            else:  # a kill near the end comes too late where the machine is busy
                undisturbed += 1
                self.assertLess(undisturbed, 5)
        return results

    def run_solver(self, service, *command):
        file = os.path.join(service.dir, "trajectory.npy")
        done = subprocess.run([*map(str, command), "--endpoint", service.endpoint, "--trajectory", file, "--json",
                               "--deadline", "120"], capture_output=True, text=True, timeout=SECONDS,
                              stdin=subprocess.DEVNULL)
        self.assertEqual(done.returncode, 0, done.stdout[-2000:] + done.stderr)
        return json.loads(done.stdout)["reports"], np.load(file)

    def check_history(self, reports, path, **options):
        """Against a scene that is pushed the same positions."""
        self.assertEqual([report["step"] for report in reports], list(range(len(path))))
        with SharedClient(self.judge.endpoint[5:]) as judge:
            judge.ask("scene.create", scene="judge", replace=True, **options)
            rows = judge.positions(*path[0].shape)
            for step, report in enumerate(reports):
                rows[:] = path[step]
                expected = judge.step("judge", step, rows)[0]["report"]
                for name in ("step", "n", "parts", "epoch", "error_before", "error", "imbalance", "repartitioned",
                             "reason", "axes_flipped", "moved", "inserted", "removed"):
                    self.assertEqual(report[name], expected[name], (step, name))
                self.assertEqual(report["scanned"], expected["scanned"] if report["sent"] else 0, step)
                self.assertIn(report["drifted"], (expected["drifted"], None), step)
            return judge.ask("scene.show", scene="judge")[0]["hash"]

    def check(self, reports, path, kept, hash_kept, **options):
        self.assertEqual(hash_kept, self.check_history(reports, path, **options))
        self.assertEqual(kept, reports)

    def check_two_spheres(self, positions):
        command = [os.path.join(BIN, "two_spheres"), "--steps", 200, "--parts", 8, "--tolerance", 0.1, "--scene", "s",
                   "--positions", positions]
        with Service(OPTIONS.ranks) as service:
            reports, path = self.run_solver(service, *command)
        self.check_history(reports, path, parts=8, tolerance=0.1)
        for reports, disturbed, *kept in self.disturbed("s", 200, lambda service: self.run_solver(service, *command)):
            self.assertEqual(disturbed.tobytes(), path.tobytes())
            self.check(reports, path, *kept, parts=8, tolerance=0.1)
            self.check_sent(reports, positions)

    def check_slope_mpi(self, positions):
        command = [MPIRUN, 4, os.path.join(BIN, "slope_mpi"), "--points", 1500, "--steps", 40, "--interval", 0.3, "--parts",
                   7, "--tolerance", 0.05, "--scene", "s", "--positions", positions]
        with Service(OPTIONS.ranks) as service:
            reports, path = self.run_solver(service, *command)
        self.check_history(reports, path, parts=7, tolerance=0.05)
        for reports, disturbed, *kept in self.disturbed("s", 40, lambda service: self.run_solver(service, *command)):
            print(f"slope_mpi: positions within {np.abs(disturbed - path).max():.1e} m of the undisturbed run")
            np.testing.assert_allclose(disturbed, path, rtol=0, atol=1e-9)
            self.check(reports, disturbed, *kept, parts=7, tolerance=0.05)
            self.check_sent(reports, positions)

    def check_sent(self, reports, positions):
        """A step is a count, but for those that need new cuts, one after each start, and slope_mpi's last."""
        sent = sum(report["sent"] for report in reports[:-1])
        if positions == "every-step":
            self.assertEqual(sent, len(reports) - 1)
        else:
            self.assertLessEqual(sent, sum(report["repartitioned"] for report in reports) + KILLS_EACH)

    def test_two_spheres(self):
        self.check_two_spheres("every-step")

    def test_two_spheres_that_count(self):
        self.check_two_spheres("when-needed")

    def test_slope_mpi(self):
        self.check_slope_mpi("every-step")

    def test_slope_mpi_that_counts(self):
        self.check_slope_mpi("when-needed")

    def test_a_client_in_python(self):
        noise = np.random.default_rng(OPTIONS.seed).normal(0, 5e-3, (300, 800, 3))
        path = np.cumsum(noise, axis=0) + np.random.default_rng(1).random((800, 3))

        def solve(service):
            client = OutlivingClient(service.endpoint[5:], "s", parts=6, tolerance=0.1)
            reports = [client.step(step, points) for step, points in enumerate(path)]
            client.close()
            return (reports,)

        for reports, *kept in self.disturbed("s", len(path), solve):
            self.check(reports, path, *kept, parts=6, tolerance=0.1)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=OPTIONS.kills, help="of each solver")
    parser.add_argument("--ranks", type=int, default=OPTIONS.ranks)
    parser.add_argument("--seed", type=int, default=OPTIONS.seed)
    OPTIONS, rest = parser.parse_known_args(namespace=OPTIONS)
    print(f"seed {OPTIONS.seed}", flush=True)
    unittest.main(argv=[sys.argv[0], *rest], verbosity=2)
