"""Every fenced block of every page: compiled, run with a service of its own as a user with the installed files would, or it
says why not. pages.py has the marks."""
from pages import *

NOT_RUN_MOST = 5
PROGRAMS = {"c": (".c", r"\bint main\("), "cpp": (".cpp", r"\bint main\("), "fortran": (".f90", r"(?m)^\s*program \w")}
SHELLS = ("console", "bash", "sh")
KNOWN = (*PROGRAMS, *SHELLS, "python", "cmake", "json", "text")
EXAMPLES = os.path.join(ROOT, "client", "examples")
# What may be missing where tests run, by the words that need it, and what tells that it is there.
OPTIONAL = {r"\blmp\b": ("lmp", "-h"), r"\bwatch\.py\b": ("python3", "-c", "import lammps, mpi4py"), r"\bmpi4py\b|\brcbd\.mpi\b":
            ("python3", "-c", "import mpi4py"), r"(?i)\bfortran\b|\.f90\b": ("gfortran", "--version")}


class Snippets(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.prefix = tempfile.mkdtemp(prefix="rcb-e2e-prefix-")
        cls.addClassCleanup(shutil.rmtree, cls.prefix)
        run("--install", os.path.dirname(os.path.abspath(BIN)), "--prefix", cls.prefix, program="cmake", check=True)
        library, = {os.path.dirname(os.path.join(folder, name)) for folder, _, names in os.walk(cls.prefix) for name in names
                    if name == "librcbd.so.1"}
        cls.settings = {"PATH": f"{cls.prefix}/bin:{cls.prefix}/lib/rcbd:{os.path.abspath(BIN)}:/usr/bin:/bin", "RCBD_BIN_DIR": "",
                        "CPATH": f"{cls.prefix}/include", "LIBRARY_PATH": library, "LD_LIBRARY_PATH": library,
                        "PKG_CONFIG_PATH": f"{library}/pkgconfig", "CMAKE_PREFIX_PATH": cls.prefix,
                        "PYTHONPATH": f"{cls.prefix}/lib/python3/dist-packages", "OMPI_ALLOW_RUN_AS_ROOT": "1",
                        "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"}

    def each(self, languages, work):
        """Calls it with each block of these languages that is for us, for a user with a folder and nothing else in it."""
        for one in (one for page in pages() for one in blocks(page)):
            if one.language not in languages or one.mark in ("not run", "run by", "part of"):
                continue
            with self.subTest(f"{one.page}:{one.line}"):
                if one.mark == "within":
                    one = one._replace(text=text_of(ROOT, one.value).replace("SNIPPET\n", one.text))
                with tempfile.TemporaryDirectory(prefix="rcb-e2e-") as self.dir:
                    self.env = dict(self.settings, HOME=self.dir, XDG_RUNTIME_DIR=self.dir, XDG_STATE_HOME=self.dir)
                    self.files()
                    for needs, (program, *words) in OPTIONAL.items():
                        if re.search(needs, " ".join((one.language, one.text))) and not self.there(program, *words):
                            self.skipTest(f"{program} {' '.join(words)} does not work here")
                    try:
                        if "rcbctl up" not in one.text:
                            self.said("rcbctl", "up", "-n", 2)
                        work(one)
                    finally:
                        run("down", program=f"{self.prefix}/bin/rcbctl", env=self.env)
                    self.assertTrue(wait_for(lambda: not processes_of(self.dir)), "processes are left")

    def files(self):
        """What blocks may name: points, and a solver in each language."""
        points = np.random.default_rng(1).random((1000, 3))
        for name in ("points", "positions"):
            np.savetxt(os.path.join(self.dir, name + ".csv"), points, delimiter=",", header="x,y,z", comments="")
            np.save(os.path.join(self.dir, name + ".npy"), points)
        dump = "dump rcb all custom 100 jet.lammpstrj id x y z"
        write_text(os.path.join(self.dir, "in.jet"), lammps_melt(dump, cells=5, steps=500))
        shutil.copytree(os.path.join(EXAMPLES, "lammps"), os.path.join(self.dir, "client", "examples", "lammps"))
        for folder, _, names in os.walk(EXAMPLES):
            for name in names:
                if name.startswith("serial."):
                    shutil.copy(os.path.join(folder, name), os.path.join(self.dir, name.replace("serial", "solver")))

    def said(self, program, *words):
        return run(*words, program=program, cwd=self.dir, env=self.env, timeout=200, check=True).stdout

    def there(self, program, *words):
        return bool(shutil.which(program)) and run(*words, program="/usr/bin/" + program).returncode == 0

    def started(self, mpi, *words):
        return self.said(*(("mpirun", "--oversubscribe", "-n", 4) if mpi else ()), *words)

    def test_each_block_says_what_it_is(self):
        wrong, not_run = [], []
        for one in (one for page in pages() for one in blocks(page)):
            where = f"{one.page}:{one.line}: "
            if one.mark and one.mark not in MARKS:
                wrong.append(where + f"the mark '{one.mark}' is none of {', '.join(MARKS)}")
            if one.mark == "not run":
                not_run.append(where + one.value)
            elif one.language not in KNOWN:
                wrong.append(where + f"'{one.language}' is no language that can be tested: say one of {', '.join(KNOWN)} after ```, or "
                             "<!-- not run: why --> on the line before it")
            elif one.language == "text" and commands(one.text):
                wrong.append(where + "text with a prompt: say console")
            elif one.language == "console" and (not commands(one.text) or not one.mark and any(commands(one.text)[0][:1])):
                wrong.append(where + "console without a line '$ command', or of several machines and not said who runs it")
            elif one.mark in ("run by", "part of", "within") and not os.path.isfile(os.path.join(ROOT, one.value)):
                wrong.append(where + f"there is no {one.value}")
            elif one.mark == "run by" and "blocks_for(__file__)" not in text_of(ROOT, one.value):
                wrong.append(where + f"{one.value} doesn't ask for its blocks by blocks_for(__file__)")
            elif one.mark == "part of" and one.text not in text_of(ROOT, one.value):
                wrong.append(where + f"it isn't in {one.value}, word for word")
            elif one.mark == "within" and "SNIPPET\n" not in text_of(ROOT, one.value):
                wrong.append(where + f"no line SNIPPET in {one.value}")
        self.assertEqual(wrong, [])
        self.assertLessEqual(len(not_run), NOT_RUN_MOST, "\n".join(not_run))

    def terminal(self, one):
        lines = [command for _, command in commands(one.text)] if one.language == "console" else [one.text]
        self.said("bash", "-c", "\n".join(["set -eo pipefail", *lines, "wait"]))

    def program(self, one):
        """Without a main program it is only compiled."""
        ending, main = PROGRAMS[one.language]
        mpi = bool(re.search(r"\bmpi\.hp{0,2}\b|\buse mpi", one.text))
        modules = [f"{self.prefix}/include/rcbd/{name}.f90" for name in ("rcbd", *(["rcbd_mpi"] if mpi else []))]
        compiler = {"c": ["mpicc" if mpi else "cc", "-std=c99"],
                    "cpp": ["mpicxx" if mpi else "c++", "-std=" + (*one.words, "c++14")[0]],
                    "fortran": ["mpifort" if mpi else "gfortran", *modules]}[one.language]
        write_text(os.path.join(self.dir, "block" + ending), one.text)
        whole = re.search(main, one.text)
        self.said(*compiler, "-Wall", "block" + ending, *(["-o", "block", "-lrcbd", "-lm"] if whole else ["-c"]))
        if whole:
            self.started(mpi, "./block")

    def python(self, one):
        write_text(os.path.join(self.dir, "block.py"), one.text)
        self.started("mpi" in one.text, "/usr/bin/python3", "block.py")

    def project(self, one):
        begin = "" if "project(" in one.text else "project(solver LANGUAGES C CXX)\n"
        write_text(os.path.join(self.dir, "CMakeLists.txt"), "cmake_minimum_required(VERSION 3.13)\n" + begin + one.text)
        self.said("cmake", "-S", ".", "-B", "build")
        self.said("cmake", "--build", "build")

    def test_terminals(self):
        self.each(SHELLS, self.terminal)

    def test_programs(self):
        self.each(PROGRAMS, self.program)

    def test_python(self):
        self.each(["python"], self.python)

    def test_projects(self):
        """Each builds its solver."""
        self.each(["cmake"], self.project)

    def test_data(self):
        self.each(["json"], lambda one: json.loads(one.text))


if __name__ == "__main__":
    unittest.main(verbosity=2)
