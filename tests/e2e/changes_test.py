"""Steps that are more or less than all positions: few moved, none, float32, particles inserted and removed. By every
path and in every order they lead to the scene that full pushes of the same states lead to."""
import time

import judge
from protocol_client import Client, Refused
from push_client import WAYS, PushClient, Step
from support import *


class Changing(PushClient):
    def change(self, scene, step, model, moved=None, base=None, dtype="<f8", insert=None, own_ids=None, remove=(),
               send=True):
        """moved: ids; None: all. model: id -> position, as they are after the move. send: all, not only what edits."""
        ids = np.array(sorted(model))
        begin, edits, slices = self.frames(scene, step, Step(
            ids, np.array([model[i] for i in sorted(model)]), moved=moved, base_step=base, dtype=dtype, inserted=insert,
            inserted_ids=own_ids, removed=remove))
        self.socket.sendall(begin)
        for link, data in edits + (slices if send else []):
            link.sendall(data)
        return self.answer() if send else None


class Changes(Refusals, ServiceTest):
    ranks = 3

    def state(self, scene):
        with Client(self.path) as client:
            shown = client.ask("scene.show", scene=scene)[0]
            answer, bulk = client.ask("fetch", scene=scene)
        n, dims = shown["n"], shown["dims"]
        ids = np.frombuffer(bulk[: 8 * n], "<i8")
        points = np.frombuffer(bulk[8 * n: 8 * n * (1 + dims)], "<f8").reshape(dims, n).T
        parts = np.frombuffer(bulk[-4 * n:] if n else b"", "<i4")
        return shown, ids, points, parts

    def check(self, scene, model):
        shown, ids, points, parts = self.state(scene)
        self.assertEqual(sorted(model), ids.tolist())
        np.testing.assert_array_equal(points, np.array([model[i] for i in sorted(model)]).reshape(points.shape))
        np.testing.assert_array_equal(np.bincount(parts, minlength=shown["parts"]), shown["counts"])
        return shown, parts

    def full(self, client, scene, step, model, first=False):
        points = np.array([model[i] for i in sorted(model)])
        columns = {name: points[:, k] for k, name in enumerate("xyz"[: points.shape[1]])}
        begin, part, bulk = client.push_frames(scene, step, columns, len(points))
        if first:
            ids = np.array(sorted(model))
            begin["ids"], bulk = True, bulk + ids.astype("<i8").tobytes()
            part["arrays"].append({"name": "id", "dtype": "<i8", "shape": [len(ids)]})
        client.send(begin)
        number = client.number
        client.send(part, bulk)
        client.number = number
        answer = client.answer()[0]
        client.number = number + 1
        return answer

    def test_every_way_leads_to_the_same_scene(self):
        for seed, dims, tolerance in ((1, 3, 0.2), (2, 2, 0.05), (3, 1, "inf")):
            rng = np.random.default_rng(seed)
            model = {i: rng.random(dims) for i in range(500)}
            clients = {how: Changing(self.path, how) for how in WAYS}
            reference = f"full-{seed}"
            with Client(self.path) as client:
                client.ask("scene.create", scene=reference, parts=7, dims=dims, tolerance=tolerance)
                self.full(client, reference, 0, model)
                for how in WAYS:
                    client.ask("scene.create", scene=f"{how}-{seed}", parts=7, dims=dims, tolerance=tolerance)
                    self.full(client, f"{how}-{seed}", 0, model)
                same = True  # as long as nothing was inserted or removed
                for step in range(1, 16):
                    with self.subTest(seed=seed, step=step):
                        same = self.one_step(rng, model, clients, client, seed, step, same)
            for client in clients.values():
                client.close()
            # A cold partition of the same particles cuts the same.
            with Client(self.path) as client:
                client.ask("scene.create", scene="cold", parts=7, dims=dims, replace=True)
                self.full(client, "cold", 0, model, first=True)
                for how in WAYS:
                    client.ask("rebalance", scene=f"{how}-{seed}")
                    warm, cold = (self.state(scene)[0] for scene in (f"{how}-{seed}", "cold"))
                    self.assertEqual([warm[k] for k in ("hash", "counts", "n")], [cold[k] for k in ("hash", "counts", "n")])

    def one_step(self, rng, model, clients, reference, seed, step, same):
        ids = np.array(sorted(model))
        dims = len(model[int(ids[0])])
        kind = rng.integers(4)
        moved = None if kind == 0 else rng.permutation(ids)[: [0, 0, 7, len(ids) // 3][kind]]
        dtype = "<f4" if rng.integers(2) else "<f8"
        for i in ids if moved is None else moved:
            position = model[int(i)] + rng.normal(0, 0.05, dims)
            model[int(i)] = position.astype("<f4").astype("<f8") if dtype == "<f4" else position
        edit = {}
        after = dict(model)
        if step > 5 and rng.integers(3) > 0:
            insert = rng.random((int(rng.integers(0, 60)), dims)).astype(dtype)
            own = rng.permutation(10**6 * step + np.arange(len(insert))) if rng.integers(2) else None
            remove = rng.permutation(ids)[: rng.integers(0, 40)]
            edit = {"insert": insert if len(insert) else None, "own_ids": own if len(insert) else None,
                    "remove": remove}
            for i in remove:
                del after[int(i)]
            same = same and not len(remove) and not len(insert)
        answers = []
        for how, client in clients.items():
            answer, bulk = client.change(f"{how}-{seed}", step, model, moved, step - 1 if moved is not None else None,
                                         dtype, **edit)
            report = answer["report"]
            answers.append({k: v for k, v in report.items() if k not in ("scene", "seconds", "bytes", "way")})
            self.assertEqual("motion" in report["skipped"], moved is not None)
            self.assertEqual("double precision" in report["skipped"], dtype == "<f4")
            self.assertEqual(report["scanned"], len(ids) if moved is None else len(moved))
            width = dims * int(dtype[2])
            own = edit.get("own_ids")
            self.assertEqual(report["bytes"], report["scanned"] * (width + (0 if moved is None else 8)) +
                             report["removed"] * 8 + report["inserted"] * (width + (0 if own is None else 8)))
        self.assertEqual(answers[0], answers[1])
        self.assertEqual(answers[0], answers[2])
        if edit.get("insert") is not None:
            new = edit["own_ids"]
            if new is None:
                new = answers[0]["first_id"] + np.arange(len(edit["insert"]))
            after.update((int(i), p.astype("<f8")) for i, p in zip(new, edit["insert"]))
        model.clear()
        model.update(after)
        states = [self.check(f"{how}-{seed}", model) for how in clients]
        if same:
            self.full(reference, f"full-{seed}", step, model)
            states.append(self.check(f"full-{seed}", model))
        for shown, parts in states[1:]:
            for name in ("hash", "counts", "error", "plan", "epoch", "ids", "n"):
                self.assertEqual(shown[name], states[0][0][name], name)
            np.testing.assert_array_equal(parts, states[0][1])
        return same

    def test_the_parts_of_what_is_inserted_are_told_with_the_changes(self):
        points, more = np.split(np.random.default_rng(6).random((50, 3)), [40])
        tree, _ = judge.partition(points, 4)
        with PushClient(self.path) as client:
            client.ask("scene.create", scene="told", parts=4, tolerance=0)
            client.push_step("told", 0, Step(np.arange(40), points))
            edit = {"moved": np.arange(0), "base_step": 0, "inserted": more}
            _, arrays = client.push_step("told", 1, Step(np.arange(40), points, **edit))
            self.assertEqual(arrays["inserted_part"].tolist(), tree.assign(more, 40 + np.arange(10)).tolist())
            edit["base_step"] = 1
            both = np.concatenate([points, more])
            answer, arrays = client.push_step("told", 2, Step(np.arange(50), both, **edit), changes=False)
            self.assertEqual((answer["report"]["inserted"], arrays), (10, {}))

    def test_what_is_refused_changes_nothing(self):
        model = {i: np.random.default_rng(5).random((300, 3))[i] for i in range(300)}
        for how in WAYS:
            scene = "refused-" + how
            with Changing(self.path, how) as client:
                client.ask("scene.create", scene=scene, parts=5)
                with self.assertRaises(Refused) as caught:
                    client.send({"command": "push.begin", "scene": scene, "session": client.session, "step": 0, "n": 0,
                                 "slices": 0, "order": "id", "moved": "none", "base_step": 0})
                    client.answer()
                self.assertEqual(caught.exception.args[0], "base_lost")
                self.full(client, scene, 4, model)
                before = [str(x) for x in self.state(scene)]
                point = np.zeros((1, 3))
                nan = dict(model)
                nan[17] = np.array([0.0, np.nan, 0.0])
                twice = np.zeros((2, 3))
                for code, words, arguments in (
                        ("base_lost", "step 3", {"moved": [1], "base": 3}),
                        ("base_lost", "step 3", {"moved": [], "base": 3}),
                        ("invalid_argument", "base_step", {"moved": [], "base": None}),
                        ("not_finite", "particle 17: y", {"moved": [3, 17], "base": 4, "model": nan}),
                        ("not_found", "particle 300 ", {"remove": [7, 300]}),
                        ("not_found", "particle 5000 ", {"moved": [], "base": 4, "remove": [5000]}),
                        ("invalid_argument", "id 7 ", {"remove": [7, 9, 7]}),
                        ("already_exists", "particle 9 ", {"insert": point, "own_ids": [9]}),
                        ("already_exists", "particle 9 ", {"insert": point, "own_ids": [9], "remove": [9]}),
                        ("invalid_argument", "id 400 ", {"insert": twice, "own_ids": [400, 400]}),
                        ("invalid_argument", "id is -2", {"insert": twice, "own_ids": [400, -2]}),
                        ("not_finite", "inserted particle 0", {"insert": point + np.inf})):
                    with self.subTest(how=how, words=words), self.assertRaises(Refused) as caught:
                        client.change(scene, 5, arguments.pop("model", model), **arguments)
                    self.assertEqual(caught.exception.args[0], code, caught.exception.args)
                    self.assertIn(words, caught.exception.args[1])
                    self.assertEqual([str(x) for x in self.state(scene)], before)
                moved = dict(model)
                moved[3] = np.array([9.0, 9.0, 9.0])
                client.change(scene, 5, moved, [3], 4, remove=[4])
                again = client.change(scene, 5, moved, [3], 4, remove=[4]) if how == "by-id" else None
                if again:
                    self.assertTrue(again[0]["repeated"])
                del moved[4]
                self.check(scene, moved)

    def test_the_slot_behind_a_ranks_last_is_refused(self):
        ids, points = np.arange(300), np.random.default_rng(7).random((300, 3))
        for how in ("gateway", "direct"):
            scene = "slots-" + how
            with self.subTest(how), PushClient(self.path, how) as client:
                client.ask("scene.create", scene=scene, parts=5)
                client.push_step(scene, 0, Step(ids, points))
                rows, plan = client.layout(scene, Step(ids, points))
                client.layout = lambda *_: ([np.insert(of, 0, of[0]) for of in rows], plan)  # every slot is one too high
                last = Step(ids, points, moved=rows[1][-1:], base_step=0)
                self.assertIn(f"slot {len(rows[1])} of rank 1", self.refused("invalid_argument", client.push_step, scene, 1, last))

    def test_a_client_that_dies_leaves_the_previous_step(self):
        model = {i: np.random.default_rng(6).random((300, 3))[i] for i in range(300)}
        for how in WAYS:
            scene = "dies-" + how
            with Changing(self.path, how) as client:
                client.ask("scene.create", scene=scene, parts=5)
                self.full(client, scene, 0, model)
            before = [str(x) for x in self.state(scene)]
            client = Changing(self.path, how)
            client.change(scene, 1, model, list(range(40)), 0, insert=np.ones((3, 3)), remove=[5], send=False)
            time.sleep(0.1)
            client.close()
            time.sleep(0.1)
            self.assertEqual([str(x) for x in self.state(scene)], before)
            with Changing(self.path, how) as client:
                client.change(scene, 1, model, list(range(40)), 0, insert=np.ones((3, 3)), remove=[5])
            self.assertEqual(self.state(scene)[0]["n"], 302)

    def test_the_command_line(self):
        rng = np.random.default_rng(9)
        model = {i: p for i, p in enumerate(rng.random((400, 3)).astype("<f4").astype("<f8"))}
        file = {name: os.path.join(self.service.dir, name) for name in ("a.npy", "b.csv", "c.csv", "d.npy")}

        def rows(name, ids):
            with open(file[name], "w") as out:
                out.write("id,x,y,z\n")
                for i in ids:
                    out.write(",".join([str(i)] + [repr(float(x)) for x in model[i]]) + "\n")

        np.save(file["a.npy"], np.array(list(model.values())).astype("<f4"))
        self.service.json("scene", "create", "ctl", "--parts", 5)
        report = self.service.json("push", "ctl", file["a.npy"])
        self.assertEqual(report["bytes"], 400 * 12)
        self.assertIn("double precision", report["skipped"])
        report = self.service.json("push", "ctl", "--unmoved")
        self.assertEqual((report["step"], report["scanned"], report["bytes"]), (1, 0, 0))
        self.assertIn("motion", report["skipped"])
        moved = [7, 399, 12]
        for i in moved:
            model[i] = rng.random(3)
        rows("b.csv", moved)
        report = self.service.json("push", "ctl", file["b.csv"], "--subset")
        self.assertEqual((report["scanned"], report["bytes"]), (3, 3 * 32))
        self.check("ctl", model)
        for i in (1000, 500):
            model[i] = rng.random(3)
        rows("c.csv", (1000, 500))
        del model[12], model[0]
        report = self.service.json("push", "ctl", "--insert", file["c.csv"], "--remove", "12,0")
        self.assertEqual((report["inserted"], report["removed"], report["n"]), (2, 2, 400))
        self.check("ctl", model)
        new = rng.random((5, 3))
        np.save(file["d.npy"], new)
        model[7] = np.array([0.5, 0.25, 0.125])
        rows("b.csv", [7])
        report = self.service.json("push", "ctl", file["b.csv"], "--subset", "--insert", file["d.npy"])
        self.assertEqual(report["first_id"], 1001)
        model.update((1001 + k, point) for k, point in enumerate(new))
        self.check("ctl", model)
        np.save(file["d.npy"], new.round(1).astype("<f4"))
        report = self.service.json("push", "ctl", "--insert", file["d.npy"])
        self.assertEqual((report["first_id"], report["bytes"]), (1006, 5 * 12))
        model.update((1006 + k, point) for k, point in enumerate(new.round(1).astype("<f4").astype("<f8")))
        self.check("ctl", model)
        before = self.state("ctl")[0]
        self.assertEqual(self.service.failure("push", "ctl", "--remove", "12")["code"], "not_found")
        self.assertEqual(self.service.failure("push", "ctl", "--insert", file["c.csv"])["code"], "already_exists")
        self.assertEqual(self.service.failure("push", "ctl", file["d.npy"], "--subset")["code"], "invalid_argument")
        self.assertEqual(self.service.ctl("push", "ctl").returncode, 2)
        self.assertEqual(self.service.ctl("push", "ctl", file["a.npy"], "--unmoved").returncode, 2)
        self.assertEqual(self.state("ctl")[0], before)


if __name__ == "__main__":
    unittest.main(verbosity=2)
