"""A service over several machines (tests/hosts): the answers of one machine, solvers on any of them, and machines that
vanish. Needs root, since the machines are made of network namespaces."""
import itertools
import re
import socket

import judge
import seats_client
from listener import Listener
from machines import *
from pages import blocks_for, commands

STRANGER = """
import os, socket, sys, time
held = []
for place in sys.argv[1:]:
    host, port = place.split(":")
    for words in (b"", b"GET / HTTP/1.0\\r\\n\\r\\n", os.urandom(5000)):
        try:
            held.append(socket.create_connection((host, int(port)), timeout=2))
            held[-1].sendall(words)
        except OSError:
            pass
time.sleep(2)
print(len(held))
"""


class HostsTest(MachinesTest):
    def test_the_sessions_of_the_pages(self):
        """Line by line, each on its machine, as a user whose home all machines share."""
        for one in blocks_for(__file__):
            with self.subTest(f"{one.page}:{one.line}"):
                self.machines(4)
                environment = self.hosts.environment(HOME=self.hosts.shared, RCBD_BIN_DIR=self.bin, PATH=f"{os.environ['PATH']}:{self.bin}",
                                                     OMPI_ALLOW_RUN_AS_ROOT="1", OMPI_ALLOW_RUN_AS_ROOT_CONFIRM="1")
                said = ""
                for name, lines in itertools.groupby(commands(one.text), key=lambda line: line[0]):
                    script = "\n".join(["set -e", *(line for _, line in lines)])
                    done = self.hosts.run(name, "bash", "-c", script, env=environment, capture_output=True, text=True, timeout=200,
                                          cwd=self.hosts.shared)
                    self.assertEqual(done.returncode, 0, f"on {name}: {script}: {done.stdout}{done.stderr}")
                    said += done.stdout
                if "status" in one.text:
                    self.assertRegex(said, r"a \(ranks 0-(1\), b \(ranks 2-3|3\), b \(ranks 4-7)\)")
                endpoint = f"file:{self.hosts.shared}/rcbd.where"
                if os.path.exists(endpoint[5:]):
                    self.on("a", os.path.join(self.bin, "rcbctl"), "down", endpoint=endpoint, RCBD_TOKEN_FILE="", check=True)
                self.assertTrue(wait_for(lambda: not any(self.hosts.processes(name) for name in self.hosts.names)), "processes are left")

    def test_answers_are_those_of_one_machine(self):
        for layout, ranks in (("a:2,b:2,c:2", 6), ("a:4,b:4", 8), ("a:1,b:1,c:1,d:1,e:1", 5)):
            with self.subTest(layout):
                self.machines(len(layout.split(",")))
                self.up("--hosts", layout, "--trusted-network", endpoint="unix:/tmp/rcbd.sock")
                status = self.ctl("status", "--json", endpoint="unix:/tmp/rcbd.sock")
                self.assertEqual([one["host"] for one in status["hosts"]],
                                 [part[0] for part in layout.split(",") for _ in range(int(part[2]))])
                self.assertEqual(status["ranks"], ranks)
                for name, points in hard_scenes().items():
                    parts = min(7, max(1, len(points)))
                    file = os.path.join(self.hosts.shared, f"{name}.npy")
                    np.save(file, points)
                    assign = os.path.join(self.hosts.shared, "assign.npy")
                    self.ctl("partition", file, "--parts", parts, "--assign", assign, "--json",
                             endpoint="unix:/tmp/rcbd.sock")
                    np.testing.assert_array_equal(np.load(assign), judge.partition(points, parts)[1], name)
                self.down(endpoint="unix:/tmp/rcbd.sock")

    def test_solvers_run_on_every_machine_and_on_others(self):
        self.machines(4)  # d has no rank
        self.up("--hosts", "a:2,b:2,c:1", "--trusted-network", "--interface", "10.77.0.0/24")
        alone = None
        for name in "abcd":
            done = self.on(name, os.path.join(self.bin, "two_spheres"), "--steps", 40, "--parts", 6, "--json",
                           RCBD_PATH="direct", check=True)
            result = json.loads(done.stdout)
            steps = [(report["error"], report["repartitioned"]) for report in result["reports"]]
            alone = alone or steps
            self.assertEqual(steps, alone)
            self.assertEqual({report["way"] for report in result["reports"]}, {"sockets"})
        addresses = [one["addresses"][0] for one in self.ctl("status", "--json")["hosts"]]
        self.assertEqual([re.sub(":.*", "", address) for address in addresses],
                         [f"10.77.0.{k}" for k in (1, 1, 2, 2, 3)])
        # The ranks of a solver's own machine read its memory, though the endpoint is TCP.
        for name, way in (("a", "shared-memory"), ("c", "shared-memory"), ("d", "endpoint")):
            done = self.on(name, os.path.join(self.bin, "two_spheres"), "--steps", 40, "--parts", 6, "--json",
                           RCBD_PATH="shared", check=True)
            reports = json.loads(done.stdout)["reports"]
            self.assertEqual([report["way"] for report in reports], 41 * [way], name)
            self.assertEqual([(report["error"], report["repartitioned"]) for report in reports], alone)
        slope = ["--points", 1000, "--steps", 6, "--interval", 0.3, "--parts", 6, "--json"]
        alone = None
        for name in "abcd":
            done = self.on(name, os.path.join(self.bin, "slope"), *slope, check=True)
            steps = [(report["error"], report["repartitioned"]) for report in json.loads(done.stdout)["reports"]]
            alone = alone or steps
            self.assertEqual(steps, alone)
        for name, processes in (("a", "a:1,b:1,c:1"), ("b", "c:2,a:1"), ("c", "b:1,d:1"), ("d", "d:3")):
            done = self.on(name, "mpirun", "--allow-run-as-root", "--bind-to", "none", "--oversubscribe", "--host", processes,
                           "-x", "RCBD_ENDPOINT", "-x", "RCBD_TOKEN_FILE", os.path.join(self.bin, "slope_mpi"), *slope,
                           "--positions", "every-step", "--check")
            self.assertEqual(done.returncode, 0, f"on {name}: {done.stdout}{done.stderr}\n{self.log()}")
        self.down()

    def test_one_history_by_any_number_of_seats(self):
        # Each sent in each step or counted, from all machines, to three of them and to one.
        path = np.random.default_rng(11).random((400, 3)) + np.random.default_rng(12).normal(
            [0.02, 0, 0], 0.01, (25, 400, 3)).cumsum(axis=0)
        slope = ["--points", 1000, "--steps", 5, "--interval", 0.3, "--parts", 7, "--tolerance", 0.05, "--json"]
        histories, slopes = [], []
        for layout in ("a:2,b:2,c:1", "a:3"):
            self.machines(3)
            self.up("--hosts", layout, "--trusted-network")
            for seats in (1, 2, 4, 7):
                for positions in ("every-step", "when-needed"):
                    with self.subTest(layout, seats=seats, positions=positions):
                        told, sent = seats_client.history(
                            path, TCP, "s", seats, positions, np.random.default_rng(seats), ("endpoint", "sockets"),
                            network=lambda k: self.hosts.network("bca"[k % 3]), token=token_of(self.data),
                            scene_options={"parts": 7, "tolerance": 0.05})
                        histories.append(told)
                        self.assertEqual(told, histories[0])
                        self.assertTrue(sent == len(path) or 3 < sent < len(path) - 3, sent)
            for seats, positions in ((1, "every-step"), (4, "when-needed"), (7, "when-needed")):
                done = self.on("a", "mpirun", "--allow-run-as-root", "--bind-to", "none", "--oversubscribe", "--host",
                               "a:3,b:2,c:2", "-n", seats, "-x", "RCBD_ENDPOINT", "-x", "RCBD_TOKEN_FILE",
                               os.path.join(self.bin, "slope_mpi"), *slope, "--positions", positions, check=True)
                slopes.append([[report[field] for field in seats_client.FIELDS] for report in json.loads(done.stdout)["reports"]])
                self.assertEqual(slopes[-1], slopes[0])
            self.down()

    def test_a_client_of_the_socket_reaches_ranks_on_other_machines(self):
        self.machines(2)
        endpoint = "unix:/tmp/rcbd.sock"
        self.up("--hosts", "a:2,b:2", "--trusted-network", endpoint=endpoint)
        kinds = [one["addresses"][0].split(":")[0] for one in self.ctl("status", "--json", endpoint=endpoint)["hosts"]]
        self.assertEqual(kinds, ["unix", "unix", "10.77.0.2", "10.77.0.2"])
        alone = None
        # By `shared` only the ranks on this machine read the memory; the others get slices in the same push.
        for path, way in (("direct", "sockets"), ("shared", "shared-memory"), ("gateway", "endpoint")):
            done = self.on("a", os.path.join(self.bin, "two_spheres"), "--steps", 60, "--parts", 6, "--json", endpoint=endpoint,
                           RCBD_PATH=path, RCBD_TOKEN_FILE="", check=True)
            reports = json.loads(done.stdout)["reports"]
            self.assertEqual([report["way"] for report in reports], 61 * [way], path)
            steps = [(report["error"], report["moved"], report["migrated"]) for report in reports]
            alone = alone or steps
            self.assertEqual(steps, alone)
            done = self.on("a", os.path.join(self.bin, "mpirun"), 3, os.path.join(self.bin, "slope_mpi"), "--points", 1000,
                           "--steps", 6, "--interval", 0.3, "--parts", 6, "--positions", "every-step",
                           "--check", "--json", endpoint=endpoint, RCBD_PATH=path, RCBD_TOKEN_FILE="",
                           check=True)
            ways = {report["way"] for report in json.loads(done.stdout)["reports"]}
            self.assertLessEqual(ways, {"endpoint", way}, path)
            self.assertIn(way, ways)
        self.down(endpoint=endpoint)

    def ways(self, name, endpoint, *args, **settings):
        """By which the steps of a solver on that machine travel."""
        done = self.on(name, os.path.join(self.bin, "two_spheres"), *args, "--json", endpoint=endpoint, **settings, check=True)
        return {report["way"] for report in json.loads(done.stdout)["reports"]}

    def test_ipv6(self):
        self.machines(3)  # c has no rank
        for number, name in enumerate(self.hosts.names, 1):
            self.hosts.run(name, "ip", "addr", "add", f"fd77::{number}/64", "dev", "eth0", "nodad", check=True)
        endpoint = "[fd77::1]:7470"
        self.up("--hosts", "a:2,b:1", "--trusted-interconnect", endpoint=endpoint)
        self.assertEqual(self.ctl("status", "--json", endpoint=endpoint)["encryption"], ["TLS 1.3"])
        for name, path, ways in (("a", "shared", {"shared-memory"}), ("b", "direct", {"sockets"}),
                                 ("c", "direct", {"sockets"}), ("c", "gateway", {"endpoint"})):
            self.assertEqual(self.ways(name, endpoint, "--steps", 3, RCBD_PATH=path), ways, f"{name} {path}")
        self.down(endpoint=endpoint)

    def test_where_only_the_endpoint_is_reached(self):
        """Through a tunnel, from a machine whose packets to the ranks vanish."""
        self.machines(3)
        self.up("--hosts", "a:2,b:1", "--trusted-network")
        many = ["--steps", 2, "--points", 100000]
        self.assertEqual(self.ways("c", TCP, *many), {"sockets"})
        self.hosts.run("c", "sh", "-c", "ip addr del 10.77.0.3/24 dev eth0; ip addr add 10.99.0.3/32 dev eth0; "
                       "ip route add 10.77.0.0/24 dev eth0 via 10.77.0.1 onlink", check=True)
        with self.hosts.network("c"):
            here = socket.create_server(("127.0.0.1", 7000))

        def tunnel(listener, made):
            with self.hosts.network("a"):
                service = socket.create_connection(("10.77.0.1", 7470))
            listener.pass_on(made, service)

        with Listener(here, tunnel):
            self.assertEqual(self.ways("c", "127.0.0.1:7000", *many), {"endpoint"})
        self.down()

    def listening(self, name):
        """The TCP ports at which processes of a machine listen."""
        found = set()
        for table in ("tcp", "tcp6"):
            lines = self.hosts.run(name, "cat", f"/proc/net/{table}", capture_output=True, text=True).stdout
            found |= {int(line.split()[1].split(":")[1], 16) for line in lines.splitlines()[1:] if line.split()[3] == "0A"}
        return found

    def test_strangers_at_every_port_change_nothing(self):
        self.machines(3)
        self.up("--hosts", "a:2,b:2", "--trusted-network")
        status = self.ctl("status", "--json")
        meant = {int(address.rsplit(":", 1)[1]) for one in status["hosts"] for address in one["addresses"]} | {7470}
        ports = {name: self.listening(name) for name in "ab"}
        self.assertLessEqual(meant, ports["a"] | ports["b"])
        ours = [f"{self.hosts.address(name)}:{port}" for name in "ab" for port in ports[name] & meant]
        self.assertEqual(len(ours), 5)
        stranger = self.on("c", sys.executable, "-c", STRANGER, *ours)
        self.assertEqual(stranger.stdout.strip(), "15", stranger.stderr)
        unproved = self.on("c", os.path.join(self.bin, "rcbctl"), "status", RCBD_TOKEN_FILE="", RCBD_TOKEN="guess")
        self.assertNotEqual(unproved.returncode, 0)
        done = self.on("c", os.path.join(self.bin, "two_spheres"), "--steps", 10, "--parts", 4, "--json", RCBD_PATH="direct")
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        after = self.ctl("status", "--json")
        self.assertEqual((after["pid"], after["restarted"], after["silent"]), (status["pid"], False, []))
        self.down()

    def test_a_pbs_job_has_its_machines_in_a_file(self):
        self.machines(2)
        nodes = os.path.join(self.hosts.shared, "nodes")
        write_text(nodes, "a\na\nb\n")
        self.up("--trusted-network", PBS_NODEFILE=nodes, PBS_JOBID="7.a")
        self.assertEqual([one["host"] for one in self.ctl("status", "--json")["hosts"]], ["a", "a", "b"])
        self.down()

    def test_clients_find_the_service_by_its_file(self):
        self.machines(3)
        file = os.path.join(self.hosts.shared, "service")
        endpoint = "file:" + file
        waiting = self.on("c", os.path.join(self.bin, "rcbctl"), "status", endpoint=endpoint, RCBD_TOKEN_FILE="")
        self.assertEqual(waiting.returncode, 3, waiting.stderr)
        self.assertIn("no service has written it", waiting.stderr)
        self.up("--hosts", "a:1,b:1", "--trusted-network", "--publish", file)
        for name in "abc":
            self.on(name, os.path.join(self.bin, "two_spheres"), "--steps", 5, "--parts", 3, "--json", endpoint=endpoint,
                    RCBD_TOKEN_FILE="", check=True)
        text = text_of(file)
        job = json.loads(text)["job"]
        self.assertNotIn(token_of(self.data), text)
        self.ctl("down", endpoint=endpoint, name="b")
        self.assertTrue(wait_for(lambda: not os.path.exists(file)), "the file is left")
        write_text(file, text)  # as one whose host has lost its power
        stale = self.on("c", os.path.join(self.bin, "rcbctl"), "status", endpoint=endpoint, RCBD_TOKEN_FILE="")
        self.assertEqual(stale.returncode, 3, stale.stderr)
        self.assertIn(f"the service that wrote {file} (job {job} on host a) no longer answers", stale.stderr)
        for foreign in ("{}", text.replace(job, "1\\n2")):
            write_text(file, foreign)
            refused = self.on("c", os.path.join(self.bin, "rcbctl"), "status", endpoint=endpoint)
            self.assertIn("is no file that", refused.stderr)

    def test_an_endpoint_named_by_its_host(self):
        self.machines(2)
        self.up("--hosts", "a:1,b:1", "--trusted-interconnect", endpoint="a:7470", RCBD_TOKEN_FILE="")
        for endpoint in ("a:7470", "10.77.0.1:7470"):  # on its machine the token is found without its being named
            self.ctl("status", endpoint=endpoint, RCBD_TOKEN_FILE="")
        supervisor, = (pid for pid in self.hosts.processes("a") if process_name(pid) == "rcbd-supervisor")
        os.kill(supervisor, signal.SIGTERM)
        self.assertTrue(wait_for(lambda: not any(self.hosts.processes(name) for name in self.hosts.names)),
                        "processes are left")
        self.assertIn("ended cleanly", self.log())
        for name in self.hosts.names:
            files = self.hosts.run(name, "ls", "/tmp", "/dev/shm", capture_output=True, text=True).stdout.split()
            self.assertEqual([file for file in files if not file.endswith(":")], [], f"files are left on {name}")

    def test_what_the_machines_do_not_share_is_told(self):
        self.machines(3)
        file = os.path.join(self.hosts.shared, "service")
        unshared = "says that its token is in /tmp/data/token, which can't be read on this machine"
        for where, says in (("10.77.0.1:7470", unshared),
                            ("127.0.0.1:7470", f"{file} names 127.0.0.1:7470 on host a, which is not this one"),
                            ("unix:/tmp/s", f"{file} names unix:/tmp/s on host a, which is not this one")):
            with self.subTest(where):
                self.ctl("up", "--hosts", "a:1,b:1", "--trusted-network", "--data-dir", "/tmp/data", "--publish", file,
                         endpoint=where)
                for program in (["rcbctl", "status"], ["two_spheres", "--steps", 3]):
                    refused = self.on("c", os.path.join(self.bin, program[0]), *program[1:], endpoint="file:" + file,
                                      RCBD_TOKEN_FILE="")
                    self.assertNotEqual(refused.returncode, 0)
                    self.assertIn(says, refused.stderr)
                self.down(endpoint=where, RCBD_TOKEN_FILE="/tmp/data/token")
        self.hosts.run("a", "cp", "-r", self.bin, "/tmp/bin", check=True)
        failed = self.on("a", "/tmp/bin/rcbctl", "up", "--hosts", "a:1,b:1", "--trusted-network", "--data-dir", self.data,
                         RCBD_BIN_DIR="/tmp/bin")
        self.assertNotEqual(failed.returncode, 0)
        self.assertRegex(failed.stderr, r"(?s)Executable: /tmp/bin/rcbd.*Node: b")

    def test_a_machine_that_vanishes_is_named_and_the_service_comes_back(self):
        self.machines(2)
        endpoint = "unix:/tmp/rcbd.sock"
        self.up("--hosts", "a:2,b:2", "--trusted-network", endpoint=endpoint, RCBD_SILENCE_SECONDS="4")
        instance = self.ctl("status", "--json", endpoint=endpoint)["pid"]

        def another():
            done = self.on("a", os.path.join(self.bin, "rcbctl"), "status", "--json", endpoint=endpoint)
            return done.returncode == 0 and json.loads(done.stdout)["pid"] != instance

        self.hosts.link("b", "down")
        self.assertTrue(wait_for(lambda: re.search(r"rank [23] on b has been silent for", self.log()), 40), self.log())
        self.hosts.link("b", "up")
        self.assertTrue(wait_for(another, 120), self.log())

        # What killed ranks leave goes when ranks start there again; a younger socket may be about to be used.
        def listed(pattern):
            return set(self.hosts.run("b", "sh", "-c", f"ls -d {pattern}", capture_output=True, text=True).stdout.split())

        instance = self.ctl("status", "--json", endpoint=endpoint)["pid"]
        for pid in self.hosts.processes("b"):
            if process_name(pid) == "rcbd":
                kill(pid)
        self.assertTrue(wait_for(another, 120), self.log())
        self.assertEqual(listed("/dev/shm/*"), set())
        sockets = listed("/tmp/rcbd-*")
        self.assertGreater(len(sockets), 2, "of killed ranks, and of the two that live")
        self.hosts.run("b", "touch", "-d", "2 minutes ago", *sockets, check=True)
        instance = self.ctl("status", "--json", endpoint=endpoint)["pid"]
        self.hosts.kill("b")
        self.assertTrue(wait_for(another, 120), self.log())
        self.assertTrue(self.ctl("status", "--json", endpoint=endpoint)["restarted"])
        self.assertTrue(wait_for(lambda: len(listed("/tmp/rcbd-*") - sockets) == 2), listed("/tmp/*"))
        self.assertEqual(listed("/tmp/rcbd-*") & sockets, set())
        self.down(endpoint=endpoint)
        self.assertEqual(listed("/tmp/rcbd-*") | listed("/dev/shm/*"), set())

    def test_what_cannot_be_is_told(self):
        self.machines(3)
        endpoint = "unix:/tmp/rcbd.sock"
        for args, says in ((["--hosts", "b:1,c:1", "--trusted-network"], "rank 0 would run on b, but 'rcbctl up' was run on a"),
                           (["--hosts", "a:1,b:1", "--trusted-network", "--interface", "192.168.7.0/24"], "no interface of this machine that others reach is"),
                           (["--hosts", "a:1,nowhere:1"], "no machine nowhere"),
                           (["--hosts", "a:1,b:1", "--interface", "10.77.0.1"], "no interface and no IPv4 network"),
                           (["--hosts", "a:1,b:1"], "say with --trusted-network"),
                           (["--hosts", "c:2", "--trusted-network"], "rank 0 would run on c"),
                           (["--hosts", "a:1,b:x"], "doesn't say how many ranks"),
                           (["--hostfile", "/nowhere"], "hostfile /nowhere can't be read")):
            with self.subTest(args):
                failed = self.on("a", os.path.join(self.bin, "rcbctl"), "up", *args, "--data-dir", self.data, endpoint=endpoint)
                self.assertNotEqual(failed.returncode, 0)
                self.assertIn(says, failed.stderr + self.log())
        # mpirun may live on, though ranks have failed; the message has what they said.
        self.hosts.run("b", "mount", "-o", "remount,size=1m", "/tmp", check=True)
        failed = self.on("a", os.path.join(self.bin, "rcbctl"), "up", "--hosts", "a:2,b:2", "--trusted-network", "--deadline", 8,
                         "--data-dir", self.data, endpoint=endpoint)
        self.assertNotEqual(failed.returncode, 0)
        self.assertRegex(failed.stderr, r"(?m)^\[b:\d+\] PMIX ERROR")


if __name__ == "__main__":
    unittest.main(verbosity=2)
