"""rcb_bench memory on a small scene: the phases are what they say, and what is told of memory holds together."""
import unittest

from measuring import expect_refused, measure

N = 300_000
PHASES = ["first push", "moving", "repartition", "moving again", "scattered", "moving at last"]


class Memory(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        # A limit that no service keeps: told, after everything was measured and written.
        document, cls.done = measure("memory", "--points", str(N), "--ranks", "2", "--parts", "4", "--most", "0.5", code=1)
        cls.rows = document["rows"]

    def test_every_path_has_every_phase(self):
        for path in ("direct", "gateway"):
            self.assertEqual([row["phase"] for row in self.rows if row["path"] == path], PHASES)
        for row in self.rows:
            self.assertEqual([row[f] for f in ("n", "dims", "parts", "ranks", "work", "tool")],
                             [N, 3, 4, 2, "memory", "rcbd"])

    def test_bytes_hold_together(self):
        for row in self.rows:
            # Positions, ids and parts, nothing of which is shared; and at no time three times as much again.
            self.assertGreaterEqual(row["bytes"], 36 * N * 0.95, row)
            self.assertLessEqual(row["bytes"], row["bytes_peak"])
            self.assertLessEqual(row["bytes_peak"], row["bytes_peaks"])
            self.assertLess(row["bytes_peaks"], 4 * 36 * N + 2 * (8 << 20), row)  # and a round of the hand-over
            self.assertAlmostEqual(row["peak_over_particles"], row["bytes_peak"] / (32 * N))
            self.assertGreater(row["bytes_empty"], 0)

    def test_phases_do_what_they_say(self):
        for row in self.rows:
            repartition = row["phase"] in ("repartition", "scattered")
            self.assertEqual(row["moved"] > 0, repartition, row)
            if row["phase"] == "scattered":
                self.assertGreater(row["drifted"], N / 4)

    def test_a_peak_above_the_limit_fails(self):
        self.assertEqual(self.done.returncode, 1, self.done.stderr)
        self.assertIn("times the particles, above 0.5", self.done.stderr)
        self.assertIn("scattered", self.done.stdout)


class Refusals(unittest.TestCase):
    def test_wrong_usage(self):
        expect_refused(self, "rcb_bench", *(["memory", *words] for words in (
            ["--points", "1.5"], ["--ranks", "0"], ["--paths", "nowhere"], ["--parts", "1"], ["--most", "0"])))


if __name__ == "__main__":
    unittest.main(verbosity=2)
