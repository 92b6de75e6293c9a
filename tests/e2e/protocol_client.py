"""A client written from PROTOCOL.md alone, so that the page is proved complete enough. Needs libxxhash."""
import ctypes
import ctypes.util
import hashlib
import hmac
import ipaddress
import json
import os
import socket
import ssl
import struct

import numpy as np

_xxh = ctypes.CDLL(ctypes.util.find_library("xxhash") or "libxxhash.so.0")
_xxh.XXH3_64bits.restype = ctypes.c_uint64
_xxh.XXH3_64bits.argtypes = [ctypes.c_char_p, ctypes.c_size_t]

WELCOME, HELLO, REQUEST, REPLY, FAILURE, NOTICE, GOODBYE = range(1, 8)


def xxh3(data):
    return _xxh.XXH3_64bits(data, len(data))


def frame(kind, request, document, bulk=b"", flags=0):
    text = json.dumps(document).encode()
    head = struct.pack("<4sHHIIQQ", b"RCBD", 2, kind, flags, len(text), request, len(bulk))
    tail = struct.pack("<Q", xxh3(bulk)) if flags & 1 else b""
    return head + struct.pack("<Q", xxh3(head + text)) + text + bulk + tail


def reframed(data, change):
    """The frame, or its beginning, with its JSON changed by a function, and a checksum that holds."""
    magic, version, kind, flags, text, request, bulk = struct.unpack("<4sHHIIQQ", data[:32])
    document = json.loads(data[40: 40 + text])
    change(document)
    words = json.dumps(document).encode()
    head = struct.pack("<4sHHIIQQ", magic, version, kind, flags, len(words), request, bulk)
    return head + struct.pack("<Q", xxh3(head + words)) + words + data[40 + text:]


def described(columns, dtypes={}):
    """(the `arrays` of a message, their bulk); positions are <f8 unless said otherwise, `id` is <i8."""
    default = {"id": "<i8"}
    arrays, bulk = [], []
    for name, column in columns.items():
        dtype = dtypes.get(name) or default.get(name, "<f8")
        arrays.append({"name": name, "dtype": dtype, "shape": [len(column)]})
        bulk.append(np.ascontiguousarray(column, dtype).tobytes())
    return arrays, b"".join(bulk)


def count_record(step, named, counts, n=None, inserted=0, removed=0, id_sum=None, drifted=None, step_seconds=None, weights=None,
                 more_bits=0):
    """The bulk of a count. named: `incarnation`, `epoch` and `hash`, as they are told; counts: by part, or {part: count};
    weights: {"scale", "least", "greatest", "weights_as_zero", "loads": by entry of counts}."""
    counts = counts if isinstance(counts, dict) else dict(enumerate(counts))
    said = [value is not None for value in (id_sum, drifted, step_seconds, weights)]
    weighted = weights or {"scale": 0, "least": 0, "greatest": 0, "weights_as_zero": 0, "loads": [0] * len(counts)}
    head = struct.pack("<QQqQQQQQQQdqddQ", sum(bit << k for k, bit in enumerate(said)) | more_bits, int(named["incarnation"], 16),
                       step, named["epoch"], int(named["hash"], 16), sum(counts.values()) if n is None else n, inserted, removed,
                       id_sum or 0, drifted or 0, step_seconds or 0,
                       *(weighted[name] for name in ("scale", "least", "greatest", "weights_as_zero")))
    rows = [struct.pack("<QQ", part, count) + (int(load).to_bytes(16, "little") if weights else b"")
            for (part, count), load in zip(counts.items(), weighted["loads"])]
    return head + b"".join(rows)


def arrays_of(document, bulk):
    """The arrays of an answer, by name."""
    arrays, at = {}, 0
    for spec in document.get("arrays", ()):
        size = int(np.prod(spec["shape"])) * np.dtype(spec["dtype"]).itemsize
        arrays[spec["name"]] = np.frombuffer(bulk[at: at + size], spec["dtype"]).reshape(spec["shape"])
        at += size
    assert at == len(bulk), (document.get("arrays"), len(bulk))
    return arrays


class Refused(Exception):
    """The service answered with a failure: its code and its message."""


def connected(address, timeout):
    """A socket to a path, `unix:PATH` or `HOST:PORT`."""
    if address.startswith(("/", "unix:")):
        made = socket.socket(socket.AF_UNIX)
        made.settimeout(timeout)
        place = address.removeprefix("unix:")
    else:
        made = socket.socket(socket.AF_INET6 if address.startswith("[") else socket.AF_INET)
        made.settimeout(timeout)
        host, port = address.rsplit(":", 1)
        place = (host.strip("[]"), int(port))
    try:
        made.connect(place)
    except OSError:
        made.close()
        raise
    return made


def encrypted(made, token):
    """(the socket, with TLS where a client with this token must speak it; the fingerprint of the certificate shown, or "")"""
    if made.family == socket.AF_UNIX or (token or "").startswith("trusted-network-"):
        return made, ""
    address = ipaddress.ip_address(made.getpeername()[0])
    if (getattr(address, "ipv4_mapped", None) or address).is_loopback:
        return made, ""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.minimum_version, context.check_hostname, context.verify_mode = ssl.TLSVersion.TLSv1_3, False, ssl.CERT_NONE
    made = context.wrap_socket(made)
    return made, hashlib.sha256(made.getpeercert(binary_form=True)).hexdigest()


def proof(role, token, listener, service_nonce, client_nonce, session, certificate=""):
    text = f"rcbd proof 1\n{role}\n{listener}\n{service_nonce}\n{client_nonce}\n{session}\n"
    if certificate:
        text += f"{certificate}\n"
    return hmac.new(token.encode(), text.encode(), "sha256").hexdigest()


class Client:
    """One connection, opened with hello unless told otherwise. `token` is for TCP; `listener` is "endpoint" or "rank R"."""

    links = ()

    def __init__(self, address, session=None, hello=True, timeout=30, token=None, listener="endpoint"):
        self.socket = connected(address, timeout)
        self.token, self.listener = token, listener
        self.number = 0
        self.session = session or os.urandom(8).hex()
        try:
            self.socket, self.certificate = encrypted(self.socket, token)
            kind, _, self.welcome, _ = self.receive()
            if kind == FAILURE:
                raise Refused(self.welcome["failure"]["code"], self.welcome["failure"]["message"])
            assert kind == WELCOME
            if hello:
                self.say_hello()
        except BaseException:
            self.socket.close()
            raise

    def say_hello(self):
        document = {"protocol": 2, "client": "e2e", "session": self.session}
        tcp = self.socket.family != socket.AF_UNIX
        if tcp:
            known = self.token, self.listener, self.welcome["nonce"], os.urandom(32).hex(), self.session, self.certificate
            document |= {"nonce": known[3], "proof": proof("client", *known)}
        self.number += 1
        self.write(frame(HELLO, self.number, document))
        self.hello = self.answer()[0]
        if tcp:
            assert hmac.compare_digest(self.hello["proof"], proof("service", *known)), "who listens there is not rcbd"

    def exactly(self, count):
        data = bytearray()
        while len(data) < count:
            chunk = self.socket.recv(min(count - len(data), 1 << 20))
            if not chunk:
                raise EOFError
            data += chunk
        return bytes(data)

    def receive(self):
        head = self.exactly(40)
        magic, version, kind, flags, json_bytes, request, bulk_bytes, checksum = struct.unpack("<4sHHIIQQQ", head)
        assert (magic, version) == (b"RCBD", 2)
        text = self.exactly(json_bytes)
        assert checksum == xxh3(head[:32] + text)
        bulk = self.exactly(bulk_bytes)
        if flags & 1:
            assert self.exactly(8) == struct.pack("<Q", xxh3(bulk))
        return kind, request, json.loads(text), bulk

    def answer(self):
        while True:
            kind, request, document, bulk = self.receive()
            if kind == NOTICE:
                continue
            if kind == FAILURE:
                raise Refused(document["failure"]["code"], document["failure"]["message"])
            assert kind == REPLY and request == self.number, (self.number, kind, request, document)
            return document, bulk

    def write(self, data):
        try:
            self.socket.sendall(data)
        except (BrokenPipeError, ConnectionResetError):
            self.answer()  # why the service has closed, where it said so
            raise

    def send(self, document, bulk=b"", flags=0):
        self.number += 1
        self.write(frame(REQUEST, self.number, document, bulk, flags))

    def ask(self, command, **arguments):
        self.send({"command": command, **arguments})
        return self.answer()

    def push_frame(self, scene, step, columns, n, attempt=0):
        """A push through the endpoint: its JSON, its bulk."""
        arrays, bulk = described(columns) if n else ([], b"")
        return {"command": "push", "scene": scene, "step": step, "attempt": attempt, "n": n, "ids": "id" in columns,
                "arrays": arrays}, bulk

    def push(self, scene, step, points, attempt=0, flags=0, ids=None, **more):
        columns = dict(zip("xyz", points.T)) | ({} if ids is None else {"id": ids})
        push, bulk = self.push_frame(scene, step, columns, len(points), attempt)
        self.send({**push, **more}, bulk, flags)
        return self.answer()

    def link_ranks(self):
        """A connection to each rank, for as long as this one lasts."""
        options = {"timeout": self.socket.gettimeout(), "token": self.token}
        self.links = [Client(place, session=self.session, listener=f"rank {rank}", **options)
                      for rank, place in enumerate(self.hello["data"])]

    def close(self):
        for link in self.links:
            link.close()
        self.socket.close()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()
