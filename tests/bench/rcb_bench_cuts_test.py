"""rcb_bench cuts on a small scene: every work is measured in both orders, and its answers don't depend on the order."""
import unittest

from measuring import expect_refused, measure

WORKS = ["read", "owner", "owner, rows", "owner, float rows", "owner, last parts", "count", "count, rows",
         "count, float rows", "count, weights", "halo", "halo, rows",
         "halo, Euclidean", "halo, periodic"]


class Cuts(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        document, _ = measure("cuts", "--points", "20000", "--parts", "1,7", "--threads", "2", "--repeats", "2")
        cls.rows = document["rows"]

    def test_every_work_in_both_orders(self):
        for parts in (1, 7):
            for order in ("by part", "shuffled"):
                rows = [row for row in self.rows if row["parts"] == parts and row["order"] == order]
                self.assertEqual([row["work"] for row in rows], WORKS)
                for row in rows:
                    self.assertGreater(row["ratio"]["read"], 0)

    def test_halos_are_those_of_any_order(self):
        for work in WORKS:
            for parts in (1, 7):
                entries = {row.get("entries") for row in self.rows if row["work"] == work and row["parts"] == parts}
                self.assertEqual(len(entries), 1, (work, parts))
        of = {(row["work"], row["parts"]): row.get("entries") for row in self.rows}
        self.assertEqual(of["halo", 1], 0)
        self.assertGreater(of["halo, periodic", 1], 0)
        self.assertEqual(of["halo", 7], of["halo, rows", 7])
        self.assertLess(of["halo, Euclidean", 7], of["halo", 7])
        self.assertLess(of["halo", 7], of["halo, periodic", 7])

    def test_wrong_options(self):
        expect_refused(self, "rcb_bench", ["cuts", "--width", "-1"], ["cuts", "--parts", "0"], ["cuts", "--threads", "0"],
                       ["cuts", "--points", "1.5"])


if __name__ == "__main__":
    unittest.main()
