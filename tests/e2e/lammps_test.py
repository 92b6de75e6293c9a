"""LAMMPS watched by rcbd (client/examples/lammps): the history is that of LAMMPS's own dump, whatever goes wrong ends the run
on all processes, and the table of compare.py. Skipped, aloud, where there is no LAMMPS for Python."""
import re

from pages import *

EXAMPLES = os.path.join(ROOT, "client", "examples", "lammps")
BLOCK = os.path.join(EXAMPLES, "in.block")
PYTHON = "/usr/bin/python3"
STEPS, EVERY, PROCESSES = 400, 50, 4

# A run that process 0 stops the service of, after its third step.
STOPPED = f"""
import functools, subprocess, sys
from watch import *
rcbd.mpi.connect = functools.partial(rcbd.mpi.connect, outlive=False)  # which does not wait for another one
def told(time_step, ids, step, imbalance):
    print(f"told {{time_step}}\\n", end="", flush=True)
    if MPI.COMM_WORLD.rank == 0 and time_step == 100:
        subprocess.run([sys.argv[1], "down"], check=True, stdout=subprocess.DEVNULL)
run = lammps(cmdargs=["-screen", "none", "-log", "none"])
run.file({BLOCK!r})
watch = Watch(run, MPI.COMM_WORLD, "stopped", 50, told, parts=4)
for _ in range(2):
    run.command("run 200")
    print(f"ended {{run.extract_global('ntimestep')}} {{watch.failed}}\\n", end="", flush=True)
"""


def missing():
    return run("-c", "import lammps, mpi4py; lammps.lammps(cmdargs=['-screen', 'none', '-log', 'none'])", program=PYTHON).stderr


class Lammps(ServiceTest):
    @classmethod
    def setUpClass(cls):
        if why := missing():
            print(f"SKIPPED: lammps_test needs liblammps-dev, python3-lammps and python3-mpi4py: {why}", file=sys.stderr)
            raise unittest.SkipTest("no LAMMPS for Python")
        super().setUpClass()

    def lammps(self, processes, *words, service=None, check=False):
        env = {"PYTHONPATH": os.pathsep.join([os.path.join(ROOT, "client", "python"), EXAMPLES]),
               "RCBD_LIBRARY": os.path.abspath(os.path.join(BIN, "..", "lib", "librcbd.so.1"))}
        return run(processes, PYTHON, *words, program=MPIRUN, endpoint=(service or self.service).endpoint, env=env,
                   cwd=self.dir, timeout=200, check=check)

    def input(self, name, *more, of=BLOCK):
        path = os.path.join(self.dir, name)
        write_text(path, "\n".join([text_of(of) if of else "", *more, ""]))
        return path

    def dumped(self, path):
        """The positions that LAMMPS has dumped, by id and wrapped into the box; and how many were outside."""
        frames, outside = [], 0
        for frame in text_of(path).split("ITEM: TIMESTEP\n")[1:]:
            head, rows = frame.split("ITEM: ATOMS id x y z\n")
            lo, hi = np.array([line.split() for line in head.splitlines()[4:7]], float).T
            rows = np.array([line.split() for line in rows.splitlines()], float)
            xyz = rows[np.argsort(rows[:, 0]), 1:]
            out = (xyz < lo) | (xyz >= hi)
            outside += np.count_nonzero(out)
            xyz = np.where(out, np.where(xyz < lo, xyz + (hi - lo), xyz - (hi - lo)), xyz)
            frames.append(np.where((xyz < lo) | (xyz >= hi), lo, xyz))
        return np.array(frames), outside

    def test_one_history(self):
        dump = os.path.join(self.dir, "all.lammpstrj")
        watched = self.input("in.watched", f"dump all all custom {EVERY} {dump} id x y z", "dump_modify all format float %.17g")
        done = self.lammps(PROCESSES, os.path.join(EXAMPLES, "watch.py"), watched, STEPS, EVERY, check=True)
        positions, outside = self.dumped(dump)
        self.assertGreater(outside, 0, "else wrapping is not seen")
        self.service.json("replay", "replayed", self.save("all.npy", positions), "--parts", PROCESSES)
        fields = ("step", "n", "error_before", "error", "imbalance", "repartitioned", "epoch", "moved", "axes_flipped")
        one, other = ([[report[field] for field in fields] for report in self.service.json("history", name)]
                      for name in ("lammps", "replayed"))
        self.assertEqual(len(one), STEPS // EVERY + 1)
        self.assertEqual(one, other)
        told = re.findall(r"time step (\d+): imbalance ([\d.]+), of the parts of rcbd ([\d.]+)", done.stdout)
        self.assertEqual([int(step) for step, _, _ in told], list(range(0, STEPS + 1, EVERY)))
        self.assertEqual([parts for _, _, parts in told], [f"{row[4]:.3f}" for row in one])
        self.assertGreater(max(float(lammps) for _, lammps, _ in told), 1.5)

    def test_a_plane(self):
        plane = self.input("in.plane", "dimension 2", "boundary p f p", "region box block 0 20 0 20 -0.5 0.5", "create_box 1 box",
                           "create_atoms 1 random 300 7 NULL", "mass 1 1.0", "pair_style zero 2.5", "pair_coeff * *",
                           "velocity all create 1.0 7", "fix 1 all nve", "fix 2 all wall/reflect ylo EDGE yhi EDGE",
                           "fix 3 all enforce2d", of=None)
        self.lammps(3, os.path.join(EXAMPLES, "watch.py"), plane, 100, 20, check=True)
        self.assertEqual(self.service.json("scene", "show", "lammps")["dims"], 2)
        self.assertEqual(len(self.service.json("history", "lammps")), 6)

    def test_a_service_that_is_stopped_ends_the_run_on_all_processes(self):
        program = os.path.join(self.dir, "stopped.py")
        write_text(program, STOPPED)
        with Service(1) as service:
            done = self.lammps(PROCESSES, program, RCBCTL, service=service)
        self.assertEqual(done.returncode, 0, done.stderr)
        lines = sorted(done.stdout.splitlines())
        self.assertEqual(lines, sorted([f"told {step}" for step in (0, 50, 100)] * PROCESSES + ["ended 150 True"] * 2 * PROCESSES))
        self.assertRegex(done.stderr, r"rcbd, on process \d: .*stopped")

    def test_what_is_refused(self):
        tilted = self.input("in.tilted", "region box prism 0 6 0 6 0 6 1 0 0", "create_box 1 box", "create_atoms 1 single 1 1 1",
                            "mass 1 1.0", of=None)
        done = self.lammps(2, os.path.join(EXAMPLES, "watch.py"), tilted, 10, 10)
        self.assertEqual(done.returncode, 1)
        self.assertIn("the box is triclinic; parts are boxes along x, y and z: use an orthogonal box", done.stderr)
        # Atoms that leave the box are gone, which no step has said.
        leaving = self.input("in.leaving", "change_box all boundary f p p", "velocity all set 40.0 NULL NULL",
                             "thermo_modify lost ignore")
        done = self.lammps(2, os.path.join(EXAMPLES, "watch.py"), leaving, 2000, 100)
        self.assertEqual(done.returncode, 1, done.stderr)
        self.assertRegex(done.stderr, r"rcbd, on process \d: .*(missing|fewer|particles)")

    def test_the_page(self):
        """Its session, shorter."""
        session = blocks("docs/lammps.md")[0].text
        told = re.findall("^time step 0:.*$", session, re.M)
        lines = [line.partition("#")[0].split() for _, line in commands(session)]
        self.assertEqual([words[0] for words in lines], ["cd", "rcbctl", "mpirun", "rcbctl"])
        _, _, _, processes, _, *words = lines[2]
        self.assertEqual(words, ["watch.py", "in.block", "1000", "100"])
        done = self.lammps(processes, *(os.path.join(EXAMPLES, word) for word in words[:2]), 50, 50, check=True)
        self.assertEqual(done.stdout.splitlines()[:1], told)  # none of LAMMPS's own before it
        self.service.ctl(*lines[3][1:-1], os.path.join(self.dir, lines[3][-1]), check=True)
        needed = run("--tests", "--list", program=os.path.join(ROOT, "deploy", "dependencies"), check=True).stdout.split()
        packages = re.search(r"the packages (\S+), (\S+) and (\S+) of Debian", text_of(ROOT, "docs", "lammps.md")).groups()
        self.assertLessEqual(set(packages), set(needed))

    def test_the_table(self):
        done = self.lammps(2, "-m", "mpi4py", os.path.join(EXAMPLES, "compare.py"), BLOCK, 200, 50, 1, check=True)
        rows = {name: [float(number) for number in numbers.split()] for name, numbers in
                re.findall(r"^(LAMMPS as it is|LAMMPS with fix balance rcb|rcbd, which watches LAMMPS) +([\d. ]+)", done.stdout, re.M)}
        plain, balanced, watched = rows["LAMMPS as it is"], rows["LAMMPS with fix balance rcb"], rows["rcbd, which watches LAMMPS"]
        self.assertGreater(plain[0], 1.2, done.stdout)
        self.assertLess(balanced[0], 1.15, done.stdout)
        self.assertLess(watched[1], 1.1, done.stdout)
        self.assertTrue(balanced[3] > 0 and watched[3] > 0, done.stdout)


if __name__ == "__main__":
    unittest.main(verbosity=2)
