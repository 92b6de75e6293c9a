"""rcbd.f90 and rcbd_mpi.f90 as Fortran programs see them: one history whatever the compiler's options, every misuse a message,
arrays that stay, and the halo of brute force with Open MPI and MPICH."""
from languages import *

COMPILER = shutil.which("gfortran")
STRICT = ("-std=f2008", "-Wall", "-Wextra", "-pedantic", "-fcheck=all", "-Werror")
CHECKED = ("-g", "-fcheck=all,no-array-temps", "-O1")
LONG = ("-fdefault-integer-8", "-fdefault-real-8", "-fdefault-double-8")
LINK = ("-L", LIB, "-lrcbd", "-Wl,-rpath," + LIB)
MODULES = {"rcbd": os.path.join(INCLUDE, "rcbd", "rcbd.f90"), "rcbd_mpi": os.path.join(INCLUDE, "rcbd", "rcbd_mpi.f90")}


def source(name):
    return os.path.join(ROOT, "tests", "client", "fortran", name + ".f90")


class FortranTest(LanguageTest):
    @classmethod
    def setUpClass(cls):
        if COMPILER is None:
            print(f"SKIPPED: {cls.__name__} needs gfortran", file=sys.stderr)
            raise unittest.SkipTest("gfortran isn't installed")
        super().setUpClass()

    def compiled(self, words, compiler=COMPILER):
        """In a folder of its own, since modules are written there. Returns what the compiler said."""
        return subprocess.run([compiler, *words], cwd=tempfile.mkdtemp(dir=self.dir), capture_output=True, text=True, timeout=200).stderr

    def program(self, name, *options, sources=("rcbd",), compiler=COMPILER):
        made = os.path.join(self.dir, "_".join([name, *(option.lstrip("-").replace("=", "_") for option in options)])[:100])
        words = (*options, *(MODULES[one] for one in sources), source("expect"), source(name), "-o", made, *LINK)
        self.assertEqual(self.compiled(words, compiler), "")
        return made


class Fortran(FortranTest):
    def test_the_standard(self):
        self.assertEqual(self.compiled([*STRICT, "-c", MODULES["rcbd"]]), "")
        self.assertEqual(self.compiled([*STRICT, "-O3", "-Wno-maybe-uninitialized", "-c", MODULES["rcbd"]]), "")  # GCC 12 errs there

    def test_one_history(self):
        self.one_history([os.path.join(BIN, "fortran_history")])

    def test_one_history_under_traps(self):
        self.one_history([self.program("history", *CHECKED, "-ffpe-trap=invalid,zero,overflow")])

    def test_one_history_fast_and_long(self):
        """Which flushes denormals, whose temporaries are on the stack, and whose default kinds are of 64 bits."""
        self.one_history([self.program("history", "-Ofast", *LONG)])

    def test_other_kinds_than_the_modules(self):
        """A program compiled with other kinds than the module is refused by the compiler, not at run time."""
        folder = tempfile.mkdtemp(dir=self.dir)
        run("-c", MODULES["rcbd"], "-J", folder, "-o", os.path.join(folder, "rcbd.o"), program=COMPILER, check=True)
        code = "use rcbd\ntype(rcbd_client) :: c\ninteger :: stat\ndouble precision :: x(3, 5)\ncall c%connect(stat=stat)\ncall rcbd_wrap(x, x(:, 1), x(:, 2))\nend\n"
        path = os.path.join(folder, "other.f90")
        write_text(path, code)
        self.assertEqual(self.compiled(["-I", folder, "-c", path]), "")
        self.assertIn("passed INTEGER(8) to INTEGER(4)", self.compiled(["-fdefault-integer-8", "-I", folder, "-c", path]))
        self.assertIn("no specific subroutine", self.compiled(["-fdefault-real-8", "-I", folder, "-c", path]))

    def test_misuse(self):
        self.cases_of("fortran_misuse", 7)

    def test_misuse_under_traps(self):
        self.cases_of(self.program("misuse", *CHECKED, "-ffpe-trap=invalid,zero,overflow"), 7)

    def test_lifetime(self):
        self.cases_of("fortran_lifetime", 9, MALLOC_PERTURB_="165")  # memory that was freed is filled with this byte

    def test_lifetime_of_fast_programs(self):
        self.cases_of(self.program("lifetime", "-Ofast"), 9, MALLOC_PERTURB_="165")

    def test_no_memory_is_read_that_was_freed(self):
        if not shutil.which("valgrind"):
            self.skipTest("valgrind isn't installed")
        for case in ("scopes", "copies", "components", "restored", "grown", "arrays", "results", "begun"):
            with self.subTest(case):
                done = run("-q", "--error-exitcode=9", os.path.join(BIN, "fortran_lifetime"), self.service.endpoint, case,
                           program=shutil.which("valgrind"))
                self.assertEqual((done.returncode, done.stdout, done.stderr), (0, "", ""))

    def test_near(self):
        self.cases_of("fortran_near", 4)

    def test_without_stat_the_program_ends(self):
        for case, words in (("ends", "invalid_argument: the handle (scene) is NULL"), ("assigned", "assigned to one of another type")):
            done = run(self.service.endpoint, case, program=os.path.join(BIN, "fortran_misuse"))
            self.assertEqual(done.returncode, 1)
            self.assertIn(words, done.stderr)
            self.assertEqual(len(done.stderr.splitlines()), 1, done.stderr)

    def test_the_serial_example(self):
        self.serial_example(os.path.join(BIN, "serial_fortran"))

    def test_places_of_components(self):
        kept = [line for line in text_of(ROOT, "tests/client/c/abi.txt").splitlines() if " " in line]
        self.assertEqual(run(program=os.path.join(BIN, "fortran_abi"), check=True).stdout.splitlines(), kept)


class Mpi:
    name, start = None, None

    @classmethod
    def setUpClass(cls):
        if not shutil.which("mpifort." + cls.name):
            print(f"SKIPPED: {cls.__name__} needs mpifort.{cls.name}", file=sys.stderr)
            raise unittest.SkipTest(f"no mpifort.{cls.name}")
        super().setUpClass()

    def test_cases(self):
        compiler = shutil.which("mpifort." + self.name)
        for options, several in ((CHECKED, (1, 4)), (("-Ofast", *LONG), (3,))):
            program = self.program("mpi", *options, sources=("rcbd", "rcbd_mpi"), compiler=compiler)
            for case in run(program=program, check=True).stdout.split():
                for processes in several:
                    with self.subTest(options=options, case=case, processes=processes):
                        done = run(*self.start[1:], processes, program, self.service.endpoint, case, program=self.start[0])
                        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)

    def test_the_standard(self):
        words = [*STRICT, "-c", MODULES["rcbd"], MODULES["rcbd_mpi"]]
        self.assertEqual(self.compiled(words, shutil.which("mpifort." + self.name)), "")


class OpenMpi(Mpi, FortranTest):
    name, start = "openmpi", [MPIRUN]


class Mpich(Mpi, FortranTest):
    name, start = "mpich", ["/usr/bin/mpiexec.mpich", "-n"]


if __name__ == "__main__":
    unittest.main(verbosity=2)
