"""For tests whose programs run on several machines, made of namespaces (tests/hosts)."""
from support import *

sys.path.insert(0, os.path.join(os.path.dirname(__file__), "..", "hosts"))
from hosts import Hosts

TCP = "10.77.0.1:7470"


class MachinesTest(unittest.TestCase):
    """Needs root. The endpoint is on machine a."""

    def setUp(self):
        if os.geteuid() != 0 or shutil.which("ip") is None:
            self.skipTest("machines made of namespaces need root and the program ip")

    def machines(self, count, make=Hosts):
        self.hosts = make(count)
        self.addCleanup(self.hosts.close)
        self.data = os.path.join(self.hosts.shared, "data")
        self.bin = os.path.join(self.hosts.shared, "bin")  # a checkout in /tmp isn't seen there
        os.mkdir(self.bin)
        for program in ("rcbd", "rcbctl", "two_spheres", "slope", "slope_mpi"):
            shutil.copy(os.path.join(BIN, program), self.bin)
        shutil.copy(MPIRUN, self.bin)

    def on(self, name, *args, endpoint=TCP, timeout=120, check=False, **more):
        """The program's end, run on a machine."""
        settings = {"RCBD_ENDPOINT": endpoint, "RCBD_BIN_DIR": self.bin, "RCBD_TOKEN_FILE": os.path.join(self.data, "token")}
        environment = self.hosts.environment(**settings | more)
        done = self.hosts.run(name, *args, env=environment, capture_output=True, text=True, timeout=timeout,
                              cwd=self.hosts.shared)
        if check:
            self.assertEqual(done.returncode, 0, f"on {name}: {args}: {done.stdout}{done.stderr}\n{self.log()}")
        return done

    def ctl(self, *args, name="a", **kwargs):
        done = self.on(name, os.path.join(self.bin, "rcbctl"), *args, **kwargs)
        self.assertEqual(done.returncode, 0, f"rcbctl {args}: {done.stdout}{done.stderr}\n{self.log()}")
        return json.loads(done.stdout) if "--json" in args else done.stdout

    def up(self, *args, **kwargs):
        self.ctl("up", "--data-dir", self.data, *args, **kwargs)

    def log(self):
        try:
            return text_of(self.data, "rcbd.log")
        except OSError:
            return ""

    def down(self, **kwargs):
        self.ctl("down", **kwargs)
        self.assertTrue(wait_for(lambda: not any(self.hosts.processes(name) for name in self.hosts.names)),
                        "processes are left")
