"""Many connections at once that push, count, share, open, drop and repartition one scene, most of it wrong."""
import math
import struct
import time

import numpy as np
from actor import LOST, Actor, Unexpected
from model import Model, check_cut_anew, check_scene, tree_of
from protocol_client import FAILURE, NOTICE, REPLY, REQUEST, Refused, arrays_of, count_record, frame, reframed
from push_client import WAYS, Block, PushClient
from pushers import UNTRUE
from seat_client import id_sum

BAD = (math.nan, math.inf, -math.inf, -0.0, 5e-324, 1e308, -1e308)
KINDS = {"push": 12, "tally": 6, "open": 2, "leave": 1, "change": 1, "question": 1, "memory": 1, "scribble": 2, "vanish": 1,
         "pause": 1}
NUMBERS = (0, 1, 2, 7, 300, 2**31, 2**40, 2**48, 2**48 + 1, 2**53 + 1, 2**63 - 1, -1)


class Guest(PushClient):
    """A connection that doesn't wait for its answers. `owed`: the requests that are to be answered, each once."""

    def __init__(self, address, scene, **options):
        super().__init__(address, "shared-memory", **options)
        for link in self.links:
            link.socket.settimeout(2)
        self.scene, self.owed, self.seat, self.broken = scene, {}, None, False

    def request(self, document, bulk=b"", seconds=0.3):
        self.number += 1
        document.setdefault("deadline_seconds", seconds)
        self.owed[self.number] = document
        self.socket.sendall(frame(REQUEST, self.number, document, bulk))


class Mob(Actor):
    expects = "whatever many seats and clients push and count at once: each request is answered once, no step is half a step"

    def start(self):
        self.close_all()
        self.control = self.connect()
        self.drop_all(self.control)
        rng = self.rng
        self.dims, self.parts = int(rng.integers(1, 4)), int(rng.integers(1, 12))
        self.model = Model.random(rng, int(rng.choice([1, 60, 400, 3000])), self.dims, own_ids=rng.integers(2) == 1,
                                  weighted=rng.integers(3) == 0)
        self.scene = self.create(self.control, parts=self.parts, dims=self.dims, tolerance=float(rng.choice([0.02, 0.2])),
                                 positions=str(rng.choice(["every-step", "when-needed"])))
        with self.connect(PushClient, keep=False) as client:
            block = Block(self.model.points, self.model.ids, self.model.weights)
            self.patiently(client.push_block, self.scene, 0, block)
        self.look()

    def look(self):
        self.shown = self.ask(self.control, "scene.show", scene=self.scene)[0]
        self.at = self.shown["step"] + 1
        answer = self.ask(self.control, "cuts", scene=self.scene)[0]
        self.tree = tree_of(answer, self.shown["dims"])

    def turn(self):
        self.team = self.random.choice([0, 0, 1, 2, 4])
        guests = [self.guest() for _ in range(self.random.randint(2, 6))]
        for _ in range(self.random.randint(4, 40)):
            k = self.random.randrange(len(guests))
            kind = self.random.choices(*zip(*KINDS.items()))[0]
            self.count(kind)
            try:
                getattr(self, "do_" + kind)(guests[k])
            except (*LOST, TimeoutError, Refused, AssertionError) as fault:  # of a rank that waits for a push, perhaps
                self.expect(not isinstance(fault, Unexpected), fault)
                guests[k].close()
                guests[k] = self.guest()
        for guest in guests:
            self.drain(guest)
        for guest in self.clients[1:]:
            guest.close()
        del self.clients[1:]
        self.honest()

    def guest(self):
        twin = self.random.choice(self.clients[1:]).session if len(self.clients) > 1 and self.random.random() < 0.1 else None
        guest = self.connect(Guest, self.scene, tcp=self.rng.integers(4) == 0, session=twin)
        if self.team and self.random.random() < 0.8:
            self.do_open(guest)
        return guest

    # What guests do. None waits for an answer at the endpoint.

    def do_open(self, guest):
        more = {}
        if self.team and self.random.random() < 0.9:
            seat = self.random.randrange(self.team)
            more = {"seat": seat, "seats": self.team, "generation": self.random.choice([None, None, 1, 2, 2**40])}
            guest.seat = seat
        guest.request({"command": "scene.open", "scene": self.scene, **more})

    def do_leave(self, guest):
        guest.request({"command": "scene.close", "scene": self.scene})

    def do_change(self, guest):
        if self.random.random() < 0.6:
            more = {"command": "rebalance", "parts": self.random.choice([1, 2, 5, 9, 33]),
                    "method": self.random.choice(["rcb", "bands-x"]),
                    "force": self.random.random() < 0.5, "dry_run": self.random.random() < 0.3}
        elif self.random.random() < 0.9:
            more = {"command": "scene.create", "parts": self.random.choice([1, 4, 7]), "dims": self.random.choice([1, 2, 3]),
                    "replace": True, "positions": self.random.choice(["every-step", "when-needed"])}
        else:
            more = {"command": "scene.drop"}
        guest.request({"scene": self.scene, **more})

    def do_question(self, guest):
        command = self.random.choice(["fetch", "assign", "quality", "counts", "history", "scene.show", "halo"])
        guest.request({"command": command, "scene": self.scene, "held": self.random.random() < 0.7, "width": 0.1})

    def do_memory(self, guest):
        for link in guest.links:
            link.ask(self.random.choice(["memory.drop", "memory.drop", "memory.share"]),
                     memory=self.random.choice([guest.memories, 0, 1, 2**62]), bytes=self.random.choice(NUMBERS))

    def do_scribble(self, guest):
        """Into memory that ranks may be reading."""
        if len(guest.area) >= 64:
            at = 8 * self.random.randrange(len(guest.area) // 8)
            guest.area[at: at + 8] = self.random.choice([struct.pack("<d", self.random.choice(BAD)), self.random.randbytes(8)])

    def do_vanish(self, guest):
        raise EOFError

    def do_pause(self, guest):
        time.sleep(self.random.uniform(0, 0.05))

    def step(self):
        """Mostly that of the push before, or the next one."""
        if self.random.random() < 0.1:
            return self.at + self.random.choice([2, 3, -1, 2**40])
        self.at += self.random.random() < 0.3
        return self.at

    def rows(self, guest):
        """Those of the guest's seat, or all; now and then one less or one twice."""
        rows = np.arange(len(self.model.ids))
        if self.team and guest.seat is not None:
            rows = np.array_split(rows, self.team)[guest.seat]
        what = self.random.random()
        if what < 0.04 and len(rows):
            rows = np.delete(rows, self.random.randrange(len(rows)))
        elif what < 0.08 and len(rows):
            rows = np.append(rows, self.random.choice(list(rows)))
        elif what < 0.12:
            rows = rows[:0]
        return self.rng.permutation(rows) if self.random.random() < 0.5 else rows

    def block(self, guest):
        rows = self.rows(guest)
        points = self.model.points[rows]
        points = points + self.rng.normal(0, self.random.choice([0, 0.01, 0.3]), points.shape)
        ids = self.model.ids[rows].copy()
        weights = None if self.model.weights is None else self.model.weights[rows].copy()
        if len(rows) and self.random.random() < 0.1:
            points[self.random.randrange(len(rows)), self.random.randrange(points.shape[1])] = self.random.choice(BAD)
        if len(rows) and self.random.random() < 0.1:
            ids[self.random.randrange(len(rows))] = self.random.choice([0, 5, -1, -2**63, 2**63 - 1, ids[0], ids[-1]])
        if weights is not None and len(rows) and self.random.random() < 0.1:
            weights[self.random.randrange(len(rows))] = self.random.choice(BAD)
        if self.random.random() < 0.05:
            weights = None if weights is not None else np.ones(len(rows))
        plain = np.array_equal(ids, np.arange(len(ids)))
        if self.random.random() < (0.5 if plain else 0.05):
            ids = None
        return Block(points, ids, weights, self.random.choice(["<f8", "<f8", "<f4"]))

    def do_push(self, guest):
        block, said = self.block(guest), {"deadline_seconds": self.random.choice([0.01, 0.1, 0.3, 0.6])}
        n = len(block.points)
        if self.random.random() < 0.3:
            name, values = self.random.choice([
                ("inserted", NUMBERS), ("removed", NUMBERS), ("n", (n + 1, n - 1, *NUMBERS)), ("drifted", NUMBERS),
                ("step_seconds", (0, 1, 1e308, -1)), ("cuts_known", ({}, {"epoch": 1, "hash": "0" * 16})),
                ("incarnation", (self.shown["incarnation"], "0" * 16)), ("attempt", NUMBERS), ("ids", (True, False)),
                ("weights", (True, False)), ("dtype", ("<f8", "<f4")), ("way", WAYS), ("counts", UNTRUE),
                ("memory", UNTRUE), ("sockets", ([0], [1, 2], [0, 1, 2], *UNTRUE)),
                ("counts", (None, [n, 0, 0], [0, 0, n], [2**48] * 3, [n + 1, -1, 0]))])
            said[name] = self.random.choice(values)
            if self.random.random() < 0.3:
                said |= {"inserted": (k := self.random.choice([1, 3, 2**48])), "removed": k}
        deal = None
        if self.random.random() < 0.3:
            to = self.rng.integers(0, 3, n) if self.random.random() < 0.5 else np.full(n, self.random.randrange(3))
            deal = [np.flatnonzero(to == r) for r in range(self.world.ranks)]
        way, other = self.random.choice(WAYS), said.pop("way", None)
        begin, slices = guest.frames(self.scene, self.step(), block, way=way, deal=deal,
                                     by_socket=self.random.choice([(), (), (1,), (0, 2)]),
                                     each=self.random.choice([n + 1, 7 + n // 5]), **said)
        if other:
            begin = reframed(begin, lambda document: document.update(way=other))
        if way == "endpoint":  # one frame
            begin, slices = b"".join([begin, *(rows for _, rows in slices)]), []
        begin, slices = self.spoil(guest, begin, slices, n)
        self.deliver(guest, [(guest.socket, begin), *slices])

    def spoil(self, guest, begin, slices, n):
        what = self.random.random()
        if what < 0.1:
            begin = reframed(begin, lambda document: self.spoil_memory(document, n))
        elif what < 0.15:
            slices = slices[: self.random.randrange(len(slices) + 1)]
        elif what < 0.2:
            slices = slices + slices[-1:]
        elif what < 0.23:
            slices = slices[::-1]
        elif what < 0.28 and slices:
            k = self.random.randrange(len(slices))
            guest.broken = True
            slices[k] = (slices[k][0], reframed(slices[k][1], self.spoil_slice))
        elif what < 0.33 and guest.area:  # a row that isn't there, or twice
            at = max(0, len(guest.area) // 2 - 16 - 8 * self.random.randrange(1, 2 + n))
            row = self.random.choice([0, n, max(n - 1, 0), 2**63, 2**64 - 1, 2**61])
            guest.area[at // 8 * 8: at // 8 * 8 + 8] = struct.pack("<Q", row)
        return begin, slices

    def spoil_memory(self, document, n):
        if not isinstance(document.get("memory"), list) or not all(isinstance(one, dict) for one in document["memory"]):
            return
        if self.random.random() < 0.3:  # the plain one, without rows named
            document["counts"] = document["sockets"] = None
            document["memory"] = [one for one in document["memory"] if one.get("name") != "row"]
        elif document["memory"]:
            name, values = self.random.choice([("offset", (0, 4, 8, 8 * n, 2**40, 2**61, 2**62)),
                                               ("stride", (0, 4, 8, 4096, 4104)), ("number", (0, 1, 2**62, -1)),
                                               ("name", ("x", "row", "id", "w"))])
            self.random.choice(document["memory"])[name] = self.random.choice(values)

    def spoil_slice(self, document):
        name = self.random.choice([name for name in document if name not in ("command", "scene")])
        document[name] = self.random.choice([*UNTRUE, *NUMBERS])

    def deliver(self, guest, frames):
        whole = self.random.random() > 0.05
        left = math.inf if whole else self.random.randrange(sum(len(data) for _, data in frames))
        document = {}
        reframed(frames[0][1], document.update)
        guest.owed[guest.begun] = document
        for link, data in frames:
            link.sendall(data if left >= len(data) else data[: int(left)])
            left -= len(data)
            if left < 0:
                raise EOFError
            if self.random.random() < 0.02:
                self.do_pause(guest)

    def tally_of(self, guest):
        rows = self.rows(guest)
        points, ids = self.model.points[rows], self.model.ids[rows]
        if points.shape[1] != self.tree.dims:
            return {}, {}
        parts = self.tree.assign(points, ids)
        counts = np.bincount(parts, minlength=self.tree.parts)
        some = [int(part) for part in np.flatnonzero(counts)]
        said = {"id_sum": id_sum(ids)}
        if self.model.weights is not None:
            w = self.model.weights
            most = float(w.max())
            scale = 127 - math.frexp(most)[1] - (len(w) - 1).bit_length() if most else 0
            loads = [sum(int(v * 4) << max(scale - 2, 0) for v in w[rows][parts == p]) % 2**128 for p in some]
            said["weights"] = {"scale": scale, "least": float(w[rows].min(initial=most)),
                               "greatest": float(w[rows].max(initial=0)), "weights_as_zero": 0, "loads": loads}
        return said, {part: int(counts[part]) for part in some}

    def do_tally(self, guest):
        said, counts = self.tally_of(guest)
        if self.random.random() < 0.2:
            said |= {"inserted": (k := self.random.choice([1, 3, 2**48])), "removed": k}
        record = bytearray(count_record(self.step(), self.shown, counts, **said))
        if self.random.random() < 0.4:
            word = self.random.choice([*NUMBERS, struct.unpack("<Q", struct.pack("<d", self.random.choice(BAD)))[0]])
            struct.pack_into("<Q", record, 8 * self.random.randrange(len(record) // 8), word % 2**64)
        if self.random.random() < 0.1:
            record = record[:self.random.randrange(len(record))] + record[:self.random.choice([0, 16, 32, 20000])]
        document = {"command": "count", "scene": self.scene}
        if self.random.random() < 0.1:
            document |= {"step": self.random.choice([self.step(), *NUMBERS]), "fault": self.random.choice(
                [*UNTRUE, {"code": "not_finite", "message": "x"}, {"code": "internal"}])}
        guest.request(document, bytes(record))

    # What they are answered.

    def drain(self, guest):
        try:
            while guest.owed:
                kind, number, document, _ = guest.receive()
                if kind == NOTICE:
                    continue
                if kind not in (REPLY, FAILURE) or number == 0:
                    self.expect(guest.broken, "a connection was ended:", document)
                    return
                asked = guest.owed.pop(number, None)
                self.expect(asked is not None, "answered twice, or never asked:", number, document)
                failure = document.get("failure", {})
                self.expect(failure.get("code") != "internal", "an internal fault:", failure, asked)
                self.count(failure.get("code", "answered"))
        except TimeoutError:
            self.expect(False, "no answer to", guest.owed)
        except LOST:
            self.expect(guest.broken, "lost by the service, with", guest.owed)

    # And the scene is whole.

    def honest(self):
        """What guests that have vanished had asked for may still come in between; then it is judged after the next turn."""
        try:
            self.judge()
        except (Refused, Unexpected):
            if not self.overtaken():
                raise
            self.count("overtaken")
            self.start()

    def overtaken(self):
        try:
            now = self.ask(self.control, "scene.show", scene=self.scene)[0]
        except Refused as refused:
            return refused.args[0] == "not_found"
        return any(now[name] != self.shown[name] for name in ("incarnation", "epoch", "step"))

    def judge(self):
        self.shown = self.ask(self.control, "scene.show", scene=self.scene)[0]
        if self.shown["step"] is None or self.shown["step"] > 2**39 or self.shown["n"] == 0:
            return self.start()
        self.take_held()
        if self.model.ids.max() > 2**62:
            return self.start()
        self.honest_push(self.model.move_on(self.rng))
        self.look()
        check_scene(self, self.control, self.scene, self.model)
        self.count("checks")
        if self.rng.integers(6) == 0:
            self.cut_anew()

    def take_held(self):
        """What the ranks hold becomes the model, if it can be that of any steps."""
        held = arrays_of(*self.ask(self.control, "fetch", scene=self.scene, held=True))
        dims, n = self.shown["dims"], self.shown["n"]
        ids, points = held["id"], np.stack([held["xyz"[a]] for a in range(dims)], axis=1)
        self.expect(len(ids) == n and len(np.unique(ids)) == n and ids.min() >= 0, "ids", n, ids)
        self.expect(self.shown["ids"] == (ids.max() != n - 1), "has ids", self.shown["ids"], ids.max(), n)
        self.expect(np.isfinite(points).all(), "positions that aren't finite")
        tree = tree_of(self.ask(self.control, "cuts", scene=self.scene)[0], dims)
        expected = tree.assign(points, ids)
        self.expect(np.array_equal(expected, held["part"]), "parts held, against the cuts")
        if self.shown["positions_step"] == self.shown["step"]:
            self.expect(np.array_equal(np.bincount(expected, minlength=tree.parts), self.shown["counts"]), "counts", self.shown)
        if "w" in held:
            self.expect((held["w"] >= 0).all() and np.isfinite(held["w"]).all(), "weights")
        self.model = Model(ids, points, self.rng.integers(0, 40, n) / 4 if "w" in held else None)
        wild = (np.abs(points) > 1e6).any(axis=1)  # a solver's next step is of ordinary numbers again
        points[wild] = self.rng.random((wild.sum(), dims))

    def honest_push(self, said):
        with self.connect(PushClient, str(self.rng.choice(WAYS)), keep=False) as client:
            block = Block(self.model.points, self.model.ids, self.model.weights, self.model.dtype)
            try:
                answer, _ = self.patiently(client.push_block, self.scene, self.shown["step"] + 1, block,
                                           deadline_seconds=self.world.answer_seconds, **said)
            except Refused as refused:
                self.expect(False, "an honest step:", refused.args, client.way, said, self.shown, block)
        self.expect(answer["report"]["n"] == len(self.model.ids), "n after an honest step", answer)

    def cut_anew(self):
        """Cut anew, it is as a scene that never saw the others."""
        parts = int(self.rng.integers(1, 12))
        hashes = [check_cut_anew(self, self.control, self.scene, self.model, parts, "rcb")]
        other = self.create(self.control, parts=parts, dims=self.shown["dims"])
        with self.connect(PushClient, keep=False) as client:
            self.patiently(client.push_block, other, 0, Block(self.model.points, self.model.ids, self.model.weights))
        hashes.append(self.ask(self.control, "scene.show", scene=other)[0]["hash"])
        self.expect(hashes[0] == hashes[1], "cut anew", hashes)
        self.ask(self.control, "scene.drop", scene=other)
        self.scenes.remove(other)
        self.look()
