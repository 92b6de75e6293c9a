"""Who gets in and what others learn: taken ports, relays, replays, silence before hello, files that aren't the clients'."""
import contextlib
import socket
import time

import protocol_client
from listener import Listener
from protocol_client import HELLO, REPLY, WELCOME, Client, frame
from support import *


def welcome(authentication, **more):
    return frame(WELCOME, 0, {"server": "rcbd", "protocol": 2, "authentication": authentication,
                              "limits": {"hello_seconds": 5}, **more})


def impostor(greeting, **reply):
    """Greets, says yes to every frame, and goes on listening."""
    def script(self, made):
        made.sendall(greeting)
        while True:
            data = self.read(made)
            request = int.from_bytes(data[16:24], "little")
            made.sendall(frame(REPLY, request, {"session": "0" * 16, "ranks": 1, "data": [], **reply}))
    return script


class Auth(Refusals, unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.dir = tempfile.mkdtemp(prefix="rcb-auth-")
        cls.addClassCleanup(shutil.rmtree, cls.dir)
        cls.points = os.path.join(cls.dir, "points.npy")
        np.save(cls.points, np.random.default_rng(1).random((500, 3)))

    def test_who_takes_the_port_learns_nothing(self):
        port = free_port()
        endpoint = f"127.0.0.1:{port}"
        with Service(1, tcp=endpoint) as service:
            token = token_of(service.data)
            service.json("scene", "create", "s", "--parts", 2)
        nonce = "5" * 64
        for greeting, reply in ((welcome("none"), {}), (welcome("token"), {}),
                                (welcome("hmac-sha256", nonce=nonce), {}),
                                (welcome("hmac-sha256", nonce=nonce), {"proof": "0" * 64}),
                                (welcome("hmac-sha256", nonce=""), {"proof": ""})):
            with Listener(port, impostor(greeting, **reply)) as listener:
                for command in (["status"], ["push", "s", self.points], ["down"]):
                    done = run(*command, "--json", endpoint=endpoint, env={"RCBD_TOKEN": token})
                    self.assertEqual(done.returncode, 4, done.stderr)
                    self.assertIn(f"whoever listens at {endpoint}", done.stderr)
            self.assertNotIn(token.encode(), listener.heard)
            for word in (b"command", b"scene", b"push", b"shutdown"):
                self.assertNotIn(word, listener.heard)
            self.assertEqual(bool(listener.heard), b"hmac" in greeting and b"555" in greeting)

    def test_an_answer_whose_lists_differ_in_length_is_told(self):
        path = os.path.join(self.dir, "odd.sock")
        lists = {"counts": [1, 2], "targets": [1.5, 1.5, 1.5], "ghosts": [0, 0], "neighbours": [1]}
        with Listener(path, impostor(welcome("none"), **lists)):
            for command in ("counts", "quality"):
                done = run(command, "s", endpoint=f"unix:{path}")
                self.assertEqual(done.returncode, 1, done.stderr)
                self.assertIn("not as expected: its lists of parts differ in length", done.stderr)

    def test_relays_and_replays_prove_nothing(self):
        with Service(2, tcp=f"127.0.0.1:{free_port()}") as service:
            token = token_of(service.data)
            with Client(service.endpoint, token=token) as client:
                ranks = client.hello["data"]
                self.assertEqual(len(ranks), 2)
            # Between a client and the endpoint: what is overheard is said again, at the endpoint and at a rank.
            said = bytearray()

            def overhear(self, made):
                host, port = service.endpoint.split(":")
                with socket.create_connection((host, int(port))) as real:
                    made.sendall(real.recv(65536))
                    said.extend(self.read(made))
                    real.sendall(said)
                    made.sendall(real.recv(65536))
            with Listener(0, overhear) as listener:
                address = "127.0.0.1:%d" % listener.socket.getsockname()[1]
                Client(address, token=token).close()
            self.assertNotIn(token.encode(), said)
            for where in (service.endpoint, ranks[0], service.endpoint):
                with Client(where, hello=False) as client:
                    client.socket.sendall(said)
                    client.number = 1
                    self.refused("not_authorised", client.answer)

            # In the endpoint's place: the client answers the nonce of rank 1, and its answer is taken there.
            answers = []

            def relay(self, made):
                with Client(ranks[1], hello=False) as rank:
                    made.sendall(welcome("hmac-sha256", nonce=rank.welcome["nonce"]))
                    rank.socket.sendall(self.read(made))
                    answers.append(rank.receive()[2]["failure"]["code"])
            with Listener(0, relay) as listener:
                address = "127.0.0.1:%d" % listener.socket.getsockname()[1]
                done = run("status", "--json", endpoint=address, env={"RCBD_TOKEN": token})
                self.assertNotEqual(done.returncode, 0)
            self.assertEqual(set(answers), {"not_authorised"})  # it comes again, since the connection was lost
            self.assertEqual(service.ctl("status").returncode, 0)

    def test_every_start_has_a_token_of_its_own(self):
        endpoint = f"127.0.0.1:{free_port()}"
        with Service(1, tcp=endpoint) as service:
            old = token_of(service.data)
            with Client(endpoint, token=old) as client:
                for pid, line in processes_of(service.dir):
                    if line.split()[0].endswith("/rcbd"):
                        kill(pid)
                with self.assertRaises((EOFError, OSError)):
                    client.answer()
            deadline = time.time() + 60
            while service.ctl("status").returncode != 0:
                self.assertLess(time.time(), deadline)
                time.sleep(0.2)
            self.assertEqual(token_of(service.data), old, "after a crash its clients go on")
            self.assertEqual(service.ctl("down").returncode, 0)
            self.assertEqual(service.ctl("up", "-n", 1, "--data-dir", service.data).returncode, 0)
            self.assertNotEqual(token_of(service.data), old)
            self.assertEqual(service.ctl("status").returncode, 0, "a client that connects again reads the new one")
            done = service.ctl("status", env={"RCBD_TOKEN": old})
            self.assertEqual(done.returncode, 4)
            self.assertIn("each start by hand makes a new one", done.stderr)

    def test_silence_locks_nobody_out(self):
        for tcp in (None, f"127.0.0.1:{free_port()}"):
            # Few may wait at a listener, so that the silent ones are more.
            with (self.subTest(tcp=tcp), PreparedService(2, "ulimit -n 512", tcp=tcp) as service,
                  contextlib.ExitStack() as stack):
                token = token_of(service.data) if tcp else None
                address = service.endpoint
                with Client(address, token=token) as client:
                    listeners = [address, *client.hello["data"]]
                solver = subprocess.Popen([os.path.join(BIN, "two_spheres"), "--points", "3000", "--steps", "30"],
                                          env=dict(os.environ, RCBD_ENDPOINT=service.endpoint, RCBD_PATH="direct"),
                                          stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
                stack.callback(solver.kill)
                for _ in range(300):
                    for listener in listeners:
                        silent = stack.enter_context(contextlib.closing(protocol_client.connected(listener, 10)))
                        with contextlib.suppress(OSError):
                            silent.sendall(b"R")
                self.assertEqual(service.ctl("status").returncode, 0)
                self.assertEqual(solver.wait(200), 0, solver.stderr.read())
                solver.stderr.close()
                service.ctl("replay", "late", self.points, "--parts", 3, env={"RCBD_PATH": "direct"}, check=True)
                self.assertLess(len(text_of(service.data, "rcbd.log").splitlines()), 100, "a line for each who said nothing")
                self.assertEqual(service.ctl("down").returncode, 0)

    def test_places_are_kept_for_the_owner(self):
        with PreparedService(1, "ulimit -n 512") as service, contextlib.ExitStack() as stack:
            most = stack.enter_context(Client(service.endpoint)).hello["limits"]["sessions"]
            self.assertIn(most, range(100, 171))
            for _ in range(most - 1):
                stack.enter_context(Client(service.endpoint))
            late = [stack.enter_context(Client(service.endpoint)) for _ in range(6)]
            self.assertIn(f"{most} sessions", self.refused("busy", late[-1].ask, "scene.create", scene="s", parts=2))
            self.assertEqual(service.json("status")["sessions"], most + 4)
            self.assertEqual(service.json("scene", "list")["scenes"], [])
            self.assertEqual(service.ctl("down").returncode, 0)

    def test_off_loopback(self):
        # An address of documents, which no machine has (RFC 5737): with TLS, or where the network is trusted, it is tried.
        with tempfile.TemporaryDirectory() as data:
            for option in ([], ["--trusted-network"]):
                done = run("up", "-n", 1, "--data-dir", data, *option, endpoint="192.0.2.1:17499")
                self.assertEqual(done.returncode, 1)
                self.assertIn("can't listen on 192.0.2.1", done.stderr)
                self.assertEqual(text_of(data, "token").startswith("trusted-network-"), bool(option))

    def test_files_of_others_are_out_of_reach(self):
        root, outside = os.path.join(self.dir, "root"), os.path.join(self.dir, "outside")
        os.makedirs(root), os.makedirs(outside)
        np.save(os.path.join(root, "points.npy"), np.random.default_rng(1).random((50, 3)))
        for name in (os.path.join(outside, "secret.csv"), os.path.join(root, "words.csv")):
            write_text(name, "1,2,3\n1,hunter2,3\n")
        os.symlink(os.path.join(outside, "secret.csv"), os.path.join(root, "link.csv"))
        os.symlink(outside, os.path.join(root, "out"))

        def attack(client):
            """What must be refused whatever was allowed."""
            client.ask("scene.create", scene="f", parts=2, replace=True)
            for path in ("/etc/shadow", os.path.join(outside, "secret.csv"), os.path.join(root, "link.csv"),
                         os.path.join(root, "out", "secret.csv"), os.path.join(root, "..", "outside", "secret.csv")):
                said = self.refused("not_authorised", client.ask, "load", scene="f", path=path)
                self.assertNotIn("hunter2", said)
                self.assertNotIn("root:", said)
            self.assertIsNone(client.ask("scene.show", scene="f")[0]["step"])

        # `up` on a Unix socket: below its working directory.
        with Service(2, cwd=root) as service, Client(service.endpoint) as client:
            attack(client)
            said = self.refused("invalid_argument", client.ask, "load", scene="f", path=os.path.join(root, "words.csv"))
            self.assertIn("words.csv:2: column 2", said)
            self.assertNotIn("hunter2", said)
            client.ask("load", scene="f", path=os.path.join(root, "points.npy"))
            for prefix in ("two\nlines", "../x", "a/b", "", ".."):
                self.refused("invalid_argument", client.ask, "write_parts", scene="f", directory=root, prefix=prefix)
            for directory in (outside, os.path.join(root, "out"), "/tmp"):
                self.refused("not_authorised", client.ask, "write_parts", scene="f", directory=directory)
            self.assertEqual(os.listdir(outside), ["secret.csv"])
            files = client.ask("write_parts", scene="f", directory=os.path.join(root, "parts"))[0]["files"]
            self.assertEqual([os.path.exists(name) for name in files], [True, True])
        # The program's own service reads and writes where its user may.
        done = run("partition", os.path.join(root, "link.csv"), "--parts", 2, "--ranks", 2)
        self.assertIn("hunter2", done.stderr, "and tells its user what is wrong with the user's own file")
        out = os.path.join(outside, "parts")
        run("partition", os.path.join(root, "points.npy"), "--parts", 2, "--ranks", 2, "--out", out, check=True)
        self.assertEqual(len(os.listdir(out)), 2)

        # Over TCP: nowhere, unless the option says so.
        for option in ([], ["--files-below", root]):
            with (Service(1, tcp=f"127.0.0.1:{free_port()}", options=option, cwd=root) as service,
                  Client(service.endpoint, token=token_of(service.data)) as client):
                attack(client)
                path = os.path.join(root, "points.npy")
                if option:
                    client.ask("load", scene="f", path=path)
                else:
                    self.refused("not_authorised", client.ask, "load", scene="f", path=path)

    def test_words_of_clients_forge_no_log(self):
        with Service(1) as service:
            path = service.endpoint
            with Client(path, hello=False) as client:
                client.socket.sendall(frame(HELLO, 1, {"protocol": 2, "client": "a\nFORGED 1", "session": "0" * 16}))
                client.number = 1
                self.refused("protocol_error", client.answer)
            with Client(path) as client:
                for command in ("x\nFORGED 2", "x\x1b[2JFORGED", "x\x9b2J"):
                    self.refused("unsupported", client.ask, command)
                self.refused("not_found", client.ask, "error", scene="a\r\nFORGED 3")
            for _ in range(200):  # lines take their time through the supervisor
                with open(os.path.join(service.data, "rcbd.log"), newline="\n") as log:
                    text = log.read()
                if "FORGED 3" in text:
                    break
                time.sleep(0.05)
            self.assertIn("FORGED 3", text, "else this test proves nothing")
            for line in text.split("\n"):
                self.assertFalse(line.startswith("FORGED"), line)
            for control in ("\r", "\x1b", "\x9b"):
                self.assertNotIn(control, text)


if __name__ == "__main__":
    unittest.main(verbosity=2)
