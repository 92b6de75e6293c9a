"""To the ranks' sockets: a push that breaks half-way is given up everywhere, and the next one works."""
from protocol_client import Client, Refused, reframed
from push_client import Block, PushClient
from support import *


class Direct(PushClient):
    def __init__(self, path, **kwargs):
        super().__init__(path, "sockets", **kwargs)
        assert all(address.startswith("unix:") for address in self.hello["data"])
        assert [link.hello["rank"] for link in self.links] == list(range(len(self.links)))

    def begin(self, scene, step, points, **more):
        """Says the push, and keeps its slices, a list of frames for each rank."""
        begin, slices = self.frames(scene, step, Block(points), each=700, **more)
        self.slices = [[data for link, data in slices if link is of.socket] for of in self.links]
        self.socket.sendall(begin)

    def send_slices(self):
        for link, frames in zip(self.links, self.slices):
            link.socket.sendall(b"".join(frames))

    def push_directly(self, scene, step, points, **more):
        self.begin(scene, step, points, **more)
        self.send_slices()
        return self.finish()


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
            for name in ("seconds", "scene", "bytes", "way", "drifted"):
                report.pop(name)
            report["skipped"] = [skip for skip in report["skipped"] if skip != "exchange"]  # by who got which rows
        kept = {name: shown[name] for name in ("hash", "counts", "error", "step", "epoch")}
        with Client(self.path) as client:
            return kept, history, client.ask("assign", scene=scene)[1]

    def test_the_library_by_every_path(self):
        with Client(self.path) as client:
            client.ask("scene.create", scene="by-hand", parts=7)
            for step, points in enumerate(self.walk):
                client.push("by-hand", step, points)
        file = self.save("walk.npy", self.walk)
        for path in ("shared", "direct", "gateway"):
            self.service.ctl("replay", path, file, "--parts", 7, env={"RCBD_PATH": path}, check=True)
            self.assertEqual(self.state(path), self.state("by-hand"))
            ways = {report["way"] for report in self.service.json("history", path)}
            self.assertEqual(ways, {{"shared": "shared-memory", "direct": "sockets", "gateway": "endpoint"}[path]})

    def test_what_breaks_is_given_up_and_the_next_step_works(self):
        points = self.walk[0]
        with Direct(self.path) as client:
            client.ask("scene.create", scene="broken", parts=5)
            client.push_directly("broken", 0, points)
        before = self.state("broken")

        def refused(client, code):
            said = self.refused(code, client.finish)
            self.assertEqual(self.state("broken"), before)
            return said

        with Direct(self.path) as client:  # one rank's connection is cut within its slice
            client.begin("broken", 1, points)
            for rank in (0, 2):
                client.links[rank].socket.sendall(b"".join(client.slices[rank]))
            client.links[1].socket.sendall(b"".join(client.slices[1])[:9000])
            time.sleep(0.1)
            client.links[1].close()
            refused(client, "aborted")
        with Direct(self.path) as client:
            bad = points.copy()
            bad[1234, 1] = np.nan
            client.begin("broken", 1, bad)
            client.send_slices()
            self.assertIn("1234", refused(client, "not_finite"))
            for change, code in (({"first": 3}, "invalid_argument"), ({"rank": 0}, "invalid_argument"),
                                 ({"arrays": []}, "protocol_error")):
                client.begin("broken", 1, points)
                client.links[1].socket.sendall(reframed(client.slices[1][0], lambda document: document.update(change)))
                refused(client, code)
        for cut in (0, 1, 100, 9_000):  # the whole client dies
            client = Direct(self.path)
            client.begin("broken", 1, points)
            for rank, link in enumerate(client.links):
                link.socket.sendall(b"".join(client.slices[rank])[: cut * (rank + 1)])
            client.close()
        self.assertEqual(self.state("broken"), before)
        with Direct(self.path) as client:  # a deadline
            client.begin("broken", 1, points, deadline_seconds=0.3)
            client.links[0].socket.sendall(client.slices[0][0])
            refused(client, "deadline_exceeded")
            client.push_directly("broken", 1, points + 1)  # the same connections go on
            self.assertTrue(client.push_directly("broken", 1, points + 1)[0]["repeated"])
        self.assertEqual(self.service.json("scene", "show", "broken")["step"], 1)

    def test_a_refused_twin_leaves_the_rows_of_the_open_push(self):
        with Direct(self.path) as client:
            client.ask("scene.create", scene="twin", parts=4)
            client.begin("twin", 0, self.walk[0], deadline_seconds=10)
            slices, first = client.slices, client.number
            client.attempts -= 1  # the same attempt once more
            client.begin("twin", 0, self.walk[0], deadline_seconds=10)
            with self.assertRaises(Refused) as refused:
                client.finish()
            self.assertEqual(refused.exception.args[0], "aborted")
            client.slices, client.begun = slices, first
            client.send_slices()
            self.assertEqual(client.finish()[0]["report"]["n"], len(self.walk[0]))

    def test_a_push_that_is_whole_at_its_deadline_is_committed_or_refused(self):
        points, seconds, codes = self.walk[0, :2000], 0.002, []
        with Direct(self.path) as client:
            client.ask("scene.create", scene="late", parts=5)
            client.push_directly("late", 0, points)
            step = 1
            for k in range(400):
                try:
                    client.push_directly("late", step, points, deadline_seconds=seconds * (0.3 + k % 18 / 10))
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
        with Direct(self.path) as client:
            client.ask("scene.create", scene="early", parts=3)
            begin, slices = client.frames("early", 0, Block(self.walk[0]))
            for link, data in slices:
                link.sendall(data)
            time.sleep(0.2)
            client.socket.sendall(begin)
            self.assertEqual(client.finish()[0]["report"]["step"], 0)

    def test_an_older_attempt_does_not_replace_a_newer_one(self):
        points = self.walk[0]
        with Direct(self.path) as client:
            client.ask("scene.create", scene="attempts", parts=3)
            client.attempts = 4
            client.begin("attempts", 0, points)
            with Direct(self.path, session=client.session) as late:
                late.attempts = 3
                self.assertIn("not older than 4", self.refused("aborted", late.push_directly, "attempts", 0, points + 1))
            client.send_slices()
            self.assertEqual(client.finish()[0]["report"]["step"], 0)

    def test_refused_at_the_begin(self):
        points = self.walk[0]
        with (PreparedService(2, "ulimit -n 512") as service, Direct(service.endpoint) as holder,
              Direct(service.endpoint) as other):
            holder.ask("scene.create", scene="held", parts=3)
            holder.begin("held", 0, points)
            time.sleep(0.1)
            self.refused("busy", other.push_directly, "held", 0, points)
            holder.send_slices()
            self.assertEqual(holder.finish()[0]["report"]["step"], 0)
            self.assertEqual(other.push_directly("held", 1, points)[0]["report"]["step"], 1)
            # Before it is looked at, too: for a deadline that is none, and for lack of a seat.
            self.refused("invalid_argument", other.push_directly, "held", 2, points, deadline_seconds=1e9)
            self.assertEqual(other.push_directly("held", 2, points)[0]["report"]["step"], 2)
            seated = [Client(service.endpoint) for _ in range(holder.hello["limits"]["sessions"] - 2)]
            with Direct(service.endpoint) as late:
                self.assertIn("sessions are open", self.refused("busy", late.push_directly, "held", 3, points))
                for client in seated:
                    client.close()
                self.assertTrue(wait_for(lambda: service.json("status")["sessions"] < 10))
                self.assertEqual(late.push_directly("held", 3, points)[0]["report"]["step"], 3)

    def test_over_tcp_and_by_the_gateway_alone(self):
        file = self.save("tcp.npy", self.walk[:2])
        with Service(2, tcp=f"127.0.0.1:{free_port()}") as service:
            for path in ("direct", "auto"):
                service.ctl("replay", path, file, "--parts", 3, env={"RCBD_PATH": path}, check=True)
            self.assertEqual(*(service.json("scene", "show", path)["hash"] for path in ("auto", "direct")))
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
