"""What is around a service fails or is odd, and it lives on: the look-up of its name, room in the memory that processes
share, the place of its data, what its starter ignores, other children of its supervisor."""
import glob
import re
import resource
import socket

from protocol_client import Client
from support import *

FAR_SECONDS = 3600  # what is noticed only after so long isn't noticed in a test


def started_again(service, ranks):
    """Waits until other ranks answer."""
    if not wait_for(lambda: not set(ranks) & set(service.processes("rcbd")) and service.ctl("status").returncode == 0, 60):
        raise AssertionError("not started again:\n" + text_of(os.path.join(service.data, "rcbd.log")))


class Starters(unittest.TestCase):
    """rcbctl up in a shell that has made odd preparations."""

    def setUp(self):
        self.dir = tempfile.mkdtemp(prefix="rcb-e2e-")
        self.data = os.path.join(self.dir, "data")
        self.addCleanup(shutil.rmtree, self.dir)
        self.addCleanup(lambda: self.ctl("down"))

    def ctl(self, *args):
        return run(*args, endpoint=f"unix:{self.dir}/s")

    def processes(self, name):
        return sorted(pid for pid, _ in processes_of(self.dir) if process_name(pid) == name)

    def up(self, before, *options):
        line = (f"cd {self.dir}; {before} exec {RCBCTL} --endpoint unix:{self.dir}/s up -n 2 --data-dir {self.data} "
                + " ".join(map(str, options)))
        up = subprocess.Popen(["bash", "-c", line], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        self.addCleanup(up.stdout.close)
        self.addCleanup(up.stderr.close)
        self.addCleanup(up.kill)
        return up

    def foreground(self, before):
        """Returns once the supervisor, too, knows that the service answers: one that dies before isn't started again."""
        up = self.up(before, "--foreground", "--publish", f"{self.dir}/where")
        self.assertTrue(wait_for(lambda: os.path.exists(f"{self.dir}/where"), 60))
        return up

    def kill_a_rank(self):
        ranks = self.processes("rcbd")
        os.kill(ranks[-1], signal.SIGKILL)
        self.assertTrue(wait_for(lambda: not set(ranks) & set(self.processes("rcbd")) and self.ctl("status").returncode == 0,
                                 60), text_of(self.data + "/rcbd.log"))

    def test_who_ignores_the_ends_of_children(self):
        for odd in ("trap '' CHLD;", "trap '' CHLD ALRM TERM INT QUIT USR1;"):
            with self.subTest(odd):
                self.assertEqual(self.up(odd, "--answer-seconds", FAR_SECONDS).wait(60), 0)
                self.kill_a_rank()
                self.assertEqual(self.ctl("down").returncode, 0)
                self.assertEqual(self.processes("rcbd-supervisor"), [])

    def test_the_reason_of_a_failed_start_is_told_to_who_ignores_the_ends_of_children(self):
        up = self.up("trap '' CHLD; export RCBD_SILENCE_SECONDS=1;", "--deadline", FAR_SECONDS)
        self.assertIn("silence-seconds", up.communicate(timeout=60)[1].lower().replace("_", "-"))
        self.assertEqual(up.returncode, 1)

    def test_who_ignores_hanging_up_is_not_ended_by_it(self):
        up = self.foreground("trap '' HUP;")
        up.send_signal(signal.SIGHUP)
        # It reads its signals in order of their numbers, SIGCHLD last: so it has seen SIGHUP when it has noticed a death.
        self.kill_a_rank()
        self.assertIsNone(up.poll())

    def test_other_children_of_a_supervisor_are_left_alone(self):
        """Those of the shell that became the supervisor, and an orphan that it has adopted."""
        up = self.foreground("sleep 1001 & echo $! >child; (sh -c 'sleep 1002 & echo $! >orphan; sleep 0.1' &);")
        others = [int(text_of(f"{self.dir}/{name}")) for name in ("child", "orphan")]
        try:
            self.kill_a_rank()
            self.assertEqual([process_name(pid) for pid in others], ["sleep", "sleep"], "at a restart")
            self.assertEqual(self.ctl("down").returncode, 0)
            self.assertEqual(up.wait(60), 0)
            self.assertEqual([process_name(pid) for pid in others], ["sleep", "sleep"], "at the end")
            self.assertEqual(self.processes("rcbd") + self.processes("mpirun"), [])
        finally:
            for pid in others:
                if process_name(pid) == "sleep":
                    os.kill(pid, signal.SIGKILL)


class Environments(unittest.TestCase):
    """What is left in the environment from elsewhere, or lacks there, keeps a service from starting only with a reason."""

    def setUp(self):
        self.dir = tempfile.mkdtemp(prefix="rcb-e2e-")
        self.addCleanup(shutil.rmtree, self.dir)
        self.endpoint = f"unix:{self.dir}/s"
        self.addCleanup(lambda: run("down", endpoint=self.endpoint))

    def up(self, *before, ranks=2, endpoint=None, **environment):
        return run(*before, RCBCTL, "up", "-n", ranks, "--data-dir", f"{self.dir}/data", program="/usr/bin/env",
                   endpoint=endpoint or self.endpoint, env={name: str(value) for name, value in environment.items()})

    def test_what_other_jobs_tell_open_mpi(self):
        """How many ranks a core may have, which networks there are: a service on one machine heeds none of it."""
        told = {"rmaps_base_no_oversubscribe": 1, "rmaps_base_mapping_policy": "ppr:1:core", "oob_tcp_if_include": "eth77",
                "btl": "nothere", "pml": "nothere", "plm_rsh_agent": "/nonexistent", "hwloc_base_binding_policy": "core"}
        up = self.up(ranks=os.cpu_count() + 1, **{f"OMPI_MCA_{name}": value for name, value in told.items()})
        self.assertEqual(up.returncode, 0, up.stderr)

    def test_what_open_mpi_heeds_is_named(self):
        up = self.up(OMPI_MCA_coll="nothere")
        self.assertEqual(up.returncode, 1)
        self.assertIn("OMPI_MCA_coll=nothere", up.stderr)

    def test_no_search_path(self):
        up = self.up("-u", "PATH")
        self.assertEqual(up.returncode, 0, up.stderr)

    def test_another_allocation_of_slurm(self):
        job = {"SLURM_JOB_ID": 999, "SLURM_JOBID": 999, "SLURM_NTASKS": 4, "SLURM_TASKS_PER_NODE": "2(x2)"}
        for nodes in ("elsewhere[1-2]", f"elsewhere,{socket.gethostname()}"):
            up = self.up(SLURM_JOB_NODELIST=nodes, SLURM_NODELIST=nodes, SLURM_NNODES=2, SLURM_JOB_NUM_NODES=2, **job)
            self.assertEqual(up.returncode, 1)
            self.assertIn("SLURM_JOB_ID", up.stderr)
            self.assertIn("unset", up.stderr)

    def test_no_network(self):
        up = self.up("unshare", "--net")
        if "unshare failed" in up.stderr:
            self.skipTest("no namespaces here")
        self.assertEqual(up.returncode, 1)
        self.assertIn("needs an IPv4 address", up.stderr)

    def test_a_port_in_use(self):
        with socket.socket() as other:
            other.bind(("127.0.0.1", 0))
            other.listen()
            up = self.up(endpoint="127.0.0.1:%d" % other.getsockname()[1])
        self.assertEqual(up.returncode, 1)
        self.assertRegex(up.stderr, "in use by another program.*--endpoint")
        self.assertNotIn("--listen", up.stderr)

    @only_root
    def test_a_user_without_a_home_and_places_of_other_users(self):
        """As in a batch job, or in a container. The other user may not look into TMPDIR, nor to where the programs are."""
        place = tempfile.mkdtemp(prefix="rcb-e2e-", dir="/tmp")
        self.addCleanup(shutil.rmtree, place)
        os.chmod(place, 0o755)
        for folder, mode in (("theirs", 0o755), ("closed", 0o700), ("own", 0o755), ("bin", 0o755)):
            os.mkdir(f"{place}/{folder}", mode)
        os.chown(f"{place}/own", ANOTHER_USER, ANOTHER_USER)
        for program in ("rcbctl", "rcbd"):
            shutil.copy(os.path.join(BIN, program), f"{place}/bin")
        data = ("--data-dir", f"{place}/own")

        def ctl(*args):
            return run(f"--reuid={ANOTHER_USER}", f"--regid={ANOTHER_USER}", "--clear-groups", "env", "-u", "XDG_STATE_HOME",
                       "-u", "RCBD_BIN_DIR", "TMPDIR=/tmp", "XDG_RUNTIME_DIR=/nonexistent", "HOME=/", f"{place}/bin/rcbctl",
                       *args, program="setpriv")

        self.addCleanup(shutil.rmtree, f"/tmp/rcbd-{ANOTHER_USER}", ignore_errors=True)
        self.addCleanup(ctl, "down")
        for folder in ("theirs", "closed"):
            self.assertIn("choose a folder of yours for the socket, with --endpoint",
                          ctl("up", "--endpoint", f"unix:{place}/{folder}/s", *data).stderr)
        self.assertRegex(ctl("up", "-n", 1).stderr, "can't be made: .*\n.*with --data-dir")
        self.assertRegex(ctl("up", "-n", 1, "--endpoint", "127.0.0.1:17496").stderr, "with XDG_STATE_HOME")
        up = ctl("up", "-n", 1, *data)
        self.assertIn(f"/tmp/rcbd-{ANOTHER_USER}/", up.stdout, up.stderr)
        self.assertEqual(ctl("status").returncode, 0)


class Supervisors(unittest.TestCase):
    """What befalls the supervisor itself at the moment when its service dies."""

    def test_a_data_directory_that_cannot_be_examined(self):
        with Service(2) as service:
            away, ranks = service.data + ".away", service.processes("rcbd")
            supervisor = service.processes("rcbd-supervisor")
            os.rename(service.data, away)
            os.symlink("data", service.data)
            os.kill(ranks[-1], signal.SIGKILL)
            try:
                self.assertTrue(wait_for(lambda: len(re.findall("has died", text_of(away + "/rcbd.log"))) >= 2),
                                text_of(away + "/rcbd.log"))
            finally:
                os.unlink(service.data)
                os.rename(away, service.data)
            started_again(service, ranks)
            self.assertEqual(service.processes("rcbd-supervisor"), supervisor)

    def test_no_memory(self):
        with Service(2) as service:
            supervisor, ranks = service.processes("rcbd-supervisor")[0], service.processes("rcbd")
            log = os.path.join(service.data, "rcbd.log")
            before = resource.prlimit(supervisor, resource.RLIMIT_AS)
            resource.prlimit(supervisor, resource.RLIMIT_AS, (1, before[1]))
            with open(f"/proc/{service.processes('mpirun')[0]}/fd/1", "wb", buffering=0) as output:
                for _ in range(10):  # more than it keeps, so it needs memory for that
                    output.write(b"x" * 63 + b"\n" + b"y" * 30_000 + b"\n")
            os.kill(ranks[-1], signal.SIGKILL)
            self.assertTrue(wait_for(lambda: not set(ranks) & set(service.processes("rcbd"))))
            self.assertTrue(wait_for(lambda: "this process has failed, and goes on" in text_of(log)), text_of(log)[-3000:])
            resource.prlimit(supervisor, resource.RLIMIT_AS, before)
            started_again(service, ranks)
            self.assertEqual(service.processes("rcbd-supervisor"), [supervisor])


def mounted(kind, *args):
    return subprocess.run(["mount", "-t", kind, *args], capture_output=True).returncode == 0 if kind != "bind" else \
        subprocess.run(["mount", "--bind", *args], capture_output=True).returncode == 0


def without_its_name():
    """The service is at NAME:PORT, and the name can't be looked up any more."""
    folder = tempfile.mkdtemp(prefix="rcb-e2e-")
    hosts = os.path.join(folder, "hosts")

    def names(*known):
        with open(hosts, "w") as file:
            file.writelines(f"127.0.0.1 {name}\n" for name in known)
    names("localhost", "rcbhost")
    if not mounted("bind", hosts, "/etc/hosts"):
        return 77
    with Service(2, tcp="rcbhost:17495", options=("--answer-seconds", 1)) as service:
        log = os.path.join(service.data, "rcbd.log")
        ranks = service.processes("rcbd")
        names("localhost")
        time.sleep(4)  # many times what it may be silent
        assert service.processes("rcbd") == ranks and "has died" not in text_of(log), text_of(log)
        os.kill(ranks[-1], signal.SIGKILL)
        assert wait_for(lambda: len(re.findall("rcbhost:17495: no such host", text_of(log))) >= 2, 60), text_of(log)
        names("localhost", "rcbhost")
        started_again(service, ranks)
        names("localhost")
        os.kill(service.processes("rcbd-supervisor")[0], signal.SIGTERM)
        assert wait_for(lambda: not service.processes("rcbd-supervisor"), 60)
        assert os.path.exists(os.path.join(service.data, "clean-shutdown")), text_of(log)
    shutil.rmtree(folder, ignore_errors=True)
    return 0


def without_shared_memory():
    """/dev/shm is small; another program fills it while the service runs, or has done so before it starts."""
    if not mounted("tmpfs", "-o", "size=20m", "shm", "/dev/shm"):
        return 77
    with Service(4) as service:
        ranks = service.processes("rcbd")
        sparse = [path for path in glob.glob("/dev/shm/rcbd-*/**", recursive=True)
                  if os.path.isfile(path) and os.stat(path).st_blocks * 512 < os.stat(path).st_size]
        assert not sparse, sparse
        fill_disk("/dev/shm")
        rng = np.random.default_rng(1)
        with Client(service.endpoint, timeout=60) as client:
            client.ask("scene.create", scene="s", parts=64)
            for step in range(3):
                client.push("s", step, rng.random((200_000, 3)))
        assert service.processes("rcbd") == ranks, text_of(os.path.join(service.data, "rcbd.log"))
        os.kill(ranks[-1], signal.SIGKILL)  # it comes back in the data directory
        started_again(service, ranks)
        assert glob.glob(os.path.join(service.data, "rcbd-*")), os.listdir(service.data)
    with tempfile.TemporaryDirectory(dir="/dev/shm", prefix="rcb-e2e-") as folder:
        up = run("up", "-n", 2, "--data-dir", folder + "/data", endpoint=f"unix:{folder}/s")
        run("down", endpoint=f"unix:{folder}/s")
        assert up.returncode == 1 and re.search("neither /dev/shm nor .* has room for", up.stderr), up.stderr
    # Enough to begin in, not for all, where the system has no other shared memory: rcbd by itself refuses as well.
    os.unlink("/dev/shm/fill")
    subprocess.run(["mount", "-o", "remount,size=10m", "/dev/shm"], check=True)
    with tempfile.TemporaryDirectory(prefix="rcb-e2e-") as folder:
        alone = run(3, os.path.join(BIN, "rcbd"), "--socket", folder + "/s", "--data-dir", folder + "/data", program=MPIRUN,
                    env={"OMPI_MCA_shmem": "mmap"})
        assert alone.returncode == 1 and re.search("through which ranks share memory: No space", alone.stderr), alone.stderr
    return 0


def without_inodes():
    """/dev/shm takes no more files: the job's folder is in the data directory."""
    if not mounted("tmpfs", "-o", "nr_inodes=5", "shm", "/dev/shm"):
        return 77
    with Service(2) as service:
        assert glob.glob(os.path.join(service.data, "rcbd-*")), os.listdir(service.data)
    return 0


def with_low_limits():
    """Of System V's memory: a segment's size, their number, all pages together."""
    for limit, value in (("shmmax", 4096), ("shmmni", 2), ("shmall", 2000)):
        before = text_of(f"/proc/sys/kernel/{limit}")
        write_text(f"/proc/sys/kernel/{limit}", str(value))
        with Service(3) as service:
            assert len(glob.glob("/dev/shm/rcbd-*/vader_segment*")) == 3, (limit, os.listdir("/dev/shm"))
            with Client(service.endpoint, timeout=60) as client:
                client.ask("scene.create", scene="s", parts=8)
                client.push("s", 0, np.random.default_rng(1).random((20_000, 3)))
        write_text(f"/proc/sys/kernel/{limit}", before)
    with open("/proc/sysvipc/shm") as file:
        assert len(file.readlines()) == 1, "segments are left"
    return 0


CASES = {"name": without_its_name, "memory": without_shared_memory, "limits": with_low_limits, "inodes": without_inodes}


class InAnotherPlace(unittest.TestCase):
    """Each in a mount namespace of its own; an assertion that fails there is the test's failure."""

    def run_case(self, name):
        if os.geteuid() != 0:
            print("SKIPPED: only root can mount", file=sys.stderr)
            self.skipTest("only root can mount")
        done = subprocess.run(["unshare", "--mount", "--ipc", "--propagation", "private", sys.executable, __file__, "--case", name],
                              capture_output=True, text=True, timeout=240)
        if done.returncode == 77:
            print("SKIPPED: nothing can be mounted here", file=sys.stderr)
            self.skipTest("nothing can be mounted here")
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)

    def test_a_name_that_cannot_be_looked_up(self):
        self.run_case("name")

    def test_no_room_in_shared_memory(self):
        self.run_case("memory")

    def test_no_inodes_in_shared_memory(self):
        self.run_case("inodes")

    def test_low_limits_of_shared_memory(self):
        self.run_case("limits")


if __name__ == "__main__":
    if sys.argv[1:2] == ["--case"]:
        sys.exit(CASES[sys.argv[2]]())
    unittest.main(verbosity=2)
