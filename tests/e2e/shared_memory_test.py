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

from protocol_client import REQUEST, Client, Refused, arrays_of, described, frame
from push_client import PushClient, Step
from shared_memory_client import F_SEAL_GROW, F_SEAL_SHRINK, SharedClient, memfd
from support import *

OPTIONS = argparse.Namespace(steps=1500, kills=40)
DIFFERING = ("seconds", "scene", "bytes", "way")
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

    def test_all_ways_agree(self):
        with SharedClient(self.path) as client:
            for name in ("rows", "axes", "single", "by-id", "single-by-id"):
                client.ask("scene.create", scene=name, parts=7)
            for step, points in enumerate(self.walk):
                expected = client.push("by-id", step, points)[0]
                rows = client.positions(len(points))
                rows[:] = points
                axes_of_points = rows.reshape(-1)
                given = client.step("rows", step, rows)[0]
                self.assertEqual(given["report"]["way"], "shared-memory")
                self.assertEqual(self.report(given["report"]), self.report(expected["report"]))
                self.assertEqual(given["plan"], expected["plan"])
                axes_of_points[:] = np.ascontiguousarray(points.T).reshape(-1)
                where = [{"name": "xyz"[a], "offset": a * 8 * len(points), "stride": 8} for a in range(3)]
                given = client.step("axes", step, rows, where)[0]
                self.assertEqual(self.report(given["report"]), self.report(expected["report"]))
                single = client.positions(len(points), dtype="<f4")
                single[:] = points
                given = client.step("single", step, single)[0]
                expected = client.push("single-by-id", step, single.astype("<f8"))[0]
                for report in (given["report"], expected["report"]):
                    report["skipped"] = [skip for skip in report["skipped"] if skip != "double precision"]
                self.assertEqual(self.report(given["report"]), self.report(expected["report"]))
        self.assertEqual(self.assign("rows"), self.assign("by-id"))
        self.assertEqual(self.assign("axes"), self.assign("by-id"))
        self.assertEqual(self.assign("single"), self.assign("single-by-id"))

    def test_weights_ids_insertions_and_removals(self):
        points, n = self.walk[0], len(self.walk[0])
        weight = np.random.default_rng(1).random(n)
        with SharedClient(self.path) as client, PushClient(self.path) as judge:
            for name in ("weighted", "weighted-by-id", "own", "edited", "edited-by-id"):
                client.ask("scene.create", scene=name, parts=5)
            both = client.positions(n, 5)  # rows of x, y, z, weight, and room for an id
            both[:, :3], both[:, 3] = points, weight
            both[:, 4].view("<i8")[:] = np.arange(n)[::-1] * 3
            where = [{"name": name, "offset": 8 * k, "stride": 40} for k, name in enumerate(("x", "y", "z", "w"))]
            for step in range(3):
                both[:, :3] = self.walk[step]
                given = client.step("weighted", step, both[:, :3], where, weights=True)[0]
                expected = judge.push_step("weighted-by-id", step, Step(np.arange(n), self.walk[step], weights=weight))[0]
                self.assertEqual(self.report(given["report"]), self.report(expected["report"]))
            own = [*where[:3], {"name": "id", "offset": 32, "stride": 40}]
            client.step("own", 0, both[:, :3], own, ids=True)
            answer, bulk = client.ask("fetch", scene="own")
            self.assertEqual(arrays_of(answer, bulk)["id"].tolist(), (np.arange(n) * 3).tolist())
            self.refused("unsupported", client.step, "own", 1, both[:, :3], where[:3])

            rows = client.positions(n)
            rows[:] = points
            client.step("edited", 0, rows)
            more = self.walk[3][:7]
            arrays, bulk = described({"x": more[:, 0], "y": more[:, 1], "z": more[:, 2]})
            begin = client.begin("edited", 1, rows, inserted=7, slices=1)
            head = {"scene": "edited", "session": client.session, "step": 1, "attempt": client.attempts}
            client.write(begin + frame(REQUEST, client.number, head | {
                "command": "push.slice", "holds": "inserted", "count": 7, "arrays": arrays}, bulk))
            self.assertEqual(client.answer()[0]["report"]["n"], n + 7)
            rows = client.positions(n + 7)
            rows[:] = np.concatenate([self.walk[1], more])
            self.assertEqual(client.step("edited", 2, rows)[0]["report"]["n"], n + 7)
            client.push("edited-by-id", 0, rows)

    def test_rows_of_own_ids_are_listed_by_slot(self):
        points, n = self.walk[0], len(self.walk[0])
        ids = np.random.default_rng(2).permutation(n) * 7 + 1  # by row
        with SharedClient(self.path) as client:
            client.ask("scene.create", scene="listed", parts=5)
            columns = client.positions(n, 5)  # of each row x, y, z, its id, and an entry of the list of rows
            columns[:, :3] = points
            columns[:, 3].view("<i8")[:] = ids
            axes = [{"name": name, "offset": 8 * k, "stride": 40} for k, name in enumerate(("x", "y", "z"))]
            client.step("listed", 0, columns[:, :3], [*axes, {"name": "id", "offset": 24, "stride": 40}], ids=True)
            listed = [*axes, {"name": "row", "offset": 32, "stride": 40}]

            def plan():
                answer, bulk = client.ask("plan", scene="listed")
                row_of = {i: row for row, i in enumerate(ids.tolist())}
                columns[:, 4].view("<i8")[:] = [row_of[i] for i in arrays_of(answer, bulk)["id"].tolist()]
                return {"order": "plan", "plan": answer["plan"], "counts": answer["counts"]}

            by_slot = plan()
            for step in range(1, 5):
                columns[:, :3] = self.walk[step]
                answer = client.step("listed", step, columns[:, :3], listed, **by_slot)[0]
                self.assertEqual(answer["report"]["way"], "shared-memory")
                held = arrays_of(*client.ask("fetch", scene="listed"))
                np.testing.assert_array_equal(np.stack([held[a] for a in "xyz"], 1), self.walk[step][np.argsort(ids)])
                if answer["plan"] != by_slot["plan"]:
                    self.refused("stale_plan", client.step, "listed", 9, columns[:, :3], listed, **by_slot)
                by_slot = plan()
            step = client.ask("scene.show", scene="listed")[0]["step"]
            again = client.step("listed", step, columns[:, :3], axes, order="plan", plan=by_slot["plan"])[0]
            self.assertTrue(again["repeated"])
            before = client.ask("scene.show", scene="listed")[0]
            counts = by_slot["counts"]
            wrong = (("invalid_argument", {"counts": counts[1:]}), ("invalid_argument", {"counts": []}),
                     ("stale_plan", {"counts": [counts[0] - 1, counts[1] + 1, *counts[2:]]}),
                     ("stale_plan", {"counts": [n] * len(counts)}),
                     ("stale_plan", {"plan": {"version": 77, "checksum": "0" * 16}}))
            for code, more in wrong:
                self.refused(code, client.step, "listed", 9, columns[:, :3], listed, **(by_slot | more))
            for offset in (33, 32 + 40 * 3, 2**60):
                far = [*axes, {"name": "row", "offset": offset, "stride": 40}]
                self.refused("invalid_argument", client.step, "listed", 9, columns[:, :3], far, **by_slot)
            for row in (n, -1, 2**62):
                right = columns[n // 2, 4]
                columns[n // 2: n // 2 + 1, 4].view("<i8")[:] = row
                self.assertIn("row", self.refused("invalid_argument", client.step, "listed", 9, columns[:, :3], listed, **by_slot))
                columns[n // 2, 4] = right
            self.assertEqual(client.ask("scene.show", scene="listed")[0], before)
            client.step("listed", 9, columns[:, :3], listed, **by_slot)

    def test_some_ranks_read_memory_and_others_get_slices(self):
        n = len(self.walk[0])
        with SharedClient(self.path) as client, Client(self.path) as judge:
            for name in ("mixed", "mixed-by-id"):
                client.ask("scene.create", scene=name, parts=7)
            columns = client.positions(n, 4)  # of each row x, y, z, and an entry of the list of rows
            listed = [{"name": name, "offset": 8 * k, "stride": 32} for k, name in enumerate(("x", "y", "z", "row"))]
            columns[:, :3] = self.walk[0]
            client.step("mixed", 0, columns[:, :3], listed[:3])
            judge.push("mixed-by-id", 0, self.walk[0])

            def plan():
                answer, bulk = client.ask("plan", scene="mixed")
                columns[:, 3].view("<i8")[:] = ids = arrays_of(answer, bulk)["id"]
                return ({"order": "plan", "plan": answer["plan"], "counts": answer["counts"]},
                        np.split(ids.copy(), np.cumsum(answer["counts"])[:-1]))

            def send(step, points, by_slot, rows, sockets, slices_for=None):
                columns[:, :3] = points
                for rank in range(self.ranks):  # those that get slices don't read the memory
                    if isinstance(sockets, list) and rank in sockets:
                        columns[rows[rank], :3] = np.nan
                begin = client.begin("mixed", step, columns[:, :3], listed, **by_slot, sockets=sockets)
                frames = []
                for rank in sockets if slices_for is None else slices_for:
                    arrays, bulk = described({"xyz"[a]: points[rows[rank], a] for a in range(3)})
                    frames.append((rank, frame(REQUEST, client.number, {
                        "command": "push.slice", "scene": "mixed", "session": client.session, "step": step, "rank": rank,
                        "attempt": client.attempts, "plan": by_slot["plan"], "count": len(rows[rank]), "arrays": arrays}, bulk)))
                client.write(begin)
                for rank, slice_frame in frames:
                    client.links[rank].write(slice_frame)
                return client.answer()[0]

            by_slot, rows = plan()
            for step, sockets in enumerate(([1], [0, 2], [0, 1, 2], []), start=1):
                points = self.walk[step]
                given = send(step, points, by_slot, rows, sockets)["report"]
                expected = judge.push("mixed-by-id", step, points)[0]["report"]
                self.assertEqual(given["way"], "shared-memory")
                self.assertEqual(self.report(given), self.report(expected))
                self.assertEqual(self.assign("mixed"), self.assign("mixed-by-id"))
                by_slot, rows = plan()
            before = client.ask("scene.show", scene="mixed")[0]
            for wrong in ([3], [-1], [1, 1], [1, 0], "1", 1, [1.5], [None], [0] * 4):
                self.assertIn("sockets", self.refused("invalid_argument", send, 5, points, by_slot, rows, wrong, []))
            self.assertIn("sockets", self.refused("invalid_argument", client.step, "mixed", 5, columns[:, :3], listed[:3], sockets=[1]))
            # A slice that another rank reads from memory is dropped; one that doesn't come is missed at the deadline.
            by_slot["deadline_seconds"] = 1
            self.refused("deadline_exceeded", send, 5, points, by_slot, rows, [1, 2], [0, 1])
            self.assertEqual(client.ask("scene.show", scene="mixed")[0], before)
            by_slot["deadline_seconds"] = 60
            send(6, points, by_slot, rows, [2])
            # Ranks whose slices would come have no particles.
            client.ask("scene.create", scene="mixed", parts=1, replace=True)
            columns[:, :3] = points
            client.step("mixed", 0, columns[:, :3], listed[:3])
            by_slot, rows = plan()
            self.assertEqual(by_slot["counts"], [0, 0, n])
            send(1, points, by_slot, rows, [0, 1], [])

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
            self.refused("invalid_argument", client.step, "s", 0, rows, slices=1)
            for more in ({"order": "plan"}, {"moved": "some", "counts": [1]}):
                self.refused("unsupported", client.step, "s", 0, rows, **more)
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
                self.refused("aborted", foreign.ask, "push.begin", scene="s", session=foreign.session, step=2, attempt=1,
                             n=n, slices=0, order="id", path="shared", memory=[
                                 {"name": "xyz"[a], "number": 1, "offset": 8 * a, "stride": 24} for a in range(3)])
                self.refused("not_authorised", foreign.ask, "push.begin", scene="s", session=client.session, step=2,
                             attempt=1, n=n, slices=0, order="id", path="shared", memory=[
                                 {"name": "xyz"[a], "number": 1, "offset": 8 * a, "stride": 24} for a in range(3)])
            links, client.links = client.links, []
            for link in links:
                link.close()
            time.sleep(0.1)
            self.refused("aborted", client.step, "s", 2, rows)
        self.settles(before)

    def test_a_step_that_is_there_already_is_told_whatever_its_counts_are(self):
        n = len(self.walk[0])
        with SharedClient(self.path) as client:
            client.ask("scene.create", scene="again", parts=4)
            rows = client.positions(n)
            rows[:] = self.walk[0]
            again = {"order": "plan", "moved": "all", "plan": client.step("again", 0, rows)[0]["plan"]}
            for counts in ({}, {"counts": []}, {"counts": [n]}, {"counts": [-1] * len(client.links)}):
                self.assertTrue(client.step("again", 0, rows, **again, **counts)[0]["repeated"])
            self.assertEqual(client.step("again", 1, rows)[0]["report"]["step"], 1)

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
