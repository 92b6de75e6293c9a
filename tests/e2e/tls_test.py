"""Between machines (tests/hosts): what a sniffer learns, who can sit between a client and the service, and who is refused.
Needs root, since the machines are made of network namespaces."""
import contextlib
import socket
import ssl
import threading

from listener import Listener
from machines import *
from protocol_client import Client, described, encrypted, frame

PORT = 7470
SERIAL = os.path.join(BIN, "serial_c")
N = 20000
OTHER_CERTIFICATE = os.path.join(os.path.dirname(os.path.abspath(__file__)), "another_certificate.pem")  # not the service's
# What no network should see, whatever a client does: words of the protocol, and a scene's name.
WORDS = [b"RCBD", b"welcome", b"authentication", b"push", b"confidential"]


class Sniffer:
    """Hears all that passes the network interface of a machine, until closed."""

    def __init__(self, hosts, name):
        with hosts.network(name):
            self.socket = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(3))  # ETH_P_ALL
            self.socket.bind(("eth0", 0))
        self.socket.setsockopt(socket.SOL_SOCKET, 33, 64 << 20)  # SO_RCVBUFFORCE
        self.socket.settimeout(0.2)
        self.heard, self.closed = bytearray(), threading.Event()
        self.thread = threading.Thread(target=self.listen, daemon=True)
        self.thread.start()

    def listen(self):
        while True:
            try:
                self.heard += self.socket.recv(1 << 17)
            except TimeoutError:
                if self.closed.is_set():  # and nothing has come for a while
                    return

    def close(self):
        self.closed.set()
        self.thread.join(20)
        self.socket.close()
        return bytes(self.heard)


class Between(Listener):
    """At a port of a machine."""

    def __init__(self, hosts, name, script):
        self.hosts, self.name = hosts, name
        with hosts.network(name):
            super().__init__(socket.create_server((hosts.address(name), 0)), script)
        self.address = "%s:%d" % self.socket.getsockname()

    def service(self):
        with self.hosts.network(self.name):
            return socket.create_connection(("10.77.0.1", PORT), timeout=20)

    def service_by_tls(self):
        return encrypted(self.service(), "")[0]


def of_another(made):
    """The connection with a certificate that isn't the service's."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(OTHER_CERTIFICATE)
    return context.wrap_socket(made, server_side=True)


class TlsTest(Refusals, MachinesTest):
    def status(self, name, endpoint=TCP, **more):
        return self.on(name, os.path.join(self.bin, "rcbctl"), "status", "--json", endpoint=endpoint, **more)

    def client(self, name, address=TCP, **more):
        with self.hosts.network(name):
            return Client(address, token=token_of(self.data), **more)

    def connection(self, name, address=TCP, timeout=60):
        host, port = address.rsplit(":", 1)
        with self.hosts.network(name):
            return socket.create_connection((host, int(port)), timeout=timeout)

    def seen(self, *options):
        """Pushes from another machine in three ways. What a sniffer has heard, and the positions."""
        self.machines(2)
        self.up("-n", 2, *options)
        points = np.random.default_rng(7).random((N, 3))
        file = os.path.join(self.hosts.shared, "points.npy")
        np.save(file, np.stack([points, 1 - points]))
        sniffer = Sniffer(self.hosts, "a")
        try:
            for path, way in (("direct", "sockets"), ("gateway", "endpoint")):
                self.ctl("replay", "confidential", file, "--parts", 3, "--replace", name="b", RCBD_PATH=path)
                reports = self.ctl("history", "confidential", "--json", name="b")
                self.assertEqual({report["way"] for report in reports}, {way})
            with self.client("b") as client:
                client.ask("scene.create", scene="confidential-2", parts=3)
                client.push("confidential-2", 0, points)
        finally:
            heard = sniffer.close()
        encryption = self.ctl("status", "--json", name="b")["encryption"]
        self.assertIn(f"encryption  {encryption[0]}", self.ctl("status", name="b"))
        token = token_of(self.data)
        self.down()
        self.assertGreater(len(heard), 5 * points.nbytes * 0.9, "else it proves nothing")
        self.assertNotIn(token.removeprefix("trusted-network-").encode(), heard)
        return heard, points, encryption

    def test_a_sniffer_sees_neither_token_nor_positions(self):
        heard, points, encryption = self.seen()
        self.assertEqual(encryption, ["TLS 1.3"])
        for value in (*points[:200].ravel(), *(1 - points[:200]).ravel()):
            self.assertNotIn(value.tobytes(), heard)
        for word in WORDS:
            self.assertNotIn(word, heard)

    def test_on_a_trusted_network_it_sees_positions(self):
        heard, points, encryption = self.seen("--trusted-network")
        self.assertEqual(encryption, ["none"])
        found = sum(value.tobytes() in heard for value in points[:200].ravel())
        self.assertGreater(found, 500, "of 600; some lie across packets")
        for word in WORDS:
            if word != b"welcome":
                self.assertIn(word, heard)

    def test_who_sits_between_is_found_out(self):
        self.machines(3)
        self.up("-n", 2)
        self.assertEqual(self.status("c").returncode, 0)

        with Between(self.hosts, "b", lambda self, made: self.pass_on(made, self.service())) as wire:
            done = self.status("c", wire.address)
            self.assertEqual(done.returncode, 0, "a mere wire is no harm: " + done.stderr)
            recorded = bytes(wire.heard)

        def relay(self, made):  # with a certificate of its own
            self.pass_on(of_another(made), self.service_by_tls())
        with Between(self.hosts, "b", relay) as between:
            done = self.status("c", between.address)
            self.assertEqual(done.returncode, 4, done.stdout + done.stderr)
            self.assertIn("somebody sits between", done.stderr)
            self.assertIn(b"proof", between.heard)
            self.assertNotIn(b"status", between.heard)
            self.refused("not_authorised", self.client, "c", between.address)

        def impostor(self, made):  # that says yes to everything
            with of_another(made) as made:
                made.sendall(frame(1, 0, {"server": "rcbd", "protocol": 2, "authentication": "hmac-sha256",
                                          "nonce": "5" * 64}))
                while data := made.recv(65536):
                    self.heard += data
                    number = int.from_bytes(data[16:24], "little")
                    made.sendall(frame(4, number, {"session": "0" * 16, "ranks": 1, "proof": "0" * 64}))
        with Between(self.hosts, "b", impostor) as between:
            done = self.status("c", between.address)
            self.assertEqual(done.returncode, 4, done.stdout + done.stderr)
            self.assertIn("doesn't know the token", done.stderr)
            self.assertNotIn(b"status", between.heard)

        def undo(self, made):  # without TLS towards the client
            made.settimeout(5)
            service = self.service_by_tls()
            made.sendall(service.recv(65536))
            self.pass_on(made, service)
        with Between(self.hosts, "b", undo) as between:
            done = self.status("c", between.address)
            self.assertEqual(done.returncode, 1, done.stdout + done.stderr)
            self.assertIn("doesn't speak TLS", done.stderr)
            self.assertNotIn(b"proof", between.heard)

        with Between(self.hosts, "b", lambda self, made: made.recv(65536)) as between:  # dies in the handshake
            done = self.status("c", between.address)
            self.assertEqual(done.returncode, 3, "one that may come back: " + done.stdout + done.stderr)

        # What the wire has heard, once more.
        sessions = json.loads(self.status("a").stdout)["sessions"]
        for where in (TCP, TCP, self.data_addresses()[1]):
            with self.connection("b", where) as again:
                again.sendall(recorded)
                with contextlib.suppress(ConnectionError):
                    answers = b""
                    while data := again.recv(65536):
                        answers += data
            self.assertNotIn(b"RCBD", answers)
        self.assertEqual(json.loads(self.status("a").stdout)["sessions"], sessions)
        self.down()

    def data_addresses(self):
        with self.client("b") as client:
            return client.hello["data"]

    def test_a_foreign_client_pushes_straight_to_the_ranks(self):
        self.machines(2)
        self.up("-n", 2)
        points = np.random.default_rng(3).random((1000, 2))
        with contextlib.ExitStack() as stack:
            client = stack.enter_context(self.client("b"))
            self.assertEqual(len(client.certificate), 64)
            ranks = [stack.enter_context(self.client("b", address, session=client.session, listener=f"rank {rank}"))
                     for rank, address in enumerate(client.hello["data"])]
            self.assertEqual(len({client.certificate, *(rank.certificate for rank in ranks)}), 2,
                             "a process has one certificate, and shares it with no other")
            show = client.ask("scene.create", scene="s", parts=5, dims=2)[0]
            push = {"scene": "s", "step": 0, "attempt": 1}
            client.send({"command": "push", **push, "n": 1000, "way": "sockets", "counts": [500, 500]})
            for rank, connection in enumerate(ranks):
                part = points[rank * 500: (rank + 1) * 500]
                arrays, bulk = described({"x": part[:, 0], "y": part[:, 1]})
                connection.send({"command": "push.slice", **push, "rank": rank, "first": 0, "count": 500, "arrays": arrays},
                                bulk)
            report = client.answer()[0]["report"]
            self.assertEqual((report["n"], report["way"], show["n"]), (1000, "sockets", 0))
            # A proof is one listener's, here too.
            for listener in ("endpoint", "rank 0"):
                self.refused("not_authorised", self.client, "b", client.hello["data"][1], listener=listener)
        self.down()

    def test_garbage_silence_and_old_versions(self):
        self.machines(2)
        self.up("-n", 2)
        started = json.loads(self.status("b").stdout)
        places = [TCP, *self.data_addresses()]
        rng = np.random.default_rng(5)
        hello = ssl.MemoryBIO()
        with contextlib.suppress(ssl.SSLWantReadError):
            ssl.create_default_context().wrap_bio(ssl.MemoryBIO(), hello, server_hostname="rcbd").do_handshake()
        client_hello = hello.read()
        with contextlib.ExitStack() as stack:
            silent = []
            for place in places:
                for words in (b"", b"\x16", b"\x16\x03\x01\x02\x00\x01", client_hello, client_hello[:100]):
                    silent.append(stack.enter_context(self.connection("b", place)))
                    silent[-1].sendall(words)
                for words in (b"GET / HTTP/1.0\r\n\r\n", rng.bytes(5000), b"\x16" + rng.bytes(5000), b"\x15" * 5000,
                              b"\x16\x03\x01\x40\x00" + rng.bytes(16384), client_hello + rng.bytes(5000),
                              frame(2, 1, {"protocol": 2})):
                    with self.connection("b", place) as made, contextlib.suppress(ConnectionError):
                        made.sendall(words)
                        while made.recv(65536):
                            pass
            self.assertEqual(self.status("b").returncode, 0)
            said = []
            for made in silent:  # each is closed in the end
                answer = b""
                with contextlib.suppress(ConnectionError):
                    while data := made.recv(65536):
                        answer += data
                said.append(b"TLS 1.3 is spoken here" in answer)
            self.assertEqual(said, 3 * [True, False, False, False, False],
                             "who says nothing is told so in the clear, at the endpoint as at the ranks")

            # No number of half a handshake keeps others out.
            for _ in range(200):
                for place in places:
                    stack.enter_context(self.connection("b", place)).sendall(client_hello[:50])
            self.on("b", os.path.join(self.bin, "two_spheres"), "--points", 3000, "--steps", 5, "--json",
                    RCBD_PATH="direct", check=True)
        for place in places:
            with self.connection("b", place) as plain:
                plain.sendall(frame(2, 1, {"protocol": 2, "client": "old", "session": "0" * 16}))
                answer = plain.recv(65536)
                self.assertIn(b"protocol_error", answer)
                self.assertIn(b"the client doesn't speak it", answer)
            context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
            context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
            context.maximum_version = ssl.TLSVersion.TLSv1_2
            with self.connection("b", place) as old, self.assertRaisesRegex(ssl.SSLError, "(?i)protocol.version"):
                context.wrap_socket(old)
        ended = json.loads(self.status("b").stdout)
        self.assertEqual((ended["pid"], ended["silent"]), (started["pid"], []))
        self.down()

    def test_ranks_on_two_machines_encrypt_towards_clients(self):
        self.machines(3)
        self.up("--hosts", "a:1,b:1", "--trusted-interconnect")
        points = np.random.default_rng(8).random((N, 3))
        file = os.path.join(self.hosts.shared, "points.npy")
        np.save(file, np.stack([points, 1 - points]))
        sniffer = Sniffer(self.hosts, "c")
        try:
            self.ctl("replay", "confidential", file, "--parts", 3, name="c", RCBD_PATH="direct")
        finally:
            heard = sniffer.close()
        for name in "abc":
            reports = self.ctl("history", "confidential", "--json", name=name)
            self.assertEqual({report["way"] for report in reports}, {"sockets"})
        self.assertGreater(len(heard), 2 * points.nbytes * 0.9, "else it proves nothing")
        for value in (*points[:200].ravel(), *(1 - points[:200]).ravel()):
            self.assertNotIn(value.tobytes(), heard)
        for word in WORDS:
            self.assertNotIn(word, heard)
        self.down()

    def test_a_token_of_another_network_is_explained(self):
        self.machines(2)
        self.up("-n", 1)
        plain = self.status("b", RCBD_TOKEN_FILE="", RCBD_TOKEN="trusted-network-" + token_of(self.data))
        self.assertEqual(plain.returncode, 1)
        self.assertIn("TLS 1.3 is spoken here", plain.stderr)
        self.down()
        self.up("-n", 1, "--trusted-network")
        wants_tls = self.status("b", RCBD_TOKEN_FILE="", RCBD_TOKEN=token_of(self.data).removeprefix("trusted-network-"))
        self.assertEqual(wants_tls.returncode, 1)
        self.assertIn("doesn't speak TLS", wants_tls.stderr)
        self.assertIn("--trusted-network", wants_tls.stderr)
        self.assertEqual(self.status("b").returncode, 0)
        self.down()

    def test_all_addresses_of_a_machine(self):
        self.machines(2)
        for every in ("0.0.0.0:7470", "[::]:7470"):
            with self.subTest(every):
                self.up("-n", 2, endpoint=every)
                for name, where in (("a", "127.0.0.1:7470"), ("a", TCP), ("b", TCP)):
                    done = self.on(name, os.path.join(self.bin, "two_spheres"), "--points", 3000, "--steps", 3, "--json",
                                   endpoint=where, RCBD_PATH="direct", check=True)
                    self.assertEqual({one["way"] for one in json.loads(done.stdout)["reports"]}, {"sockets"})
                with self.hosts.network("a"), Client("127.0.0.1:7470", token=token_of(self.data)) as client:
                    self.assertEqual(client.certificate, "")
                with self.client("b") as client:
                    self.assertNotEqual(client.certificate, "")
                self.down(endpoint=TCP, name="a")

    def test_a_solver_outlives_a_service_whose_certificate_changes(self):
        self.machines(2)
        self.up("-n", 2)
        with self.client("b") as client:
            before = client.certificate
        ended = []
        solver = threading.Thread(target=lambda: ended.append(
            self.on("b", os.path.join(self.bin, "two_spheres"), "--points", 3000, "--steps", 300, "--parts", 4, "--json",
                    RCBD_PATH="direct")), daemon=True)
        solver.start()
        self.assertTrue(wait_for(lambda: json.loads(self.status("a").stdout)["steps"] > 20, 100), ended)
        for process in self.hosts.processes("a"):
            with contextlib.suppress(OSError), open(f"/proc/{process}/comm") as comm:
                if comm.read().strip() == "rcbd":
                    os.kill(process, signal.SIGKILL)
        solver.join(100)
        self.assertEqual([done.returncode for done in ended], [0], ended)
        reports = json.loads(ended[0].stdout)["reports"]
        self.assertEqual(len(reports), 301)
        self.assertTrue(json.loads(self.status("a").stdout)["restarted"], "the service died in the middle")
        with self.client("b") as client:
            self.assertNotEqual(client.certificate, before)
        self.down()

    def test_the_c_library_finds_openssl(self):
        """It does not link it (c_library_test.py)."""
        self.machines(2)
        self.up("-n", 2)
        done = self.on("b", SERIAL, check=True)
        self.assertIn("has reached the tolerance", done.stdout)
        folder = os.path.join(self.hosts.shared, "without")
        os.mkdir(folder)
        write_text(os.path.join(folder, "libssl.so.3"), "")
        done = self.on("b", SERIAL, LD_LIBRARY_PATH=folder)
        self.assertEqual(done.returncode, 1)
        self.assertIn("OpenSSL can't be opened", done.stderr)
        self.down()

    def test_without_tls_and_trust_nobody_else_may_connect(self):
        self.machines(1)
        config = os.path.join(self.hosts.shared, "openssl.cnf")  # no provider has ciphers, hashes or keys
        write_text(config, "openssl_conf = all\n[all]\nproviders = some\n[some]\nbase = on\n[on]\nactivate = 1\n")
        for where in (TCP, "0.0.0.0:7470"):
            done = self.on("a", os.path.join(self.bin, "rcbctl"), "up", "-n", 1, "--data-dir", self.data, endpoint=where,
                           OPENSSL_CONF=config)
            self.assertEqual(done.returncode, 1, done.stdout + done.stderr)
            for remedy in ("OpenSSL", "127.0.0.1", "ssh -L", "--trusted-network"):
                self.assertIn(remedy, done.stderr)


if __name__ == "__main__":
    unittest.main(verbosity=2)
