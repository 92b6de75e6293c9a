"""Bytes and frames that no honest client sends, to every listener of the service."""
import json
import os
import socket
import struct

from actor import LOST, Actor
from protocol_client import GOODBYE, HELLO, NOTICE, REPLY, REQUEST, Client, Refused, connected, frame, xxh3

# Names that the service uses on its inside, and fields of requests: nobody may believe them from outside.
INTERNAL = ("staged", "seat", "session", "blocks", "together", "seats", "number", "rank", "direct", "loan",
            "snapshot", "terms", "internal", "push", "secret", "way", "generation")
COMMANDS = ("status", "scene.list", "scene.show", "scene.open", "scene.close", "scene.create", "error", "counts", "cuts",
            "history", "stats", "owner", "box", "assign", "fetch", "quality", "compare", "count", "rebalance",
            "push", "push", "push.slice", "push.staged", "hello", "")
FIELDS = ("step", "attempt", "n", "dtype", "weights", "ids", "drifted", "cuts_known", "incarnation", "hash", "id_sum",
          "path", "rank", "count", "first", "counts", "inserted", "removed", "memory", "sockets", "arrays", "parts",
          "dims", "method", "tolerance", "part_sizes", "replace", "position", "id", "lo", "hi", "last", "seat",
          "seats", "epoch", "methods", "ghost_width", "dry_run", "policy", "step_seconds", "client",
          "protocol", "token", "version", "deadline_seconds")


def listeners(pids):
    """Every listening address of these processes: `unix:PATH` or `HOST:PORT`."""
    inodes = set()
    for pid in pids:
        for fd in os.listdir(f"/proc/{pid}/fd"):
            try:
                target = os.readlink(f"/proc/{pid}/fd/{fd}")
            except OSError:
                continue
            if target.startswith("socket:["):
                inodes.add(target[8:-1])
    found = []
    with open("/proc/net/unix") as file:
        for line in file.readlines()[1:]:
            fields = line.split()
            if len(fields) > 7 and fields[6] in inodes and int(fields[3], 16) & 0x10000 and not fields[7].startswith("@"):
                found.append("unix:" + fields[7])
    with open("/proc/net/tcp") as file:
        for line in file.readlines()[1:]:
            fields = line.split()
            if fields[9] in inodes and fields[3] == "0A":
                host, port = fields[1].split(":")
                host = socket.inet_ntoa(struct.pack("<I", int(host, 16)))
                found.append(f"{'127.0.0.1' if host == '0.0.0.0' else host}:{int(port, 16)}")
    return sorted(set(found))


class Fuzz(Actor):
    expects = "whatever comes to whichever listener, the connection is answered or closed, and nothing else is affected"

    def start(self):
        with self.connect(keep=False) as control:
            self.drop_all(control)
            self.scene = self.create(control, parts=3)
            self.sessions = [control.session]
        self.listeners = listeners(self.world.rank_pids())
        self.expect(len(self.listeners) >= 2, "listeners", self.listeners)

    def turn(self):
        kind = self.random.choice(["noise", "header", "mutated", "fields", "fields", "fields", "order", "deep", "text",
                                   "announced", "arrays"])
        self.count(kind)
        getattr(self, kind)()
        if self.counts["turns"] % 50 == 0:
            with self.connect(keep=False) as control:
                self.ask(control, "status")

    # Connections.

    def bare(self):
        """A connection to any listener, without hello."""
        address = self.random.choice(self.listeners)
        self.count("to " + ("endpoint" if address == self.world.endpoint else address.split(":")[0].rstrip("0123456789.")
                            or "tcp"))
        return connected(address, self.world.answer_seconds)

    def opened(self):
        """A connection that has said hello: to the endpoint, or to a rank's data listener."""
        tcp = self.rng.integers(2) == 1
        client = self.connect(tcp=tcp, keep=False)
        if self.rng.integers(3) > 0:
            return client
        with client:
            rank, place = self.random.choice(list(enumerate(client.hello["data"])))
            return self.patiently(Client, place, session=client.session, token=client.token, listener=f"rank {rank}",
                                  timeout=client.socket.gettimeout())

    def send(self, link, data):
        try:
            link.sendall(data)
        except LOST:
            self.count("closed meanwhile")

    def drain(self, link, end=False):
        """Reads what comes until the connection ends, or, unless its end is awaited, for a moment."""
        link.settimeout(self.world.answer_seconds if end else 0.05)
        try:
            while link.recv(1 << 16):
                pass
            return True
        except ConnectionError:
            return True
        except TimeoutError:
            self.expect(not end, "a connection was neither answered nor closed")
            return False

    # What is sent.

    def noise(self):
        with self.bare() as link:
            self.send(link, self.random.randbytes(self.random.choice([1, 39, 40, 41, 500, 100_000])))
            self.drain(link)

    def header(self):
        """A header of random fields, with a checksum that holds or doesn't."""
        def any_of(*values):
            return self.random.choice([*values, self.random.getrandbits(32)])
        head = struct.pack("<4sHHIIQQ", self.random.choice([b"RCBD", b"RCBD", b"\0\0\0\0"]), any_of(1, 1, 0) & 0xFFFF,
                           any_of(*range(9)) & 0xFFFF, any_of(0, 1, 2**32 - 1), any_of(0, 1, 20, 2**24, 2**24 + 1, 2**32 - 1),
                           any_of(0, 1, 2**64 - 1), any_of(0, 1, 8, 2**31, 2**47, 2**63, 2**64 - 1))
        with self.bare() as link:
            self.send(link, head + struct.pack("<Q", self.random.choice([xxh3(head), 0])) + self.random.randbytes(30))
            self.drain(link)

    def mutated(self):
        """A frame of which some bytes are others; the checksum is made to fit, or not."""
        data = bytearray(frame(self.random.choice([HELLO, REQUEST]), 7, self.document()))
        for _ in range(self.random.randint(1, 8)):
            data[self.random.randrange(len(data))] = self.random.randrange(256)
        if self.random.random() < 0.7:
            data[32:40] = struct.pack("<Q", xxh3(bytes(data[:32] + data[40:])))
        if self.random.random() < 0.2:
            data = data[: self.random.randrange(len(data))]
        opened = self.opened() if self.random.random() < 0.7 else None
        with opened or self.bare() as link:
            link = opened.socket if opened else link
            self.send(link, bytes(data))
            self.drain(link)

    def value(self, depth=0):
        number = self.random.choice([0, 1, -1, 2, 7, 2**31, 2**48, 2**53 + 1, 2**63 - 1, -2**63, 2**64 - 1, 0.5, 1e308])
        text = self.random.choice(["", self.scene, "id", "<f8", "<f4", "none", "endpoint", "sockets", "shared-memory", "x" * 1000, "0" * 16, "\u0000", "é", *self.sessions])
        if depth > 2:
            return number
        return self.random.choice([
            number, number, text, text, None, True, False, [self.value(depth + 1) for _ in range(self.random.randrange(4))],
            {self.random.choice(FIELDS + INTERNAL): self.value(depth + 1)}])

    def document(self):
        """A request with the fields of some other one, about the fuzzer's own scene."""
        names = [*FIELDS, *INTERNAL]
        document = {self.random.choice(names): self.value() for _ in range(self.random.randrange(8))}
        document |= {"command": self.random.choice(COMMANDS), "scene": self.scene}
        if self.random.random() < 0.3:
            document |= {"step": self.random.randrange(4), "attempt": 1}
        return document

    def fields(self):
        """Well-formed requests that make no sense. Each must be answered, or end the connection."""
        with self.opened() as client:
            self.sessions = [*self.sessions[-3:], client.session]
            is_data = "rank" in client.hello
            for _ in range(self.random.randint(1, 6)):
                document = self.document()
                if document.get("deadline_seconds"):
                    document["deadline_seconds"] = self.random.choice([1e-3, 1, 5])
                document.setdefault("deadline_seconds", 5)
                client.number += 1
                self.send(client.socket, frame(REQUEST, client.number, document))
                if is_data or document["command"] == "push":
                    continue  # answered when its rows have come, or not at all
                try:
                    self.answer_of(client)
                except LOST:
                    return self.count("closed")
            self.drain(client.socket)

    def answer_of(self, client):
        """The answer to the last request; answers to earlier ones may come before."""
        while True:
            kind, request, document, _ = client.receive()
            failure = document.get("failure", {})
            self.expect(failure.get("code") != "internal", "an internal fault:", failure)
            if kind != NOTICE and request in (client.number, 0):
                return

    def order(self):
        """Frames in an order that no client sends."""
        with self.opened() as client:
            for _ in range(self.random.randint(1, 5)):
                kind = self.random.choice([HELLO, REQUEST, REPLY, NOTICE, GOODBYE, 1, 5])
                self.send(client.socket, frame(kind, self.random.choice([0, 1, 5]), self.document()))
            self.drain(client.socket)

    def deep(self):
        """JSON nested deeper than anybody reads, or of many small things."""
        depth = self.random.choice([31, 32, 33, 1000, 100_000])
        text = self.random.choice([
            b'{"command":"status","x":' + b"[" * depth + b"]" * depth + b"}", b'{"a":' * depth,
            b'{"command":"status","x":[' + b"{}," * depth + b"{}]}",
            b'{"command":"status","x":1e' + b"9" * min(depth, 1000) + b"}", b"[" * depth])
        self.send_text(text)

    def text(self):
        """What isn't JSON, or not UTF-8, or says a thing twice."""
        self.send_text(self.random.choice([
            b"", b"{", b"null", b'"command"', b'{"command":"status"}{}', b'{"command":"status","command":"error"}',
            b'{"command":"st\xff"}', b'{"command":"status","x":"\\u0000"}', b'{"command":"status","x":NaN}', b"\0" * 40,
            b'{"command":"status","x":"\\ud800"}', json.dumps({"command": "status", "x": "\u2028"}).encode("utf-16")]))

    def send_text(self, text):
        head = struct.pack("<4sHHIIQQ", b"RCBD", 2, REQUEST, 0, len(text), 3, 0)
        with self.opened() as client:
            self.send(client.socket, head + struct.pack("<Q", xxh3(head + text)) + text)
            client.number = 3
            try:
                client.answer()
            except Refused as refused:
                self.expect(refused.args[0] in ("protocol_error", "too_large", "invalid_argument", "unsupported"), refused.args)
            except (AssertionError, *LOST):
                pass  # told so with request 0, or closed

    def arrays(self):
        """A push or slice whose arrays contradict themselves."""
        shapes = [[1], [3], [0], [-1], [2**48], [2**61, 8], [2**32, 2**32], [], [1] * 9, "x", None]
        arrays = [{"name": self.random.choice(["x", "y", "z", "id", "w", "", "x" * 65, 7]),
                   "dtype": self.random.choice(["<f8", "<f4", "<i8", ">f8", "object", "", 3]),
                   "shape": self.random.choice(shapes)} for _ in range(self.random.choice([0, 1, 3, 4, 17]))]
        document = {**self.document(), "command": self.random.choice(["push.slice", "push", "status"]),
                    "arrays": self.random.choice([arrays, None, {}, 5])}
        with self.opened() as client:
            self.send(client.socket, frame(REQUEST, 9, document, self.random.randbytes(self.random.choice([0, 8, 24, 1000])),
                                           flags=self.random.randrange(2)))
            self.drain(client.socket)

    def announced(self):
        """Gigabytes that are announced and never come."""
        with self.opened() as client:
            if "rank" in client.hello:
                return
            n = self.random.choice([10**6, 10**8, 4 * 10**8])
            push = {"command": "push", "scene": self.scene, "step": 0, "attempt": 1, "n": n, "deadline_seconds": 2,
                    "arrays": [{"name": axis, "dtype": "<f8", "shape": [n]} for axis in "xyz"]}
            text = json.dumps(push).encode()
            head = struct.pack("<4sHHIIQQ", b"RCBD", 2, REQUEST, 0, len(text), 9, 24 * n)
            self.send(client.socket, head + struct.pack("<Q", xxh3(head + text)) + text)
            self.drain(client.socket)
