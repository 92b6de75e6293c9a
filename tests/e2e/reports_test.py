"""The main job: two colliding spheres drive the service; every field of every report is predicted."""
import re

import judge
from support import *

FIELDS = ("step", "epoch", "n", "error_before", "error", "imbalance", "repartitioned", "axes_flipped", "drifted",
          "moved", "migrated")


class Reports(ServiceTest):
    ranks = 8

    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.trajectory = os.path.join(cls.dir, "t.npy")
        cls.runs = {}
        for tolerance in ("inf", "0.1"):
            done = run("--points", 1500, "--steps", 200, "--parts", 8, "--tolerance", tolerance, "--scene",
                       "spheres-" + tolerance, "--trajectory", cls.trajectory, "--json",
                       endpoint=cls.service.endpoint, program=os.path.join(BIN, "two_spheres"))
            assert done.returncode == 0, done.stdout + done.stderr
            cls.runs[tolerance] = json.loads(done.stdout)["reports"]

    def compare(self, reports, expected):
        self.assertEqual(len(reports), len(expected))
        for report, prediction in zip(reports, expected):
            for field in FIELDS:
                self.assertEqual(report[field], prediction[field], f"step {prediction['step']}, {field}: {report}")
            self.assertTrue(report["reason"])

    def test_tolerance_holds_the_error(self):
        reports = self.runs["0.1"]
        self.assertEqual(len(reports), 201)
        self.assertLess(max(report["error"] for report in reports), 0.1)
        repartitions = sum(report["repartitioned"] for report in reports)
        self.assertLess(repartitions, 60)
        self.assertGreater(repartitions, 1)
        self.compare(reports, judge.reports(np.load(self.trajectory), 8, 8, 0.1))

    def test_without_repartition_the_error_grows(self):
        reports = self.runs["inf"]
        self.assertGreater(max(report["error"] for report in reports), 0.2)
        self.assertEqual([report["step"] for report in reports if report["repartitioned"]], [0])
        self.compare(reports, judge.reports(np.load(self.trajectory), 8, 8, float("inf")))

    def test_history_is_what_the_solver_heard(self):
        self.assertEqual(self.service.json("history", "spheres-0.1"), self.runs["0.1"])
        table = os.path.join(self.dir, "h.csv")
        self.service.json("history", "spheres-0.1", "--csv", table)
        rows = np.genfromtxt(table, delimiter=",", names=True, dtype=None, encoding="utf-8")
        self.assertEqual(list(rows["step"]), list(range(201)))
        fields = {field for report in self.runs["0.1"] for field in report} - {"seconds"}
        fields |= {"seconds_" + name for name in self.runs["0.1"][0]["seconds"]}
        self.assertEqual(set(rows.dtype.names), fields | {"weights_as_zero"})
        np.testing.assert_array_equal(rows["scanned"], [1500] * 201)
        np.testing.assert_array_equal(rows["error"], [report["error"] for report in self.runs["0.1"]])

    def test_plot(self):
        figure = os.path.join(self.dir, "h.svg")
        self.service.ctl("history", "spheres-0.1", "--plot", figure, check=True)
        self.assertIn("<svg", text_of(figure))
        self.service.ctl("history", "spheres-0.1", "--plot", os.path.join(self.dir, "h.PNG"), check=True)
        with open(os.path.join(self.dir, "h.PNG"), "rb") as figure:
            self.assertEqual(figure.read(8), b"\x89PNG\r\n\x1a\n")

    def test_plot_of_one_step(self):
        """A dot, and whole steps on the axis; beside a longer history it gets no figure of its own."""
        points = os.path.join(self.dir, "one.npy")
        np.save(points, np.random.default_rng(3).random((100, 2)))
        self.service.json("replay", "one", points, "--parts", 3)

        def drawn(*words):
            figure = os.path.join(self.dir, "one.svg")
            self.assertEqual(self.service.ctl("history", *words, "--plot", figure, check=True).stderr, "")
            return text_of(figure)

        alone = drawn("one")
        self.assertEqual(alone.count("<use xlink:href='#gpPt6'"), 2, "the dot, and that of the key")
        written = re.findall(r"<text> ?(-?[\d.]+)</text>", alone)
        self.assertEqual(written[written.index("0", 1):], ["0"], "the step's tick alone follows those of the error")
        self.assertNotIn("enlarged", drawn("spheres-inf", "--with", "one"))
        self.assertIn("enlarged", drawn("spheres-inf", "--with", "spheres-0.1"))

    def test_replay_of_random_walks(self):
        rng = np.random.default_rng(5)
        for name, dims, n, parts, tolerance, hysteresis in (
                ("a", 3, 300, 8, 0.05, 1.2), ("b", 2, 200, 7, 0, 1), ("c", 1, 64, 5, 0.3, 2.0), ("d", 3, 5, 8, 0.1, 1.2)):
            start = rng.random((n, dims))
            walk = start + np.cumsum(rng.normal(0, 0.02, (40, n, dims)), axis=0)
            walk[7] = walk[6]  # a step without motion
            path = os.path.join(self.dir, f"walk-{name}.npy")
            np.save(path, walk)
            self.service.json("replay", f"walk-{name}", path, "--parts", parts, "--tolerance", tolerance,
                              "--axis-hysteresis", hysteresis)
            self.compare(self.service.json("history", f"walk-{name}"),
                         judge.reports(walk, parts, 8, tolerance, hysteresis))
            counts = self.service.json("counts", f"walk-{name}")["counts"]
            self.assertEqual(sum(counts), n)
            assign = os.path.join(self.dir, "assign.npy")
            self.service.json("assign", f"walk-{name}", "--out", assign)
            np.testing.assert_array_equal(np.bincount(np.load(assign), minlength=parts), counts)

    def test_owner_never_contradicts_the_partition(self):
        points = np.load(self.trajectory)[-1]
        assign = os.path.join(self.dir, "owner.npy")
        self.service.json("assign", "spheres-0.1", "--out", assign)
        part = np.load(assign)
        for k in range(0, len(points), 300):
            answer = self.service.json("owner", "spheres-0.1", *[repr(float(c)) for c in points[k]], "--id", k)
            self.assertEqual(answer["owner"], part[k])


if __name__ == "__main__":
    unittest.main(verbosity=2)
