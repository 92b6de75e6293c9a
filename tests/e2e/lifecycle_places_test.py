"""One service an endpoint, whose sockets are its own; places that another user has made are refused; and after a kill
nothing stays."""
import contextlib
import ctypes
import fcntl
import itertools
import socket
import threading

from listener import Listener
from support import *

CLONE_NEWNS = 0x20000  # of sched.h


def setUpModule():
    """What is left behind here on purpose, any other service that starts would remove: it goes to a /dev/shm of our own."""
    if os.geteuid() == 0:
        if ctypes.CDLL(None, use_errno=True).unshare(CLONE_NEWNS) != 0:
            raise OSError(ctypes.get_errno(), "unshare")
        for command in (["mount", "--make-rprivate", "/"], ["mount", "-t", "tmpfs", "tmpfs", "/dev/shm"]):
            subprocess.run(command, check=True)


class Places(unittest.TestCase):
    def setUp(self):
        self.dir = tempfile.mkdtemp(prefix="rcb-e2e-")
        self.endpoint = f"unix:{self.dir}/s"

    def tearDown(self):
        run("down", endpoint=self.endpoint)
        shutil.rmtree(self.dir)

    def up(self, data="data", ranks=2, **kwargs):
        return run("up", "-n", ranks, "--data-dir", os.path.join(self.dir, data), endpoint=self.endpoint, **kwargs)

    def named(self, name):
        return sorted(pid for pid, _ in processes_of(self.dir) if process_name(pid) == name)

    def job_folders(self):
        found = []
        for pid in self.named("rcbd"):
            with open(f"/proc/{pid}/environ") as file:
                found += [entry.split("=", 1)[1] for entry in file.read().split("\0") if entry.startswith("RCBD_JOB_FOLDER=")]
        return set(found)

    def test_down_waits_for_its_own_service_and_not_for_who_listens_there(self):
        """Through a tunnel, which stays where it is when the service has ended."""
        self.assertEqual(self.up().returncode, 0)
        place = f"{self.dir}/tunnel"

        def tunnel(listener, made):
            service = socket.socket(socket.AF_UNIX)
            service.connect(f"{self.dir}/s")
            listener.pass_on(made, service)

        with Listener(place, tunnel):
            down = run("down", endpoint=f"unix:{place}")
        self.assertEqual((down.returncode, down.stdout.strip()), (0, f"stopped unix:{place}"), down.stderr)
        self.assertTrue(wait_for(lambda: not processes_of(self.dir)))

    @only_root
    def test_a_process_with_the_same_number_in_another_container_is_another(self):
        """Two services in PID namespaces of their own, started alike, so that their ranks have the same numbers."""
        shells = {}

        def said(shell, line):
            print(f"{line}; echo; echo ended", file=shells[shell].stdin, flush=True)
            return "".join(itertools.takewhile(lambda said: said != "ended\n", shells[shell].stdout))

        def ctl(shell, of, *arguments):
            return said(shell, f"{RCBCTL} --endpoint unix:{self.dir}/{of} " + " ".join(map(str, arguments)) + " 2>&1")

        def number_of_rank(name):
            shells[name] = subprocess.Popen(["unshare", "--pid", "--fork", "--kill-child", "--mount-proc", "sh"], text=True,
                                            stdin=subprocess.PIPE, stdout=subprocess.PIPE, cwd=self.dir)
            for end in (shells[name].wait, shells[name].stdout.close, shells[name].stdin.close):
                self.addCleanup(end)
            self.assertIn("endpoint", ctl(name, name, "up", "-n", 1, "--data-dir", f"{self.dir}/data-{name}"))
            return json.loads(ctl(name, name, "status", "--json"))["pid"]
        of_x = number_of_rank("x")
        for _ in range(5):  # mpirun's threads take numbers, too
            if number_of_rank("y") == of_x:
                break
            ctl("y", "y", "down")
        else:
            self.fail("no two ranks had one number")
        ctl("x", "x", "scene", "create", "precious", "--parts", 2)
        self.assertIn("stopped", ctl("x", "y", "down"))
        self.assertIn("precious", ctl("x", "x", "scene", "list"))
        self.assertIn("died 0 times", said("x", f"echo died $(grep -c 'has died' {self.dir}/data-x/rcbd.log) times"))
        ctl("x", "x", "down")

    @only_root
    def test_who_is_told_to_end_from_elsewhere_ends_for_good_though_a_rank_is_stuck(self):
        with socket.create_server(("127.0.0.1", 0)) as listener:
            self.endpoint = "127.0.0.1:%d" % listener.getsockname()[1]
        self.assertEqual(self.up(ranks=3).returncode, 0)
        token = {"RCBD_TOKEN_FILE": os.path.join(self.dir, "data", "token")}
        ranks = [rank["pid"] for rank in json.loads(run("status", "--json", endpoint=self.endpoint, env=token).stdout)["hosts"]]
        os.kill(ranks[1], signal.SIGSTOP)
        try:
            # Whose processes this one can't see.
            run("--pid", "--fork", "--mount-proc", RCBCTL, "--endpoint", self.endpoint, "down", program="unshare",
                env=token, check=True)
            self.assertEqual(run("status", endpoint=self.endpoint, env=token).returncode, 3, "it waits until it is gone")
            deadline = time.time() + 60
            while self.named("rcbd-supervisor"):
                self.assertLess(time.time(), deadline)
                time.sleep(0.1)
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.kill(ranks[1], signal.SIGCONT)
        self.assertNotIn("started again", text_of(self.dir, "data", "rcbd.log"))

    def test_of_two_ups_at_once_one_wins(self):
        for _ in range(3):
            done = [None, None]

            def start(i):
                done[i] = self.up(f"data{i}", ranks=i + 1)
            threads = [threading.Thread(target=start, args=(i,)) for i in range(2)]
            for thread in threads:
                thread.start()
            for thread in threads:
                thread.join()
            self.assertEqual(sorted(one.returncode for one in done), [0, 1], [one.stderr for one in done])
            winner = next(i for i in range(2) if done[i].returncode == 0)
            self.assertIn(f"{self.dir}/s", done[1 - winner].stderr)
            self.assertEqual(len(self.named("rcbd-supervisor")), 1)
            status = run("status", "--json", endpoint=self.endpoint)
            self.assertEqual(json.loads(status.stdout)["ranks"], winner + 1, status.stderr)
            self.assertEqual(len([name for name in os.listdir(self.dir) if name.startswith("s.") and name != "s.lock"]),
                             winner + 1)
            self.assertEqual(run("down", endpoint=self.endpoint).returncode, 0)
            self.assertEqual([name for name in os.listdir(self.dir) if name.startswith("s")], [])

    def test_of_two_ups_on_a_port_one_wins(self):
        endpoint = "127.0.0.1:17472"
        done = [run("up", "-n", 1, "--data-dir", f"{self.dir}/data{i}", endpoint=endpoint) for i in range(2)]
        try:
            self.assertEqual([one.returncode for one in done], [0, 1], done[1].stderr)
            self.assertIn("already", done[1].stderr)
        finally:
            self.assertEqual(run("down", endpoint=endpoint).returncode, 0)

    def test_in_a_container_whose_root_is_unknown(self):
        """A namespace in which the files of the machine's root show as nobody's."""
        namespace = ["unshare", "--user", "--map-root-user"]
        # Where that user gets to, whatever folder these tests were given.
        self.addCleanup(shutil.rmtree, self.dir)
        self.dir = tempfile.mkdtemp(prefix="rcb-e2e-", dir="/tmp")
        self.endpoint = f"unix:{self.dir}/s"
        if os.geteuid() == 0:
            os.chown(self.dir, ANOTHER_USER, ANOTHER_USER)
            namespace = ["setpriv", "--reuid", str(ANOTHER_USER), "--regid", str(ANOTHER_USER), "--clear-groups", *namespace]
        if subprocess.run([*namespace, "true"], capture_output=True).returncode != 0:
            print("SKIPPED: no user namespaces here", file=sys.stderr)
            self.skipTest("no user namespaces here")
        for name in ("rcbctl", "rcbd"):  # that user may not get to the folder of this checkout
            shutil.copy(os.path.join(BIN, name), self.dir)
        program = [*namespace, os.path.join(self.dir, "rcbctl")]
        run(*program[1:], "up", "-n", 1, "--data-dir", f"{self.dir}/data", program=program[0], endpoint=self.endpoint,
            env={"TMPDIR": self.dir, "RCBD_BIN_DIR": self.dir}, check=True)
        self.assertEqual(run(*program[1:], "down", program=program[0], endpoint=self.endpoint).returncode, 0)

    def test_a_foreign_lock_on_the_folder_is_no_obstacle(self):
        folder = os.open(self.dir, os.O_RDONLY)
        try:
            fcntl.flock(folder, fcntl.LOCK_EX | fcntl.LOCK_NB)
            self.up(check=True)
        finally:
            os.close(folder)

    def test_a_killed_supervisor_leaves_nothing(self):
        """Also where a rank is stopped at that moment, which nobody is left to continue."""
        for stop in (False, True):
            with self.subTest(stop=stop):
                self.assertEqual(self.up(ranks=3).returncode, 0)
                folders = self.job_folders()
                self.assertEqual(len(folders), 1)
                if stop:
                    os.kill(self.named("rcbd")[1], signal.SIGSTOP)
                os.kill(self.named("rcbd-supervisor")[0], signal.SIGKILL)

                def gone():
                    sockets = [name for name in os.listdir(self.dir) if name.startswith("s") and name != "s.lock"]
                    return not processes_of(self.dir) and not sockets and not any(map(os.path.exists, folders))
                self.assertTrue(wait_for(gone), (processes_of(self.dir), os.listdir(self.dir), folders))
                self.assertEqual(self.up(ranks=3).returncode, 0)
                self.assertEqual(run("down", endpoint=self.endpoint).returncode, 0)

    def kill_all(self):
        folders = self.job_folders()
        everybody = [pid for name in ("rcbd-supervisor", "mpirun", "rcbd") for pid in self.named(name)]
        for pid in everybody:
            os.kill(pid, signal.SIGSTOP)  # so that nobody cleans up after another
        for pid in reversed(everybody):
            kill(pid)
        self.assertTrue(wait_for(lambda: not processes_of(self.dir)))
        self.assertTrue(os.path.exists(f"{self.dir}/s"))
        self.assertTrue(all(map(os.path.exists, folders)))
        return folders

    @only_root
    def test_what_was_killed_altogether_is_removed_by_down(self):
        self.assertEqual(self.up(ranks=2).returncode, 0)
        folders = self.kill_all()
        down = run("down", endpoint=self.endpoint, check=True)
        for name in (f"{self.dir}/s", f"{self.dir}/s.0", f"{self.dir}/s.1", *folders):
            self.assertIn(name, down.stdout)
            self.assertFalse(os.path.exists(name), name)
        self.assertEqual(run("down", endpoint=self.endpoint).returncode, 3)

    @only_root
    def test_what_was_killed_altogether_is_removed_by_the_next_start_anywhere(self):
        self.assertEqual(self.up(ranks=2).returncode, 0)
        folders = self.kill_all()
        with Service(1):
            for name in (f"{self.dir}/s", f"{self.dir}/s.0", f"{self.dir}/s.1", *folders):
                self.assertFalse(os.path.exists(name), name)

    @only_root
    def test_a_folder_of_another_user_is_refused(self):
        theirs = os.path.join(self.dir, "theirs")
        precious = os.path.join(self.dir, "precious")
        write_text(precious, "precious")
        os.mkdir(theirs)
        os.symlink(precious, os.path.join(theirs, "rcbd.log"))
        os.symlink(precious, os.path.join(theirs, "lock"))
        os.chown(theirs, ANOTHER_USER, ANOTHER_USER)
        for data in ("theirs", "theirs/data"):
            up = self.up(data)
            self.assertNotEqual(up.returncode, 0)
            self.assertIn(f"{theirs} belongs to user {ANOTHER_USER}", up.stderr)
        self.assertEqual(text_of(precious), "precious")
        self.assertEqual(sorted(os.listdir(theirs)), ["lock", "rcbd.log"])
        # Files in a folder of our own that lead elsewhere.
        os.mkdir(os.path.join(self.dir, "ours"), 0o700)
        os.symlink(precious, os.path.join(self.dir, "ours", "rcbd.log"))
        up = self.up("ours")
        self.assertNotEqual(up.returncode, 0)
        self.assertIn("is a symbolic link", up.stderr)
        self.assertEqual(processes_of(self.dir), [])

    @only_root
    def test_another_users_lock_is_not_taken_for_ours(self):
        open(f"{self.dir}/s.lock", "w").close()
        os.chown(f"{self.dir}/s.lock", ANOTHER_USER, ANOTHER_USER)
        up = self.up()
        self.assertNotEqual(up.returncode, 0)
        self.assertIn(f"{self.dir}/s.lock", up.stderr)
        os.remove(f"{self.dir}/s.lock")


if __name__ == "__main__":
    unittest.main(verbosity=2)
