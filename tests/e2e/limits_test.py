"""What one request can cost: long histories and many parts come in pages and arrays, and while one client asks for them
the others are answered; long commands end at their deadline; rank 0's memory is bounded."""
import contextlib
import select
import shutil
import tempfile
import threading

from protocol_client import NOTICE, REPLY, REQUEST, Client, Refused, arrays_of, count_record, frame
from support import *


def memory_mib(pid):
    """What a process holds, in MiB."""
    with open(f"/proc/{pid}/status") as file:
        return next(int(line.split()[1]) for line in file if line.startswith("VmRSS:")) / 1024


def rank_0(service):
    """The process that answers."""
    return service.json("status")["pid"]


class Poller:
    """A client that asks `status` all the time; how often it was answered while a block ran."""

    def __init__(self, address):
        self.address = address

    def __enter__(self):
        self.answers, self.ended = 0, False
        self.thread = threading.Thread(target=self.run)
        self.thread.start()
        return self

    def run(self):
        with Client(self.address) as client:
            while not self.ended:
                client.ask("status")
                self.answers += 1

    def __exit__(self, *_):
        self.ended = True
        self.thread.join()


def pages(client, command, take, **arguments):
    """Every page of an answer; the first item's number and how many pages there were."""
    first, count, next_page = None, 0, {}
    while True:
        page = client.ask(command, **{**arguments, **next_page})[0]
        first = page["from"] if first is None else first
        count += 1
        take(page)
        if page["next"] is None:
            return first, count
        assert page["next"] > page["from"]
        next_page = {"from": page["next"]}
        arguments.pop("last", None)


class Announcements(unittest.TestCase):
    def test_a_count_that_is_announced_takes_no_memory(self):
        with Service(1) as service, contextlib.ExitStack() as stack:
            control = stack.enter_context(Client(service.endpoint))
            control.ask("scene.create", scene="wide", parts=2**20, positions="when-needed")
            before = memory_mib(rank_0(service))
            announced = frame(REQUEST, 2, {"command": "count", "scene": "wide"}, bytes(120 + 32 * 2**20))
            for _ in range(40):
                stack.enter_context(Client(service.endpoint)).socket.sendall(announced[:200])
            time.sleep(0.5)
            control.ask("status")
            self.assertLess(memory_mib(rank_0(service)) - before, 40)  # of 1,280


class History(unittest.TestCase):
    STEPS = 60_000

    def test_a_long_history_is_kept_in_files_and_read_in_pages(self):
        with Service(2, options=("--keep-reports", 1000)) as service, Client(service.endpoint) as client:
            client.ask("scene.create", scene="still", parts=2, positions="when-needed")
            client.push("still", 0, np.random.default_rng(1).random((10, 3)))
            shown = client.ask("scene.show", scene="still")[0]

            def steps(first, last):
                for at in range(first, last, 32):
                    number = client.number
                    for step in range(at, min(at + 32, last)):
                        client.send({"command": "count", "scene": "still"}, count_record(step, shown, shown["counts"]))
                    for client.number in range(number + 1, client.number + 1):
                        self.assertIn("report", client.answer()[0])

            steps(1, 20_000)
            before = memory_mib(rank_0(service))
            steps(20_000, self.STEPS)
            self.assertLess(memory_mib(rank_0(service)) - before, 15)  # 40,000 reports would take more
            scenes = os.path.join(service.data, "scenes")
            kept, = os.listdir(scenes)
            self.assertGreater(sum(os.path.getsize(os.path.join(scenes, kept, name)) for name in
                                   os.listdir(os.path.join(scenes, kept))), 100 * self.STEPS)

            with self.assertRaises(Refused) as refused:
                client.ask("history", scene="still")
            self.assertEqual(refused.exception.args[0], "too_large")
            found = []
            with Poller(service.endpoint) as poller:
                first, count = pages(client, "history", lambda page: found.extend(r["step"] for r in page["history"]),
                                     scene="still", count=4096)
            self.assertEqual((first, found), (0, list(range(self.STEPS))))
            self.assertGreater(poller.answers, count // 2)

            self.read_by_rcbctl(service)
            client.ask("scene.drop", scene="still")
            awaited(lambda: not os.listdir(scenes))

    def read_by_rcbctl(self, service):
        reports = service.json("history", "still")
        self.assertEqual([report["step"] for report in reports], list(range(self.STEPS)))
        self.assertEqual({report["scene"] for report in reports}, {"still"})
        for arguments, expected in ((("--last", 3), range(self.STEPS - 3, self.STEPS)), (("--first", 3), range(3)),
                                    (("--last", 5000, "--first", 4500), range(self.STEPS - 5000, self.STEPS - 500))):
            self.assertEqual([r["step"] for r in service.json("history", "still", *arguments)], list(expected))
        table = os.path.join(service.dir, "h.csv")
        self.assertEqual(service.ctl("history", "still", "--csv", table).returncode, 0)
        with open(table) as file:
            self.assertEqual(sum(1 for _ in file), self.STEPS + 1)
        peak = run("-f", "%M", RCBCTL, "history", "still", "--json", endpoint=service.endpoint, program="/usr/bin/time") \
            if os.path.exists("/usr/bin/time") else None
        if peak:
            self.assertLess(int(peak.stderr.split()[-1]) / 1024, 200)


class ManyParts(unittest.TestCase):
    PARTS = 1 << 18

    @classmethod
    def setUpClass(cls):
        cls.service = Service(2)
        cls.addClassCleanup(cls.service.stop)
        cls.points = np.random.default_rng(3).random((2000, 3))
        with Client(cls.service.endpoint, timeout=120) as client:
            client.ask("scene.create", scene="many", parts=cls.PARTS)
            client.push("many", 0, cls.points)

    def test_answers_are_small_and_others_are_answered(self):
        with Client(self.service.endpoint, timeout=120) as client, Poller(self.service.endpoint) as poller:
            before = memory_mib(rank_0(self.service))
            asked = [("counts", {}), ("scene.show", {}), ("box", {"lo": [-1] * 3, "hi": [2] * 3}),
                     ("quality", {}), ("halo", {"width": 1e-3}), ("neighbours", {"width": 0}),
                     ("owner", {"position": [0.5] * 3}), ("stats", {}), ("error", {}),
                     ("compare", {"deadline_seconds": 600}), ("rebalance", {"dry_run": True})]
            for command, arguments in asked:
                client.send({"command": command, "scene": "many", **arguments})
                kind, _, document, bulk = client.receive()
                while kind not in (REPLY, 5):
                    kind, _, document, bulk = client.receive()
                self.assertEqual(kind, REPLY, (command, document))
                self.assertLess(len(json.dumps(document)), 1 << 16, command)
                if command == "counts":
                    counts = arrays_of(document, bulk)["counts"]
                    self.assertIsNone(document["counts"])
                    self.assertEqual((len(counts), counts.sum()), (self.PARTS, len(self.points)))
            with self.assertRaises(Refused) as refused:
                client.ask("cuts", scene="many")
            self.assertEqual(refused.exception.args[0], "too_large")
            answered = poller.answers
            cuts, regions = [], []
            _, count = pages(client, "cuts", lambda page: cuts.extend(c["node"] for c in page["cuts"]), scene="many",
                             list="cuts", count=1 << 20)
            pages(client, "cuts", lambda page: regions.extend(r["part"] for r in page["regions"]), scene="many",
                  list="regions")
            self.assertEqual((cuts, regions), (list(range(self.PARTS - 1)), list(range(self.PARTS))))
            self.assertGreater(poller.answers - answered, count // 2)
            self.assertLess(memory_mib(rank_0(self.service)) - before, 1000)

    def test_rcbctl_has_the_whole(self):
        with Client(self.service.endpoint) as client:
            client.ask("scene.create", scene="some", parts=20_000, replace=True)
            points = np.random.default_rng(4).random((40_000, 3))
            client.push("some", 0, points)
        counts = self.service.json("counts", "some")
        self.assertEqual((len(counts["counts"]), sum(counts["counts"]), len(counts["targets"])),
                         (20_000, len(points), 20_000))
        shown = self.service.json("scene", "show", "some")
        self.assertEqual(shown["counts"], counts["counts"])
        cuts = self.service.json("cuts", "some")
        self.assertEqual([cut["node"] for cut in cuts["cuts"]], list(range(19_999)))
        self.assertEqual([region["part"] for region in cuts["regions"]], list(range(20_000)))
        self.assertEqual((cuts["hash"], cuts["parts"], cuts["method"]), (shown["hash"], 20_000, "rcb"))
        self.assertEqual(len(self.service.json("quality", "some")["ghosts"]), 20_000)
        self.assertEqual(len(self.service.json("box", "some", -1, -1, -1, 2, 2, 2)["parts"]), 20_000)
        halo = self.service.json("halo", "some", "--width", 0.1)
        self.assertEqual(sum(pair["count"] for pair in halo["pairs"]), halo["entries"])
        self.assertEqual(len(self.service.json("neighbours", "some", "--width", 0)["neighbours"]), 20_000)


class ChangingFile(unittest.TestCase):
    def test_a_file_that_is_cut_while_it_is_read_is_refused_or_whole(self):
        rows = 400_000
        refused = 0
        folder = tempfile.mkdtemp()
        self.addCleanup(shutil.rmtree, folder)
        with Service(2, options=("--files-below", folder)) as service, Client(service.endpoint, timeout=60) as client:
            path = os.path.join(folder, "p.csv")
            text = "".join(f"{k},{k % 7}.5,{k % 11}.25\n" for k in range(rows))
            for k in range(12):
                write_text(path, text)
                client.ask("scene.create", scene="cut", parts=2, replace=True)
                cut = threading.Timer(0.004 * k, os.truncate, (path, len(text) // 2))
                cut.start()
                try:
                    report = client.ask("load", scene="cut", path=path)[0]["report"]
                    # Cut before it was opened, or after it was read.
                    self.assertIn(report["n"], (rows, text[:len(text) // 2].count("\n") + 1))
                except Refused as failure:
                    refused += 1
                    # invalid_argument: it was opened after the cut, which left half a row.
                    self.assertIn(failure.args[0], ("io_error", "invalid_argument"), failure)
                cut.join()
        print(f"refused {refused} of 12")


class Memory(unittest.TestCase):
    def test_answers_that_nobody_reads_are_bounded(self):
        with Service(1, options=("--bulk-bytes", "32mb")) as service, Client(service.endpoint, timeout=60) as client:
            client.ask("scene.create", scene="f", parts=2)
            client.push("f", 0, np.random.default_rng(1).random((200_000, 3)))
            before = memory_mib(rank_0(service))
            silent = [Client(service.endpoint, timeout=60) for _ in range(40)]
            for one in silent:
                one.send({"command": "fetch", "scene": "f"})  # 7 MB each, of which sockets hold little
            client.ask("quality", scene="f")  # comes after them all
            self.assertLess(memory_mib(rank_0(service)) - before, 100)
            kinds = []
            for one in silent:
                with one:
                    kind, _, document, _ = one.receive()
                    kinds.append(kind)
                    self.assertTrue(kind == REPLY or document["failure"]["code"] == "busy", document)
            self.assertIn(REPLY, kinds)
            self.assertGreater(len(set(kinds)), 1, "else this test proves nothing")
            self.assertEqual(client.ask("fetch", scene="f")[0]["n"], 200_000)

    def test_what_lasts_gives_way_to_other_scenes(self):
        points = np.random.default_rng(8).random((30_000, 3))
        with Service(2) as service, Client(service.endpoint) as costly, Client(service.endpoint) as other:
            costly.ask("scene.create", scene="costly", parts=8)
            costly.push("costly", 0, points)
            other.ask("scene.create", scene="other", parts=4)
            costly.send({"command": "compare", "scene": "costly", "parts": 1 << 20, "deadline_seconds": 600})
            for step in range(5):
                other.push("other", step, points[:1000])
                other.ask("assign", scene="other")
            # However many wait for its scene, or have a large question about it.
            crowd = [Client(service.endpoint) for _ in range(160)]
            for k, one in enumerate(crowd):
                one.send({"command": "assign" if k % 8 else "compare", "scene": "costly", "deadline_seconds": 600,
                          "nobody": "x" * (0 if k % 8 else 70_000)})
            for step in range(5, 10):
                other.push("other", step, points[:1000])
                other.ask("scene.create", scene="many", parts=20_000, part_sizes=[1.5] * 20_000, replace=True)
            with self.assertRaises(Refused) as refused:
                other.ask("compare", scene="other", methods=["x" * 70_000])
            self.assertEqual(refused.exception.args[0], "too_large")
            for one in [costly, *crowd]:
                while select.select([one.socket], [], [], 0)[0]:
                    self.assertEqual(one.receive()[0], NOTICE, "the costly command was over first")
            for one in crowd:
                one.close()

    def test_a_file_that_takes_long_to_read_holds_up_nobody(self):
        points = np.random.default_rng(8).random((1000, 3))
        with tempfile.TemporaryDirectory() as folder, Service(2, cwd=folder) as service, \
                Client(service.endpoint) as reader, Client(service.endpoint) as other:
            path = os.path.join(folder, "holes.csv")
            with open(path, "wb") as file:
                file.write(b"x,y,z\n")
                file.truncate(3 << 30)  # nothing of it is on the disk
            reader.ask("scene.create", scene="file", parts=2)
            other.ask("scene.create", scene="other", parts=4)
            reader.send({"command": "load", "scene": "file", "path": path, "deadline_seconds": 600})
            for step in range(3):
                other.push("other", step, points)
            self.assertFalse(select.select([reader.socket], [], [], 0)[0], "the file was read first")
            reader.close()
            other.ask("scene.drop", scene="file")  # the ranks have given it up, too
            other.ask("scene.create", scene="file", parts=2)
            with self.assertRaises(Refused) as refused:
                other.ask("load", scene="file", path=path, deadline_seconds=0.2)
            self.assertEqual(refused.exception.args[0], "deadline_exceeded")

    def test_the_end_waits_for_no_question(self):
        with Service(2) as service, Client(service.endpoint) as costly:
            costly.ask("scene.create", scene="costly", parts=8)
            costly.push("costly", 0, np.random.default_rng(8).random((30_000, 3)))
            costly.send({"command": "compare", "scene": "costly", "parts": 1 << 20, "deadline_seconds": 600})
            self.assertTrue(wait_for(lambda: service.ctl("status").returncode == 0))
            self.assertEqual(service.ctl("down").returncode, 0)
            with self.assertRaises(Refused) as refused:
                costly.answer()
            self.assertEqual(refused.exception.args[0], "aborted")

    def test_seats_of_scenes_that_are_gone_are_forgotten(self):
        with Service(1) as service, Client(service.endpoint, timeout=60) as client:
            def seats(first, last):
                for k in range(first, last):
                    client.ask("scene.create", scene=f"m{k}", parts=1)
                    client.ask("scene.open", scene=f"m{k}", seat=0, seats=256)
                    client.ask("scene.drop", scene=f"m{k}")
                    client.ask("scene.close", scene=f"m{k}")
                return memory_mib(rank_0(service))

            before = seats(0, 500)
            self.assertLess(seats(500, 3500) - before, 15)  # 18 KB each would be more than 50


class LongCommands(unittest.TestCase):
    def test_compare_of_a_method_repeated_is_refused_and_any_ends_at_its_deadline(self):
        with Service(2) as service, Client(service.endpoint, timeout=60) as client:
            points = np.random.default_rng(5).random((300_000, 3))
            client.ask("scene.create", scene="large", parts=8)
            client.push("large", 0, points)
            with self.assertRaises(Refused) as refused:
                client.ask("compare", scene="large", methods=["rcb"] * 5000)
            self.assertEqual(refused.exception.args[0], "invalid_argument")
            before = service.json("scene", "show", "large")
            for command, arguments in (("compare", {}), ("quality", {"ghost_width": 0.05}), ("halo", {"width": 9}), ("fetch", {}),
                                       ("rebalance", {"parts": 5})):
                with self.assertRaises(Refused) as refused:
                    client.ask(command, scene="large", **arguments, deadline_seconds=1e-6)
                self.assertEqual(refused.exception.args[0], "deadline_exceeded", command)
                client.ask("error", scene="large")  # the engine is free again
            self.assertEqual(service.json("scene", "show", "large"), before)


if __name__ == "__main__":
    unittest.main(verbosity=2)
