"""A scene of 1,024 seats: all of them connect, open and step at the same moment, and are answered alike."""
import resource
import select
import struct

import protocol_client as protocol
from protocol_client import Client
from seat_client import id_sum
from support import *

SEATS, EACH = 1024, 4
SEED = 20240117


class Crowd:
    """A connection a seat, all of one thread: what is to be sent is there before it begins. Nothing waits for one alone."""

    def __init__(self, address, seats=SEATS, token=None):
        self.address, self.token = address, token
        self.sessions = [os.urandom(8).hex() for _ in range(seats)]
        self.sockets, self.buffers, self.poll = {}, {}, select.epoll()
        for seat in range(seats):
            self.connect(seat)
        welcomes = self.answers(range(seats), protocol.WELCOME)
        self.hellos = self.ask({seat: self.hello(seat, welcome) for seat, (welcome, _) in welcomes.items()})

    def connect(self, seat):
        made = self.sockets[seat] = protocol.connected(self.address, 60)
        self.poll.register(made, select.EPOLLIN)
        self.buffers[made.fileno()] = seat, bytearray()

    def hello(self, seat, welcome):
        document = {"protocol": 2, "client": f"process {seat}", "session": self.sessions[seat]}
        if self.token:
            known = self.token, "endpoint", welcome["nonce"], os.urandom(32).hex(), self.sessions[seat]
            document |= {"nonce": known[3], "proof": protocol.proof("client", *known)}
        return protocol.frame(protocol.HELLO, 1, document)

    def lose(self, seat):
        made = self.sockets.pop(seat)
        del self.buffers[made.fileno()]
        made.close()

    def back(self, seat):
        self.connect(seat)
        welcome = self.answers([seat], protocol.WELCOME)[seat][0]
        self.ask({seat: self.hello(seat, welcome)})

    def send(self, frames):
        for seat, data in frames.items():
            self.sockets[seat].sendall(data)

    def ask(self, frames, kind=protocol.REPLY):
        """The answers to these frames, a seat each, as (document, arrays); all of this kind."""
        self.send(frames)
        return self.answers(frames, kind)

    def answers(self, seats, kind):
        missing, answers = set(seats), {}
        while missing:
            ready = self.poll.poll(60)
            assert ready, f"no answer to {len(missing)} seats, such as {min(missing)}"
            for descriptor, _ in ready:
                seat, buffer = self.buffers[descriptor]
                some = self.sockets[seat].recv(1 << 20)
                assert some, f"seat {seat} has been turned away"
                buffer += some
                for got, document, bulk in self.frames_in(buffer):
                    if got == protocol.NOTICE:
                        continue
                    assert got == kind, (seat, document)
                    assert seat in missing, (seat, document)
                    missing.remove(seat)
                    answers[seat] = document, protocol.arrays_of(document, bulk)
        return answers

    @staticmethod
    def frames_in(buffer):
        """Takes the whole frames out of the buffer."""
        while len(buffer) >= 40:
            kind, flags, text, _, bulk = struct.unpack("<6xHIIQQ8x", buffer[:40])
            assert flags == 0
            size = 40 + text + bulk
            if len(buffer) < size:
                return
            yield kind, json.loads(buffer[40: 40 + text]), bytes(buffer[40 + text: size])
            del buffer[:size]

    def close(self):
        for made in self.sockets.values():
            made.close()
        self.poll.close()


class Solver:
    """What the processes of a solver know together: whose row is whose, and the cuts."""

    def __init__(self, crowd, scene):
        self.crowd, self.scene, self.seats = crowd, scene, range(SEATS)
        self.x = np.random.default_rng(SEED).random((SEATS * EACH, 3))
        self.part = np.repeat(np.arange(SEATS), EACH)  # seat k has part k
        self.generation = [1] * SEATS

    def request(self, command, columns=None, dtypes={}, **fields):
        arrays, bulk = protocol.described(columns, dtypes) if columns else (None, b"")
        return protocol.frame(protocol.REQUEST, 2, {"command": command, "scene": self.scene, "arrays": arrays, **fields}, bulk)

    def open(self, seats):
        opened = self.crowd.ask({k: self.request("scene.open", seat=k, seats=SEATS, generation=self.generation[k])
                                 for k in seats})
        self.incarnation = opened[min(opened)][0]["incarnation"]
        return opened

    def pushes(self, step, **more):
        frames = {}
        for k in self.seats:
            rows = np.flatnonzero(self.part == k)
            push = {"step": step, "attempt": step}
            columns = dict(zip("xyz", self.x[rows].T)) | {"id": rows}
            frames[k] = self.request("push", columns if len(rows) else None, **push, n=len(rows), ids=True, **more)
        return frames

    def counts(self, step):
        frames = {}
        for k in self.seats:
            rows = np.flatnonzero(self.part == k)
            record = protocol.count_record(step, {**self.cuts, "incarnation": self.incarnation}, {k: len(rows)},
                                           id_sum=id_sum(rows))
            frames[k] = protocol.frame(protocol.REQUEST, 2, {"command": "count", "scene": self.scene}, record)
        return frames

    def take_cuts(self, told, control):
        """All seats hand over their rows: each has its own part's."""
        self.cuts = {name: told[name] for name in ("epoch", "hash")}
        answer, bulk = control.ask("assign", scene=self.scene, held=True)
        self.part = protocol.arrays_of(answer, bulk)["part"]


class Seats(unittest.TestCase):
    def setUp(self):
        soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        if hard < 6 * SEATS:
            print("SKIPPED: too few files may be open (ulimit -n)", file=sys.stderr)
            self.skipTest("too few open files")
        resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
        self.addCleanup(resource.setrlimit, resource.RLIMIT_NOFILE, (soft, hard))

    def same(self, answers):
        """The report that all seats got."""
        texts = {json.dumps(document, sort_keys=True) for document, _ in answers.values()}
        self.assertEqual(len(texts), 1, sorted(texts)[:2])
        return json.loads(texts.pop())["report"]

    def solve(self, service, crowd, control):
        control.ask("scene.create", scene="many", parts=SEATS, positions="when-needed")
        solver = Solver(crowd, "many")
        opened = solver.open(solver.seats)
        self.assertEqual(opened[7][0]["seat"], {"seat": 7, "seats": SEATS, "generation": 1})
        shown = control.ask("scene.show", scene="many")[0]
        self.assertEqual(shown["holders_count"], SEATS)
        self.assertEqual(shown["holders"], sorted(f"process {k}" for k in solver.seats)[:8])
        self.assertIn("1016 more", service.failure("scene", "drop", "many")["message"])

        first = crowd.ask(solver.pushes(0, cuts_known={}))
        report = self.same(first)
        self.assertEqual((report["n"], report["parts"], report["way"]), (SEATS * EACH, SEATS, "endpoint"))
        arrays = [arrays for _, arrays in first.values()]
        for name in ("axes", "at", "id"):
            self.assertEqual({one[name].tobytes() for one in arrays}, {arrays[0][name].tobytes()})
        solver.take_cuts(first[0][0]["cuts"], control)
        for step in range(1, 6):
            report = self.same(crowd.ask(solver.counts(step)))
            self.assertEqual((report["step"], report["n"], report["way"]), (step, SEATS * EACH, "count"))
            self.assertEqual((report["sent"], report["strangers"]), (False, 0))

        lost, frames = SEATS - 24, solver.counts(6)
        others = {k: data for k, data in frames.items() if k != lost}
        crowd.send(others)
        self.assertEqual(control.ask("status")[0]["sessions"], SEATS + 1)
        crowd.lose(lost)
        for answer, _ in crowd.answers(others, protocol.FAILURE).values():
            self.assertEqual(answer["failure"]["code"], "aborted")
            self.assertIn(f"seat {lost} ('process {lost}'", answer["failure"]["message"])
        crowd.back(lost)
        solver.generation[lost] = 2
        self.assertEqual(solver.open([lost])[lost][0]["seat"]["generation"], 2)
        self.assertEqual(self.same(crowd.ask(frames))["step"], 6)

        report = self.same(crowd.ask(solver.pushes(7)))
        self.assertEqual((report["step"], report["way"], report["strangers"]), (7, "endpoint", 0))
        self.assertEqual((report["bytes"], report["positions_step"]), (SEATS * EACH * 32, 7))

    def test_over_a_unix_socket(self):
        with Service(2) as service, Client(service.endpoint, timeout=60) as control:
            crowd = Crowd(service.endpoint)
            self.addCleanup(crowd.close)
            self.solve(service, crowd, control)

    def test_over_tcp(self):
        with Service(2, tcp=f"127.0.0.1:{free_port()}") as service:
            token = token_of(service.data)
            crowd = Crowd(service.endpoint, token=token)
            self.addCleanup(crowd.close)
            with Client(service.endpoint, token=token, timeout=60) as control:
                self.solve(service, crowd, control)


if __name__ == "__main__":
    unittest.main()
