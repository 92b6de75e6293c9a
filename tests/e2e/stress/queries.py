"""Questions: right ones, wrong ones, many at once, and from clients that behave badly."""
import socket
import time

import numpy as np
from actor import LOST, Actor
from protocol_client import REQUEST, Client, Refused, arrays_of, frame
from push_client import Block, PushClient

# What the service may say to a question that makes no sense.
NONSENSE = ("invalid_argument", "not_found", "unsupported", "too_large", "already_exists", "busy", "deadline_exceeded")
NASTY = (None, True, "", "x" * 300, "../../etc", "a\nb", "nan", "inf", 0, -1, 3, 1.5, -0.0, 1e308, 2**31, 2**53, 2**63 - 1,
         -2**63, 2**64, [], [[]], [1], [0, 0, 0], [1e308] * 3, ["x"], {}, {"a": {"b": []}}, list(range(500)))


class OwnScene(Actor):
    """Asks about a scene that nobody else changes, so that answers can be foretold."""

    def start(self):
        self.client = self.connect(tcp=self.rng.integers(3) == 0)
        self.drop_all(self.client)
        self.dims, self.n, self.parts = (int(self.rng.integers(1, most)) for most in (4, 3000, 30))
        self.points = self.rng.random((self.n, self.dims))
        self.scene = self.create(self.client, parts=self.parts, dims=self.dims)
        with self.connect(PushClient, "endpoint", keep=False) as pusher:
            self.patiently(pusher.push_block, self.scene, 0, Block(self.points))
        self.assigned = arrays_of(*self.ask(self.client, "assign", scene=self.scene))["part"]

    def right(self):
        """A request about the own scene."""
        rng, scene = self.rng, {"scene": self.scene}
        position = self.points[rng.integers(self.n)].tolist()
        return [
            {"command": "status"}, {"command": "scene.list"}, {"command": "scene.show", **scene},
            {"command": "error", **scene}, {"command": "counts", **scene}, {"command": "cuts", **scene},
            {"command": "history", **scene, "last": 3}, {"command": "stats", **scene},
            {"command": "owner", **scene, "position": position, "id": int(rng.integers(self.n))},
            {"command": "box", **scene, "lo": [0.2] * self.dims, "hi": [0.4] * self.dims},
            {"command": "assign", **scene}, {"command": "fetch", **scene},
            {"command": "quality", **scene}, {"command": "compare", **scene, "methods": ["rcb", "bands-x"]},
            {"command": "rebalance", **scene, "dry_run": True, "parts": 5},
            {"command": "halo", **scene, "width": 0.3, "lists": True, "periodic": {"lo": [0] * self.dims, "hi": [1] * self.dims}},
            {"command": "neighbours", **scene, "width": 0.01, "norm": "euclid"}, {"command": "cuts", **scene, "list": "arrays"},
        ][rng.integers(18)]

    def judge(self, command, answer):
        """What is foretold of an answer."""
        if command == "counts":
            self.expect(np.array_equal(answer["counts"], np.bincount(self.assigned, minlength=self.parts)), answer)
        elif command == "scene.show":
            self.expect((answer["n"], sum(answer["counts"]), answer["step"]) == (self.n, self.n, 0), answer)
        elif command == "history":
            # Only a full disk, which another actor makes, loses a report, and the answer tells it.
            lost = "No space left" in answer.get("loss", "") and answer["lost"] == 1
            self.expect([report["step"] for report in answer["history"]] == ([] if lost else [0]), answer)


class Readers(OwnScene):
    expects = "a right question is answered rightly, a wrong one refused in words; neither ends the connection"

    def turn(self):
        if self.counts["turns"] % 300 == 299:
            self.close_all()
            return self.start()
        request = self.right()
        command = request.pop("command")
        if self.rng.integers(2):
            answer = self.ask(self.client, command, **request)[0]
            self.judge(command, answer)
            if command == "owner":
                self.owner()
        else:
            self.wrong(command, request)

    def owner(self):
        i = int(self.rng.integers(self.n))
        answer = self.ask(self.client, "owner", scene=self.scene, position=self.points[i].tolist(), id=i)[0]
        self.expect(answer["owner"] == self.assigned[i], "owner of", i, answer, "not", self.assigned[i])

    def wrong(self, command, request):
        names = [*request, "scene", "position", "deadline_seconds", "ghost_width", "methods", "last", "parts", "surplus", "width",
                 "norm", "periodic", "lists"]
        for _ in range(self.rng.integers(1, 3)):
            request[self.random.choice(names)] = self.random.choice(NASTY)
        request["deadline_seconds"] = self.random.choice([self.world.answer_seconds, "x", -1, 1e9, None])
        if command == "rebalance":
            request["dry_run"] = True
        self.count("wrong requests")
        try:
            self.client.ask(command, **request)
        except Refused as refused:
            code, message = refused.args
            self.expect(code in NONSENSE, command, request, "was refused with", code, message)
            self.expect(message and not any(ord(c) < 32 or 127 <= ord(c) < 160 for c in message), command, request, "was refused with", repr(message))


class Pipelined(OwnScene):
    expects = "requests that are sent without waiting are answered all, in their order"

    def turn(self):
        requests = [self.right() for _ in range(int(self.rng.integers(2, 60)))]
        numbers = []
        data = []
        for request in requests:
            self.client.number += 1
            numbers.append(self.client.number)
            data.append(frame(REQUEST, self.client.number, {**request, "deadline_seconds": self.world.answer_seconds}))
        self.client.socket.sendall(b"".join(data))
        last = self.client.number
        for number, request in zip(numbers, requests):
            self.client.number = number
            try:
                self.judge(request["command"], self.client.answer()[0])
            except Refused as refused:
                self.expect(refused.args[0] == "busy", request, refused.args)
                self.count("busy")
        self.client.number = last
        self.count("requests", len(requests))


class Flood(OwnScene):
    """Commands that rank 0 answers alone, faster than a slow rank follows."""

    expects = "however many questions come at once, every one is answered or told busy"

    def start(self):
        super().start()
        self.many = [self.connect() for _ in range(4)]

    def turn(self):
        command = self.random.choice(["error", "counts", "scene.show", "stats"])
        for client in self.many:
            first = client.number + 1
            data = b"".join(frame(REQUEST, first + k, {"command": command, "scene": self.scene}) for k in range(120))
            client.first, client.number = first, first + 119
            client.socket.sendall(data)
        # In turns: one whose answers stay unread for long loses its connection, as it should.
        for k in range(120):
            for client in self.many:
                client.number = client.first + k
                try:
                    client.answer()
                except Refused as refused:
                    self.expect(refused.args[0] == "busy", command, refused.args)
                    self.count("busy")
        self.count("requests", 120 * len(self.many))


class Rude(OwnScene):
    expects = "clients that vanish in the midst of an answer, never read it, or read a byte a second hurt themselves alone"
    pause_seconds = 0.2

    def large(self, count=1):
        """A connection on which large answers are due."""
        client = self.connect(keep=False)
        client.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        command = self.random.choice(["fetch", "cuts", "assign", "scene.show"])
        client.socket.sendall(b"".join(frame(REQUEST, 10 + k, {"command": command, "scene": self.scene})
                                       for k in range(count)))
        return client

    def turn(self):
        kind = self.random.choice(["vanish", "vanish", "vanish", "never", "slow", "half"])
        self.count(kind)
        getattr(self, kind)()

    def vanish(self):
        with self.large(int(self.rng.integers(1, 20))) as client:
            client.socket.recv(int(self.rng.integers(1, 3000)))

    def never(self):
        with self.large(200) as client:
            client.socket.settimeout(1)
            try:
                for _ in range(20):
                    client.socket.sendall(frame(REQUEST, 5, {"command": "fetch", "scene": self.scene}) * 50)
            except (TimeoutError, *LOST):
                pass  # the service need not take what it can't answer
            time.sleep(self.rng.uniform(0, 3))

    def slow(self):
        with self.large() as client:
            for _ in range(6):
                self.expect(client.socket.recv(1), "an answer that is read slowly ended")
                time.sleep(1)

    def half(self):
        """Half a frame, then nothing."""
        data = frame(REQUEST, 3, {"command": "scene.show", "scene": self.scene})
        with self.connect(keep=False) as client:
            client.socket.sendall(data[: int(self.rng.integers(1, len(data)))])
            time.sleep(self.rng.uniform(0, 2))


class Costly(OwnScene):
    """Requests that are small to say and large to answer."""

    expects = "a request that costs too much is refused or ends at its deadline; others are answered meanwhile"
    pause_seconds = 5

    def turn(self):
        kind = self.random.choice(["compare_repeated", "large_json", "many_cuts"])
        self.count(kind)
        getattr(self, kind)()

    def refused_or_done(self, client, command, **request):
        try:
            self.ask(client, command, **request)
        except Refused as refused:
            self.expect(refused.args[0] in NONSENSE, command, refused.args)

    def compare_repeated(self):
        methods = ["rcb", "bands-x"] * int(self.rng.integers(1, 3000))
        self.refused_or_done(self.client, "compare", scene=self.scene, methods=methods, deadline_seconds=5)

    def large_json(self):
        clients = [self.connect(keep=False) for _ in range(4)]
        for client in clients:
            surplus = self.random.choice(["x" * 15_000_000, [0.5] * 3_000_000, [[0.5] * 100] * 2000])
            client.send({"command": "status", "surplus": surplus})
        for client in clients:
            with client:
                try:
                    client.answer()
                except Refused as refused:
                    self.expect(refused.args[0] in ("protocol_error", "too_large"), refused.args)

    def many_cuts(self):
        self.refused_or_done(self.client, "rebalance", scene=self.scene, parts=2**20)
        self.refused_or_done(self.client, "cuts", scene=self.scene)
        self.refused_or_done(self.client, "rebalance", scene=self.scene, parts=self.parts)


class Crowd(Actor):
    """Takes more seats than there are."""

    expects = "connections that never say hello leave a seat for who does"
    pause_seconds = 10

    def turn(self):
        silent = []
        try:
            for _ in range(300):
                silent.append(Client(self.world.endpoint, hello=False, timeout=5))
        except (TimeoutError, Refused, *LOST):
            pass  # no seat for this one
        self.count("silent connections", len(silent))
        with self.connect(keep=False) as client:
            self.ask(client, "status")
        for client in silent:
            client.close()
