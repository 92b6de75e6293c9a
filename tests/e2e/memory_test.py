"""What the service's memory can't hold is refused, and the service lives on: files of millions of rows that take no disk,
and questions whose answers are too large, under a limit of address space."""
import resource

from seat_client import Seat
from protocol_client import Client, Refused
from shared_memory_client import SharedClient
from support import *

MIB = 1 << 20


def sparse(path, rows):
    """An .npy of so many points, all zeros, that takes no disk."""
    with open(path, "wb") as file:
        np.lib.format.write_array_header_1_0(file, {"descr": "<f8", "fortran_order": False, "shape": (rows, 3)})
        file.truncate(file.tell() + rows * 24)
    return path


class Memory(Refusals, unittest.TestCase):
    def service(self, mebibytes, *options):
        """A service of one rank that gets so much address space, with a scene that must survive."""
        _, hard = resource.getrlimit(resource.RLIMIT_AS)
        if mebibytes:
            resource.setrlimit(resource.RLIMIT_AS, (mebibytes * MIB, hard))
        try:
            service = Service(1, options=("--files-below", tempfile.gettempdir(), *options))
        finally:
            resource.setrlimit(resource.RLIMIT_AS, (hard, hard))
        self.addCleanup(service.stop)
        client = Client(service.endpoint[5:], timeout=120)
        self.addCleanup(client.close)
        client.ask("scene.create", scene="keep", parts=2)
        client.push("keep", 0, np.random.default_rng(1).random((100, 3)))
        return service, client

    def too_large(self, client, command, **arguments):
        said = self.refused("too_large", client.ask, command, **arguments)
        self.assertEqual(client.ask("error", scene="keep")[0]["step"], 0)
        return said

    def test_a_file_that_memory_cannot_hold(self):
        service, client = self.service(3400)
        for rows in (60_000_000, 80_000_000):
            client.ask("scene.create", scene="big", parts=4, replace=True)
            self.too_large(client, "load", scene="big", path=sparse(os.path.join(service.dir, "big.npy"), rows))
        self.assertFalse(client.ask("status")[0]["restarted"])

    def test_a_file_beyond_the_limit_on_bytes(self):
        service, client = self.service(0, "--bulk-bytes", "64mb")
        client.ask("scene.create", scene="big", parts=4)
        said = self.too_large(client, "load", scene="big", path=sparse(os.path.join(service.dir, "big.npy"), 3_000_000))
        self.assertIn("at most 67108864", said)
        text = os.path.join(service.dir, "big.csv")
        write_text(text, "x,y,z\n" + "0,0,0\n" * (65 * MIB // 6))
        self.too_large(client, "load", scene="big", path=text)
        client.ask("load", scene="big", path=sparse(os.path.join(service.dir, "fits.npy"), 1_000_000))

    def test_a_push_from_shared_memory_beyond_the_limit_on_bytes(self):
        service, _ = self.service(0, "--bulk-bytes", "1mb")
        with SharedClient(service.endpoint[5:]) as client:
            client.ask("scene.create", scene="big", parts=4)
            rows = np.zeros((200_000, 3), "<f4")
            client.positions(60_000, dtype="<f4")
            same = [{"name": axis, "offset": 0, "stride": 4} for axis in "xyz"]  # three arrays in one place
            self.refused("too_large", client.step, "big", 0, rows, same)

    def test_blocks_in_shared_memory_that_are_beyond_the_limit_on_bytes_together(self):
        service, client = self.service(0, "--bulk-bytes", "1mb")
        points = np.random.default_rng(1).random((36_000, 3))
        client.ask("scene.create", scene="big", parts=4)
        team = [Seat(service.endpoint[5:], "big", k, 3, way="shared-memory") for k in range(3)]
        for n, fits in ((36_000, False), (24_000, True)):  # 32 bytes each
            for k, one in enumerate(team):
                one.start(0, np.arange(k, n, 3), points)
            for one in team:
                if fits:
                    self.assertEqual(one.finish()[0]["report"]["n"], n)
                else:
                    self.assertIn("1152000 bytes together, at most 1048576", self.refused("too_large", one.finish))
        for one in team:
            one.close()

    def test_an_answer_that_memory_cannot_hold(self):
        service, client = self.service(900)
        client.ask("scene.create", scene="big", parts=4)
        client.ask("load", scene="big", path=sparse(os.path.join(service.dir, "big.npy"), 7_000_000))
        self.too_large(client, "fetch", scene="big")
        self.assertEqual(client.ask("counts", scene="big")[0]["counts"], [1_750_000] * 4)

    def test_questions_and_a_push_with_next_to_no_memory_left(self):
        service, client = self.service(1000)  # the last push alone needs up to 880
        n = 4_000_000
        client.ask("scene.create", scene="big", parts=8, tolerance="inf")
        client.ask("load", scene="big", path=sparse(os.path.join(service.dir, "big.npy"), n))
        others, each = 0, 1_000_000
        while each >= 50_000:
            client.ask("scene.create", scene=f"other-{others}", parts=1)
            try:
                client.ask("load", scene=f"other-{others}", path=sparse(os.path.join(service.dir, "other.npy"), each))
            except Refused:
                each //= 2
            others += 1
        for command, more in (("quality", {}), ("quality", {"ghost_width": 0.5}), ("halo", {"width": 0.5}),
                              ("write_parts", {"directory": service.dir})):
            self.too_large(client, command, scene="big", **more)
        points = np.zeros((n, 3), "<f4")
        points[:, 0] = np.arange(n) / n
        with self.assertRaises(Refused) as refused:
            client.push("big", 1, points)
        self.assertIn(refused.exception.args[0], ("too_large", "busy"))
        self.assertEqual(client.ask("error", scene="keep")[0]["step"], 0)
        for k in range(others):
            client.ask("scene.drop", scene=f"other-{k}")
        self.assertEqual(client.push("big", 1, points)[0]["report"]["n"], n)


if __name__ == "__main__":
    unittest.main(verbosity=2)
