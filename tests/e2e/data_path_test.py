"""Pushes by every path and in every order give the same scene; a push that breaks half-way is given up everywhere."""
import time

from protocol_client import REQUEST, Client, Refused, frame
from support import *


def mix(v):
    mask = 2**64 - 1
    v = (v + 0x9E3779B97F4A7C15) & mask
    v = ((v ^ v >> 30) * 0xBF58476D1CE4E5B9) & mask
    v = ((v ^ v >> 27) * 0x94D049BB133111EB) & mask
    return v ^ v >> 31


class Direct(Client):
    """A client of the direct path, from PROTOCOL.md alone: it fetches the plan before every push."""

    def __init__(self, path, **kwargs):
        super().__init__(path, **kwargs)
        self.link_ranks()
        assert all(address.startswith("unix:") for address in self.hello["data"])
        assert [link.hello["rank"] for link in self.links] == list(range(len(self.links)))

    def plan(self, scene, n):
        """(rows of each rank, the plan's name)."""
        shown = self.ask("scene.show", scene=scene)[0]
        if shown["step"] is None:
            ranks = len(self.links)
            rows = [np.arange(r * n // ranks, (r + 1) * n // ranks) for r in range(ranks)]
            checksum = sum(mix(int(i) + mix((r << 40) + slot) & 2**64 - 1)
                           for r, ids in enumerate(rows) for slot, i in enumerate(ids)) & 2**64 - 1
            return rows, {"version": 0, "checksum": f"{checksum:016x}"}
        answer, bulk = self.ask("plan", scene=scene)
        ids = np.frombuffer(bulk[: 8 * n], "<i8")
        return np.split(ids, np.cumsum(answer["counts"])[:-1]), answer["plan"]

    def begin(self, scene, step, points, attempt=0, **more):
        self.rows, plan = self.plan(scene, len(points))
        self.push_id = {"scene": scene, "session": self.session, "step": step, "attempt": attempt, "plan": plan}
        self.send({"command": "push.begin", **self.push_id, "n": len(points), "slices": 0, "order": "plan",
                   "path": "direct", "changes": True, **more})

    def slice_frames(self, of, points, each=700, **more):
        rows, out = self.rows[of], []
        for first in range(0, len(rows), each):
            part = points[rows[first: first + each]]
            arrays = [{"name": "xyz"[k], "dtype": "<f8", "shape": [len(part)]} for k in range(points.shape[1])]
            out.append(frame(REQUEST, self.number, {"command": "push.slice", **self.push_id, "rank": of,
                                                    "first": first, "count": len(part), "arrays": arrays, **more},
                             part.T.astype("<f8").tobytes(), flags=first % 2))
        return out

    def push_directly(self, scene, step, points, attempt=0, **more):
        self.begin(scene, step, points, attempt, **more)
        for rank, link in enumerate(self.links):
            for data in self.slice_frames(rank, points):
                link.socket.sendall(data)
        return self.answer()


class DataPath(Refusals, ServiceTest):
    ranks = 3

    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.walk = random_walk(4, 4000)

    def state(self, scene):
        shown = self.service.json("scene", "show", scene)
        history = self.service.json("history", scene)
        for report in history:
            for name in ("seconds", "scene", "bytes", "way"):
                report.pop(name)
        kept = {name: shown[name] for name in ("hash", "counts", "error", "plan", "step", "epoch")}
        with Client(self.path) as client:
            parts = client.ask("assign", scene=scene)[1]
        return kept, history, parts

    def test_all_paths_and_orders_agree(self):
        with Client(self.path) as client:
            client.ask("scene.create", scene="by-id", parts=7)
            for step, points in enumerate(self.walk):
                client.push("by-id", step, points)
        with Direct(self.path) as client:
            client.ask("scene.create", scene="direct", parts=7)
            for step, points in enumerate(self.walk):
                client.push_directly("direct", step, points)
        self.assertEqual(self.state("direct"), self.state("by-id"))
        folder = os.path.join(self.service.dir, "walk.npy")
        np.save(folder, self.walk)
        for path in ("shared", "direct", "gateway"):
            self.service.ctl("replay", path + "-lib", folder, "--parts", 7, env={"RCBD_PATH": path}, check=True)
            self.assertEqual(self.state(path + "-lib"), self.state("by-id"))

    def test_what_breaks_is_given_up_and_the_next_step_works(self):
        points = self.walk[0]
        with Direct(self.path) as client:
            client.ask("scene.create", scene="broken", parts=5)
            client.push_directly("broken", 0, points)
        before = self.state("broken")

        def refused(client, code):
            with self.assertRaises(Refused) as caught:
                client.answer()
            self.assertEqual(caught.exception.args[0], code, caught.exception.args)
            self.assertEqual(self.state("broken"), before)

        with Direct(self.path) as client:  # one rank's connection is cut within its slice
            client.begin("broken", 1, points)
            for rank in (0, 2):
                client.links[rank].socket.sendall(b"".join(client.slice_frames(rank, points)))
            client.links[1].socket.sendall(b"".join(client.slice_frames(1, points))[:9000])
            time.sleep(0.1)
            client.links[1].close()
            refused(client, "aborted")
        with Direct(self.path) as client:
            bad = points.copy()
            bad[1234, 1] = np.nan
            with self.assertRaises(Refused) as caught:
                client.push_directly("broken", 1, bad)
            self.assertEqual(caught.exception.args[0], "not_finite")
            self.assertIn("1234", caught.exception.args[1])
            self.assertEqual(self.state("broken"), before)
            faults = (({"plan": {"version": 9, "checksum": "0" * 16}}, "stale_plan"),
                      ({"first": 3}, "invalid_argument"), ({"rank": 0}, "invalid_argument"),
                      ({"arrays": []}, "protocol_error"))
            for attempt, (change, code) in enumerate(faults, 1):
                client.begin("broken", 1, points, attempt)
                link = client.links[1]
                link.socket.sendall(client.slice_frames(1, points, **change)[0])
                refused(client, code)
        for cut in (0, 1, 100, 9_000):  # the whole client dies
            client = Direct(self.path)
            client.begin("broken", 1, points)
            for rank, link in enumerate(client.links):
                link.socket.sendall(b"".join(client.slice_frames(rank, points))[: cut * (rank + 1)])
            client.close()
        self.assertEqual(self.state("broken"), before)
        with Direct(self.path) as client:  # a deadline
            client.begin("broken", 1, points, deadline_seconds=0.3)
            client.links[0].socket.sendall(client.slice_frames(0, points)[0])
            refused(client, "deadline_exceeded")
            client.push_directly("broken", 1, points + 1, attempt=2)  # the same connections go on
            again = client.push_directly("broken", 1, points + 1, attempt=3)[0]
            self.assertTrue(again["repeated"])
        self.assertEqual(self.service.json("scene", "show", "broken")["step"], 1)

    def test_a_push_that_is_whole_at_its_deadline_is_committed_or_refused(self):
        points, seconds, codes = self.walk[0, :2000], 0.002, []
        with Direct(self.path) as client:
            client.ask("scene.create", scene="late", parts=5)
            client.push_directly("late", 0, points)
            step = 1
            for k in range(400):
                client.begin("late", step, points, k, deadline_seconds=seconds * (0.3 + k % 18 / 10))
                for rank, link in enumerate(client.links):
                    link.socket.sendall(b"".join(client.slice_frames(rank, points)))
                try:
                    client.answer()
                    seconds *= 0.9
                    step += 1
                except Refused as refused:
                    codes.append(refused.args[0])
                    seconds *= 1.1
                    step += refused.args[0] == "stale_step"  # the one before was committed after its deadline
            self.assertLessEqual(set(codes), {"deadline_exceeded", "stale_step"})
            self.assertEqual(client.ask("status")[0]["restarted"], False)
            client.ask("scene.drop", scene="late")

    def test_slices_may_come_before_their_push(self):
        points = self.walk[0]
        with Direct(self.path) as client:
            client.ask("scene.create", scene="early", parts=3)
            client.rows, plan = client.plan("early", len(points))
            client.push_id = {"scene": "early", "session": client.session, "step": 0, "attempt": 0, "plan": plan}
            for rank, link in enumerate(client.links):
                link.socket.sendall(b"".join(client.slice_frames(rank, points)))
            time.sleep(0.2)
            client.begin("early", 0, points)
            self.assertEqual(client.answer()[0]["report"]["step"], 0)

    def test_an_older_attempt_does_not_replace_a_newer_one(self):
        points = self.walk[0]
        with Direct(self.path) as client:
            client.ask("scene.create", scene="attempts", parts=3)
            client.begin("attempts", 0, points, attempt=5)
            newer, newer_id = client.number, client.push_id
            with Direct(self.path, session=client.session) as late:
                with self.assertRaises(Refused) as caught:
                    late.begin("attempts", 0, points + 1, attempt=4)
                    late.answer()
                self.assertEqual(caught.exception.args[0], "aborted")
                self.assertIn("newer than 4", caught.exception.args[1])
            client.number, client.push_id = newer, newer_id
            for rank, link in enumerate(client.links):
                link.socket.sendall(b"".join(client.slice_frames(rank, points)))
            self.assertEqual(client.answer()[0]["report"]["step"], 0)
            client.ask("scene.drop", scene="attempts")

    def test_refused_at_the_begin(self):
        points = self.walk[0]
        with Direct(self.path) as holder, Direct(self.path) as other:
            holder.ask("scene.create", scene="held", parts=3)
            holder.begin("held", 0, points)
            time.sleep(0.1)
            with self.assertRaises(Refused) as caught:
                other.push_directly("held", 0, points)
            self.assertEqual(caught.exception.args[0], "busy")
            for rank, link in enumerate(holder.links):
                link.socket.sendall(b"".join(holder.slice_frames(rank, points)))
            self.assertEqual(holder.answer()[0]["report"]["step"], 0)
            self.assertEqual(other.push_directly("held", 1, points)[0]["report"]["step"], 1)
            # Before it is looked at, too: for a deadline that is none, and for lack of a seat.
            self.refused("invalid_argument", other.push_directly, "held", 2, points, deadline_seconds=1e9)
            self.assertEqual(other.push_directly("held", 2, points, 1)[0]["report"]["step"], 2)
            plan = other.plan("held", len(points))
            seated = [Client(self.path) for _ in range(254)]
            with Direct(self.path) as late:
                late.plan = lambda *_: plan  # it may not ask
                self.assertIn("sessions are open", self.refused("busy", late.push_directly, "held", 3, points))
                for client in seated:
                    client.close()
                self.assertTrue(wait_for(lambda: self.service.json("status")["sessions"] < 10))
                self.assertEqual(late.push_directly("held", 3, points, 1)[0]["report"]["step"], 3)

    def test_over_tcp_and_by_the_gateway_alone(self):
        file = os.path.join(self.service.dir, "tcp.npy")
        np.save(file, self.walk[:2])
        with Service(2, tcp=f"127.0.0.1:{free_port()}") as service:
            for path in ("direct", "auto"):
                service.ctl("replay", path, file, "--parts", 3, env={"RCBD_PATH": path}, check=True)
            self.assertEqual(service.json("scene", "show", "auto")["plan"],
                             service.json("scene", "show", "direct")["plan"])
        os.environ["RCBD_GATEWAY_ONLY"] = "1"
        try:
            with Service(2) as service:
                self.assertFalse(os.path.exists(service.endpoint[5:] + ".0"))
                service.ctl("replay", "auto", file, "--parts", 3, check=True)
                done = service.ctl("replay", "direct", file, "--parts", 3, env={"RCBD_PATH": "direct"})
                self.assertEqual(done.returncode, 3)
                self.assertIn("--gateway-only", done.stderr)
        finally:
            del os.environ["RCBD_GATEWAY_ONLY"]

    def test_sockets_are_private_and_go(self):
        service = Service(2)
        socket_path = service.endpoint[5:]
        names = [f"{socket_path}.{rank}" for rank in range(2)]
        try:
            for name in names:
                self.assertEqual(os.stat(name).st_mode & 0o777, 0o600)
        finally:
            service.ctl("down")
            left = [name for name in names if os.path.exists(name)]
            service.stop()
        self.assertEqual(left, [])


if __name__ == "__main__":
    unittest.main(verbosity=2)
