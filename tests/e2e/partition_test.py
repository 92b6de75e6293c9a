"""rcbctl partition against the judge: every particle's part, counts, one hash for any number of ranks."""
import judge
from support import *


class Partition(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.dir = tempfile.mkdtemp(prefix="rcb-partition-")
        cls.hashes = {}
        cls.scenes = hard_scenes()
        for name, points in cls.scenes.items():
            np.save(os.path.join(cls.dir, name + ".npy"), points)

    @classmethod
    def tearDownClass(cls):
        shutil.rmtree(cls.dir)

    def check(self, service, name, parts, method="rcb", extra=()):
        points = self.scenes[name]
        assign, cuts = os.path.join(self.dir, "a.npy"), os.path.join(self.dir, "c.json")
        result = service.json("partition", os.path.join(self.dir, name + ".npy"), "--parts", parts, "--method", method,
                              "--assign", assign, "--cuts", cuts, *extra)
        where = f"{name}, {parts} parts, {method}, {service.ranks} ranks"
        tree, expected = judge.partition(points, parts, method)
        part = np.load(assign)
        self.assertEqual(part.dtype, np.int32, where)
        np.testing.assert_array_equal(part, expected, err_msg=where)
        self.assertEqual(result["counts"], judge.quotas(len(points), parts), where)
        self.assertEqual(result["error"], judge.error_of(result["counts"], len(points)), where)
        self.assertEqual(result["n"], len(points))
        self.assertEqual(result["dims"], points.shape[1])
        self.assertEqual(self.hashes.setdefault((name, parts, method), result["hash"]), result["hash"], where)
        self.check_cuts(json.loads(text_of(cuts)), tree, result, where)

    def check_cuts(self, document, tree, result, where):
        self.assertEqual(document["hash"], result["hash"])
        self.assertEqual(len(document["cuts"]), tree.parts - 1)
        self.assertEqual(len(document["regions"]), tree.parts)
        by_node = {cut["node"]: cut for cut in document["cuts"]}

        def walk(node, a, b):
            if b - a == 1:
                return
            m = a + (b - a + 1) // 2
            axes, key = tree.cuts[(a, b)]
            cut = by_node[node]
            self.assertEqual(cut["axis"], axes[0], where)
            if key is None:
                self.assertIsNone(cut["at"])
                self.assertIsNone(cut["ties"])
            else:
                self.assertEqual(cut["at"], key[0], where)
                self.assertEqual(cut["ties"], {"axes": axes[1:], "at": key[1:-1], "id": key[-1]}, where)
            for side, (lo, hi) in (("left", (a, m)), ("right", (m, b))):
                child = cut[side]
                self.assertEqual(child, {"part": lo} if hi - lo == 1 else {"node": child.get("node")}, where)
                walk(child.get("node"), lo, hi)

        walk(0, 0, tree.parts)

    def test_every_scene_on_any_number_of_ranks(self):
        for ranks in (1, 2, 3, 4, 8):
            with Service(ranks) as service:
                for name in self.scenes:
                    for parts in (1, 7, 8, 13, 37, 64):
                        self.check(service, name, parts)
                for name in ("lattice", "half_coincident", "few"):
                    self.check(service, name, 4096)
                for method in ("bands-x", "bands-y", "bands-z"):
                    self.check(service, "lattice", 8, method)
                    self.check(service, "decades", 7, method)

    def test_embedded_service_and_files_by_part(self):
        points = self.scenes["uniform"]
        csv = os.path.join(self.dir, "uniform.csv")
        np.savetxt(csv, points, delimiter=",", header="x,y,z", comments="", fmt="%.17g")
        out = os.path.join(self.dir, "out")
        assign = os.path.join(self.dir, "embedded.npy")
        done = run("partition", csv, "--parts", 5, "--ranks", 3, "--out", out, "--assign", assign, "--json",
                   endpoint="unix:/nonexistent/socket", check=True)
        result = json.loads(done.stdout)
        self.assertEqual(result["ranks"], 3)
        _, expected = judge.partition(points, 5)
        np.testing.assert_array_equal(np.load(assign), expected)
        files = sorted(os.listdir(out))
        self.assertEqual(len(files), 5)
        for part, name in enumerate(files):
            table = np.genfromtxt(os.path.join(out, name), delimiter=",", names=True)
            ids = np.sort(table["id"].astype(int))
            np.testing.assert_array_equal(ids, np.flatnonzero(expected == part))
            order = np.argsort(table["id"])
            np.testing.assert_array_equal(table["x"][order], points[ids, 0])

    def test_part_files_keep_further_columns(self):
        """As the text that they were, with the rows in any order of their ids; also a file without names."""
        points = self.scenes["uniform"][:200]
        ids = np.random.default_rng(5).permutation(200) * 3
        rows = {int(i): [repr(float(v)) for v in p] + [f"{i % 7}.50", f'"kind, {i % 3}"'] for i, p in zip(ids, points)}
        named = os.path.join(self.dir, "further.csv")
        write_text(named, "vx,id,x,y,z,kind\n" + "".join(f"{r[3]},{i},{r[0]},{r[1]},{r[2]},{r[4]}\n" for i, r in rows.items()))
        plain = os.path.join(self.dir, "further.txt")
        write_text(plain, "".join(f"{r[0]} {r[1]} {r[2]} {r[3]}\n" for r in rows.values()))
        with Service(2) as service:
            for place in ([], ["--ranks", 2]):
                out = os.path.join(self.dir, "further" + "-".join(map(str, place)))
                service.json("partition", named, "--parts", 3, "--out", out, *place)
                seen = {}
                for name in sorted(os.listdir(out)):
                    head, *lines = text_of(out, name).splitlines()
                    self.assertEqual(head, "x,y,z,id,vx,kind")
                    for x, y, z, i, rest in (line.split(",", 4) for line in lines):
                        seen[int(i)] = [*(repr(float(v)) for v in (x, y, z)), *rest.split(",", 1)]
                self.assertEqual(seen, rows)
                service.json("partition", plain, "--dims", 3, "--parts", 3, "--out", out, *place)
                head, first, *_ = text_of(out, "part-0.csv").splitlines()
                self.assertEqual(head, "x,y,z,id,column3")
                self.assertEqual(first.split(",")[4], list(rows.values())[int(first.split(",")[3])][3])

    def test_part_files_are_all_there_or_none(self):
        """Where one of them can't be written, as on a full disk."""
        csv = os.path.join(self.dir, "sizes.csv")
        np.savetxt(csv, self.scenes["uniform"], delimiter=",", header="x,y,z", comments="", fmt="%.17g")
        with Service(2) as service:
            for place in ([], ["--ranks", 2]):
                out = os.path.join(self.dir, "blocked" + "-".join(map(str, place)))
                os.makedirs(os.path.join(out, "part-2.csv"))
                failure = service.failure("partition", csv, "--parts", 3, "--out", out, *place)
                self.assertIn("part-2.csv: is a directory", failure["message"])
                self.assertEqual(os.listdir(out), ["part-2.csv"])
            missing = os.path.join(self.dir, "never", "made")
            limited = f"ulimit -f 20; exec {RCBCTL} partition {csv} --parts 3 --part-sizes 1,1,20 --out {missing}"
            done = run("-c", limited, program="/bin/bash", endpoint=service.endpoint)
            self.assertEqual(done.returncode, 1, done.stdout)
            self.assertIn("part-2.csv", done.stderr)
            self.assertFalse(os.path.exists(missing))

    def test_a_part_without_points_is_a_file_that_can_be_read(self):
        csv = os.path.join(self.dir, "two.csv")
        write_text(csv, "x,y\n1,2\n3,4\n")
        out = os.path.join(self.dir, "two")
        done = run("partition", csv, "--parts", 3, "--ranks", 2, "--out", out, "--json", check=True)
        counts = json.loads(done.stdout)["counts"]
        self.assertEqual(sorted(counts), [0, 1, 1])
        for count, name in zip(counts, sorted(os.listdir(out))):
            lines = text_of(out, name).splitlines()
            self.assertEqual((lines[0], len(lines)), ("x,y,id", 1 + count))
            again = run("partition", os.path.join(out, name), "--parts", 1, "--ranks", 1, "--json", check=True)
            self.assertEqual(json.loads(again.stdout)["n"], count)

    def test_no_point(self):
        empty = os.path.join(self.dir, "empty.csv")
        write_text(empty, "x,y,z\n")
        done = run("partition", empty, "--parts", 3, "--ranks", 2, "--json", check=True)
        result = json.loads(done.stdout)
        self.assertEqual((result["n"], result["counts"], result["error"], result["imbalance"]), (0, [0, 0, 0], 0, 1))
        self.assertIn("no points", done.stderr)

    def test_weights_and_part_sizes(self):
        points = self.scenes["uniform"]
        csv = os.path.join(self.dir, "weighted.csv")
        weight = np.arange(len(points)) % 7
        np.savetxt(csv, np.column_stack([points, weight]), delimiter=",", header="x,y,z,w", comments="", fmt="%.17g")
        hashes = set()
        for ranks in (1, 3):
            done = run("partition", csv, "--parts", 6, "--ranks", ranks, "--weights", "w", "--json", check=True)
            result = json.loads(done.stdout)
            self.assertAlmostEqual(sum(result["loads"]), weight.sum())
            self.assertLess(result["error"], 6 * 7 / weight.sum() * 6)
            hashes.add(result["hash"])
        self.assertEqual(len(hashes), 1)
        sizes = [1, 2, 0.5, 4]
        done = run("partition", os.path.join(self.dir, "uniform.npy"), "--parts", 4, "--ranks", 2, "--part-sizes",
                   ",".join(map(str, sizes)), "--json", check=True)
        self.assertEqual(json.loads(done.stdout)["counts"], judge.quotas(len(points), 4, sizes))


if __name__ == "__main__":
    unittest.main(verbosity=2)
