"""Bad input: a message that says what, where and what to do; the exit code; and nothing changed."""
import socket
import time

from support import *


class BadInput(ServiceTest):
    ranks = 3

    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.points = np.random.default_rng(3).random((60, 3))
        cls.good = cls.save("good.npy", cls.points)
        cls.service.json("scene", "create", "a", "--parts", 4)
        cls.service.json("push", "a", cls.good)

    @classmethod
    def text(cls, name, content):
        path = os.path.join(cls.dir, name)
        write_text(path, content)
        return path

    def setUp(self):
        self.before = self.service.json("scene", "show", "a")

    def tearDown(self):
        after = self.service.json("scene", "show", "a")
        self.assertEqual(self.before, after, "a refused request changed the scene")

    def refuse(self, *args, code, exit=1, says=()):
        failure = self.service.failure(*args)
        self.assertEqual((failure["code"], failure["exit"]), (code, exit), failure)
        for word in says:
            self.assertIn(word, failure["message"] + " " + failure["hint"], failure)

    def test_not_finite(self):
        for value in (np.nan, np.inf, -np.inf):
            points = self.points.copy()
            points[41, 1] = points[17, 2] = value
            bad = self.save("nan.npy", points)
            self.refuse("push", "a", bad, code="not_finite", says=["17"])
            self.refuse("partition", bad, "--parts", 2, code="not_finite", says=["17"])

    def test_files(self):
        self.refuse("push", "a", self.text("ragged.csv", "x,y,z\n1,2,3\n4,5\n"), code="invalid_argument",
                    says=["ragged.csv", "3"])
        self.refuse("partition", self.text("word.csv", "1,2,3\n1,two,3\n"), "--parts", 2, code="invalid_argument",
                    says=["word.csv", "2"])
        with open(self.good, "rb") as file:
            content = file.read()
        truncated = os.path.join(self.dir, "truncated.npy")
        with open(truncated, "wb") as file:
            file.write(content[:-40])
        self.refuse("push", "a", truncated, code="invalid_argument", says=["truncated.npy"])
        self.refuse("push", "a", self.save("flat.npy", self.points[:, :2]), code="invalid_argument", says=["2"])
        self.refuse("partition", os.path.join(self.dir, "missing.csv"), "--parts", 2, code="not_found",
                    says=["missing.csv"])
        self.refuse("partition", self.text("twins.csv", "id,x,y\n7,1,1\n8,2,2\n7,3,3\n"), "--parts", 2,
                    code="invalid_argument", says=["7"])
        self.refuse("partition", self.text("wide.csv", "1,2,3,4,5\n"), "--parts", 2, code="invalid_argument",
                    says=["--dims"])

    def test_arguments(self):
        self.refuse("partition", self.good, "--parts", 0, code="usage", exit=2)
        self.refuse("partition", self.good, code="usage", exit=2)
        self.refuse("nonsense", code="usage", exit=2)
        self.refuse("error", "nobody", code="not_found", says=["nobody"])
        self.refuse("scene", "create", "a", "--parts", 2, code="already_exists", says=["--replace"])
        self.refuse("scene", "create", "a/b", "--parts", 2, code="invalid_argument")
        self.refuse("scene", "create", "b", "--parts", 2, "--dims", 4, code="usage", exit=2)
        self.refuse("owner", "a", 1, 2, code="invalid_argument")
        self.refuse("push", "a", self.good, "--step", 0, code="stale_step", says=["0"])

    def test_count_differs(self):
        self.refuse("push", "a", self.save("fewer.npy", self.points[:59]), code="not_conserved", says=["59", "60"])

    def test_no_service(self):
        done = run("status", "--json", endpoint="unix:/nonexistent/rcbd.sock")
        self.assertEqual(done.returncode, 3)
        self.assertEqual(json.loads(done.stdout)["failure"]["code"], "unavailable")

    def connect(self):
        client = socket.socket(socket.AF_UNIX)
        client.settimeout(20)
        client.connect(self.service.endpoint[5:])
        return client

    def test_random_bytes(self):
        rng = np.random.default_rng(11)
        for size in (1, 39, 40, 4096, 100_000):
            with self.connect() as client:
                try:
                    client.sendall(rng.bytes(size))
                    client.shutdown(socket.SHUT_WR)
                    while client.recv(65536):
                        pass
                except (BrokenPipeError, ConnectionResetError):
                    pass
            self.assertEqual(self.service.ctl("status").returncode, 0)

    def test_second_service_on_the_same_socket(self):
        done = self.service.ctl("up", "-n", 2, "--json")
        self.assertEqual(done.returncode, 1)
        self.assertIn(self.service.endpoint[5:], done.stderr)

    def test_client_killed_while_pushing(self):
        points = np.random.default_rng(4).random((400_000, 3))
        self.service.json("scene", "create", "big", "--parts", 3)
        self.service.json("push", "big", self.save("big.npy", points))
        before = self.service.json("scene", "show", "big")
        frames = self.save("frames.npy", np.stack([points + 0.001 * k for k in range(8)]))
        for delay in (0.05, 0.1, 0.2, 0.3):
            victim = subprocess.Popen([RCBCTL, "push", "big", self.save("next.npy", points)], stdout=subprocess.DEVNULL,
                                      stderr=subprocess.DEVNULL, env=dict(os.environ, RCBD_ENDPOINT=self.service.endpoint))
            time.sleep(delay)
            victim.kill()
            victim.wait()
        after = self.service.json("scene", "show", "big")
        self.assertEqual(after["n"], before["n"])
        self.assertEqual(sum(after["counts"]), len(points))
        self.service.json("push", "big", self.save("next.npy", points))
        self.service.json("replay", "big", frames, "--parts", 5, "--replace")
        self.service.json("scene", "drop", "big")


if __name__ == "__main__":
    unittest.main(verbosity=2)
