"""The DEM example: on any number of processes, with halos by the cuts of the scene, it computes what it does in one, bit for
bit. `dem_test.py --long` follows it for 10^4 time steps."""
import functools

from support import *

LONG = "--long" in sys.argv


@functools.cache  # the same for every number of processes
def serial(*args):
    return run(*args, program=os.path.join(BIN, "dem_serial"), check=True).stdout


class Dem(ServiceTest):
    def parallel(self, processes, *args, scene="spheres"):
        return run(processes, os.path.join(BIN, "dem_parallel"), *args, "--scene", scene, program=MPIRUN,
                   endpoint=self.service.endpoint, timeout=3600)

    def assert_same(self, processes, *args, more=(), scene="spheres"):
        done = self.parallel(processes, *args, *more, scene=scene)
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        self.assertEqual(done.stdout, serial(*args), f"{processes} processes, {args} {more}")
        return self.service.json("history", scene)

    def test_the_cells_find_what_all_pairs_have(self):
        for args in [("--steps", 500), ("--particles", 13, "--steps", 500), ("--damping", 5, "--seed", 7)]:
            found = serial(*args)
            self.assertEqual(serial(*args, "--brute-force"), found)
            self.assertGreater(int(found.split()[3]), 400, found)  # contacts

    def test_lists_kept_for_20_time_steps(self):
        for processes in (1, 2, 4, 7):
            reports = self.assert_same(processes, "--particles", 400, "--steps", 600)
            self.assertEqual([report["step"] for report in reports], list(range(30)))
            if processes > 1:
                self.assertGreater(sum(report["strangers"] for report in reports[1:]), 50)
                self.assertGreater(sum(report["repartitioned"] for report in reports), 3)

    def test_lists_made_at_each_time_step(self):
        for processes in (2, 4, 7):
            self.assert_same(processes, "--particles", 400, "--steps", 100, "--damping", 2, more=("--push-every", 1))

    def test_several_parts_a_process_and_few_spheres(self):
        self.assert_same(3, "--particles", 400, "--steps", 200, more=("--parts", 8))
        # In a box this small a sphere is near to a part by several of its images; some processes have no spheres.
        self.assert_same(7, "--particles", 13, "--steps", 200)
        self.assert_same(4, "--particles", 2, "--steps", 200, "--seed", 3)

    def test_a_sphere_that_moves_too_far_ends_the_run(self):
        done = self.parallel(4, "--reach", 0.01)
        self.assertEqual(done.returncode, 1, done.stdout + done.stderr)
        self.assertIn("has moved by more than 0.010000 since the last push", done.stderr)
        self.assertEqual(done.stdout, "")

    def test_a_service_that_dies_meanwhile(self):
        args = ["--steps", 3000, "--scene", "killed"]
        running = subprocess.Popen([MPIRUN, "3", os.path.join(BIN, "dem_parallel"), *map(str, args)], text=True,
                                   env=dict(os.environ, RCBD_ENDPOINT=self.service.endpoint), stdin=subprocess.DEVNULL,
                                   stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        self.addCleanup(running.terminate)
        awaited(lambda: [r for r in self.service.json("history", "killed") if r["step"] > 20], not_yet=[AssertionError])
        kill(self.service.processes("rcbd")[-1])
        out, err = running.communicate(timeout=120)
        self.assertEqual((running.returncode, out), (0, serial("--steps", 3000)), err)
        reports = self.service.json("history", "killed")  # of the service that died, and of the one that came after
        self.assertEqual([report["step"] for report in reports], list(range(150)))

    def test_usage_and_no_service(self):
        for wrong in [("--particles", 0), ("--reach", "nan"), ("--damping", 101), ("--seed",), ("--fast", 1)]:
            self.assertEqual(run(*wrong, program=os.path.join(BIN, "dem_serial")).returncode, 2)
        nowhere = self.parallel(2, "--endpoint", "unix:/nowhere/s")
        self.assertEqual(nowhere.returncode, 1, nowhere.stderr)
        self.assertIn("no service answers", nowhere.stderr)

    @unittest.skipUnless(LONG, "takes --long")
    def test_ten_thousand_time_steps(self):
        for seed, processes, every in [(1, 7, 20), (2, 4, 20), (3, 2, 20), (4, 4, 1)]:
            self.assert_same(processes, "--particles", 1000, "--steps", 10000, "--seed", seed, more=("--push-every", every))


if __name__ == "__main__":
    unittest.main(verbosity=2, argv=[arg for arg in sys.argv if arg != "--long"])
