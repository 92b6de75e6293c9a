"""Every command of rcbctl, its --json fields as promised, its human form, and that neither mixes with the other."""
import judge
from protocol_client import Client
from push_client import Block, PushClient
from support import *

STEP_REPORT = {"scene", "step", "epoch", "n", "error_before", "error", "imbalance", "repartitioned", "reason",
               "axes_flipped", "drifted", "moved", "migrated", "inserted", "removed", "scanned", "searched", "rounds", "reductions",
               "skipped", "bytes", "way", "seconds"}
PARTITION = {"n", "dims", "parts", "ranks", "method", "error", "imbalance", "counts", "targets", "hash", "rounds",
             "reductions", "moved", "migrated", "seconds"}


class Commands(Refusals, ServiceTest):
    ranks = 3

    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.points = np.random.default_rng(8).random((400, 3))
        cls.file = cls.save("points.npy", cls.points)
        cls.service.json("scene", "create", "s", "--parts", 6, "--tolerance", "inf", "--axis-hysteresis", "1.5")
        cls.service.json("push", "s", cls.file)
        cls.tree, cls.part = judge.partition(cls.points, 6)

    @classmethod
    def named(cls, name):
        return os.path.join(cls.dir, name)

    def test_status_and_scenes(self):
        status = self.service.json("status")
        self.assertEqual(status["ranks"], 3)
        self.assertIn("s", [scene["scene"] for scene in status["scenes"]])
        shown = self.service.json("scene", "show", "s")
        self.assertEqual(shown["tolerance"], "inf")
        self.assertEqual((shown["parts"], shown["n"], shown["dims"], shown["axis_hysteresis"]), (6, 400, 3, 1.5))
        self.service.json("scene", "create", "t", "--parts", 2, "--dims", 1, "--part-sizes", "1,3")
        self.service.json("scene", "create", "t", "--parts", 3, "--replace")
        self.service.json("scene", "drop", "t")
        self.assertEqual(self.service.failure("scene", "show", "t")["code"], "not_found")

    def test_push_report(self):
        self.service.json("scene", "create", "p", "--parts", 4, "--replace")
        first = self.service.json("push", "p", self.file)
        self.assertLessEqual(STEP_REPORT, first.keys())
        self.assertEqual((first["step"], first["reason"], first["error_before"]), (0, "first positions", None))
        second = self.service.json("push", "p", self.file)
        self.assertEqual((second["step"], second["repartitioned"]), (1, False))
        self.assertEqual(self.service.json("push", "p", self.file, "--step", 9)["step"], 9)
        self.assertEqual(len(self.service.json("history", "p", "--last", 2)), 2)

    def test_a_particle_comes_into_a_scene_with_weights(self):
        some, more = self.named("some.csv"), self.named("more.csv")
        for name, rows in ((some, "0,0,0,1\n1,1,1,2\n"), (more, "0,0,0,1\n1,1,1,2\n.5,.5,.5,4\n")):
            write_text(name, "x,y,z,w\n" + rows)
        self.service.json("scene", "create", "w", "--parts", 2, "--replace")
        self.service.json("push", "w", some, "--weights", "w")
        self.assertIn("weights", self.service.failure("push", "w", some)["message"])
        self.assertIn("--inserted", self.service.failure("push", "w", more, "--weights", "w")["hint"])
        self.assertEqual(self.service.json("push", "w", more, "--weights", "w", "--inserted", 1)["inserted"], 1)
        self.assertEqual(sum(self.service.json("scene", "show", "w")["loads"]), 7)

    def test_files_of_the_service_have_absolute_paths(self):
        from protocol_client import Client, Refused
        client = Client(self.service.endpoint[5:])
        self.addCleanup(client.close)
        for command, field in (("write_parts", "directory"), ("load", "path")):
            with self.assertRaises(Refused) as caught:
                client.ask(command, scene="s", **{field: "somewhere"})
            self.assertEqual(caught.exception.args[0], "invalid_argument")
            self.assertIn("absolute", caught.exception.args[1])

    def test_policy_cost(self):
        self.service.json("scene", "create", "c", "--parts", 4, "--policy", "cost", "--replace")
        self.assertEqual(self.service.json("scene", "show", "c")["policy"], "cost")
        self.service.json("push", "c", self.file)
        moved = self.named("moved.csv")
        with open(moved, "w") as file:
            file.writelines(f"{x * x + y},{y},{z}\n" for x, y, z in self.points)
        steps = [self.service.json("push", "c", moved, "--step-seconds", 1000) for _ in range(2)]
        self.assertEqual([step["repartitioned"] for step in steps], [True, False], "the first one would lose more")
        self.assertGreater(steps[0]["error_before"], 0.01)
        for step in steps:
            self.assertIn("imbalance has cost", step["reason"])
        untimed = self.service.json("push", "c", moved)
        self.assertIn("no step time was told", untimed["reason"])
        self.assertIn("step-seconds", self.service.failure("push", "c", moved, "--step-seconds", "-1")["message"])

    def test_partition_fields(self):
        result = self.service.json("partition", self.file, "--parts", 5)
        self.assertLessEqual(PARTITION, result.keys())
        self.assertEqual(set(result["seconds"]), {"read", "partition", "migrate", "write", "total"})
        self.assertEqual(len(result["hash"]), 16)
        self.assertEqual([scene["scene"] for scene in self.service.json("status")["scenes"]
                          if "partition" in scene["scene"]], [], "the scene was left behind")

    def test_reads(self):
        error = self.service.json("error", "s")
        self.assertEqual(error["error"], judge.error_of(judge.quotas(400, 6), 400))
        counts = self.service.json("counts", "s")
        self.assertEqual(counts["counts"], judge.quotas(400, 6))
        self.assertEqual(counts["targets"], [400 / 6] * 6)
        cuts = self.service.json("cuts", "s")
        self.assertEqual(len(cuts["cuts"]), 5)
        self.assertEqual(self.service.json("stats", "s")["steps"], 1)
        assign = self.named("a.npy")
        self.service.json("assign", "s", "--out", assign)
        np.testing.assert_array_equal(np.load(assign), self.part)

    def test_regions_hold_their_points(self):
        for region in self.service.json("cuts", "s")["regions"]:
            inside = self.points[self.part == region["part"]]
            for axis in range(3):
                if region["lo"][axis] is not None:
                    self.assertGreaterEqual(inside[:, axis].min(), region["lo"][axis])
                if region["hi"][axis] is not None:
                    self.assertLessEqual(inside[:, axis].max(), region["hi"][axis])

    def test_owner_and_box(self):
        for k in (0, 57, 399):
            answer = self.service.json("owner", "s", *[repr(float(c)) for c in self.points[k]], "--id", k)
            self.assertEqual(answer["owner"], self.part[k])
        self.assertEqual(self.service.ctl("owner", "s", "-.5", "1e3", "-2").returncode, 0)
        cut = self.service.json("cuts", "s")["cuts"][0]
        at = [0.5, 0.5, 0.5]
        at[cut["axis"]] = cut["at"]
        for axis, value in zip(cut["ties"]["axes"], cut["ties"]["at"]):
            at[axis] = value
        answer = self.service.json("owner", "s", *map(repr, at))
        self.assertIsNone(answer["owner"])
        self.assertEqual(len(answer["candidates"]), 2)
        box = self.service.json("box", "s", 0, 0, 0, 1, 1, 1)
        self.assertEqual(box["parts"], list(range(6)))
        self.assertEqual(self.service.failure("box", "s", 1, 1, 1, 0, 0, 0)["code"], "invalid_argument")

    def test_quality_against_all_pairs(self):
        width = 0.1
        quality = self.service.json("quality", "s", "--ghost-width", width)
        for p in range(6):
            mine = self.points[self.part == p]
            near = ((self.points >= mine.min(axis=0) - width) & (self.points <= mine.max(axis=0) + width)).all(axis=1)
            ghosts = near & (self.part != p)
            self.assertEqual(quality["ghosts"][p], ghosts.sum())
            self.assertEqual(quality["neighbours"][p], len(np.unique(self.part[ghosts])))

    def test_compare(self):
        table = self.service.json("compare", self.file, "--parts", 8)
        rows = {row["method"]: row for row in table["methods"]}
        self.assertEqual(list(rows), ["equal-boxes", "file-order", "bands-x", "bands-y", "bands-z", "rcb"])
        for method in ("bands-x", "bands-y", "bands-z", "rcb"):
            _, part = judge.partition(self.points, 8, method)
            self.assertEqual(rows[method]["counts"], list(np.bincount(part, minlength=8)))
            self.assertEqual(rows[method]["error"], 0)
        blocks = np.bincount(np.repeat(np.arange(8), judge.quotas(400, 8)), minlength=8)
        self.assertEqual(rows["file-order"]["counts"], list(blocks))
        self.assertIsNone(rows["file-order"]["interface_area"])
        self.assertLess(rows["rcb"]["interface_area"], rows["bands-x"]["interface_area"])
        self.assertEqual(rows["equal-boxes"]["counts"], np.bincount(self.halves(8), minlength=8).tolist())

    def test_compare_in_a_scene(self):
        """Its fields are those of PROTOCOL.md, its rules those of design.md: with weights, part sizes, a cut tolerance and
        a number of parts that is no power of two."""
        rng = np.random.default_rng(12)
        weights, sizes = rng.integers(1, 9, 400).astype(float), [1, 3, 1, 2, 2]
        with PushClient(self.path) as client:
            client.ask("scene.create", scene="compared", parts=5, part_sizes=sizes, cut_tolerance=1)
            client.push_block("compared", 0, Block(self.points, weights=weights))
            table = client.ask("compare", scene="compared", ghost_width=0.1)[0]
            self.assertIn("sizes for 5 parts", self.refused("invalid_argument", client.ask, "compare", scene="compared", parts=8))
            weighted = {row["method"]: row for row in table["methods"]}
            client.ask("scene.create", scene="compared", parts=5, part_sizes=sizes, cut_tolerance=1, replace=True)
            client.push("compared", 0, self.points)
            unweighted = client.ask("compare", scene="compared", methods=["rcb"])[0]["methods"][0]
        self.assertEqual(table.keys(), {"scene", "n", "parts", "ghost_width", "methods", "positions_step"})
        self.assertEqual(unweighted["counts"], judge.quotas(400, 5, sizes), "exact, whatever the scene's cut tolerance")
        targets = weights.sum() * np.array(sizes) / sum(sizes)
        blocks = np.repeat(np.arange(5), judge.quotas(400, 5, sizes))
        for method, part in (("equal-boxes", self.halves(5)), ("file-order", blocks)):
            row = weighted[method]
            self.assertEqual(row.keys(), {"method", "error", "imbalance", "errors", "counts", "ghost_width", "interface_area",
                                          "interface_areas", "neighbours", "ghosts", "seconds"})
            self.assertEqual(row["counts"], np.bincount(part, minlength=5).tolist(), method)
            loads = np.bincount(part, weights, minlength=5)
            np.testing.assert_allclose(row["errors"], abs(loads - targets) / targets, rtol=1e-14)
            self.assertEqual(row["error"], max(row["errors"]))
        self.assertIsNone(weighted["file-order"]["interface_areas"])

    def halves(self, parts):
        """The part of each point by equal-boxes."""
        part = np.zeros(len(self.points), int)

        def halve(idx, a, b, lo, hi):
            if b - a == 1:
                part[idx] = a
                return
            m = a + (b - a + 1) // 2
            axis = judge.order_by_extent([h / 2 - l / 2 for l, h in zip(lo, hi)])[0]
            middle = lo[axis] / 2 + hi[axis] / 2
            right = self.points[idx, axis] >= middle
            halve(idx[~right], a, m, lo, [*hi[:axis], middle, *hi[axis + 1:]])
            halve(idx[right], m, b, [*lo[:axis], middle, *lo[axis + 1:]], hi)

        halve(np.arange(len(self.points)), 0, parts, list(self.points.min(axis=0)), list(self.points.max(axis=0)))
        return part

    def test_rebalance(self):
        self.service.json("scene", "create", "r", "--parts", 4, "--tolerance", "inf", "--replace")
        self.service.json("push", "r", self.file)
        moved = self.named("moved.npy")
        np.save(moved, self.points ** 2)
        self.service.json("push", "r", moved)
        dry = self.service.json("rebalance", "r", "--dry-run")
        tree, before = judge.partition(self.points, 4)
        before = tree.assign(self.points ** 2)
        _, after = judge.partition(self.points ** 2, 4)
        self.assertEqual(dry["moved"], int((before != after).sum()))
        self.assertEqual(dry["error"], 0)
        self.assertIn("quality", dry)
        self.assertEqual(self.service.json("error", "r")["epoch"], 1)
        more, _ = judge.partition(self.points ** 2, 8)  # whose node of the parts 0 to 3 is compared with the root of 4
        flipped = [node for node in more.cuts if node in tree.cuts and more.cuts[node][0][0] != tree.cuts[node][0][0]]
        self.assertEqual(self.service.json("rebalance", "r", "--dry-run", "--parts", 8)["axes_flipped"], len(flipped))
        done = self.service.json("rebalance", "r", "--parts", 5, "--method", "bands-y", "--tolerance", 0.3)
        self.assertEqual(done["epoch"], 2)
        shown = self.service.json("scene", "show", "r")
        self.assertEqual((shown["parts"], shown["method"], shown["tolerance"]), (5, "bands-y", 0.3))
        self.assertEqual(len(self.service.json("history", "r")), 2)

    def test_export(self):
        out = self.named("export")
        self.service.json("export", "s", out, "--format", "csv,npy,vtk")
        self.assertGreaterEqual(len(os.listdir(out)), 3)

    def test_ids_that_no_double_holds_are_exported_exactly(self):
        ids = [2 ** 53, 2 ** 53 + 1, 2 ** 63 - 1]
        table, out = self.named("large_ids.csv"), self.named("large_ids")
        write_text(table, "id,x,y,z\n" + "".join(f"{id},{k},0,0\n" for k, id in enumerate(ids)))
        self.service.json("scene", "create", "large_ids", "--parts", 2)
        self.service.json("push", "large_ids", table)
        self.service.json("export", "large_ids", out, "--format", "npy,vtk")
        self.assertEqual(np.load(os.path.join(out, "id.npy")).tolist(), ids)
        with open(os.path.join(out, "large_ids.vtk"), "rb") as file:
            values = file.read().split(b"SCALARS id vtktypeint64 1\nLOOKUP_TABLE default\n")[1]
        self.assertEqual(np.frombuffer(values[:24], ">i8").tolist(), ids)

    def test_human_output_keeps_the_streams_apart(self):
        for args in (("status",), ("counts", "s"), ("cuts", "s"), ("history", "s"), ("quality", "s"), ("stats", "s")):
            done = self.service.ctl(*args, check=True)
            self.assertTrue(done.stdout.strip(), args)
            self.assertEqual(done.stderr, "", args)
        wrong = self.service.ctl("counts", "nobody")
        self.assertEqual((wrong.returncode, wrong.stdout), (1, ""))
        self.assertIn("nobody", wrong.stderr)

    def test_help_and_version(self):
        for program in ("rcbctl", "rcbd", "two_spheres", "slope"):
            for flag in ("--help", "--version"):
                done = run(flag, program=os.path.join(BIN, program))
                self.assertEqual((done.returncode, done.stderr), (0, ""), (program, flag))
        for command in ("up", "down", "status", "partition", "compare", "scene", "push", "replay", "error", "counts",
                        "cuts", "history", "stats", "owner", "box", "halo", "neighbours", "assign", "quality", "rebalance", "export", "watch"):
            done = run(command, "--help", check=True)
            self.assertIn(command, done.stdout)

    def test_a_solvers_scene_is_pushed_by_force_alone(self):
        points = np.random.default_rng(5).random((50, 3))
        path = self.save("foreign.npy", points)
        with Client(self.path) as solver:
            solver.ask("scene.create", scene="theirs", parts=2, replace=True)
            solver.ask("scene.open", scene="theirs")
            solver.push("theirs", 0, points)
            failure = self.service.failure("push", "theirs", path)
            self.assertEqual((failure["code"], failure["exit"]), ("busy", 1))
            self.assertIn("e2e", failure["message"])
            self.assertIn("--force", failure["hint"])
            solver.push("theirs", 1, points + 1)  # it goes on
            self.assertEqual(self.service.json("push", "theirs", path, "--force")["step"], 2)
            solver.ask("scene.close", scene="theirs")
            self.assertEqual(self.service.json("push", "theirs", path)["step"], 3)

    def test_scene_is_not_replaced_under_a_client(self):
        solver = subprocess.Popen([os.path.join(BIN, "two_spheres"), "--points", "60000", "--steps", "100", "--scene",
                                   "held", "--endpoint", self.service.endpoint], stdout=subprocess.DEVNULL,
                                  stderr=subprocess.DEVNULL)
        try:
            for _ in range(200):
                if any(scene["scene"] == "held" and scene["step"] is not None
                       for scene in self.service.json("status")["scenes"]):
                    break
            failure = self.service.failure("scene", "create", "held", "--parts", 2, "--replace")
            self.assertEqual(failure["code"], "busy")
            self.assertIn("two_spheres", failure["message"])
        finally:
            solver.terminate()
            solver.wait(30)


if __name__ == "__main__":
    unittest.main(verbosity=2)
