"""Pushes of a single client, by every way."""
import numpy as np
from actor import LOST, Actor
from model import Model, check_cut_anew, check_report, check_scene
from protocol_client import Refused, arrays_of, reframed
from push_client import WAYS, PushClient, Step

SAME = ("step", "epoch", "n", "error_before", "error", "imbalance", "repartitioned", "reason", "axes_flipped", "drifted",
        "moved", "migrated", "inserted", "removed", "scanned", "skipped")
TURNS = 40  # then other scenes

# What a field of a push may say that isn't so.
UNTRUE = (None, True, "", "x", "id", "plan", "direct", "some", "none", "<f4", "<i8", 0, 1, -1, 2, 7, 0.5, 2**31, 2**40,
          2**53 + 1, 2**63 - 1, -2**63, 2**64 - 1, 1e300, [], [1], [-1, 2, 3], [2**63 - 1] * 3, [2**62] * 4, [0.5] * 3,
          {}, {"version": 1, "checksum": "0" * 16}, {"version": 2**64, "checksum": 7})


class Ways(Actor):
    """One model, a scene for each way of pushing."""

    expects = "by id, in plan order, straight to the ranks: the same reports, parts, cuts and hash, and no particle lost"

    def start(self):
        self.control = self.connect()
        self.drop_all(self.control)
        rng = self.rng
        n = int(rng.choice([1, 7, 300, 1500, 4000, 40_000], p=[0.05, 0.1, 0.4, 0.3, 0.1, 0.05]))
        dims = int(rng.integers(1, 4))
        self.parts = int(rng.integers(1, 20))
        self.model = Model.random(rng, n, dims, own_ids=rng.integers(2) == 1, weighted=rng.integers(3) == 0)
        self.number, self.turns = 0, 0
        options = {"parts": self.parts, "dims": dims, "tolerance": rng.choice([0.02, 0.1, 0.5])}
        self.pushing = [(self.create(self.control, **options), self.connect(PushClient, way, tcp=rng.integers(4) == 0))
                        for way in WAYS]
        own = not np.array_equal(self.model.ids, np.arange(n))
        self.push(Step(self.model.ids, self.model.points, self.model.weights, own_ids=own))

    def turn(self):
        self.turns += 1
        if self.turns > TURNS:
            self.close_all()
            return self.start()
        base = self.number
        self.number += int(self.rng.integers(1, 3))
        self.push(self.model.next_step(self.rng, base))
        if self.turns % 8 == 0:
            self.check()
        if self.turns % 13 == 0:
            self.cut_anew()

    def push(self, step):
        answers = []
        for scene, client in self.pushing:
            each = int(self.rng.choice([50, 700, 10_000]))
            answer, arrays = self.patiently(client.push_step, scene, self.number, step, each=each,
                                            deadline_seconds=self.world.answer_seconds)
            self.count("steps")
            n = len(step.ids) + (0 if step.inserted is None else len(step.inserted)) - len(step.removed)
            check_report(self, answer["report"], scene, self.number, n)
            answers.append((answer, arrays))
        for (scene, _), (answer, arrays) in list(zip(self.pushing, answers))[1:]:
            for name in SAME:
                self.expect(answer["report"][name] == answers[0][0]["report"][name], name, "of", scene,
                            answer["report"], "not as by id", answers[0][0]["report"])
            for name, values in answers[0][1].items():
                self.expect(np.array_equal(arrays[name], values), name, "of", scene, "not as by id")
        self.model.commit(step, *answers[0])

    def check(self):
        hashes = [check_scene(self, self.control, scene, self.model) for scene, _ in self.pushing]
        self.expect(len(set(hashes)) == 1, "hashes", hashes)
        self.count("checks")

    def cut_anew(self):
        self.parts = int(self.rng.integers(1, 20))
        method = str(self.rng.choice(["rcb", "bands-" + "xyz"[self.model.points.shape[1] - 1]]))
        hashes = [check_cut_anew(self, self.control, scene, self.model, self.parts, method) for scene, _ in self.pushing]
        self.expect(len(set(hashes)) == 1, "hashes after rebalance", hashes)
        self.model.parts = arrays_of(*self.ask(self.control, "assign", scene=self.pushing[0][0]))["part"].copy()


class Quitters(Actor):
    """Dies in the midst of its pushes."""

    expects = "a push that is cut anywhere leaves the previous step, and the next one works"

    def start(self):
        self.control = self.connect()
        self.drop_all(self.control)
        self.model = Model.random(self.rng, 800, 3, False, False)
        self.scene, self.number = self.create(self.control, parts=6), 0
        self.push(Step(self.model.ids, self.model.points))

    def push(self, step):
        with self.connect(PushClient, str(self.rng.choice(WAYS)), keep=False) as client:
            answer, arrays = self.patiently(client.push_step, self.scene, self.number, step)
        self.model.commit(step, answer, arrays)
        self.count("steps")

    def turn(self):
        before = self.ask(self.control, "scene.show", scene=self.scene)[0]
        for _ in range(5):
            self.quit()
        after = self.ask(self.control, "scene.show", scene=self.scene)[0]
        before.pop("members"), after.pop("members")
        self.expect(before == after, "a push that was cut changed the scene", before, after)
        step = self.model.next_step(self.rng, self.number)
        self.number += 1
        self.push(step)
        if self.rng.integers(4) == 0:
            check_scene(self, self.control, self.scene, self.model)

    def quit(self):
        client = self.connect(PushClient, str(self.rng.choice(WAYS)), keep=False)
        try:
            moved = None if self.rng.integers(2) else self.model.ids[::3]
            step = Step(self.model.ids, self.model.points + 1, moved=moved, base_step=self.number)
            begin, edits, slices = self.patiently(client.frames, self.scene, self.number + 1, step, each=100)
            left = int(self.rng.integers(0, len(begin) + sum(len(data) for _, data in slices)))
            for link, data in [(client.socket, begin), *edits, *slices]:
                link.sendall(data[:left])
                left -= min(left, len(data))
                if left == 0:
                    break
            self.count("pushes cut")
        finally:
            client.close()


class Liars(Actor):
    """Pushes of which one field of one frame isn't true."""

    expects = "a push that contradicts itself is refused, and the previous step stands"

    def start(self):
        self.control = self.connect()
        self.push_first()

    def push_first(self):
        self.drop_all(self.control)
        self.dims, self.parts = int(self.rng.integers(1, 4)), int(self.rng.integers(1, 8))
        self.points = self.rng.random((300, self.dims))
        self.scene, self.number = self.create(self.control, parts=self.parts, dims=self.dims), 0
        with self.connect(PushClient, keep=False) as client:
            self.patiently(client.push_step, self.scene, 0, Step(np.arange(300), self.points))

    def turn(self):
        before = self.ask(self.control, "scene.show", scene=self.scene)[0]
        answered = self.lie()
        after = self.ask(self.control, "scene.show", scene=self.scene)[0]
        self.count({True: "believed", False: "refused", None: "given up"}[answered])
        if answered is not False:
            return self.push_first()
        before.pop("members"), after.pop("members")
        self.expect(before == after, "a push that was refused changed the scene", before, after)

    def lie(self):
        """True if the push was answered all the same; None if it may yet be committed, since its deadline was the lie."""
        step = Step(np.arange(300), self.points, base_step=0)
        if self.rng.integers(2):
            step.moved = np.sort(self.rng.permutation(300)[:20])
        if self.rng.integers(3) == 0:
            step.inserted, step.removed = self.rng.random((4, self.dims)), np.array([3, 7])
        with self.connect(PushClient, self.random.choice(WAYS), keep=False) as client:
            begin, edits, slices = self.patiently(client.frames, self.scene, 1, step, each=70, deadline_seconds=2)
            frames = [(client.socket, begin), *edits, *slices]
            k = self.random.randrange(len(frames)) if self.rng.integers(3) == 0 else 0
            frames[k] = (frames[k][0], reframed(frames[k][1], self.change))
            try:
                for link, data in frames:
                    link.sendall(data)
                client.answer()
                return True
            except Refused as refused:
                self.expect(refused.args[0] != "internal", self.changed, refused.args)
                if refused.args[0] == "deadline_exceeded":
                    return None
            except LOST:
                self.count("closed")
        return False

    def change(self, document):
        name = self.random.choice([name for name in document if name not in ("command", "scene", "session")])
        self.changed = (name, document[name])
        document[name] = self.random.choice(UNTRUE)
        if name == "arrays" and self.rng.integers(2):
            document[name] = self.random.sample(self.changed[1], len(self.changed[1]))
        self.changed = (*self.changed, document[name])
