"""Talks the wire protocol (common/wire/PROTOCOL.md): counts each step by the cuts, and pushes where it is told to send.

    counts.py SOCKET SCENE POSITIONS.npy        # of shape (steps, n, 3)
"""
import ctypes, json, random, socket, struct, sys
import numpy as np

xxh = ctypes.CDLL("libxxhash.so.0").XXH3_64bits
xxh.restype, xxh.argtypes = ctypes.c_uint64, [ctypes.c_char_p, ctypes.c_size_t]

def send(message, arrays={}, kind=3, bulk=b""):
    if arrays: message["arrays"] = [{"name": name, "dtype": a.dtype.str, "shape": a.shape} for name, a in arrays.items()]
    text, bulk = json.dumps(message).encode(), bulk + b"".join(a.tobytes() for a in arrays.values())
    head = struct.pack("<4sHHIIQQ", b"RCBD", 2, kind, 0, len(text), 1, len(bulk))
    sock.sendall(head + struct.pack("<Q", xxh(head + text, len(head) + len(text))) + text + bulk)

def receive():
    kind, flags, text, _, bulk = struct.unpack("<6xHIIQQ8x", stream.read(40))
    message, rest = json.loads(stream.read(text)), stream.read(bulk + 8 * (flags & 1))
    if kind == 5: sys.exit(message["failure"]["message"])
    if kind == 6: return receive()  # a notice
    arrays = {}
    for one in message.get("arrays", []):
        values = np.frombuffer(rest, one["dtype"], int(np.prod(one["shape"])))
        arrays[one["name"]], rest = values.reshape(one["shape"]), rest[values.nbytes:]
    return message, arrays

def owners(x, ids, node, first, last):
    """The part of each position: down the tree, whose nodes are in preorder; the whole key decides."""
    if last - first == 1: return np.full(len(ids), first, "<i4")
    middle, right, equal = first + (last - first + 1) // 2, np.zeros(len(ids), bool), np.ones(len(ids), bool)
    for values, at in zip([*x.T[cuts["axes"][node]], ids], [*cuts["at"][node], cuts["id"][node]]):
        right, equal = right | (equal & (values > at)), equal & (values == at)
    right = (right | equal) & (cuts["id"][node] >= 0)  # -1: the right side is empty
    part = np.empty(len(ids), "<i4")
    part[~right] = owners(x[~right], ids[~right], node + 1, first, middle)
    part[right] = owners(x[right], ids[right], node + middle - first, middle, last)
    return part

sock = socket.socket(socket.AF_UNIX); sock.connect(sys.argv[1]); stream = sock.makefile("rb"); receive()
send({"protocol": 2, "client": "example 1", "session": f"{random.getrandbits(64):016x}"}, kind=2); receive()
scene, steps, parts = {"scene": sys.argv[2]}, np.load(sys.argv[3]).astype("<f8", copy=False), 8
send(scene | {"command": "scene.create", "parts": parts, "positions": "when-needed", "replace": True}); receive()
send(scene | {"command": "scene.open"}); opened = {"incarnation": receive()[0]["incarnation"]}
known, ids = {}, np.arange(steps.shape[1])  # epoch and hash of the cuts
for number, x in enumerate(steps):
    step, answer = scene | opened | {"step": number, "n": len(x)}, {}
    while number > 0 and not answer.keys() & {"report", "send"}:
        if not known or "again" in answer:
            send(scene | {"command": "cuts", "list": "arrays"})
            told, cuts = receive(); known = {name: told[name] for name in ("epoch", "hash")}
        part, count = np.unique(owners(x, ids, 0, 0, parts), return_counts=True)
        record = [0, int(opened["incarnation"], 16), number, known["epoch"], int(known["hash"], 16), len(x), *[0] * 9]
        send(scene | {"command": "count"}, bulk=struct.pack("<15Q", *record) + np.stack([part, count], 1).astype("<u8").tobytes())
        answer = receive()[0]
    if "report" not in answer:
        send(step | {"command": "push"}, {axis: x[:, a] for a, axis in enumerate("xyz")})
        answer = receive()[0]
        if answer["report"]["repartitioned"]: known = {}
    print(json.dumps(answer["report"]))
