"""rcb_bench skips on few points: the two sides of every case say the same, and the report shows what was saved. No time is
asserted."""
import os
import subprocess
import unittest

from measuring import BIN, expect_refused, measure

SKIPS = ["dimension", "weights", "ids", "exchange", "search", "far from cuts", "ties",
         "double precision", "questions"]
N = 6000


class Skips(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.document, done = measure("skips", "--points", str(N), "--parts", "6", "--ranks", "3", "--repeats", "2")
        cls.text = done.stdout
        rows = cls.document["rows"]
        cls.pairs = list(zip(rows[::2], rows[1::2]))

    def of(self, skip, work, off=None):
        found = [(a, b) for a, b in self.pairs if (a["scene"], a["work"]) == (skip, work) and off in (None, b["variant"])]
        self.assertTrue(found, (skip, work, off))
        return found[0]

    def test_every_row_has_its_fields(self):
        self.assertLessEqual({"bench", "commit", "machine", "repeats", "rows"}, set(self.document))
        for on, off in self.pairs:
            self.assertEqual((on["skip"], off["skip"]), (True, False))
            for field in ("scene", "n", "parts", "ranks", "work", "off_over_on", "same_answers"):
                self.assertEqual(on[field], off[field], field)
            for row in (on, off):
                self.assertEqual([row[f] for f in ("parts", "ranks", "tool", "ratio")], [6, 3, "rcbd", {}])
                self.assertLessEqual(row["seconds_min"], row["seconds"])
                self.assertLessEqual(row["seconds"], row["seconds_max"])
            self.assertGreater(on["off_over_on"], 0)

    def test_every_skip_has_its_case(self):
        self.assertEqual(sorted({on["scene"] for on, _ in self.pairs}), sorted(SKIPS))
        for skip in SKIPS:
            self.assertIn(skip, self.text)

    def test_answers_are_the_same(self):
        for on, off in self.pairs:
            if not on["same_answers"]:
                continue
            self.assertEqual(on["checksum"], off["checksum"])
            self.assertEqual(on["error"], off["error"])
            if on["scene"] != "dimension":
                self.assertEqual(on["hash"], off["hash"])
        unequal = {on["scene"] for on, _ in self.pairs if not on["same_answers"]}
        self.assertEqual(unequal, {"ties", "weights"})  # other points; other loads
        self.assertEqual(self.of("weights", "step", "all 1")[0]["same_answers"], True)

    def test_the_report_names_what_was_skipped(self):
        for on, off in self.pairs:
            named = on["scene"] in ("dimension", "weights", "ids", "exchange", "search", "double precision")
            if named and (on["scene"], on["work"]) != ("search", "first push"):
                self.assertIn(on["scene"], on["skipped"])
                self.assertNotIn(on["scene"], off["skipped"])
            if on["scene"] == "questions":
                self.assertEqual(on["asked"], {})
                self.assertEqual(list(off["asked"].values()), [2 + 2])  # warm-ups, repeats

    def test_bytes_are_saved(self):
        for work in ("first push", "step"):
            for skip, each, many in (("dimension", 16, 24), ("weights", 24, 32), ("ids", 24, 32),
                                     ("double precision", 12, 24)):
                on, off = self.of(skip, work)
                self.assertEqual((on["bytes"], off["bytes"]), (each * N, many * N), skip)

    def test_rounds_and_collectives_are_saved(self):
        on, off = self.of("search", "step")
        self.assertEqual((on["rounds"], on["reductions"]), (0, 0))
        self.assertGreater(off["reductions"], 0)

    def test_one_skip_alone(self):
        document, _ = measure("skips", "--scenes", "exchange", "--points", "1000", "--ranks", "1", "--repeats", "1")
        self.assertEqual({row["scene"] for row in document["rows"]}, {"exchange"})


class Refusals(unittest.TestCase):
    def test_wrong_usage(self):
        expect_refused(self, "rcb_bench", *(["skips", *words] for words in (
            ["--scenes", "nothing"], ["--parts", "0"], ["--ranks", "x"], ["--repeats", "0"], ["--points", "1.5"])))

    def test_the_service_refuses_a_skip_that_it_does_not_know(self):
        for names in ("everything", "search,everything"):
            done = subprocess.run([os.path.join(BIN, "rcbd")], env={**os.environ, "RCBD_NO_SKIP": names},
                                  capture_output=True, text=True, timeout=60)
            self.assertEqual(done.returncode, 2)
            self.assertIn("'everything' is no skip", done.stderr)
            self.assertIn("exchange, search", done.stderr)


if __name__ == "__main__":
    unittest.main(verbosity=2)
