"""The DEM example in each language: on any number of processes it computes what all pairs in NumPy do, bit for bit, and its
steps make the history of `rcbctl replay`. `dem_test.py --long` follows it for 10^4 time steps."""
import functools

from support import *

LONG = "--long" in sys.argv
ROOT = os.path.abspath(os.path.join(os.path.dirname(__file__), "..", ".."))

# The words that run it, by language; each has a class of tests, DemIn_LANGUAGE.
PROGRAMS = {
    "c": [os.path.join(BIN, "dem_c")],
    "python": ["env", f"PYTHONPATH={ROOT}/client/python", f"RCBD_LIBRARY={BIN}/../lib/librcbd.so.1", "/usr/bin/python3",
               f"{ROOT}/client/examples/python/dem.py"],
}
D, K, C, DT, U = 1.0, 1000.0, 2.0, 0.005, 2.0 ** 32
TOLD = ("step", "n", "error_before", "error", "imbalance", "repartitioned", "epoch", "moved", "axes_flipped")


def side_of(particles):
    sites = 4
    while sites ** 3 < 2 * particles:
        sites += 1
    return sites, 1.2 * sites


def start(particles):
    sites, _ = side_of(particles)
    ids = np.arange(particles)
    random, u = (ids + 1) * 69621 % 2147483647, []
    for _ in range(9):
        random = random * 16807 % 2147483647
        u.append(random / 2147483647.0)
    site = np.stack([ids // (sites * sites), ids // sites % sites, ids % sites])
    x = np.stack([1.2 * (site[k] + (0.4 + 0.2 * u[3 + k])) for k in range(3)])
    v = np.stack([2 * u[6 + k] - 1 for k in range(3)])
    v[0] += np.where(site[1] < sites // 2, 1, -1)
    return x, v


def forces(x, v, i, j, side):
    """The force of each pair of i and j on j, by the image of j that touches i; (int64 sums [3][n], contacts)."""
    d = np.full((3, len(i)), 2 * D)
    for k in (-1, 0, 1):
        image = x[:, j] + k * side if k else x[:, j]
        near = image - x[:, i]
        d = np.where(abs(near) < D, near, d)
    q = (d[0] * d[0] + d[1] * d[1]) + d[2] * d[2]
    touching = (q < D * D) & (q != 0)
    d, q, i, j = d[:, touching], q[touching], i[touching], j[touching]
    r, w = np.sqrt(q), v[:, i] - v[:, j]
    closing = (w[0] * d[0] + w[1] * d[1]) + w[2] * d[2]
    g = (K * (D - r) + C * closing / r) / r
    sums = np.zeros(x.shape, np.int64)
    for k in range(3):
        force = np.floor(g * d[k] * U + 0.5).astype(np.int64)
        np.add.at(sums[k], j, force)
        np.subtract.at(sums[k], i, force)
    return sums, len(i)


@functools.cache  # the same for every program and number of processes
def judge(particles, pushes, push_every):
    """The trajectory [pushes][particles][3], how often spheres touched, and how often one crossed the border of the box."""
    x, v = start(particles)
    _, side = side_of(particles)
    i, j = np.triu_indices(particles, 1)
    trajectory, contacts, crossings = [], 0, 0
    for _ in range(pushes):
        crossings += int(((x < 0) | (x >= side)).sum())
        x = np.where(x < 0, x + side, np.where(x >= side, x - np.floor(x / side) * side, x))
        x = np.where((x < 0) | (x >= side), 0, x)
        trajectory.append(x.T)
        for _ in range(push_every):
            sums, touching = forces(x, v, i, j, side)
            contacts += touching
            v = v + DT * (sums / U)
            x = x + DT * v
    return np.array(trajectory), contacts, crossings


@functools.cache
def replayed(service, *args, parts):
    file, scene = os.path.join(service.dir, "judged.npy"), "judged-" + "-".join(map(str, (*args, parts)))
    np.save(file, judge(*args)[0])
    service.json("replay", scene, file, "--parts", parts, "--tolerance", 0.05)
    return [[report[field] for field in TOLD] for report in service.json("history", scene)]


class Dem:
    program = None  # its words

    def words(self, processes, *args, scene="spheres"):
        return [str(word) for word in (processes, *self.program, *args, "--scene", scene)]

    def run_on(self, processes, *args, scene="spheres"):
        return run(*self.words(processes, *args, scene=scene), program=MPIRUN, endpoint=self.service.endpoint, timeout=3600)

    def assert_right(self, processes, particles=200, pushes=30, push_every=10, parts=6, more=()):
        """What the judge says, what rcbctl replay tells, and what is printed. Returns the reports."""
        scene, file = "dem", os.path.join(self.dir, "trajectory")
        done = self.run_on(processes, "--particles", particles, "--pushes", pushes, "--push-every", push_every, "--parts",
                           parts, "--trajectory", file, *more, scene=scene)
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        trajectory = np.fromfile(file).reshape(pushes, particles, 3)
        np.testing.assert_array_equal(trajectory, judge(particles, pushes, push_every)[0])
        reports = self.service.json("history", scene)
        printed = f"pushes {pushes}\nrepartitioned {sum(report['repartitioned'] for report in reports)}\n" \
                  f"cuts {self.service.json('scene', 'show', scene)['hash']}\n"
        self.assertEqual(done.stdout, printed)
        self.assertEqual([[report[field] for field in TOLD] for report in reports],
                         replayed(self.service, particles, pushes, push_every, parts=parts))
        return reports

    def test_on_any_number_of_processes(self):
        _, contacts, crossings = judge(200, 30, 10)
        self.assertTrue(contacts > 400 and crossings > 20, (contacts, crossings))
        for processes in (1, 2, 4, 7):
            reports = self.assert_right(processes)
            self.assertGreater(sum(report["repartitioned"] for report in reports), 3)
        self.assertGreater(sum(report["strangers"] for report in reports), 50)

    def test_counts_in_place_of_positions(self):
        reports = self.assert_right(3, more=["--when-needed"])
        self.assertTrue(any(not report["sent"] for report in reports))

    def test_lists_made_at_each_time_step(self):
        self.assert_right(4, pushes=60, push_every=1)

    def test_few_spheres_and_other_numbers_of_parts(self):
        """In a box this small a sphere is near to a part by several of its images; some processes have no spheres."""
        self.assert_right(7, particles=13, pushes=40, parts=7)
        self.assert_right(4, particles=2, parts=4)
        self.assert_right(1, particles=60, parts=1)
        self.assert_right(3, particles=60, parts=8)
        self.assert_right(3, particles=60, parts=1)

    def test_a_sphere_that_moves_too_far_ends_the_run(self):
        done = self.run_on(4, "--reach", 0.01)
        self.assertEqual((done.returncode, done.stdout), (1, ""), done.stderr)
        self.assertRegex(done.stderr, r"sphere \d+ has moved by more than 0.01")
        self.assertIn("since the last push, so the halo may lack spheres that it touches", done.stderr)

    def test_a_service_that_dies_meanwhile(self):
        file = os.path.join(self.dir, "killed")
        scene = "killed"
        words = self.words(3, "--particles", 60, "--pushes", 600, "--push-every", 5, "--trajectory", file, scene=scene)
        running = subprocess.Popen([MPIRUN, *words], text=True, env=dict(os.environ, RCBD_ENDPOINT=self.service.endpoint),
                                   stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        self.addCleanup(running.terminate)
        awaited(lambda: [r for r in self.service.json("history", scene) if r["step"] > 20], not_yet=[AssertionError])
        kill(self.service.processes("rcbd")[-1])
        out, err = running.communicate(timeout=120)
        self.assertEqual(running.returncode, 0, out + err)
        np.testing.assert_array_equal(np.fromfile(file).reshape(600, 60, 3), judge(60, 600, 5)[0])
        reports = self.service.json("history", scene)  # of the service that died, and of the one that came after
        self.assertEqual([report["step"] for report in reports], list(range(600)))

    def test_refusals(self):
        nowhere = os.path.join(self.dir, "nowhere", "file")
        for wrong in [("--particles", 0), ("--reach", "nan"), ("--pushes", 1.5), ("--push-every", "x"), ("--scene",), ("--fast", 1)]:
            done = run(*self.program[1:], *wrong, program=self.program[0])
            self.assertEqual((done.returncode, done.stdout), (2, ""), wrong)
            self.assertIn("--push-every", done.stderr)
        done = run(*self.program[1:], "--help", program=self.program[0])
        self.assertEqual((done.returncode, done.stderr), (0, ""))
        for args, why in [(["--endpoint", "unix:/nowhere/s"], "no service answers"), (["--trajectory", nowhere], nowhere),
                          (["--particles", 13, "--reach", 1], "half of the box")]:
            done = self.run_on(2, *args)
            self.assertEqual((done.returncode, done.stdout), (1, ""), args)
            self.assertIn(why, done.stderr)

    @unittest.skipUnless(LONG, "takes --long")
    def test_ten_thousand_time_steps(self):
        for processes, every in [(7, 10), (4, 20), (2, 10), (4, 1)]:
            self.assert_right(processes, pushes=10000 // every, push_every=every)


for language, words in PROGRAMS.items():
    test = type(f"DemIn_{language}", (Dem, ServiceTest), {"program": words})
    globals()[test.__name__] = unittest.skipUnless(os.path.exists(words[-1]), f"{words[-1]} isn't there")(test)
del test  # which is the last of them, and no further one

if __name__ == "__main__":
    unittest.main(verbosity=2, argv=[arg for arg in sys.argv if arg != "--long"])
