"""Pushes of a single client, by every way."""
import dataclasses

import numpy as np
from actor import LOST, Actor
from model import Model, Told, check_cut_anew, check_report, check_scene
from protocol_client import Refused, reframed
from push_client import WAYS, Block, PushClient

SAME = ("step", "epoch", "n", "error_before", "error", "imbalance", "repartitioned", "reason", "axes_flipped", "moved",
        "migrated", "inserted", "removed", "scanned")
TURNS = 40  # then other scenes

# What a field of a push may say that isn't so.
UNTRUE = (None, True, "", "x", "id", "endpoint", "sockets", "shared-memory", "<f4", "<i8", 0, 1, -1, 2, 7, 0.5, 2**31, 2**40,
          2**53 + 1, 2**63 - 1, -2**63, 2**64 - 1, 1e300, [], [1], [-1, 2, 3], [2**63 - 1] * 3, [2**62] * 4, [0.5] * 3,
          {}, {"epoch": 1, "hash": "0" * 16}, {"epoch": 2**64, "hash": 7}, [{"name": "x"}])


class Ways(Actor):
    """One model, a scene for each way of pushing."""

    expects = "through the endpoint, to the ranks' sockets, from memory: the same reports, cuts and hash, and no particle lost"

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
        self.pushing = [(self.create(self.control, **options),
                         self.connect(PushClient, way, tcp=way != "shared-memory" and rng.integers(4) == 0), Told())
                        for way in WAYS]
        self.push({})

    def turn(self):
        self.turns += 1
        if self.turns > TURNS:
            self.close_all()
            return self.start()
        self.number += int(self.rng.integers(1, 3))
        self.push(self.model.move_on(self.rng))
        if self.turns % 8 == 0:
            self.check()
        if self.turns % 13 == 0:
            self.cut_anew()

    def push(self, said):
        reports = []
        for scene, client, told in self.pushing:
            block, each = self.model.block(self.rng), int(self.rng.choice([50, 700, 10_000]))
            if said:
                block = dataclasses.replace(block, ids=self.model.ids if block.ids is None else block.ids)
            answer, arrays = self.patiently(client.push_block, scene, self.number, block, each=each, cuts_known=told.known,
                                            deadline_seconds=self.world.answer_seconds, **said)
            self.count("steps")
            told.take(answer, arrays)
            check_report(self, answer["report"], scene, self.number, len(self.model.ids))
            reports.append(answer["report"])
            for name in SAME:
                self.expect(reports[-1][name] == reports[0][name], name, "of", scene, reports[-1], "not as through the endpoint",
                            reports[0])

    def check(self):
        hashes = [check_scene(self, self.control, scene, self.model, told) for scene, _, told in self.pushing]
        self.expect(len(set(hashes)) == 1, "hashes", hashes)
        self.count("checks")

    def cut_anew(self):
        self.parts = int(self.rng.integers(1, 20))
        method = str(self.rng.choice(["rcb", "bands-" + "xyz"[self.model.points.shape[1] - 1]]))
        hashes = [check_cut_anew(self, self.control, scene, self.model, self.parts, method) for scene, *_ in self.pushing]
        self.expect(len(set(hashes)) == 1, "hashes after rebalance", hashes)


class Quitters(Actor):
    """Dies in the midst of its pushes."""

    expects = "a push that is cut anywhere leaves the previous step, and the next one works"

    def start(self):
        self.control = self.connect()
        self.drop_all(self.control)
        self.model = Model.random(self.rng, 800, 3, False, False)
        self.scene, self.number = self.create(self.control, parts=6), 0
        self.push({})

    def push(self, said):
        with self.connect(PushClient, str(self.rng.choice(WAYS)), keep=False) as client:
            block = Block(self.model.points, self.model.ids)
            self.patiently(client.push_block, self.scene, self.number, block, **said)
        self.count("steps")

    def turn(self):
        before = self.ask(self.control, "scene.show", scene=self.scene)[0]
        for _ in range(5):
            self.quit()
        after = self.ask(self.control, "scene.show", scene=self.scene)[0]
        before.pop("holders"), after.pop("holders")
        self.expect(before == after, "a push that was cut changed the scene", before, after)
        self.number += 1
        self.push(self.model.move_on(self.rng))
        if self.rng.integers(4) == 0:
            check_scene(self, self.control, self.scene, self.model)

    def quit(self):
        client = self.connect(PushClient, str(self.rng.choice(WAYS)), keep=False)
        try:
            block = Block(self.model.points + 1, self.model.ids)
            begin, slices = self.patiently(client.frames, self.scene, self.number + 1, block, each=100, by_socket=[1])
            left = int(self.rng.integers(0, len(begin) + sum(len(data) for _, data in slices)))
            for link, data in [(client.socket, begin), *slices]:
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
            self.patiently(client.push_block, self.scene, 0, Block(self.points))

    def turn(self):
        before = self.ask(self.control, "scene.show", scene=self.scene)[0]
        answered = self.lie()
        after = self.ask(self.control, "scene.show", scene=self.scene)[0]
        self.count({True: "believed", False: "refused", None: "given up"}[answered])
        if answered is not False:
            return self.push_first()
        before.pop("holders"), after.pop("holders")
        self.expect(before == after, "a push that was refused changed the scene", before, after)

    def lie(self):
        """True if the push was answered all the same; None if it may yet be committed, since its deadline was the lie."""
        said, block = {}, Block(self.points, self.rng.permutation(300) if self.rng.integers(2) else None)
        if self.rng.integers(3) == 0:
            said = {"inserted": 1, "removed": 2}
            block = Block(self.points[1:], np.append(np.arange(298), 900))
        with self.connect(PushClient, self.random.choice(WAYS), keep=False) as client:
            begin, slices = self.patiently(client.frames, self.scene, 1, block, each=70, deadline_seconds=2, by_socket=[1], **said)
            frames = [(client.socket, begin), *slices]
            k = self.random.randrange(len(frames)) if self.rng.integers(3) == 0 and client.way != "endpoint" else 0
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
        name = self.random.choice([name for name in document if name not in ("command", "scene")])
        self.changed = (name, document[name])
        document[name] = self.random.choice(UNTRUE)
        if name == "arrays" and self.rng.integers(2):
            document[name] = self.random.sample(self.changed[1], len(self.changed[1]))
        self.changed = (*self.changed, document[name])
