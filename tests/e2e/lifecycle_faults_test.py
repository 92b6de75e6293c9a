"""What the supervisor survives: a service that fails again and again, a data directory that is removed, a full disk; and
that `down` ends what there is and tells the truth."""
import contextlib
import re

from protocol_client import Client, Refused
from support import *


class FailingService(PreparedService):
    """Its rcbd ends at once as long as there is the file `broken`."""

    def __init__(self, ranks, **kwargs):
        super().__init__(ranks, "[ -e {programs}/broken ] && {{ echo 'error: the moon is wrong' >&2; exit 3; }}", **kwargs)
        self.broken = os.path.join(self.programs, "broken")

    def failures(self):
        """In a row, as the supervisor's note says."""
        return int(re.search(r"^failures (\d+)$", text_of(f"{self.endpoint[5:]}.lock"), re.M)[1])

    def fail(self):
        open(self.broken, "w").close()
        os.kill(self.processes("rcbd")[-1], signal.SIGKILL)


class ProcessLimits(unittest.TestCase, Refusals):
    """What the system allows a process runs out: the request is refused, and the service lives on."""

    def assert_lives(self, service):
        self.assertEqual([scene["scene"] for scene in service.json("status")["scenes"]], ["s"])
        self.assertNotIn("has died", text_of(service.data, "rcbd.log"))

    def push(self, client, parts, n):
        client.ask("scene.create", scene="s", parts=parts)
        client.push("s", 0, np.random.default_rng(1).random((n, 3)))

    def test_file_size(self):
        folder = tempfile.mkdtemp(prefix="rcb-e2e-")
        self.addCleanup(shutil.rmtree, folder)
        out = os.path.join(folder, "out")
        blocks = 20_000  # of 512 bytes; less than Open MPI needs would end the start
        with (PreparedService(2, f"ulimit -f {blocks}", options=("--files-below", folder)) as service,
              Client(service.endpoint) as client):
            self.push(client, 2, 600_000)
            self.assertIn("File too large", self.refused("io_error", client.ask, "write_parts", scene="s", directory=out))
            self.assertEqual(os.listdir(out), [])
            self.assert_lives(service)

    def test_open_files(self):
        with PreparedService(2, "ulimit -n 64") as service:
            with Client(service.endpoint) as client:
                self.push(client, 2, 1000)
            clients = []
            for _ in range(60):
                with contextlib.suppress(OSError, Refused):
                    clients.append(Client(service.endpoint))
            self.assertGreater(len(clients), 2)
            self.assert_lives(service)
            self.assertIn("ulimit -n", text_of(service.data, "rcbd.log"))
            for client in clients:
                client.socket.close()
            service.ctl("export", "s", os.path.join(service.dir, "out"), check=True)

    def test_memory(self):
        with PreparedService(2, "ulimit -v 1000000") as service, Client(service.endpoint) as client:
            self.push(client, 2, 100_000)
            for command in ("rebalance", "compare"):
                message = self.refused("too_large", client.ask, command, scene="s", parts=2**20)
                self.assertIn("no memory for a partition", message)
            self.assertEqual(client.ask("rebalance", scene="s", parts=64)[0]["parts"], 64)
            self.assert_lives(service)

    def test_memory_for_a_later_step(self):
        """Other scenes take what a step needs in which most particles change rank, by drift or by new cuts."""
        points = np.random.default_rng(1).random((1_000_000, 3))
        for tolerance, moved in (("inf", points * 0.1), (0.1, points[:, ::-1] * points)):
            with PreparedService(2, "ulimit -v 420000") as service, Client(service.endpoint, timeout=120) as client:
                client.ask("scene.create", scene="s", parts=2, tolerance=tolerance)
                client.push("s", 0, points)
                for step in range(1, 120):
                    client.ask("scene.create", scene=f"f{step}", parts=2)
                    client.push(f"f{step}", 0, points[:100_000])
                    before = client.ask("scene.show", scene="s")[0]
                    try:
                        client.push("s", step, moved if step % 2 else points)
                    except Refused as refused:
                        self.assertEqual(refused.args[0], "too_large")
                        break
                    except EOFError:
                        self.fail(f"step {step} ended the service: {text_of(service.data, 'rcbd.log')}")
                else:
                    self.fail("there was memory for all")
                self.assertEqual(client.ask("scene.show", scene="s")[0], before)
                client.ask("scene.drop", scene="f1")
                self.assertNotIn("has died", text_of(service.data, "rcbd.log"))


class Places(unittest.TestCase):
    def setUp(self):
        self.dir = tempfile.mkdtemp(prefix="rcb-e2e-")
        self.addCleanup(shutil.rmtree, self.dir)

    def test_what_stands_where_an_endpoint_is_to_be_published_stays(self):
        data, target, link, pipe = (os.path.join(self.dir, name) for name in ("data.csv", "target", "link", "pipe"))
        for path in (data, target):
            write_text(path, "1,2,3\n")
        os.symlink(target, link)
        os.mkfifo(pipe)
        for path in (data, link, pipe):
            up = run("up", "-n", 1, "--data-dir", self.dir + "/data", "--publish", path, endpoint=f"unix:{self.dir}/s")
            self.assertIn(up.returncode, (1, 2, 4), up.stderr)
            self.assertRegex(up.stderr, rf"{path} is .*\n.*publish in another place")
        self.assertEqual([text_of(data), text_of(link)], ["1,2,3\n"] * 2)
        self.assertTrue(os.path.islink(link))
        self.assertEqual(processes_of(self.dir), [])

    def up(self, before, *options):
        line = f"{before}; exec {RCBCTL} --endpoint unix:{self.dir}/s up -n 2 --data-dir {self.dir}/data " + " ".join(options)
        return subprocess.Popen(["sh", "-c", line], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)

    def test_limits_under_which_nothing_can_start(self):
        before = set(os.listdir("/dev/shm"))
        for limit in ("ulimit -n 16", "ulimit -n 6", "ulimit -s 64"):
            with self.up(limit) as up:
                said = up.communicate(timeout=90)[1]
            self.assertEqual(up.returncode, 1, (limit, said))
            self.assertRegex(said, r"open|descriptor|pipe|stack|limit|memory", limit)
            left = {name for name in os.listdir("/dev/shm") if name.startswith("rcbd-")} - before
            # What can't be removed for lack of a descriptor keeps its note, by which the next start finds it.
            self.assertEqual([name for name in left if not os.path.exists(f"/dev/shm/{name}/owner")], [], limit)
            self.assertEqual(processes_of(self.dir), [], limit)

    def test_a_misspelt_interface(self):
        with self.up("true", "--interface", "eht0") as up:
            said = up.communicate(timeout=90)[1]
        self.assertEqual(up.returncode, 1, said)
        self.assertIn("no interface of this machine that others reach is 'eht0'", said)

    def test_hanging_up_ends_what_stays_in_the_foreground(self):
        for before, ends in (("true", True), ("trap '' HUP", False)):
            with self.up(before, "--foreground") as up:
                wait_for(lambda: run("status", endpoint=f"unix:{self.dir}/s").returncode == 0, 60)
                up.send_signal(signal.SIGHUP)
                if ends:
                    self.assertEqual(up.wait(60), 0, up.stderr.read())
                else:
                    self.assertEqual(run("down", endpoint=f"unix:{self.dir}/s").returncode, 0)
                    self.assertEqual(up.wait(60), 0, up.stderr.read())
            self.assertEqual(processes_of(self.dir), [])

    def test_signals_that_are_ignored_end_no_start(self):
        with self.up("trap '' HUP INT") as up:
            self.assertTrue(wait_for(lambda: any("mpirun" in line for _, line in processes_of(self.dir))))
            for number in (signal.SIGHUP, signal.SIGINT):
                up.send_signal(number)
            self.assertEqual(up.wait(60), 0, up.stderr.read())
        self.assertEqual(run("down", endpoint=f"unix:{self.dir}/s").returncode, 0)

    def test_told_to_end_before_the_launcher_has_seen_that_it_runs(self):
        def shut_down(_):
            with Client(f"unix:{self.dir}/s") as client:
                client.ask("shutdown")
            wait_for(lambda: not any("rcbd --" in line for _, line in processes_of(self.dir)), 60)

        for end in (shut_down, lambda up: up.send_signal(signal.SIGHUP)):
            with self.up("true", "--foreground") as up:
                wait_for(lambda: any("rcbd --" in line for _, line in processes_of(self.dir)), 60)
                up.send_signal(signal.SIGSTOP)
                try:
                    wait_for(lambda: run("status", endpoint=f"unix:{self.dir}/s").returncode == 0, 60)
                    end(up)
                finally:
                    up.send_signal(signal.SIGCONT)
                self.assertEqual(up.wait(60), 0, up.stderr.read())
            self.assertEqual(processes_of(self.dir), [])

    def test_a_users_own_file_where_a_lock_belongs(self):
        write_text(os.path.join(self.dir, "s.lock"), "precious")
        up = run("up", "-n", 1, "--data-dir", self.dir + "/data", endpoint=f"unix:{self.dir}/s")
        self.assertEqual(up.returncode, 1, up.stderr)
        self.assertIn("is not a lock of rcbd's", up.stderr)
        self.assertEqual(text_of(self.dir, "s.lock"), "precious")

    def test_a_mask_that_would_lock_out_the_owner(self):
        line = f"umask 777; {RCBCTL} up -n 1 --data-dir {self.dir}/data && {RCBCTL} down"
        done = subprocess.run(["sh", "-c", line], env=dict(os.environ, RCBD_ENDPOINT=f"unix:{self.dir}/s"),
                              capture_output=True, text=True, timeout=60)
        self.assertEqual(done.returncode, 0, done.stderr)
        for path, mode in (("data", 0o700), ("data/rcbd.log", 0o600)):
            self.assertEqual(os.stat(os.path.join(self.dir, path)).st_mode & 0o777, mode, path)

    def test_a_working_directory_that_is_gone(self):
        up = subprocess.run(["sh", "-c", f"mkdir gone; cd gone; rmdir ../gone; {RCBCTL} --endpoint unix:{self.dir}/s up"],
                            cwd=self.dir, capture_output=True, text=True, timeout=60)
        self.assertEqual(up.returncode, 1, up.stderr)
        self.assertIn("the working directory is gone", up.stderr)
        self.assertEqual(processes_of(self.dir), [])


class ClosedStreams(unittest.TestCase):
    def test_up_whatever_standard_streams_are_closed(self):
        folder = tempfile.mkdtemp(prefix="rcb-e2e-")
        self.addCleanup(shutil.rmtree, folder)
        rcbctl = f"{BIN}/rcbctl --endpoint unix:{folder}/s"
        for closed, told in (("<&-", True), ("2>&-", True), (">&-", False), ("<&- >&-", False), ("<&- >&- 2>&-", False)):
            up = subprocess.run(["sh", "-c", f"{rcbctl} up -n 1 --data-dir {folder}/data {closed}"], capture_output=True,
                                text=True, timeout=60)
            status = subprocess.run(["sh", "-c", f"{rcbctl} status"], capture_output=True, text=True, timeout=60)
            down = subprocess.run(["sh", "-c", f"{rcbctl} down"], capture_output=True, text=True, timeout=60)
            self.assertEqual((up.returncode == 0, status.returncode, down.returncode), (told, 0, 0), f"{closed}: {up.stderr}")


class Faults(unittest.TestCase):
    def test_down_ends_a_supervisor_that_waits(self):
        with FailingService(2) as service:
            service.fail()

            def waiting():
                done = service.ctl("status", "--json")
                return done.returncode == 3 and "starts it again" in done.stdout
            self.assertTrue(wait_for(waiting))
            # A long pause, so that the state that is asked for below lasts.
            self.assertTrue(wait_for(lambda: service.failures() >= 5))
            self.assertTrue(wait_for(waiting))
            message = service.failure("status")["message"]
            self.assertRegex(message, r"starts it again in \d+ s \(it has died \d+ times, at last: .*the moon is wrong")
            second = run("up", "--data-dir", service.data + "2", endpoint=service.endpoint)
            self.assertEqual(second.returncode, 1)
            self.assertIn(f"pid {service.processes('rcbd-supervisor')[0]}", second.stderr)
            by_hand = run(1, os.path.join(BIN, "rcbd"), "--socket", service.endpoint[5:], "--data-dir", service.data + "3",
                          program=MPIRUN)
            self.assertNotEqual(by_hand.returncode, 0)
            self.assertIn("is served already, by pid", by_hand.stderr)
            down = service.ctl("down", check=True)
            self.assertIn("which starts it again", down.stdout)
            service.assert_nothing_left()
            self.assertEqual(service.ctl("down").returncode, 3)

    def test_a_removed_data_directory_is_made_again(self):
        with Service(2, options=("--answer-seconds", 3)) as service:
            before = service.processes("rcbd")
            shutil.rmtree(service.data)
            self.assertTrue(wait_for(lambda: os.path.exists(os.path.join(service.data, "rcbd.log"))))
            os.kill(before[0], signal.SIGKILL)
            self.assertTrue(wait_for(lambda: not set(before) & set(service.processes("rcbd"))))
            self.assertTrue(wait_for(lambda: service.ctl("status").returncode == 0))
            # A clean end needs no marker either.
            shutil.rmtree(service.data)
            self.assertEqual(service.ctl("down").returncode, 0)
            service.assert_nothing_left()

    def test_what_stands_in_the_logs_place_keeps_no_service_from_a_restart(self):
        for make in (os.mkdir, os.mkfifo):
            with self.subTest(make.__name__), Service(2) as service:
                log = os.path.join(service.data, "rcbd.log")
                before = service.processes("rcbd")
                os.unlink(log)
                make(log)
                os.kill(before[0], signal.SIGKILL)
                self.assertTrue(wait_for(lambda: not set(before) & set(service.processes("rcbd"))))
                self.assertTrue(wait_for(lambda: service.ctl("status").returncode == 0))
                self.assertEqual(service.ctl("down").returncode, 0)
                service.assert_nothing_left()

    def test_removed_sockets_are_made_again(self):
        with Service(2) as service:
            ranks = service.processes("rcbd")
            service.ctl("scene", "create", "stays", "--parts", 2)
            path = service.endpoint[5:]
            for name in (path, path + ".0", path + ".1"):
                os.unlink(name)
            self.assertTrue(wait_for(lambda: all(os.path.exists(name) for name in (path, path + ".0", path + ".1"))))
            self.assertEqual([scene["scene"] for scene in service.json("scene", "list")["scenes"]], ["stays"])
            self.assertEqual(service.processes("rcbd"), ranks)

    def test_a_full_disk(self):
        if os.geteuid() != 0:
            print("SKIPPED: only root can mount a disk to fill", file=sys.stderr)
            self.skipTest("only root can mount a disk to fill")
        done = subprocess.run(["unshare", "--mount", "--propagation", "private", sys.executable, __file__, "--full-disk"],
                              capture_output=True, text=True, timeout=240)
        if done.returncode == 77:
            print("SKIPPED:", done.stderr, file=sys.stderr)
            self.skipTest(done.stderr)
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)


def on_a_full_disk():
    """Runs in a mount namespace of its own; an assertion that fails is the test's failure."""
    folder = tempfile.mkdtemp(prefix="rcb-e2e-disk-")
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=1m,nr_inodes=200", "none", folder], capture_output=True)
    if mounted.returncode != 0:
        print(mounted.stderr.decode(), file=sys.stderr)
        return 77
    data, endpoint = os.path.join(folder, "data"), f"unix:{folder}/s"

    def ctl(*args):
        return run(*args, endpoint=endpoint)

    def left():
        return [entry for entry in processes_of(folder) if process_name(entry[0]) in ("rcbd", "mpirun", "rcbd-supervisor")]
    try:
        assert ctl("up", "-n", 2, "--data-dir", data).returncode == 0
        fill_disk(folder, files=10_000)
        first = [pid for pid, _ in left() if process_name(pid) == "rcbd"]
        os.kill(first[0], signal.SIGKILL)  # it comes back without a byte of disk
        assert wait_for(lambda: not any(pid in first for pid, _ in left()))
        assert wait_for(lambda: ctl("status").returncode == 0), ctl("status").stderr
        down = ctl("down")
        assert down.returncode == 0, down.stderr
        assert not left(), left()
        assert ctl("status").returncode == 3
        fill_disk(folder, files=10_000)  # what the service has given back
        up = ctl("up", "-n", 2, "--data-dir", data)
        assert up.returncode == 1 and "No space left on device" in up.stderr, (up.returncode, up.stdout, up.stderr)
        assert not left(), left()
        for name in os.listdir(folder):
            if name.startswith("fill"):
                os.remove(os.path.join(folder, name))
        up = ctl("up", "-n", 2, "--data-dir", data)
        assert up.returncode == 0, up.stderr
        assert ctl("down").returncode == 0
        assert not left(), left()
    finally:
        for pid, _ in left():
            kill(pid)
        subprocess.run(["umount", "-l", folder])
        os.rmdir(folder)
    return 0


if __name__ == "__main__":
    if sys.argv[1:] == ["--full-disk"]:
        sys.exit(on_a_full_disk())
    unittest.main(verbosity=2)
