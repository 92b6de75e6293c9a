"""rcbd/mpi.h and mpi.hpp with Open MPI and with MPICH: rows against brute force, failures that all processes hear of."""
from support import *

ROOT = os.path.abspath(os.path.join(os.path.dirname(__file__), "..", ".."))
LIB = os.path.abspath(os.path.join(BIN, "..", "lib"))
WARNINGS = ["-Wall", "-Wextra", "-pedantic", "-Wconversion", "-Wshadow", "-Werror"]
SEED = 1


class Mpi:
    """On one MPI, whose programs are named so: mpicc.NAME, mpicxx.NAME."""
    name, start = None, None

    @classmethod
    def setUpClass(cls):
        if not shutil.which("mpicc." + cls.name):
            print(f"SKIPPED: {cls.__name__} needs mpicc.{cls.name}", file=sys.stderr)
            raise unittest.SkipTest(f"no mpicc.{cls.name}")
        super().setUpClass()

    def compiled(self, source, *options, warnings=()):
        """Headers of MPI are not ours: those of Open MPI's C++ warn."""
        program = os.path.join(self.dir, os.path.basename(source) + str(len(options)))
        compiler, standard = ("mpicxx.", "-std=c++14") if source.endswith(".cpp") else ("mpicc.", "-std=c99")
        run(standard, *WARNINGS, "-DOMPI_SKIP_MPICXX", "-O1", "-ffp-contract=off", *options, "-I", os.path.join(ROOT, "client/include"),
            os.path.join(ROOT, source), "-o", program, "-L", LIB, "-lrcbd", "-lm", "-Wl,-rpath," + LIB,
            program=shutil.which(compiler + self.name), check=True)
        return program

    def run_on(self, processes, program, *args):
        done = run(*self.start[1:], processes, program, *args, program=self.start[0], endpoint=self.service.endpoint)
        self.assertEqual(done.returncode, 0, f"{processes} processes: {done.stdout}{done.stderr}")
        return done.stdout

    def test_rows(self):
        """Handing over, halos and sums of 12 random scenes: 1 to 3 dimensions, periodic and not, several parts a process, some
        without particles."""
        program = self.compiled("tests/client/mpi/rows.c")
        for processes in (1, 2, 3, 4):
            self.run_on(processes, program, self.service.endpoint, SEED + 100 * processes)

    def test_failures(self):
        program = self.compiled("tests/client/mpi/failures.c")
        for processes in (1, 2, 4):
            self.run_on(processes, program, self.service.endpoint)

    def test_more_rows_than_mpi_can_count_and_more_processes_than_seats(self):
        for limit in ("COUNT_MAX=3", "SEATS_MAX=1"):
            program = self.compiled("tests/client/mpi/failures.c", "-DRCBD_MPI_" + limit, "-Wno-unused-function")
            self.run_on(2, program, self.service.endpoint)

    def test_vectors(self):
        program = self.compiled("tests/client/mpi/vectors.cpp")
        for processes in (2, 3):
            self.run_on(processes, program, self.service.endpoint)

    def test_the_example(self):
        printed = {self.run_on(processes, self.compiled(f"client/examples/{source}"), "--particles", 100, "--pushes", 10, "--parts", 4)
                   for source in ("c/dem.c", "cpp/dem.cpp") for processes in (1, 3)}
        self.assertEqual(len(printed), 1, printed)


class OpenMpi(Mpi, ServiceTest):
    name, start = "openmpi", [MPIRUN]


class Mpich(Mpi, ServiceTest):
    name, start = "mpich", ["/usr/bin/mpiexec.mpich", "-n"]


if __name__ == "__main__":
    unittest.main(verbosity=2)
