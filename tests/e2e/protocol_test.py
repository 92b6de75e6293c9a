"""The wire protocol from its page alone: a foreign client pushes steps, breaks rules, vanishes."""
import struct
import time

import judge
from protocol_client import GOODBYE, REQUEST, Client, Refused, arrays_of, frame
from support import *


class Protocol(Refusals, ServiceTest):
    ranks = 3

    def client(self, **kwargs):
        return Client(self.path, **kwargs)

    def alive(self):
        self.assertEqual(self.service.ctl("status").returncode, 0)

    def test_push_and_ask(self):
        rng = np.random.default_rng(2)
        walk = rng.random((6, 200, 3)).cumsum(axis=0)
        expected = judge.reports(walk, 5, 3, 0.1)
        with self.client() as client:
            self.assertEqual(client.welcome["protocol"], 2)
            self.assertEqual(client.hello["ranks"], 3)
            client.ask("scene.create", scene="p", parts=5)
            known = {}
            for step, points in enumerate(walk):
                answer, bulk = client.push("p", step, points, flags=step % 2, cuts_known=known)
                self.assertEqual(answer["previous_step"], step - 1 if step else None)
                for field in ("error", "error_before", "moved", "migrated", "epoch", "repartitioned"):
                    self.assertEqual(answer["report"][field], expected[step][field], (step, field))
                self.assertEqual(answer["report"]["drifted"], None if step else 0)
                self.assertEqual("cuts" in answer, answer["report"]["repartitioned"])
                if "cuts" in answer:
                    known, cuts = {k: answer["cuts"][k] for k in ("epoch", "hash")}, arrays_of(answer, bulk)
            part = arrays_of(*client.ask("assign", scene="p"))["part"]
            np.testing.assert_array_equal(part, judge.Tree.of_arrays(cuts, 3).assign(walk[-1]))

    def test_answers_about_positions_say_of_which_step_they_are(self):
        with self.client() as client:
            client.ask("scene.create", scene="old", parts=2)
            client.push("old", 7, np.random.default_rng(1).random((50, 3)))
            for command, arguments in (("assign", {}), ("fetch", {}), ("quality", {}), ("compare", {}), ("halo", {"width": 0.1}),
                                       ("rebalance", {"dry_run": True})):
                self.assertEqual(client.ask(command, scene="old", **arguments)[0]["positions_step"], 7, command)

    def test_a_checksum_of_no_arrays(self):
        with self.client() as client:
            for _ in range(3):
                client.number += 1
                client.socket.sendall(frame(REQUEST, client.number, {"command": "scene.list"}, b"", 1))
                self.assertIn("scenes", client.answer()[0])

    def test_a_step_is_applied_once(self):
        points = np.random.default_rng(1).random((50, 3))
        session = "00000000000000aa"
        with self.client(session=session) as client:
            client.ask("scene.create", scene="once", parts=2)
            first, _ = client.push("once", 3, points)
        with self.client(session=session) as client:
            again, _ = client.push("once", 3, points + 1, attempt=1)
            self.assertTrue(again["repeated"])
            self.assertEqual(again["report"], first["report"])
        with self.client() as other:
            self.assertIn("3", self.refused("stale_step", other.push, "once", 3, points))
            self.refused("stale_step", other.push, "once", 2, points)
            other.push("once", 10, points)

    def test_a_client_that_vanishes_in_mid_push(self):
        points = np.random.default_rng(1).random((5000, 3))
        with self.client() as client:
            client.ask("scene.create", scene="gone", parts=4)
            client.push("gone", 0, points)
        before = self.service.json("scene", "show", "gone")
        columns = {name: points[:, k] + 1 for k, name in enumerate("xyz")}
        for cut in (0, 1, 39, 40, 500, 60_000, 119_000):
            client = self.client()
            client.socket.sendall(frame(REQUEST, 99, *client.push_frame("gone", 1, columns, 5000))[:cut])
            client.close()
        self.assertEqual(self.service.json("scene", "show", "gone"), before)
        with self.client() as client:
            client.push("gone", 1, points)

    def test_a_second_pusher_hears_who_holds_it(self):
        points = np.random.default_rng(1).random((50, 3))
        with self.client() as holder, self.client() as second:
            holder.ask("scene.create", scene="held", parts=2)
            columns = {name: points[:, k] for k, name in enumerate("xyz")}
            holder.number += 1
            push = frame(REQUEST, holder.number, *holder.push_frame("held", 0, columns, 50))
            holder.socket.sendall(push[:-9])
            time.sleep(0.3)
            self.assertIn("e2e", self.refused("busy", second.push, "held", 0, points))
            holder.socket.sendall(push[-9:])
            answer, _ = holder.answer()
            self.assertEqual(answer["report"]["step"], 0)
            self.assertEqual(self.service.ctl("status").returncode, 0)

    def test_broken_rules(self):
        good = frame(REQUEST, 1, {"command": "status"})
        broken = {
            "magic": b"XXXX" + good[4:],
            "version": good[:4] + struct.pack("<H", 9) + good[6:],
            "type": good[:6] + struct.pack("<H", 77) + good[8:],
            "checksum": good[:32] + b"\0" * 8 + good[40:],
            "huge json": good[:12] + struct.pack("<I", 2**32 - 1) + good[16:],
            "huge bulk": good[:24] + struct.pack("<Q", 2**63) + good[32:],
            "no object": frame(REQUEST, 1, [1, 2]),
            "bulk without arrays": frame(REQUEST, 1, {"command": "status"}, b"12345678"),
            "array overflow": frame(REQUEST, 1, {"command": "status", "arrays": [
                {"name": "x", "dtype": "<f8", "shape": [2**61, 2**61]}]}, b"12345678"),
        }
        for name, data in broken.items():
            with self.subTest(name), self.client() as client:
                client.number = 1
                client.socket.sendall(data)
                try:
                    self.refused("too_large" if name.startswith("huge") else "protocol_error", client.answer)
                    self.assertEqual(client.socket.recv(1), b"")
                except (EOFError, ConnectionResetError):
                    pass
            self.alive()

    def test_requests_before_hello(self):
        with self.client(hello=False) as client:
            client.socket.sendall(frame(REQUEST, 1, {"command": "status"}))
            client.number = 1
            with self.assertRaises((Refused, EOFError, ConnectionResetError)):
                client.answer()
        with self.client(hello=False) as client:
            client.socket.sendall(frame(REQUEST, 1, {"command": "x" * 8000}))
            client.number = 1
            with self.assertRaises((Refused, EOFError, ConnectionResetError)):
                client.answer()
        self.alive()

    def test_pushes_that_lie(self):
        points = np.random.default_rng(1).random((40, 3))
        columns = {name: points[:, k] for k, name in enumerate("xyz")}
        with self.client() as client:
            client.ask("scene.create", scene="lies", parts=2)
            client.push("lies", 0, points)
        before = self.service.json("scene", "show", "lies")

        def attempt(changes, bytes_more=0):
            with self.client() as client:
                push, bulk = client.push_frame("lies", 1, columns, 40)
                client.send(push | changes, bulk + bytes(bytes_more))
                with self.assertRaises((Refused, EOFError)) as caught:
                    client.answer()
                return caught.exception

        for n in (39, 41, -1, 2**60):
            attempt({"n": n})
        attempt({"step": -1})
        attempt({"scene": "nobody"})
        attempt({"weights": True})
        attempt({"way": "chaos"})
        attempt({"dtype": "<f4"})
        attempt({"ids": True})
        attempt({"counts": [40, 0, 0]})
        attempt({"arrays": [{"name": "x", "dtype": "<f8", "shape": [120]}]})
        attempt({"arrays": [{"name": n, "dtype": "<f8", "shape": [40]} for n in "xyy"]})
        attempt({}, bytes_more=8)
        self.assertEqual(self.service.json("scene", "show", "lies"), before)
        with self.client() as client:
            client.push("lies", 1, points)

    def test_answers_come_in_the_order_of_requests(self):
        """Also after a history that is read from files, which takes longer than what is asked next."""
        with Service(1, options=("--keep-reports", 1)) as service, Client(service.endpoint[5:]) as client:
            client.ask("scene.create", scene="order", parts=2)
            for step in range(20):
                client.push("order", step, np.random.default_rng(step).random((10, 3)))
            asked = []
            for _ in range(50):
                for command in ("history", "error"):
                    asked.append(client.number + 1)
                    client.send({"command": command, "scene": "order"})
            answered = [client.receive()[1] for _ in asked]
        self.assertEqual(answered, asked)

    def test_goodbye(self):
        client = self.client()
        client.socket.sendall(frame(GOODBYE, 0, {}))
        rest = client.socket.recv(4096)
        self.assertTrue(rest == b"" or rest[:4] == b"RCBD")
        client.close()
        self.alive()


if __name__ == "__main__":
    unittest.main(verbosity=2)
