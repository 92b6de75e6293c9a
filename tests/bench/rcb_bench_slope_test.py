"""rcb_bench slope on a few points: what its rows say of slope_mpi holds together. No time is asserted."""
import unittest

from measuring import expect_refused, measure

N, STEPS = 600, 30
PROCESSES = (1, 2, 3)
SETTINGS = (("rcb", "inf"), ("bands-x", 0.1), ("rcb", 0))
NODE, POINT = 32, 216  # bytes that travel: of a node's momentum and mass, of a point's state


class Slope(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.document, done = measure("slope", "--points", str(N), "--steps", str(STEPS), "--ranks", "2", "--repeats", "1",
                                     "--processes", ",".join(map(str, PROCESSES)),
                                     "--settings", ",".join(f"{method}:{tolerance}" for method, tolerance in SETTINGS))
        cls.text = done.stdout
        cls.rows = {(row["processes"], row["method"], row["tolerance"]): row for row in cls.document["rows"]}

    def test_every_setting_on_every_number_of_processes(self):
        self.assertEqual(list(self.rows), [(processes, *setting) for processes in PROCESSES for setting in SETTINGS])
        for row in self.rows.values():
            self.assertEqual([row[f] for f in ("scene", "n", "dims", "ranks", "work", "steps", "positions", "ratio")],
                             ["slope", N, 3, 2, "slope_mpi", STEPS, "when-needed", {}])
            self.assertEqual(row["parts"], row["processes"])

    def test_all_compute_the_same(self):
        self.assertEqual(len({row["substeps"] for row in self.rows.values()}), 1)
        apart = [row["metres_apart"] for row in self.rows.values()]
        self.assertLess(max(apart), 1e-9)
        self.assertGreater(max(apart), 0)  # other parts, sums rounded otherwise: these are other runs' positions

    def test_times_hold_together(self):
        for row in self.rows.values():
            self.assertLessEqual(row["seconds_min"], row["seconds"])
            self.assertLessEqual(row["seconds"], row["seconds_max"])
            self.assertLess(row["seconds_service"], row["seconds"])
            self.assertGreater(row["seconds_mean"], 0)
            # The slowest of M processes is no faster than their mean, and all together have no more than they did.
            self.assertLessEqual(row["seconds_mean"], row["seconds_slowest"] * (1 + 1e-9))
            self.assertLessEqual(row["seconds_slowest"], row["seconds_mean"] * row["processes"] * (1 + 1e-9))

    def test_what_is_exchanged(self):
        for (processes, _, _), row in self.rows.items():
            nodes = row["shared_nodes"] * row["substeps"]
            if processes == 1:
                self.assertEqual((nodes, row["grid_bytes"], row["point_bytes"]), (0, 0, 0))
                continue
            self.assertGreater(nodes, 0)
            # Both of two processes count a node that they share, and send it; they send all of their common box.
            self.assertAlmostEqual(nodes % 2, 0, delta=1e-6)
            self.assertLessEqual(NODE * nodes, row["grid_bytes"] * (1 + 1e-9))
            self.assertEqual(row["grid_bytes"] % (2 * NODE), 0)
            self.assertEqual(row["point_bytes"] % POINT, 0)

    def test_repartitions_and_errors(self):
        for processes in PROCESSES[1:]:
            kept, _, exact = (self.rows[processes, *setting] for setting in SETTINGS)
            self.assertEqual(kept["repartitions"], 0)
            self.assertGreater(exact["repartitions"], 1)
            self.assertLess(exact["error_max"], kept["error_max"])
            # Of points that drifted across the cuts; step 0, which gives most points to another process, isn't in it.
            self.assertGreater(kept["point_bytes"], 0)
            self.assertLess(kept["point_bytes"], POINT * N / 4)

    def test_table(self):
        lines = [[cell.strip() for cell in line.strip("|").split("|")] for line in self.text.splitlines()
                 if line.startswith("|")]
        self.assertEqual(lines[0][:6], ["processes", "method", "tolerance", "wall s", "slowest s", "mean s"])
        self.assertEqual({len(line) for line in lines}, {12})
        self.assertEqual([(int(line[0]), line[1], line[2]) for line in lines[2:]],
                         [(processes, method, f"{float(tolerance):g}") for processes, method, tolerance in self.rows])
        self.assertEqual([int(line[10]) for line in lines[2:]], [row["repartitions"] for row in self.rows.values()])
        self.assertIn("in all runs", self.text)


class Refusals(unittest.TestCase):
    def test_wrong_usage(self):
        expect_refused(self, "rcb_bench", *(["slope", *words] for words in (
            ["--settings", "rcb"], ["--settings", "rcb:-1"], ["--settings", "file-order:0.1"], ["--processes", "0"],
            ["--positions", "never"], ["--points", "1.5"], ["--steps", "0"], ["--repeats", "0"])))


if __name__ == "__main__":
    unittest.main(verbosity=2)
