"""No load ends the service or locks it up: queries while a rank is held up, requests that take long to read, pushes that are
announced and never come."""
import json
import struct
import threading
import unittest.mock

from protocol_client import REPLY, REQUEST, Client, Refused, xxh3
from support import *


def rank_pids(service):
    """The process of each rank of the service, by rank."""
    pids = {}
    for pid, _ in processes_of(service.data):
        with open(f"/proc/{pid}/environ", "rb") as file:
            entries = dict(entry.partition(b"=")[::2] for entry in file.read().split(b"\0"))
        if process_name(pid) == "rcbd" and b"OMPI_COMM_WORLD_RANK" in entries:
            pids[int(entries[b"OMPI_COMM_WORLD_RANK"])] = pid
    return pids


class Stopped:
    """A process that stands still for a while."""

    def __init__(self, pid):
        self.pid = pid

    def __enter__(self):
        os.kill(self.pid, signal.SIGSTOP)

    def __exit__(self, *_):
        os.kill(self.pid, signal.SIGCONT)


class Overload(ServiceTest):
    @classmethod
    def setUpClass(cls):
        # A busy machine may take long to ask what is asked while a rank stands still.
        with unittest.mock.patch.dict(os.environ, RCBD_SILENCE_SECONDS="60"):
            super().setUpClass()
        cls.address = cls.service.endpoint
        cls.points = np.random.default_rng(7).random((4000, 3))
        with Client(cls.address) as client:
            for scene in ("one", "two"):
                client.ask("scene.create", scene=scene, parts=4)
                client.push(scene, 0, cls.points)
        cls.ranks = rank_pids(cls.service)

    def tearDown(self):
        self.assertEqual(rank_pids(self.service), self.ranks, "a rank has died")

    def test_queries_of_rank_0_need_no_other_rank(self):
        with Client(self.address) as client, Stopped(self.ranks[1]):
            for _ in range(300):  # more than any queue of a rank holds
                self.assertEqual(client.ask("error", scene="one")[0]["step"], 0)
            for command in ("counts", "cuts", "history", "stats", "scene.show"):
                client.ask(command, scene="one")
            client.ask("owner", scene="one", position=[0.1, 0.2, 0.3])
            client.ask("box", scene="one", lo=[0, 0, 0], hi=[1, 1, 1])

    def test_collective_commands_pile_up_no_further_than_a_rank_can_bear(self):
        clients = [Client(self.address) for _ in range(50)]
        with Stopped(self.ranks[1]):
            for _ in range(10):  # each is refused as busy, or waits
                for client in clients:
                    client.send({"command": "counts" if client is clients[0] else "quality", "scene": "one"})
        answered = 0
        for client in clients:
            for _ in range(10):
                while True:
                    kind, _, document, _ = client.receive()
                    if kind != 6:
                        break
                self.assertTrue(kind == REPLY or document["failure"]["code"] == "busy", document)
                answered += 1
            client.close()
        self.assertEqual(answered, 500)

    def test_a_rank_that_only_lags_is_waited_for(self):
        """Failing commands end on rank 0 at once, whatever the others do: they must not fill the others' queues."""
        with Client(self.address) as client:
            with Stopped(self.ranks[1]):
                for _ in range(100):  # so many may be on their way
                    with self.assertRaises(Refused):
                        client.ask("scene.create", scene="one", parts=3)
                for _ in range(60):  # not all of these are, until the rank goes on; unread ones fit into the socket
                    client.send({"command": "scene.create", "scene": "one", "parts": 3})
                with Client(self.address) as other:
                    awaited(lambda: other.ask("error", scene="one"))
            first = client.number - 59
            for client.number in range(first, first + 60):
                with self.assertRaises(Refused) as refused:
                    client.answer()
                self.assertEqual(refused.exception.args[0], "already_exists")

    def test_a_silent_rank_is_told(self):
        with Client(self.address) as client:
            self.assertEqual(client.ask("status")[0]["silent"], [])
            with Stopped(self.ranks[1]):
                silent = awaited(lambda: client.ask("status")[0]["silent"])
            self.assertEqual([one["rank"] for one in silent], [1])
            self.assertGreater(silent[0]["seconds"], 4)
            awaited(lambda: client.ask("status")[0]["silent"] == [])

    def test_large_requests_hold_up_nobody(self):
        sizes = b",".join([b"1"] * (1 << 20))
        text = b'{"command":"scene.create","scene":"one","part_sizes":[' + sizes + b'],"deadline_seconds":300}'
        head = struct.pack("<4sHHIIQQ", b"RCBD", 2, REQUEST, 0, len(text), 9, 0)
        message = head + struct.pack("<Q", xxh3(head + text)) + text
        large = [Client(self.address, timeout=120) for _ in range(12)]
        senders = [threading.Thread(target=client.socket.sendall, args=(message,)) for client in large]
        for sender in senders:
            sender.start()
        with Client(self.address) as client:
            while any(sender.is_alive() for sender in senders):
                client.ask("status")
                client.ask("error", scene="one")
        for sender, client in zip(senders, large):
            sender.join()
            client.number = 9
            with self.assertRaises(Refused):
                client.answer()
            client.close()

    def test_announced_pushes_are_in_nobodys_way(self):
        with Client(self.address) as rude, Client(self.address) as polite:
            limits = {**rude.welcome.get("limits", {}), **rude.hello.get("limits", {})}
            n = limits["bulk_bytes"] // 24 - 1
            rude.ask("scene.create", scene="announced", parts=2, replace=True)
            arrays = [{"name": axis, "dtype": "<f8", "shape": [n]} for axis in "xyz"]
            push = {"command": "push", "scene": "announced", "step": 0, "attempt": 1, "n": n, "arrays": arrays,
                    "deadline_seconds": 3600}
            text = json.dumps(push).encode()
            head = struct.pack("<4sHHIIQQ", b"RCBD", 2, REQUEST, 0, len(text), 9, 24 * n)
            rude.write(head + struct.pack("<Q", xxh3(head + text)) + text)
            for step in range(1, 4):
                polite.push("two", step, self.points)
            with Client(self.address, session=rude.session) as again:
                again.send({**push, "arrays": [], "attempt": 2, "way": "sockets", "counts": [n, 0]})
                for step in range(4, 7):
                    polite.push("two", step, self.points)


if __name__ == "__main__":
    unittest.main()
