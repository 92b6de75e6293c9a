"""The MPI form of the slope: four processes, each with the points of its own parts, compute what one does."""
import signal as signals
import time

from support import *

POINTS, STEPS = 1500, 8


def solver(service, processes, *args, wait=True):
    command = [MPIRUN, str(processes), os.path.join(BIN, "slope_mpi"), "--points", str(POINTS), "--interval", "0.3",
               *map(str, args)]
    environment = dict(os.environ, RCBD_ENDPOINT=service.endpoint)
    if not wait:
        return subprocess.Popen(command, env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                                stderr=subprocess.PIPE, text=True)
    return subprocess.run(command, env=environment, stdin=subprocess.DEVNULL, capture_output=True, text=True,
                          timeout=240)


class SlopeMpi(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.service = Service(4)
        cls.addClassCleanup(cls.service.stop)

    def run_on(self, processes, scene, *more, tolerance=0.02):
        file = os.path.join(self.service.dir, f"{scene}.npy")
        done = solver(self.service, processes, "--steps", STEPS, "--parts", 6, "--tolerance", tolerance, "--scene", scene,
                      "--trajectory", file, "--json", "--check", *more)
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        return json.loads(done.stdout), np.load(file)

    def test_four_processes_compute_what_one_does(self):
        alone, path = self.run_on(1, "alone", "--positions", "every-step")
        four, path_of_four = self.run_on(4, "four", "--positions", "every-step")
        self.assertEqual(path.shape, (STEPS + 1, POINTS, 3))
        moved = np.abs(path[-1] - path[0]).max()
        self.assertGreater(moved, 1.0)  # metres: it slides
        # Sums over the grid are rounded in another order; seen after 8 steps: 6e-14 m.
        np.testing.assert_allclose(path_of_four, path, rtol=0, atol=1e-9)
        self.assertEqual(four["substeps"], alone["substeps"])
        self.assertAlmostEqual(four["energy"]["end"] / alone["energy"]["end"], 1, delta=1e-9)
        np.testing.assert_allclose(four["momentum"]["end"], alone["momentum"]["end"], rtol=1e-9,
                                   atol=1e-9 * np.abs(alone["momentum"]["end"]).max())
        # No point is lost, and (--check) after each step every process held exactly those of its parts.
        self.assertEqual((len(four["held"]), sum(four["held"])), (4, POINTS))
        counts = self.service.json("counts", "four")["counts"]
        of_parts = [k * 6 // 4 for k in range(5)]
        self.assertEqual(four["held"], [sum(counts[a:b]) for a, b in zip(of_parts, of_parts[1:])])
        self.assertGreater(four["handed_over"], POINTS // 2)
        self.assertEqual(alone["handed_over"], 0)
        self.assertGreater(four["repartitions"], 1)
        self.assertGreater(min(four["by_step"]["shared_nodes"][1:]), 0)
        self.assertEqual(sum(alone["by_step"]["grid_bytes"]), 0)
        # The same particles by one client: the same cuts.
        plain = [(r["error"], r["repartitioned"], r["drifted"]) for r in alone["reports"]]
        self.assertEqual(len(plain), STEPS + 1)
        self.assertEqual([r["n"] for r in four["reports"]], [POINTS] * (STEPS + 1))

    def test_bands_and_steps_that_are_counted(self):
        sent, path = self.run_on(3, "sent", "--method", "bands-x", "--positions", "every-step")
        counted, path_of_counted = self.run_on(3, "counted", "--method", "bands-x")
        self.assertEqual(self.service.json("scene", "show", "sent")["method"], "bands-x")
        np.testing.assert_array_equal(path_of_counted, path)
        self.assertIn(False, [report["sent"] for report in counted["reports"]])
        for field in ("held", "handed_over", "energy", "momentum", "error_max", "repartitions"):
            self.assertEqual(counted[field], sent[field], field)

    def test_the_service_answers_for_the_end_of_a_run(self):
        for processes in (1, 4):
            scene = f"end-{processes}"
            run, path = self.run_on(processes, scene, tolerance="inf")
            self.assertEqual([report["sent"] for report in run["reports"]], [True] + [False] * (STEPS - 1) + [True])
            shown, quality = self.service.json("scene", "show", scene), self.service.json("quality", scene)
            self.assertEqual((shown["positions"], shown["positions_step"]), ("when-needed", STEPS))
            self.assertEqual(quality["positions_step"], STEPS)
            folder = os.path.join(self.service.dir, scene)
            exported = self.service.json("export", scene, folder, "--format", "npy")
            self.assertEqual(exported["positions_step"], STEPS)
            np.testing.assert_array_equal(np.load(os.path.join(folder, "positions.npy")), path[-1])
            assigned = self.service.json("assign", scene, "--out", os.path.join(folder, "assigned.npy"))
            self.assertEqual(assigned["positions_step"], STEPS)
            parts = np.load(os.path.join(folder, "assigned.npy"))
            held = np.bincount(((parts + 1) * processes - 1) // 6, minlength=processes)
            self.assertEqual(run["held"], held.tolist())

    def test_a_solver_that_is_killed_leaves_the_scene_to_the_next(self):
        running = solver(self.service, 2, "--steps", 100000, "--scene", "killed", wait=False)
        try:
            end = time.monotonic() + 60
            while time.monotonic() < end:
                scenes = {s["scene"]: s for s in self.service.json("status")["scenes"]}
                if scenes.get("killed", {}).get("step"):
                    break
                time.sleep(0.1)
        finally:
            running.send_signal(signals.SIGTERM)
            running.communicate(timeout=60)
        done = solver(self.service, 3, "--steps", 1, "--scene", "killed", "--check")
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        self.assertIn("3 processes", done.stdout)

    def test_usage_and_no_service(self):
        self.assertEqual(solver(self.service, 2, "--parts", 0).returncode, 2)
        for wrong in ("-1", "nan"):
            refused = solver(self.service, 2, "--tolerance", wrong)
            self.assertEqual(refused.returncode, 2, refused.stderr)
        done = solver(self.service, 2, "--steps", 1, "--tolerance", "inf", "--parts", "4.0")
        self.assertEqual(done.returncode, 0, done.stderr)
        nowhere = solver(self.service, 2, "--endpoint", "unix:/nowhere/s")
        self.assertEqual(nowhere.returncode, 3, nowhere.stderr)
        self.assertEqual(nowhere.stderr.count("no service answers"), 1, nowhere.stderr)


if __name__ == "__main__":
    unittest.main(verbosity=2)
