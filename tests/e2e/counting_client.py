"""A client of one page that steps by counts: it knows the cuts, counts each step by them, and pushes where it is told to send.

    counting_client.py SOCKET SCENE POSITIONS.npy      # shape (steps, n, 3); a scene that is `when-needed`, of 8 parts
"""
import ctypes, json, random, socket, struct, sys

import numpy as np

xxh = ctypes.CDLL("libxxhash.so.0").XXH3_64bits
xxh.restype, xxh.argtypes = ctypes.c_uint64, [ctypes.c_char_p, ctypes.c_size_t]


class Client:
    def __init__(self, path):
        self.sock = socket.socket(socket.AF_UNIX)
        self.sock.connect(path)
        self.stream, self.session, self.number = self.sock.makefile("rb"), f"{random.getrandbits(64):016x}", 0
        self.receive()  # welcome
        self.send(2, {"protocol": 2, "client": "counting client", "session": self.session})
        self.receive()

    def send(self, kind, message, arrays={}):
        dtypes = {"f": "<f8", "i": "<i4", "u": "<u8"}
        if arrays:
            message["arrays"] = [{"name": k, "dtype": dtypes[v.dtype.kind], "shape": v.shape} for k, v in arrays.items()]
        text, bulk = json.dumps(message).encode(), b"".join(v.tobytes() for v in arrays.values())
        head = struct.pack("<4sHHIIQQ", b"RCBD", 2, kind, 0, len(text), self.number or 1, len(bulk))
        self.sock.sendall(head + struct.pack("<Q", xxh(head + text, len(head) + len(text))) + text + bulk)

    def receive(self):
        while True:
            kind, flags, text, _, bulk = struct.unpack("<6xHIIQQ8x", self.stream.read(40))
            message, rest = json.loads(self.stream.read(text)), self.stream.read(bulk + 8 * (flags & 1))
            if kind == 5: sys.exit(message["failure"]["message"])
            if kind != 6: break
        arrays, at = {}, 0
        for one in message.get("arrays", []):
            values = np.frombuffer(rest, one["dtype"], int(np.prod(one["shape"])), at)
            arrays[one["name"]], at = values.reshape(one["shape"]), at + values.nbytes
        return message, arrays

    def call(self, message, arrays={}):
        self.number += 1
        self.send(3, message, arrays)
        return self.receive()


def owners(cuts, x, ids, node=0, first=0, last=None):
    """The part of each position: down the tree, whose nodes are in preorder; the whole key decides."""
    last = len(cuts["id"]) + 1 if last is None else last
    if last - first == 1: return np.full(len(ids), first, np.int32)
    half, axes = (last - first + 1) // 2, cuts["axes"][node]
    right, equal = np.zeros(len(ids), bool), np.ones(len(ids), bool)
    for values, at in [*((x[:, a], at) for a, at in zip(axes, cuts["at"][node])), (ids, cuts["id"][node])]:
        right, equal = right | (equal & (values > at)), equal & (values == at)
    right = (right | equal) & (cuts["id"][node] >= 0)  # -1: the right side is empty
    part = np.empty(len(ids), np.int32)
    part[~right] = owners(cuts, x[~right], ids[~right], node + 1, first, first + half)
    part[right] = owners(cuts, x[right], ids[right], node + half, first + half, last)
    return part


def main(path, scene, file):
    client, steps = Client(path), np.load(file)
    n, ids = steps.shape[1], np.arange(steps.shape[1])
    client.call({"command": "scene.create", "scene": scene, "parts": 8, "positions": "when-needed", "replace": True})
    incarnation = client.call({"command": "scene.open", "scene": scene})[0]["incarnation"]
    named, cuts, before = {}, None, None  # the cuts' epoch and hash; their arrays; the parts at the step before
    for step, x in enumerate(steps):
        push = {"scene": scene, "session": client.session, "step": step}
        drifted, answer, parts = None, {"send": "first"}, None
        while cuts and "report" not in answer:
            parts = owners(cuts, x, ids)
            drifted = None if before is None else int((parts != before).sum())
            counts = np.bincount(parts, minlength=8).astype("<u8")
            some = np.flatnonzero(counts).astype("<i4")
            answer = client.call(push | named | {"command": "count", "incarnation": incarnation, "n": n, "drifted": drifted},
                                 {"part": some, "count": counts[some]})[0]
            if "send" in answer: break
            if "again" in answer:  # somebody else has repartitioned
                told, cuts = client.call({"command": "cuts", "scene": scene, "list": "arrays"})
                named, before = {k: told[k] for k in ("epoch", "hash")}, None
        if "send" in answer:
            client.number += 1
            client.send(3, push | {"command": "push.begin", "n": n, "drifted": drifted, "cuts_known": named, "attempt": step})
            client.send(3, push | {"command": "push.slice", "count": n, "attempt": step},
                        {axis: np.ascontiguousarray(x[:, a]) for a, axis in enumerate("xyz")})
            answer, arrays = client.receive()
            if "cuts" in answer:
                named, cuts = {k: answer["cuts"][k] for k in ("epoch", "hash")}, arrays
                parts = owners(cuts, x, ids)
        before = parts
        print(json.dumps(answer["report"]))


main(*sys.argv[1:])
