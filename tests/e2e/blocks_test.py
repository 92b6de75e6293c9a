"""A step's positions are blocks: rows in any order, with particles that come and go, by every way. All lead to the same
scene; what can't be so is refused and changes nothing."""
import judge
from protocol_client import Client, arrays_of
from push_client import WAYS, Block, PushClient
from support import *

DIFFERING = ("scene", "seconds", "way")


class Blocks(Refusals, ServiceTest):
    ranks = 3

    def pusher(self, way):
        client = PushClient(self.path, way)
        self.addCleanup(client.close)
        return client

    def state(self, scene):
        """(the scene, what it holds by name); ids ascend."""
        with Client(self.path) as client:
            return client.ask("scene.show", scene=scene)[0], arrays_of(*client.ask("fetch", scene=scene))

    def check(self, scene, block):
        """No particle lost, and each where the block has it."""
        shown, held = self.state(scene)
        ids = np.arange(len(block.points)) if block.ids is None else block.ids
        rows = np.argsort(ids)
        for name, values in ({"id": ids} | block.columns()).items():
            np.testing.assert_array_equal(held[name], values[rows].astype(held[name].dtype), name)
        np.testing.assert_array_equal(np.bincount(held["part"], minlength=shown["parts"]), shown["counts"])
        return {name: shown[name] for name in ("hash", "counts", "error", "epoch", "ids", "n")}, held["part"].tobytes()

    def test_every_way_leads_to_the_same_scene(self):
        for seed, dims, tolerance in ((1, 3, 0.2), (2, 2, 0.05), (3, 1, "inf"), (4, 3, 0.1)):
            rng = np.random.default_rng(seed)
            clients = {way: self.pusher(way) for way in (*WAYS, "any")}
            block = Block(rng.random((500, dims)), rng.permutation(2000)[:500], rng.random(500) if seed % 2 == 0 else None)
            for way, client in clients.items():
                client.ask("scene.create", scene=f"{way}-{seed}", parts=7, dims=dims, tolerance=tolerance)
            for step in range(16):
                with self.subTest(seed=seed, step=step):
                    more = self.next(rng, block) if step > 0 else {}
                    self.one_step(rng, clients, seed, step, block, more)
            # A cold partition of the same particles cuts the same.
            clients["endpoint"].ask("scene.create", scene="cold", parts=7, dims=dims, replace=True)
            clients["endpoint"].push_block("cold", 0, block)
            for way, client in clients.items():
                client.ask("rebalance", scene=f"{way}-{seed}")
                for name in ("hash", "counts", "n"):
                    self.assertEqual(self.state(f"{way}-{seed}")[0][name], self.state("cold")[0][name])

    def next(self, rng, block):
        """Moves the block on, in another order; some leave and some come."""
        gone, come = (int(rng.integers(40)) * int(rng.integers(2)) for _ in range(2))
        rows = rng.permutation(len(block.ids))[gone:]
        block.dtype = str(rng.choice(["<f8", "<f4"]))
        block.points = np.concatenate([block.points[rows] + rng.normal(0, 0.05, (len(rows), block.points.shape[1])),
                                       rng.random((come, block.points.shape[1]))]).astype(block.dtype)
        block.ids = np.append(block.ids[rows], 3000 + block.ids.max() + rng.permutation(come))
        if block.weights is not None:
            block.weights = np.append(block.weights[rows], rng.random(come))
        return {"inserted": come, "removed": gone}

    def one_step(self, rng, clients, seed, step, block, more):
        reports, states = [], []
        for way, client in clients.items():
            order, way_now = rng.permutation(len(block.ids)), str(rng.choice(WAYS)) if way == "any" else way
            mine = Block(block.points[order], block.ids[order], None if block.weights is None else block.weights[order],
                         block.dtype)
            deal = np.split(rng.permutation(len(order)), np.sort(rng.integers(0, len(order), 2)))
            answer, _ = client.push_block(f"{way}-{seed}", step, mine, way=way_now, deal=deal, each=100, **more)
            report = answer["report"]
            self.assertEqual(report["way"], way_now)
            self.assertEqual((report["inserted"], report["removed"]), (more.get("inserted", 0), more.get("removed", 0)))
            width = int(block.dtype[2]) * block.points.shape[1] + 8 + (0 if block.weights is None else 8)
            self.assertEqual((report["scanned"], report["bytes"]), (len(order), width * len(order)))
            self.assertEqual("double precision" in report["skipped"], block.dtype == "<f4")
            report["skipped"] = [skip for skip in report["skipped"] if skip != "exchange"]  # by who got which rows
            reports.append({name: value for name, value in report.items() if name not in DIFFERING})
            states.append(self.check(f"{way}-{seed}", mine))
        for report, state in zip(reports[1:], states[1:]):
            self.assertEqual((report, state), (reports[0], states[0]))

    def test_rows_whose_numbers_are_their_ids(self):
        walk = random_walk(4, 3000)
        expected = judge.reports(walk, 7, self.ranks)
        for way in (*WAYS, "held"):
            client = self.pusher("shared-memory" if way == "held" else way)
            client.ask("scene.create", scene=way, parts=7)
            before = None
            for step, points in enumerate(walk):
                more = {"drifted": expected[step]["drifted"]} if step % 2 else {}
                if way == "held":  # each rank reads what it holds, and finds what has drifted
                    more = {"counts": None, "memory": client.laid_out(Block(points), np.arange(0))[:-1]}
                deal = np.array_split(np.random.default_rng(step).permutation(3000), 3) if way == "shared-memory" else None
                report = client.push_block(way, step, Block(points), deal=deal, **more)[0]["report"]
                if way != "held" and not step % 2:
                    self.assertEqual(report["drifted"], 0 if step == 0 else None)
                    report["drifted"] = expected[step]["drifted"]
                self.assertEqual({name: report[name] for name in expected[step]}, expected[step])
                before = before or self.check(way, Block(points))
            self.assertFalse(self.state(way)[0]["ids"])

    def test_ids_and_weights_that_come_or_stay_away(self):
        points, ids, ones = np.random.default_rng(5).random((300, 3)), np.arange(300)[::-1], np.ones(300)
        for way in WAYS:
            client = self.pusher(way)
            client.ask("scene.create", scene="later", parts=5, replace=True)
            client.push_block("later", 0, Block(points))
            self.refused("invalid_argument", client.push_block, "later", 1, Block(points, weights=ones))
            for step, block in enumerate((Block(points, ids), Block(points + 1), Block(points[1:], ids[1:])), 1):
                client.push_block("later", step, block, removed=300 - len(block.points))  # all but the last are 0..n-1
                self.check("later", block)
                self.assertFalse(self.state("later")[0]["ids"])
            client.push_block("later", 4, Block(points[2:], ids[1:-1]), removed=1)
            self.assertTrue(self.state("later")[0]["ids"])
            self.assertIn("ids", self.refused("invalid_argument", client.push_block, "later", 5, Block(points[2:])))
            client.ask("scene.create", scene="later", parts=5, replace=True)
            client.push_block("later", 0, Block(points, weights=ones))
            self.assertIn("weights", self.refused("invalid_argument", client.push_block, "later", 1, Block(points)))
            client.push_block("later", 1, Block(points, weights=ones * 3))
            self.check("later", Block(points, weights=ones * 3))
            incarnation = client.ask("scene.show", scene="later")[0]["incarnation"]
            client.push_block("later", 2, Block(points, weights=ones), incarnation=incarnation)
            self.refused("not_found", client.push_block, "later", 3, Block(points, weights=ones), incarnation="0" * 16)

    def test_what_is_refused_changes_nothing(self):
        points, ids = np.random.default_rng(5).random((300, 3)), np.arange(300)
        nan, twin, negative = points.copy(), np.append(ids[:-1], 7), np.append(ids[:-1], -2)
        nan[17, 1] = np.nan
        fewer = Block(points[1:], ids[1:])
        for way in WAYS:
            scene, client = "refused-" + way, self.pusher(way)
            client.ask("scene.create", scene=scene, parts=5)
            self.assertIn("id 7 occurs", self.refused("duplicate_id", client.push_block, scene, 4, Block(points, twin)))
            client.push_block(scene, 4, Block(points, ids))
            before = [str(x) for x in self.state(scene)]
            for code, words, block, more in (
                    ("not_conserved", ("299", "300"), fewer, {}),
                    ("not_conserved", ("300", "1 come"), Block(points, ids), {"inserted": 1}),
                    ("not_conserved", ("299", "300", "2 go"), fewer, {"removed": 2}),
                    ("not_conserved", ("300",), Block(points, ids), {"removed": 301}),
                    ("not_conserved", (), Block(points, ids + 1), {}),
                    ("not_conserved", ("0 ", "300"), Block(points[:0], ids[:0]), {}),
                    ("invalid_argument", ("ids",), Block(points), {"inserted": 1, "removed": 1}),
                    ("duplicate_id", ("id 7 occurs",), Block(points, twin), {"inserted": 1, "removed": 1}),
                    ("invalid_argument", ("-2",), Block(points, negative), {"inserted": 1, "removed": 1}),
                    ("not_finite", ("17",), Block(nan, ids), {}),
                    ("invalid_argument", ("weights",), Block(points, ids, points[:, 0]), {}),
                    ("invalid_argument", ("counts",), Block(points, ids), {"counts": [300, 0]}),
                    ("invalid_argument", ("counts",), Block(points, ids), {"counts": [300, 1, 0]}),
                    ("invalid_argument", ("counts",), Block(points, ids), {"counts": [300.5, -0.5, 0]})):
                if "counts" in more and way == "endpoint":
                    continue
                with self.subTest(way=way, code=code, words=words, more=more):
                    said = self.refused(code, client.push_block, scene, 5, block, **more)
                    for word in words:
                        self.assertIn(word, said)
                    self.assertEqual([str(x) for x in self.state(scene)], before)
                if client.links:  # rows of a push that was refused at its begin may be on their way
                    client.close()
                    client = self.pusher(way)
            self.assertIn("4", self.refused("stale_step", self.pusher(way).push_block, scene, 4, Block(points, ids)))
            client.push_block(scene, 5, Block(points[2:], ids[2:]), removed=2)
            for more in ({}, {"counts": [-1] * 3}, {"inserted": 7}, {"n": 9}):  # whatever it says and brings
                self.assertTrue(client.push_block(scene, 5, Block(points, ids), **more)[0]["repeated"])
            self.check(scene, Block(points[2:], ids[2:]))

    def test_a_client_that_dies_leaves_the_previous_step(self):
        points, ids = np.random.default_rng(6).random((300, 3)), np.arange(300)
        for way in WAYS:
            scene, client = "dies-" + way, self.pusher(way)
            client.ask("scene.create", scene=scene, parts=5)
            client.push_block(scene, 0, Block(points, ids))
            before = [str(x) for x in self.state(scene)]
            for left in (0, 1):  # all but so many of its frames, and a byte; by memory the push alone
                client = self.pusher(way)
                begin, slices = client.frames(scene, 1, Block(points + 1, ids), by_socket=[1, 2])
                for link, data in [(client.socket, begin), *slices][:-1 - left]:
                    link.sendall(data)
                if slices:
                    slices[-1][0].sendall(slices[-1][1][:-1 - 1000 * left])
                client.close()
                self.assertEqual([str(x) for x in self.state(scene)], before)
            self.pusher(way).push_block(scene, 1, Block(points + 2, ids))
            self.check(scene, Block(points + 2, ids))

    def test_the_command_line(self):
        rng = np.random.default_rng(9)
        points = rng.random((400, 3)).astype("<f4")
        self.service.json("scene", "create", "ctl", "--parts", 5)
        report = self.service.json("push", "ctl", self.save("a.npy", points))
        self.assertEqual(report["bytes"], 400 * 12)
        self.assertIn("double precision", report["skipped"])
        block = Block(points.astype("<f8"), np.append(np.arange(2, 400), (1000, 500)))

        def file(block):
            path = os.path.join(self.dir, "b.csv")
            np.savetxt(path, np.column_stack([block.ids, block.points]), "%.17g", ",", header="id,x,y,z", comments="")
            return path

        report = self.service.json("push", "ctl", file(block), "--inserted", 2, "--removed", 2)
        self.assertEqual((report["inserted"], report["removed"], report["n"]), (2, 2, 400))
        self.check("ctl", block)
        fewer = Block(block.points[1:], block.ids[1:])
        for more in ((), ("--inserted", 1), ("--removed", 2)):
            failure = self.service.failure("push", "ctl", file(fewer), *more)
            self.assertEqual((failure["code"], failure["exit"]), ("not_conserved", 1))
        self.assertEqual(self.service.ctl("push", "ctl").returncode, 2)
        self.check("ctl", block)
        self.service.json("push", "ctl", file(fewer), "--removed", 1)
        self.check("ctl", fewer)


if __name__ == "__main__":
    unittest.main(verbosity=2)
