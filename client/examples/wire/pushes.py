"""Talks the wire protocol (common/wire/PROTOCOL.md): pushes one step of a scene of 1000 points, whose ids are their rows.

    pushes.py SOCKET        # needs the C library xxHash: Debian's libxxhash0
"""
import array, ctypes, json, random, socket, struct, sys

xxh = ctypes.CDLL("libxxhash.so.0").XXH3_64bits  # or the package python3-xxhash: xxhash.xxh3_64_intdigest
xxh.restype, xxh.argtypes = ctypes.c_uint64, [ctypes.c_char_p, ctypes.c_size_t]


def send(kind, request, message, arrays={}):
    raw = {name: array.array("d", values).tobytes() for name, values in arrays.items()}  # little-endian machine
    message["arrays"] = [{"name": name, "dtype": "<f8", "shape": [len(values) // 8]} for name, values in raw.items()]
    text, bulk = json.dumps(message).encode(), b"".join(raw.values())
    head = struct.pack("<4sHHIIQQ", b"RCBD", 2, kind, 0, len(text), request, len(bulk))
    sock.sendall(head + struct.pack("<Q", xxh(head + text, len(head) + len(text))) + text + bulk)


def receive():
    """The next frame that isn't a notice."""
    while True:
        kind, flags, text, request, bulk = struct.unpack("<6xHIIQQ8x", stream.read(40))
        message, rest = json.loads(stream.read(text)), stream.read(bulk + 8 * (flags & 1))
        if kind == 5: sys.exit(message["failure"]["message"])
        if kind != 6: return message, rest


sock = socket.socket(socket.AF_UNIX)
sock.connect(sys.argv[1])
stream = sock.makefile("rb")
receive()  # welcome
send(2, 1, {"protocol": 2, "client": "example 1", "session": f"{random.getrandbits(64):016x}"})
receive()
send(3, 2, {"command": "scene.create", "scene": "demo", "parts": 4, "replace": True})
receive()
n = 1000
send(3, 3, {"command": "push", "scene": "demo", "step": 0, "n": n}, {axis: [random.random() for _ in range(n)] for axis in "xyz"})
print(receive()[0]["report"])
