"""rcb_bench dynamic on a short run: every setting sees the same motion, and what the rows say holds together. No time is
asserted."""
import os
import tempfile
import unittest
import xml.dom.minidom

from measuring import expect_refused, measure

STEPS = 30
COUNTS = ("repartitions", "drifted", "moved", "migrated")
ERRORS = ("error", "error_max", "error_before_mean", "error_before_max")
SECONDS = ("seconds", "seconds_min", "seconds_max", "seconds_search", "seconds_migrate", "seconds_exchange",
           "seconds_client", "seconds_round_trip", "seconds_first", "seconds_lost", "seconds_both", "seconds_balancing")


class Dynamic(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        with tempfile.TemporaryDirectory() as folder:
            figure = os.path.join(folder, "figure.svg")
            cls.document, done = measure("dynamic", "--points", "403", "--steps", str(STEPS), "--parts", "4", "--ranks", "2",
                                         "--repeats", "2", "--tolerances", "0,0.05,inf", "--axis-hysteresis", "1.2,1",
                                         "--figure", figure)
            cls.text = done.stdout
            xml.dom.minidom.parse(figure)
            with open(os.path.join(folder, "figure.gp")) as file:
                cls.script = file.read()

    def rows(self, scene, tool="rcbd", hysteresis=1.2, positions="when-needed"):
        return {row["tolerance"] if row["policy"] == "tolerance" else "cost": row for row in self.document["rows"]
                if row["scene"] == scene and row["tool"] == tool and
                (row["axis_hysteresis"], row["positions"]) == ((hysteresis, positions) if tool == "rcbd" else (None, None))}

    def peers(self):
        return ["Zoltan"] if "no Zoltan," not in self.document["peers"] else []

    def test_every_row_has_its_fields(self):
        self.assertLessEqual({"bench", "commit", "machine", "repeats", "rows"}, set(self.document))
        self.assertEqual(self.document["bench"], "dynamic")
        self.assertEqual(len(self.document["rows"]), 2 * (2 * 2 * 4 + 3 * len(self.peers())))
        for row in self.document["rows"]:
            self.assertEqual([row[f] for f in ("n", "dims", "parts", "ranks", "work", "steps", "ratio")],
                             [403, 3, 4, 2, "dynamic", STEPS, {}])
            for field in SECONDS:
                if row["tool"] == "rcbd" or field != "seconds_round_trip":
                    self.assertGreaterEqual(row[field], 0, field)
            for field in COUNTS:
                self.assertIsInstance(row[field], int)
            self.assertLessEqual(row["seconds_min"], row["seconds_max"])
            self.assertLessEqual(row["seconds"], row["seconds_max"])
            self.assertAlmostEqual(row["seconds_both"], row["seconds_client"] + row["seconds_lost"])
            self.assertAlmostEqual(row["seconds_balancing"], row["seconds_search"] + row["seconds_migrate"])

    def test_every_scene_has_every_setting(self):
        for scene in ("two_spheres", "slope"):
            for hysteresis in (1, 1.2):
                for positions in ("when-needed", "every-step"):
                    self.assertEqual(list(self.rows(scene, "rcbd", hysteresis, positions)), [0, 0.05, "inf", "cost"])
            for tool in self.peers():
                self.assertEqual(list(self.rows(scene, tool)), [0, 0.05, "inf"])

    def test_counts_and_positions_give_one_history(self):
        for scene in ("two_spheres", "slope"):
            counted, sent = self.rows(scene), self.rows(scene, positions="every-step")
            self.assertGreater(counted["inf"]["seconds_round_trip"], 0)
            for tolerance in (0, 0.05, "inf"):
                for field in (*COUNTS, *ERRORS):
                    if field != "migrated":  # the ranks may be behind, and catch up when positions travel
                        self.assertEqual(counted[tolerance][field], sent[tolerance][field], (scene, tolerance, field))
                self.assertEqual(counted[tolerance]["sent"], counted[tolerance]["repartitions"], (scene, tolerance))
                self.assertEqual(sent[tolerance]["sent"], STEPS)

    def test_tolerances_hold_their_error(self):
        quota = max(abs(count * 4 - 403) / 403 for count in (100, 101))
        for scene in ("two_spheres", "slope"):
            rows = self.rows(scene)
            self.assertAlmostEqual(rows[0]["error_max"], quota)
            self.assertLess(rows[0.05]["error_max"], 0.05)
            self.assertEqual(rows["inf"]["repartitions"], 0)
            self.assertEqual(rows["inf"]["moved"], 0)
            self.assertEqual(rows["inf"]["error_max"], rows["inf"]["error_before_max"])
            self.assertGreaterEqual(rows[0]["repartitions"], rows[0.05]["repartitions"])
            for row in rows.values():
                self.assertLessEqual(row["error"], row["error_max"])
                self.assertLessEqual(row["error"], row["error_before_mean"] + 1e-12)

    def test_the_peer_follows_the_same_motion_by_the_same_rule(self):
        for tool in self.peers():
            for scene in ("two_spheres", "slope"):
                ours, rows = self.rows(scene), self.rows(scene, tool)
                self.assertLess(rows[0.05]["error_max"], 0.05)
                self.assertGreaterEqual(rows[0]["repartitions"], rows[0.05]["repartitions"])
                self.assertEqual([rows["inf"][f] for f in ("repartitions", "moved", "seconds_balancing")], [0, 0, 0])
                self.assertEqual(rows["inf"]["error_max"], rows["inf"]["error_before_max"])
                for row in rows.values():
                    self.assertLessEqual(row["error"], row["error_before_mean"] + 1e-12)
                    self.assertGreaterEqual(row["moved"] + row["drifted"], row["migrated"])
            # On the slope, whose boxes are full, both have the same cuts but for ties: as much drifts over them.
            drifted = ours["inf"]["drifted"]
            self.assertLessEqual(abs(rows["inf"]["drifted"] - drifted), 2 + 0.2 * drifted)

    def test_something_moved(self):
        rows = self.rows("two_spheres")
        self.assertGreater(rows[0]["repartitions"], rows["inf"]["repartitions"])
        self.assertGreater(rows["inf"]["drifted"], 0)

    def test_table_and_figure_name_what_was_run(self):
        for word in ("two_spheres: 403 points", "slope: 403 points", "cost", "inf"):
            self.assertIn(word, self.text)
            self.assertIn(word, self.script)


def two_spheres(*arguments):
    """The rows of the policy tolerance."""
    document, _ = measure("dynamic", "--scenes", "two_spheres", "--points", "2003", "--ranks", "2", "--repeats", "1",
                          "--no-peers", "--positions", "every-step", *arguments)
    return [row for row in document["rows"] if row["policy"] == "tolerance"]


class Hysteresis(unittest.TestCase):
    def test_it_keeps_particles_where_they_are(self):
        rows = two_spheres("--steps", "40", "--tolerances", "0", "--axis-hysteresis", "1.2,1")
        self.assertEqual([row["axis_hysteresis"] for row in rows], [1.2, 1])
        self.assertEqual([row["repartitions"] for row in rows], [40, 40])
        self.assertLess(rows[0]["moved"], rows[1]["moved"])  # the spheres' longest axis turns as they collide


class Refusals(unittest.TestCase):
    def test_wrong_usage(self):
        expect_refused(self, "rcb_bench", *(["dynamic", *words] for words in (
            ["--scenes", "nowhere"], ["--tolerances", "-1"], ["--axis-hysteresis", "0.5"], ["--positions", "never"],
            ["--parts", "0"], ["--repeats", "0"], ["--points", "1.5"], ["--ranks", "x"])))


if __name__ == "__main__":
    unittest.main(verbosity=2)
