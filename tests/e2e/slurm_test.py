"""The batch scripts of deploy/slurm on a real Slurm, whose nodes are machines made of namespaces: a service as a job, solvers
that find it by its file, and what becomes of both when a job is cancelled or a node dies."""
import re

from machines import *
from pages import blocks_for, commands
from slurm import Cluster, missing

ROOT = os.path.abspath(os.path.join(os.path.dirname(__file__), "..", ".."))


class SlurmTest(MachinesTest):
    def setUp(self):
        super().setUp()
        if missing():
            self.skipTest(f"no {', '.join(missing())}: the packages slurm-wlm and munge")

    def cluster(self, count):
        self.machines(count, Cluster)
        os.remove(os.path.join(self.bin, os.path.basename(MPIRUN)))  # the scripts call Open MPI's
        self.where = os.path.join(self.hosts.shared, "where")
        shutil.copytree(os.path.join(ROOT, "deploy"), os.path.join(self.hosts.shared, "deploy"))  # as for the programs
        self.scripts = os.path.join(self.hosts.shared, "deploy", "slurm")
        self.settings = {"RCBD_BIN_DIR": self.bin, "WHERE": self.where}

    def submit(self, *args, **more):
        """The number of the job."""
        out = self.hosts.slurm("sbatch", "--parsable", *args, **self.settings | more).strip()
        self.assertTrue(out.isdigit(), out + self.hosts.logs())
        return out

    def output(self, job, name):
        try:
            return text_of(self.hosts.shared, f"{name}-{job}.out")
        except OSError:
            return ""

    def ended(self, job, seconds=60):
        self.hosts.wait_for(lambda: self.hosts.state(job) == "", f"the end of job {job}", seconds)

    def nothing_is_left(self, files_of=("rcbd", "vader")):
        """Neither processes of the programs nor files in the folders that are each node's own."""
        for name in self.hosts.names:
            running = [pid for pid in self.hosts.processes(name) if process_name(pid) in ("rcbd", "rcbctl", "mpirun")]
            self.assertEqual(running, [], f"processes on {name}")
            files = self.hosts.run(name, "ls", "/tmp", "/dev/shm", capture_output=True, text=True).stdout.split()
            # Not ompi.*: Slurm may end mpirun's daemon before it has removed its folder.
            self.assertEqual([file for file in files if file.startswith(files_of)], [], f"on {name}")

    def published(self):
        try:
            return json.loads(text_of(self.where))
        except OSError:
            return None

    def up(self, *args):
        """Submits a service, and waits until it says where it is."""
        job = self.submit(*args, os.path.join(self.scripts, "service.sh"))
        # Longer than a start that fails takes to say why, and than srun waits where Slurm first refuses it a step.
        self.hosts.wait_for(lambda: self.published() is not None or self.hosts.state(job) == "", "the service", 150)
        self.assertIsNotNone(self.published(), f"the service's job has ended: {self.service_log()}\n{self.hosts.logs()}")
        return job

    def status(self, name="c"):
        done = self.on(name, os.path.join(self.bin, "rcbctl"), "status", "--json", endpoint="file:" + self.where,
                       RCBD_TOKEN_FILE="")
        return json.loads(done.stdout) if done.returncode == 0 else None

    def service_log(self):
        try:
            return text_of(self.where + ".data.0/rcbd.log")
        except OSError:
            return ""

    def test_a_service_and_solvers_in_jobs_of_their_own(self):
        self.cluster(3)
        # The solver is there first, and waits.
        solver = self.submit("--nodelist=c", os.path.join(self.scripts, "solver.sh"), "two_spheres", "--steps", "30",
                             "--parts", "6", "--json")
        service = self.up("--nodelist=a,b", "--ntasks=5")
        self.assertEqual(self.published()["job"], service)
        self.ended(solver)
        text = self.output(solver, "solver")
        self.assertIn("waiting for the service", text)
        got = json.loads(text[text.index("{"):])
        self.assertEqual([one["host"] for one in self.status()["hosts"]], ["a", "a", "a", "b", "b"])
        self.assertEqual(self.status()["encryption"], ["TLS 1.3"])
        # The same on one machine.
        alone = Service(2)
        self.addCleanup(alone.stop)
        done = subprocess.run([os.path.join(BIN, "two_spheres"), "--steps", "30", "--parts", "6", "--json"],
                              env=os.environ | {"RCBD_ENDPOINT": alone.endpoint}, capture_output=True, text=True, timeout=60)
        expected = json.loads(done.stdout)
        for report, other in zip(got["reports"], expected["reports"], strict=True):
            for field in ("error", "repartitioned", "moved", "n"):  # who pushes over sockets counts no drift
                self.assertEqual(report[field], other[field], field)
        # scancel ends it cleanly.
        self.hosts.slurm("scancel", service)
        self.ended(service)
        self.assertIn("the service has ended", self.service_log())
        self.assertNotIn("given up", self.service_log())
        self.assertIsNone(self.published())
        self.nothing_is_left()

    def solver_outlives(self, lose):
        """A solver on a node of its own goes on when a node of the service is lost, since the job begins anew on others.
        lose(job, node)"""
        self.cluster(4)
        service = self.up("--nodes=2", "--ntasks=4", "--exclude=d")
        hosts = {one["host"] for one in self.status("d")["hosts"]}
        self.assertEqual(len(hosts), 2)
        solver = self.submit("--nodelist=d", os.path.join(self.scripts, "solver.sh"), "two_spheres", "--steps", "1000",
                             "--parts", "5", "--json")
        self.hosts.wait_for(lambda: self.status("d")["steps"] > 50, "the solver's first steps")
        dead = max(hosts - {"a"})  # the controller is on a
        before = self.published()
        lose(service, dead)
        # Slurm puts the job back into the queue, to start two minutes later on nodes that live: here at once.
        self.hosts.wait_for(lambda: self.hosts.state(service) == "PENDING", "the job to be queued again")
        self.hosts.slurm("scontrol", "update", f"jobid={service}", "starttime=now")
        self.hosts.wait_for(lambda: self.published() not in (None, before) and self.status("d") is not None,
                            "the service to come back", 90)
        self.assertNotIn(dead, {one["host"] for one in self.status("d")["hosts"]})
        self.ended(solver, 120)
        text = self.output(solver, "solver")
        result = json.loads(text[text.index("{"):])
        self.assertEqual(len(result["reports"]), 1001, text[:2000])
        self.assertEqual(self.status("d")["restored"]["scenes"], 1)
        self.hosts.slurm("scancel", service)
        self.ended(service)

    def test_a_node_that_dies_and_a_solver_that_waits(self):
        self.solver_outlives(lambda job, node: self.hosts.kill(node))

    def test_a_node_that_is_drained(self):
        def drain(job, node):
            self.hosts.slurm("scontrol", "update", f"nodename={node}", "state=drain", "reason=repair")
            self.hosts.slurm("scontrol", "requeue", job)

        self.solver_outlives(drain)
        self.nothing_is_left()

    def both(self, steps):
        return self.submit("--nodes=2", "--ntasks=4", os.path.join(self.scripts, "both.sh"), "slope_mpi", "--points", "1000",
                           "--steps", steps, "--interval", "0.3", "--parts", "6", "--check",
                           RANKS_PER_NODE="2", OMPI_ALLOW_RUN_AS_ROOT="1", OMPI_ALLOW_RUN_AS_ROOT_CONFIRM="1")

    def folders_of_both(self):
        return [name for name in os.listdir(self.hosts.shared) if name.startswith("rcbd-")]

    def test_both_in_one_job(self):
        self.cluster(2)
        job = self.both("6")
        self.ended(job, 120)
        text = self.output(job, "solver")
        self.assertIn("4 ranks on", text)
        self.assertIn("1000 points on 4 processes, 6 steps", text)
        self.assertEqual(self.folders_of_both(), [], text)
        self.nothing_is_left()
        job = self.both("100000")

        def stepping():
            folders = self.folders_of_both()
            self.where = os.path.join(self.hosts.shared, *folders, "where")
            return folders and (self.status("a") or {"steps": 0})["steps"] > 2

        self.hosts.wait_for(stepping, "the solver's first steps")
        self.hosts.slurm("scancel", job)
        self.ended(job)
        self.assertEqual(self.folders_of_both(), [], self.output(job, "solver"))
        self.nothing_is_left(files_of=("rcbd",))  # Open MPI's would be those of the solver, whose ranks were killed

    def test_the_page_on_clusters_is_true_to_the_letter(self):
        self.cluster(3)
        block, = blocks_for(__file__)

        def on(name, command):
            settings = self.hosts.environment(HOME=self.hosts.shared, XDG_STATE_HOME="")
            path = f"{self.bin}:{settings['PATH']}"
            done = self.hosts.run(name, "env", "-C", self.hosts.shared, "sh", "-c", command, env=settings | {"PATH": path},
                                  capture_output=True, text=True, timeout=120)
            self.assertEqual(done.returncode, 0, f"{command}: {done.stdout}{done.stderr}")
            return done.stdout

        jobs = re.findall(r"job (\d+)", "".join(on(*line) for line in commands(block.text)))
        self.assertEqual(len(jobs), 2)
        self.ended(jobs[1], 120)
        self.assertIn("50 steps", self.output(jobs[1], "solver"))
        self.hosts.slurm("scancel", jobs[0])
        self.ended(jobs[0])

    def test_what_runs_on_one_machine_stays_there(self):
        self.cluster(2)
        points = os.path.join(self.hosts.shared, "points.npy")
        np.save(points, np.random.default_rng(1).random((1000, 3)))
        script = os.path.join(self.hosts.shared, "one.sh")
        write_text(script, f"#!/bin/sh\n{self.bin}/rcbctl partition {points} --parts 8 --ranks 6 --json\n")
        job = self.submit("--nodes=2", "--ntasks=4", "--output=one-%j.out", script)
        self.ended(job)
        text = self.output(job, "one")
        self.assertEqual(json.loads(text[text.index("{"):])["ranks"], 6, text)
        # A job on one machine has a rank for each task that it asked for.
        with open(script, "w") as file:
            file.write(f"#!/bin/sh\ncd /tmp\nexport RCBD_ENDPOINT=unix:/tmp/s\n{self.bin}/rcbctl up --json && "
                       f"{self.bin}/rcbctl down >&2\n")
        job = self.submit("--nodes=1", "--ntasks=3", "--output=one-%j.out", "--error=one.err", script)
        self.ended(job)
        text = self.output(job, "one")
        self.assertEqual(json.loads(text)["ranks"], 3, text)
        self.nothing_is_left()


if __name__ == "__main__":
    unittest.main()
