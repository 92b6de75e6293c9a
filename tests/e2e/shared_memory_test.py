"""Pushes from memory that a client shares with the ranks: the same scenes as by any other way, and nothing that a client
does with its memory harms anybody else.

shared_memory_test.py --steps 10000 --kills 500 is the long form.
"""
import argparse
import contextlib
import random
import socket
import subprocess
import tempfile
import threading

from protocol_client import REQUEST, Client, Refused, arrays_of, frame
from push_client import Block, PushClient
from shared_memory_client import F_SEAL_GROW, F_SEAL_SHRINK, SharedClient, memfd
from support import *

OPTIONS = argparse.Namespace(steps=1500, kills=40)
DIFFERING = ("seconds", "scene", "way")
VICTIM = """
import sys, time
sys.path.insert(0, sys.argv[2])
import numpy as np
from shared_memory_client import SharedClient
client = SharedClient(sys.argv[1])
client.ask("scene.create", scene=sys.argv[3], parts=4, replace=True)
xyz = client.positions(3000)
print("ready", flush=True)
step = 0
while True:
    xyz[:] = np.random.default_rng(step).random(xyz.shape)
    client.step(sys.argv[3], step, xyz)
    step += 1
    if step % 5 == 0:
        xyz = client.positions(3000 + step)
        client.ask("scene.create", scene=sys.argv[3], parts=4, replace=True)
"""


class SharedMemory(Refusals, ServiceTest):
    ranks = 3

    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.walk = random_walk(4, 3000)

    def report(self, report):
        return {name: value for name, value in report.items() if name not in DIFFERING}

    def assign(self, scene):
        with Client(self.path) as client:
            return client.ask("assign", scene=scene)[1]

    def mappings(self):
        """Of memfds, in the ranks, those that these share with each other among them; and their descriptors."""
        maps = descriptors = 0
        for rank in self.service.processes("rcbd"):
            with open(f"/proc/{rank}/maps") as file:
                maps += sum("memfd:" in line for line in file)
            descriptors += len(os.listdir(f"/proc/{rank}/fd"))
        return maps, descriptors

    def at_rest(self):
        """The same once nothing of the tests before is about to be closed any more."""
        last, since = self.mappings(), time.monotonic()
        while time.monotonic() < since + 0.5:
            time.sleep(0.01)
            if self.mappings() != last:
                last, since = self.mappings(), time.monotonic()
        return last

    def settles(self, wanted):
        for _ in range(500):
            if self.mappings() == wanted:
                return
            time.sleep(0.01)
        self.assertEqual(self.mappings(), wanted)

    def test_all_layouts_agree(self):
        with SharedClient(self.path) as client:
            for name in ("rows", "axes", "single", "by-id", "single-by-id"):
                client.ask("scene.create", scene=name, parts=7)
            for step, points in enumerate(self.walk):
                rows = client.positions(len(points))
                rows[:] = points
                axes_of_points = rows.reshape(-1)
                given = client.step("rows", step, rows)[0]["report"]
                self.assertEqual(given["way"], "shared-memory")
                # The ranks find what has drifted by what they hold; who pushes by the gateway must say it.
                expected = client.push("by-id", step, points, drifted=given["drifted"])[0]["report"]
                self.assertEqual(self.report(given), self.report(expected))
                axes_of_points[:] = np.ascontiguousarray(points.T).reshape(-1)
                where = [{"name": "xyz"[a], "offset": a * 8 * len(points), "stride": 8} for a in range(3)]
                self.assertEqual(self.report(client.step("axes", step, rows, where)[0]["report"]), self.report(expected))
                single = client.positions(len(points), dtype="<f4")
                single[:] = points
                given = client.step("single", step, single)[0]["report"]
                self.assertIn("double precision", given["skipped"])
                self.assertEqual(given["bytes"], 12 * len(points))
                client.push("single-by-id", step, single.astype("<f8"))
        self.assertEqual(self.assign("rows"), self.assign("by-id"))
        self.assertEqual(self.assign("axes"), self.assign("by-id"))
        self.assertEqual(self.assign("single"), self.assign("single-by-id"))

    def test_weights_and_ids(self):
        points, n = self.walk[0], len(self.walk[0])
        weight = np.random.default_rng(1).random(n)
        with SharedClient(self.path) as client, PushClient(self.path) as judge:
            for name in ("weighted", "weighted-by-id", "own"):
                client.ask("scene.create", scene=name, parts=5)
            both = client.positions(n, 5)  # rows of x, y, z, weight, and room for an id
            both[:, :3], both[:, 3] = points, weight
            both[:, 4].view("<i8")[:] = np.arange(n)[::-1] * 3
            where = [{"name": name, "offset": 8 * k, "stride": 40} for k, name in enumerate(("x", "y", "z", "w"))]
            for step, points in enumerate(self.walk):
                both[:, :3], told = points, step % 2 == 0  # at other steps the particles keep their weights
                if told:
                    both[:, 3] = weight = weight[::-1]
                given = client.step("weighted", step, both[:, :3], where[:4 if told else 3], weights=told)[0]["report"]
                expected = judge.push_block("weighted-by-id", step, Block(points, weights=weight),
                                            drifted=given["drifted"])[0]["report"]
                for report in (given, expected):
                    self.assertEqual(report.pop("bytes"), n * (32 if told or report is expected else 24))
                    report["skipped"] = [skip for skip in report["skipped"] if skip != "weights"]
                self.assertEqual(self.report(given), self.report(expected))
            self.assertEqual(self.assign("weighted"), self.assign("weighted-by-id"))
            own = [*where[:3], {"name": "id", "offset": 32, "stride": 40}]
            client.step("own", 0, both[:, :3], own, ids=True)
            answer, bulk = client.ask("fetch", scene="own")
            self.assertEqual(arrays_of(answer, bulk)["id"].tolist(), (np.arange(n) * 3).tolist())
            self.refused("invalid_argument", client.step, "own", 1, both[:, :3], where[:3])
            for more in ({"inserted": 1}, {"removed": 1}, {"ids": True}):
                arrays = where[:3] + (own[3:] if "ids" in more else [])
                self.assertIn(self.refused_code(client.step, "weighted", 9, both[:, :3], arrays, **more),
                              ("unsupported", "invalid_argument"))

    def refused_code(self, call, *args, **kwargs):
        with self.assertRaises(Refused) as caught:
            call(*args, **kwargs)
        return caught.exception.args[0]

    def test_a_list_of_rows_and_ranks_that_get_slices(self):
        points, n = self.walk[0], len(self.walk[0])
        ids, rng = np.random.default_rng(2).permutation(n) * 7 + 1, np.random.default_rng(3)
        with PushClient(self.path, "shared-memory") as client, PushClient(self.path) as judge:
            for name in ("listed", "listed-by-hand"):
                client.ask("scene.create", scene=name, parts=7)
            for step, sockets in enumerate(((), (1,), (0, 2), (0, 1, 2), ())):
                block = Block(self.walk[step], ids)
                deal = np.split(rng.permutation(n), np.sort(rng.integers(0, n + 1, 2)))
                begin, slices = client.frames("listed", step, block, deal=deal, by_socket=sockets, each=400)
                for rank in sockets:  # those that get slices don't read the memory
                    np.frombuffer(client.area, "<f8", n)[deal[rank]] = np.nan
                client.write(begin)
                for link, data in slices:
                    link.sendall(data)
                given, expected = client.finish()[0]["report"], judge.push_block("listed-by-hand", step, block)[0]["report"]
                self.assertEqual(given["way"], "shared-memory")
                self.assertEqual(self.report(given), self.report(expected))
                self.assertEqual(self.assign("listed"), self.assign("listed-by-hand"))
            before = client.ask("scene.show", scene="listed")[0]
            counts = [1000] * 3
            for more in ({"counts": counts[1:]}, {"counts": [999, 1000, 1000]}, {"counts": [n] * 3},
                         {"sockets": [3]}, {"sockets": [-1]}, {"sockets": [1, 1]}, {"sockets": [1, 0]}, {"sockets": "1"},
                         {"sockets": 1}, {"sockets": [1.5]}, {"sockets": [None]}, {"sockets": [0] * 4}):
                self.assertIn(next(iter(more)), self.refused("invalid_argument", client.push_block, "listed", 9, block, **more))
            memory = client.laid_out(block, np.arange(n))
            for far in ({"offset": memory[-1]["offset"] + 1}, {"offset": len(client.area) - 8}, {"offset": 2**60}):
                self.refused("invalid_argument", client.push_block, "listed", 9, block, memory=[*memory[:-1], memory[-1] | far])
            for row in (n, -1, 2**62):
                wrong = np.arange(n)
                wrong[n // 2] = row
                self.assertIn("row", self.refused("invalid_argument", client.push_block, "listed", 9, block,
                                                  deal=np.array_split(wrong, 3)))
            twice = np.arange(n)
            twice[5] = 6  # so that a particle would be there twice, and another would not
            self.refused("not_conserved", client.push_block, "listed", 9, block, deal=np.array_split(twice, 3))
            client.ask("scene.create", scene="twice", parts=7)
            self.refused("duplicate_id", client.push_block, "twice", 0, Block(points), deal=np.array_split(twice, 3))
            # Rows of a rank that reads the memory are dropped where they come; those of another are missed at the deadline.
            self.refused("deadline_exceeded", self.push_without, client, block, deadline_seconds=1, by_socket=[1, 2])
            self.assertEqual(client.ask("scene.show", scene="listed")[0], before)
            self.assertEqual(client.push_block("listed", 9, block)[0]["report"]["step"], 9)

    def push_without(self, client, block, **more):
        """A push whose last rank gets no slice."""
        begin, slices = client.frames("listed", 9, block, **more)
        client.write(begin)
        slices[0][0].sendall(slices[0][1])
        return client.finish()

    def test_memory_that_is_not_what_it_should_be(self):
        points, n = self.walk[0], len(self.walk[0])
        before = self.at_rest()
        with SharedClient(self.path) as client:
            client.ask("scene.create", scene="s", parts=3)
            size = 24 * n
            unsealed = memfd(size, 0)
            self.addCleanup(os.close, unsealed)
            with tempfile.TemporaryFile() as file:
                file.truncate(size)
                for kind, descriptor in (("unsealed", unsealed), ("grows", memfd(size, F_SEAL_SHRINK)),
                                         ("shrinks", memfd(size, F_SEAL_GROW)), ("small", memfd(size - 1)),
                                         ("file", file.fileno()), ("pipe", os.pipe()[0]), ("null", os.open("/dev/null", 0))):
                    with self.subTest(kind), SharedClient(self.path) as other:
                        self.refused("invalid_argument", other.share, descriptor, size)
            with SharedClient(self.path) as other:
                self.refused("invalid_argument", other.share, None, size, descriptors=[])
            with SharedClient(self.path) as other:
                self.refused("invalid_argument", other.share, memfd(size), 0)
            if os.geteuid() == 0:
                os.seteuid(65534)
                foreign = memfd(size)
                os.seteuid(0)
                with SharedClient(self.path) as other:
                    self.refused("not_authorised", other.share, foreign, size)
            with SharedClient(self.path) as other:  # more than are asked for, and some that nobody asks for
                other.share(memfd(size), size, descriptors=[memfd(size)] * 9)
                other.links[0].number += 1
                socket_frame = frame(REQUEST, other.links[0].number, {"command": "memory.drop", "memory": 1})
                other.links[0].socket.sendall(socket_frame)
                other.links[0].answer()

            client.memories = 1
            rows = np.zeros((n, 3))
            self.assertIn("memory 1", self.refused("aborted", client.step, "s", 0, rows))
            client.memories = 0
            rows = client.positions(n)
            for wrong in ([{"name": "x", "offset": 8, "stride": 24}], None, {"name": "x"}, [3], [],
                          [{"name": "xyz"[a], "offset": 8 * a + 8, "stride": 24} for a in range(3)],
                          [{"name": "xyz"[a], "offset": 8 * a + 4, "stride": 24} for a in range(3)],
                          [{"name": "xyz"[a], "offset": 2**62 + 8 * a, "stride": 24} for a in range(3)],
                          [{"name": "xyz"[a], "offset": 8 * a, "stride": 4096} for a in range(3)],
                          [{"name": "xyz"[a], "offset": -8, "stride": 24} for a in range(3)],
                          [{"name": "zyx"[a], "offset": 8 * a, "stride": 24} for a in range(3)]):
                if wrong and type(wrong) is list and wrong != [3]:
                    wrong = [{"number": 1} | array for array in wrong]
                self.refused("invalid_argument", client.step, "s", 0, rows, memory=wrong)
            rows[:] = points
            rows[17, 1] = np.nan
            self.assertIn("particle 17", self.refused("not_finite", client.step, "s", 0, rows))
            rows[:] = points
            client.step("s", 0, rows)
            rows[4, 2] = np.inf
            self.assertIn("particle 4", self.refused("not_finite", client.step, "s", 1, rows))
            with SharedClient(self.path) as other:  # a number is one memory, so that no push takes some of each
                zeros = memfd(24 * n)
                for link in other.links:
                    def ask(command, number, descriptor=zeros):
                        link.number += 1
                        request = frame(REQUEST, link.number, {"command": command, "memory": number, "bytes": 24 * n})
                        socket.send_fds(link.socket, [request], [descriptor])
                        return link.answer()

                    for number in (4, 4, 6):
                        ask("memory.share", number)
                    self.assertIn("another", self.refused("already_exists", ask, "memory.share", 4, memfd(24 * n)))
                    ask("memory.drop", 6)
                    self.assertIn("after 6 was dropped", self.refused("invalid_argument", ask, "memory.share", 5))
                    ask("memory.share", 4)
                    ask("memory.share", 7)
            rows = client.positions(n)  # all zeros
            self.assertEqual(client.step("s", 1, rows)[0]["report"]["step"], 1)
            answer, bulk = client.ask("fetch", scene="s")
            self.assertEqual(set(arrays_of(answer, bulk)["x"]), {0.0})
            with Client(self.path) as foreign:  # another session's number is nobody else's
                self.refused("aborted", foreign.ask, "push", scene="s", step=2, attempt=1, n=n, way="shared-memory", memory=[
                    {"name": "xyz"[a], "number": 1, "offset": 8 * a, "stride": 24} for a in range(3)])
            links, client.links = client.links, []
            for link in links:
                link.close()
            time.sleep(0.1)
            self.refused("aborted", client.step, "s", 2, rows)
        self.settles(before)

    def test_descriptors_that_nobody_asked_for_are_closed(self):
        maps, descriptors = self.at_rest()
        with SharedClient(self.path) as client:
            opened = self.at_rest()[1]
            stray = memfd(4096)
            for link in client.links:
                for _ in range(20):
                    link.number += 1
                    request = frame(REQUEST, link.number, {"command": "memory.drop", "memory": 9})
                    socket.send_fds(link.socket, [request], [stray] * 4)
                    link.answer()
            self.settles((maps, opened))
            rows = client.positions(5)  # and are not taken for others
            rows[:] = self.walk[0][:5]
            client.ask("scene.create", scene="after-strays", parts=2)
            self.assertEqual(client.step("after-strays", 0, rows)[0]["report"]["n"], 5)
        self.settles((maps, descriptors))

    def test_what_all_clients_share_together_is_limited(self):
        before = self.at_rest()
        with contextlib.ExitStack() as stack:
            shared, status = 0, None
            bulk = memfd(2**30)  # takes no memory
            while shared < 20 * 256:
                client = stack.enter_context(SharedClient(self.path))
                link = client.links[1]
                for number in range(256):
                    link.number += 1
                    request = frame(REQUEST, link.number, {"command": "memory.share", "memory": number, "bytes": 2**30})
                    socket.send_fds(link.socket, [request], [bulk])
                    try:
                        link.answer()
                    except Refused as refused:
                        status = refused.args
                        break
                    shared += 1
                if status:
                    break
            self.assertEqual(status[0], "busy")
            self.assertLessEqual(shared, 4096)
            with Client(self.path) as other:  # who goes on as ever
                other.ask("scene.create", scene="beside", parts=3)
                self.assertEqual(other.push("beside", 0, self.walk[0])[0]["report"]["n"], len(self.walk[0]))
        self.settles(before)

    def test_a_solver_that_scribbles_while_it_pushes_harms_itself_alone(self):
        n = 400
        with SharedClient(self.path) as client, Client(self.path) as other:
            for scene in ("scribbled", "quiet", "judge"):
                client.ask("scene.create", scene=scene, parts=6, tolerance=0.05)
            rows = client.positions(n)
            rows[:] = self.walk[0][:n]
            client.step("scribbled", 0, rows)
            done = threading.Event()

            def scribble():
                rng = np.random.default_rng(9)
                while not done.is_set():
                    rows[rng.integers(n, size=50)] = rng.random((50, 3)) * rng.choice([1, 1e300, 1e-300])
                    if rng.random() < 0.2:
                        rows[rng.integers(n), 0] = rng.choice([np.nan, np.inf])
                    if rng.random() < 0.3:
                        rows[:] = rng.random((n, 3))

            scribbler = threading.Thread(target=scribble)
            scribbler.start()
            committed = 0
            try:
                for step in range(1, OPTIONS.steps):
                    try:
                        report = client.step("scribbled", step, rows)[0]["report"]
                        committed += 1
                        self.assertEqual(report["n"], n)
                    except Refused as refusal:
                        self.assertEqual(refusal.args[0], "not_finite")
                    if step % 50 == 0:
                        other.push("quiet", step, self.walk[step // 50 % 5][:n])
                        self.assertEqual(sum(client.ask("counts", scene="scribbled")[0]["counts"]), n)
            finally:
                done.set()
                scribbler.join()
            self.assertGreater(committed, 10)
            # What the ranks hold is one scene: pushed elsewhere, its positions give the parts that its cuts say.
            answer, bulk = other.ask("fetch", scene="scribbled")
            held = arrays_of(answer, bulk)
            cuts = other.ask("cuts", scene="scribbled")[0]
            for region in cuts["regions"]:
                mine = held["part"] == region["part"]
                for a, axis in enumerate("xyz"):
                    for bound, outside in ((region["lo"][a], np.less), (region["hi"][a], np.greater)):
                        self.assertFalse(bound is not None and outside(held[axis][mine], bound).any())
            rows[:] = self.walk[2][:n]
            last = client.step("scribbled", 10**6, rows)[0]["report"]
            self.assertEqual(last["n"], n)
            client.ask("rebalance", scene="scribbled")
            judged = other.push("judge", 0, self.walk[2][:n])[0]
            self.assertEqual(judged["report"]["n"], n)
            self.assertEqual(client.ask("cuts", scene="scribbled")[0]["hash"], other.ask("cuts", scene="judge")[0]["hash"])

    def test_who_does_not_read_the_answers_is_not_read(self):
        with SharedClient(self.path) as client:
            link = client.links[1].socket
            link.settimeout(2)
            many = b"".join(frame(REQUEST, k, {"command": "memory.drop", "memory": 5}) for k in range(1, 1000))
            with self.assertRaises(TimeoutError):
                for _ in range(1000):
                    link.sendall(many)

    def test_killed_clients_leave_nothing_behind(self):
        rng = random.Random(3)
        with Client(self.path) as client:
            client.ask("scene.list")
        time.sleep(0.2)
        before = self.at_rest()
        for kill in range(OPTIONS.kills):
            victim = subprocess.Popen([sys.executable, "-c", VICTIM, self.path, os.path.dirname(__file__), f"k{kill % 3}"],
                                      stdout=subprocess.PIPE, stdin=subprocess.DEVNULL)
            if rng.random() < 0.9:
                victim.stdout.readline()
            time.sleep(rng.uniform(0, 0.03))
            victim.kill()
            victim.wait()
            victim.stdout.close()
        self.settles(before)
        with SharedClient(self.path) as client:
            for _ in range(OPTIONS.kills * 20):
                with SharedClient(self.path) as other:
                    other.positions(10)
        self.settles(before)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=OPTIONS.steps, help="of the scribbling solver")
    parser.add_argument("--kills", type=int, default=OPTIONS.kills, help="of clients; 20 times as many connections")
    OPTIONS, rest = parser.parse_known_args(namespace=OPTIONS)
    unittest.main(argv=[sys.argv[0], *rest], verbosity=2)
