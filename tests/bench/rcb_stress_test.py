"""rcb_stress --quick: all of ours is right. Nothing is asserted about peers: how they break is their release's affair."""
import functools
import unittest

from measuring import expect_refused, measure, run


class Quick(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        document, cls.done = measure("--quick", "--timeout", "5", run=functools.partial(run, "rcb_stress"))
        cls.rows = document["rows"]

    def test_ours_is_exact_and_the_same_everywhere(self):
        ours = [row for row in self.rows if row["tool"] == "rcbd"]
        scenes = {row["scene"] for row in ours}
        self.assertGreaterEqual(len(scenes), 17)
        self.assertEqual(len(ours), len(scenes) * 2 * 2 * 2)
        answers = {}
        for row in ours:
            n, parts = row["n"], row["parts"]
            counts = [(p + 1) * n // parts - p * n // parts for p in range(parts)]
            self.assertEqual(row["error"], max(abs(c * parts - n) / n for c in counts) if n else 0, row)
            self.assertEqual(row["empty_parts"], counts.count(0), row)
            self.assertEqual(row["owner_differs"], 0, row)
            answers.setdefault((row["scene"], n, parts), set()).add((row["hash"], row["assignment"]))
        self.assertEqual({key: found for key, found in answers.items() if len(found) != 1}, {})

    def test_table_has_every_scene(self):
        for row in self.rows:
            self.assertIn(row["scene"], self.done.stdout)


class Refusals(unittest.TestCase):
    def test_wrong_usage(self):
        expect_refused(self, "rcb_stress", ["--scenes", "nowhere"], ["--parts", "0"], ["--points", "1.5"],
                       ["--methods", "magic"], ["--ranks", "0"], ["--timeout", "0"], ["more"])


if __name__ == "__main__":
    unittest.main(verbosity=2)
