"""rcb_bench measures what it says: small runs of both benches, judged from their JSON. No time is asserted."""
import math
import os
import signal
import subprocess
import tempfile
import time
import unittest
import xml.dom.minidom

from measuring import BIN, bench, expect_refused, measure

FIELDS = {"scene", "n", "dims", "parts", "ranks", "tool", "method", "work", "cut_tolerance", "seconds", "seconds_min",
          "seconds_max", "error", "empty_parts", "ratio"}
PEERS = {"Zoltan RCB", "Zoltan RIB", "Zoltan HSFC", "Zoltan2 MJ"}


def quota_error(n, parts):
    counts = [(p + 1) * n // parts - p * n // parts for p in range(parts)]
    return max(abs(c * parts - n) / n for c in counts)


class Static(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.document, done = measure("static", "--points", "20001", "--parts", "7,8", "--ranks", "1,3", "--repeats",
                                     "2", "--scenes", "uniform,half-coincident,plane")
        cls.text = done.stdout

    def ours(self):
        return [row for row in self.document["rows"] if row["tool"] == "rcbd"]

    def test_every_row_has_its_fields(self):
        self.assertLessEqual({"bench", "commit", "machine", "rows"}, set(self.document))
        for row in self.document["rows"]:
            self.assertLessEqual(FIELDS, set(row), row)
            self.assertNotIn("failure", row)
            self.assertLessEqual(row["seconds_min"], row["seconds"])
            self.assertLessEqual(row["seconds"], row["seconds_max"])
            self.assertGreater(row["seconds_min"], 0)

    def test_every_cell_has_our_methods(self):
        for scene, dims in (("uniform", 3), ("half-coincident", 3), ("plane", 2)):
            for parts in (7, 8):
                for ranks in (1, 3):
                    methods = sorted((row["method"], row["work"]) for row in self.ours() if row["cut_tolerance"] == 0 and
                                     (row["scene"], row["parts"], row["ranks"]) == (scene, parts, ranks))
                    bands = [("bands-" + axis, "partition") for axis in "xyz"[:dims]]
                    self.assertEqual(methods, bands + [("rcb", "partition"), ("rcb", "partition+migrate")])

    def test_our_error_is_that_of_the_quotas(self):
        for row in self.ours():
            if row["cut_tolerance"] == 0:
                self.assertTrue(math.isclose(row["error"], quota_error(row["n"], row["parts"]), rel_tol=1e-12), row)
                self.assertEqual(row["empty_parts"], 0)

    def test_one_hash_on_any_number_of_ranks(self):
        hashes = {}
        for row in self.ours():
            key = (row["scene"], row["parts"], row["method"], row["cut_tolerance"])
            hashes.setdefault(key, set()).add(row["hash"])
        self.assertEqual({key: found for key, found in hashes.items() if len(found) != 1}, {})

    def test_ratios_stand_where_they_belong(self):
        def name_of(row):
            return "read" if row["tool"] == "floor" else row["tool"] + " " + row["method"]

        present = {name_of(row) for row in self.document["rows"] if row["tool"] != "rcbd"}
        self.assertLessEqual(present, PEERS | {"read"})
        self.assertIn("read", present)
        for row in self.document["rows"]:
            due = row["tool"] == "rcbd" and row["work"] == "partition" and row["cut_tolerance"] == 0
            self.assertEqual(set(row["ratio"]), present if due else set(), row)
            for name, ratio in row["ratio"].items():
                peer = next(r for r in self.document["rows"] if name_of(r) == name and
                            r["work"] == "partition" and all(r[f] == row[f] for f in ("scene", "parts", "ranks")))
                self.assertLessEqual(ratio, row["seconds_max"] / peer["seconds_min"])
                self.assertGreaterEqual(ratio, row["seconds_min"] / peer["seconds_max"])

    def test_what_passes_move_is_counted(self):
        for row in self.ours():
            self.assertGreaterEqual(row["reads"], 2)  # bounds and integers; all sets here are below the limit of buckets
            self.assertGreaterEqual(row["bytes_moved"], 8 * row["dims"] + 16 + 4)
            self.assertLess(row["bytes_moved"], 2000)
        for row in self.document["rows"]:
            if row["tool"] != "rcbd":
                self.assertNotIn("bytes_moved", row)

    def test_peers_are_judged_by_their_answers(self):
        bisections = [row for row in self.document["rows"] if row["tool"] == "Zoltan" and row["method"] == "RCB"]
        for row in bisections:  # with and without the hand-over
            self.assertLess(row["error"], 2 * row["parts"] / row["n"], row)

    def test_tables_name_what_was_run(self):
        for word in ("uniform", "half-coincident", "plane", "1 rank(s)", "3 rank(s)", "rcb +migrate"):
            self.assertIn(word, self.text)


class Sizes(unittest.TestCase):
    def test_several_numbers_of_points(self):
        document, done = measure("static", "--points", "3e4,20000", "--parts", "8", "--ranks", "2", "--repeats", "2",
                                 "--scenes", "uniform,plane", "--methods", "rcb,read")
        cells = {(row["scene"], row["n"]) for row in document["rows"]}
        self.assertEqual(cells, {(scene, n) for scene in ("uniform", "plane") for n in (20000, 30000)})
        self.assertEqual({entry["n"] for entry in document["summary"]}, {20000, 30000})
        rcb = [next(row for row in document["rows"] if row["work"] == "partition" and row["method"] == "rcb" and
                    (row["scene"], row["n"], row["cut_tolerance"]) == ("plane", n, 0)) for n in (30000, 20000)]
        line = next(line for line in done.stdout.partition("nanoseconds a point")[2].splitlines() if line.startswith("plane"))
        nanoseconds = [1e9 * row["seconds"] / row["n"] for row in rcb]
        self.assertEqual(line.split()[:4], ["plane", "8"] + [f"{value:.1f}" for value in nanoseconds])
        self.assertEqual(line.split()[4], f"{max(nanoseconds) / nanoseconds[0]:.2f}")


@unittest.skipIf(os.geteuid() != 0, "machines are made of network namespaces, which only root may")
class Hosts(unittest.TestCase):
    def test_what_is_counted_and_predicted(self):
        document, done = measure("hosts", "--hosts", "2", "--latency", "1", "--bandwidth", "1", "--points", "5000",
                                 "--repeats", "8")  # several, since heartbeats between them are counted, too
        self.assertEqual(document["bench"], "hosts")
        rows = {row["variant"]: row for row in document["rows"]}
        self.assertEqual(list(rows), ["sockets", "count-members", "partition"])
        # A count and its answer. Positions are a slice, that it is whole, the order, a reduction.
        self.assertEqual(rows["count-members"]["rounds"], 2)
        self.assertGreaterEqual(rows["sockets"]["rounds"], 4)
        self.assertGreater(rows["sockets"]["bytes"], 5000 / 2 * 24)
        for row in rows.values():
            self.assertEqual([row["latency"], row["bandwidth"], row["ranks"]], [0.0005, 1.25e8, 2])
            self.assertEqual(row["round_trips"] > 0, row["seconds"] > row["seconds_within"])
            self.assertAlmostEqual(row["ratio"]["model"], row["seconds"] / row["seconds_predicted"])
        self.assertIn("2 | 1.0 ms | 1.0", done.stdout)


class Scaling(unittest.TestCase):
    def test_memory_and_growth(self):
        document, _ = measure("scaling", "--points", "200000,400000", "--parts", "8,16", "--ranks", "2", "--repeats", "2",
                              "--methods", "rcb")
        cells = [(row["n"], row["parts"]) for row in document["rows"]]
        self.assertEqual(cells, [(200000, 8), (200000, 16), (400000, 8)])
        for row in document["rows"]:
            self.assertGreaterEqual(row["bytes_per_particle"], 3.5)  # the parts themselves are 4, in whole pages
        growth = document["summary"][0]
        first, _, last = document["rows"]
        self.assertAlmostEqual(growth["time_per_particle"]["ratio"],
                               last["seconds"] / last["n"] / (first["seconds"] / first["n"]))
        self.assertEqual(growth["time_per_particle"]["worst"], max(1, growth["time_per_particle"]["ratio"]))


class Figure(unittest.TestCase):
    def test_drawn(self):
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, "figure.svg")
            done = bench("static", "--points", "5000", "--parts", "8", "--ranks", "1", "--repeats", "1", "--scenes",
                         "uniform,offset", "--figure", path)
            self.assertEqual(done.returncode, 0, done.stderr)
            xml.dom.minidom.parse(path)
            with open(os.path.join(folder, "figure.gp")) as file:
                self.assertIn("# offset, tolerance 0", file.read())


class Refusals(unittest.TestCase):
    def test_wrong_usage(self):
        expect_refused(self, "rcb_bench", [], ["nonsense"], ["static", "--scenes", "nowhere"], ["static", "--parts", "0"],
                       ["static", "--ranks", "x"], ["static", "--methods", "magic"], ["scaling", "--points", "1.5"],
                       ["static", "--repeats", "0"], ["static", "--cut-tolerances", "-1"], ["hosts", "--hosts", "1"],
                       ["hosts", "--latency", "-1"], ["hosts", "--bandwidth", "0"])

    def test_unwritable_json(self):
        done = bench("static", "--points", "1000", "--parts", "2", "--ranks", "1", "--repeats", "1", "--scenes", "plane",
                     "--json", "/nonexistent/x.json")
        self.assertEqual(done.returncode, 1)
        self.assertIn("/nonexistent/x.json", done.stderr)

    def test_interrupted_run_leaves_nothing(self):
        with tempfile.TemporaryDirectory() as folder:
            process = subprocess.Popen([os.path.join(BIN, "rcb_bench"), "static", "--ranks", "3", "--scenes", "uniform"],
                                       stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True,
                                       env={**os.environ, "TMPDIR": folder})
            for line in process.stderr:
                if line.startswith("ranks 3"):
                    break
            process.send_signal(signal.SIGINT)
            process.stderr.read()
            self.assertEqual(process.wait(60), 1)
            process.stderr.close()
            self.assertEqual(os.listdir(folder), [])
            deadline = time.monotonic() + 30
            while time.monotonic() < deadline and self.ranks_of(folder):
                time.sleep(0.1)
            self.assertEqual(self.ranks_of(folder), [])

    @staticmethod
    def ranks_of(folder):
        found = []
        for pid in filter(str.isdigit, os.listdir("/proc")):
            try:
                with open(f"/proc/{pid}/cmdline", "rb") as file:
                    if folder.encode() in file.read():
                        found.append(pid)
            except OSError:
                pass
        return found


class Drift(unittest.TestCase):
    def test_few_searched_and_all_searched_agree(self):
        document, done = measure("drift", "--scenes", "plane", "--parts", "8", "--ranks", "2", "--repeats", "1")
        row, = document["rows"]
        ways = {way["way"]: way for way in row["ways"]}
        self.assertEqual(len(ways), 4)
        self.assertAlmostEqual(row["crossed"], 0.01, delta=0.002)
        self.assertEqual(len(row["read"]), 1)
        for name, way in ways.items():
            self.assertIn(name, done.stdout)
            self.assertAlmostEqual(way["times_read"], way["seconds"][0] / row["read"][0])
        for warm, cold in (("warm", "cold"), ("warm, pure rule", "cold, pure rule")):
            self.assertEqual(ways[warm]["hash"], ways[cold]["hash"])
            self.assertEqual(ways[warm]["moved"], ways[cold]["moved"])
            self.assertEqual(ways[cold]["looked_at"], row["n"])
        self.assertTrue(ways["warm"]["warm"])
        self.assertLess(ways["warm"]["looked_at"], row["n"] / 5)
        self.assertLessEqual(ways["warm"]["moved"], 2 * row["crossed"] * row["n"])

    def test_bad_arguments(self):
        for arguments in (["--scenes", "nope"], ["--crossed", "2"], ["--parts", "1"], ["--ranks", "0"], ["--repeats", "0"]):
            done = bench("drift", *arguments)
            self.assertEqual(done.returncode, 2, arguments)
            self.assertIn(arguments[0], done.stderr)


class Idle(unittest.TestCase):
    def test_cpu_and_latency_are_told(self):
        document, done = measure("idle", "--ranks", "2", "--seconds", "0.5", "--queries", "20", "--points", "1000", "--counts", "50")
        row, = document["rows"]
        self.assertEqual([row["ranks"], row["n"], row["work"]], [2, 1000, "idle"])
        self.assertGreaterEqual(row["processes"], 3)  # the ranks and their launcher
        self.assertGreaterEqual(row["seconds"], 0.5)
        self.assertGreaterEqual(row["seconds_cpu"], 0)
        self.assertAlmostEqual(row["share_of_a_core"], row["seconds_cpu"] / row["seconds"])
        self.assertEqual(row["counts"], 50)
        self.assertGreater(row["seconds_of_counts"], 0)
        for share in ("share_of_ranks_but_0", "share_of_ranks_but_0_in_counts"):
            self.assertGreaterEqual(row[share], 0)
        self.assertEqual(set(row["seconds_of_a_query"]), {"status", "error", "counts", "owner", "box"})
        for name, query in row["seconds_of_a_query"].items():
            self.assertIn(name + " ms", done.stdout)
            self.assertTrue(0 < query["median"] <= query["most"])

    def test_bad_arguments(self):
        for arguments in (["--ranks", "0"], ["--seconds", "0"], ["--queries", "0"], ["--counts", "0"], ["--points", "1.5"]):
            done = bench("idle", *arguments)
            self.assertEqual(done.returncode, 2, arguments)
            self.assertIn(arguments[0], done.stderr)


if __name__ == "__main__":
    unittest.main(verbosity=2)
