"""The Python package: one history whoever tells it, every misuse a message, and what is installed works."""
import ctypes
import importlib.util
import inspect
import pydoc
import re
import zipfile

from languages import *

PACKAGE = os.path.join(ROOT, "client", "python")
EXAMPLES = os.path.join(ROOT, "client", "examples", "python")
TESTS = os.path.join(ROOT, "tests", "client", "python")
PYTHON = "/usr/bin/python3"
SURROUNDINGS = {"PYTHONPATH": PACKAGE, "RCBD_LIBRARY": os.path.join(LIB, "librcbd.so.1"), "PYTHONDONTWRITEBYTECODE": "1"}
os.environ.update(SURROUNDINGS)
sys.path.insert(0, PACKAGE)
sys.dont_write_bytecode = True

import rcbd
import rcbd._library as library


class PythonPackage(LanguageTest):
    def python(self, *words, **kwargs):
        return run(*words, program=PYTHON, endpoint=self.service.endpoint, **kwargs)

    def cases(self, name):
        """A file of test cases, in a process of its own: they fork, and end on signals."""
        done = self.python("-X", "dev", "-W", "error", os.path.join(TESTS, name + ".py"), timeout=200)
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        self.assertRegex(done.stderr, r"\nOK\n$")

    def test_one_history(self):
        self.one_history([PYTHON, os.path.join(TESTS, "history.py")])

    def test_misuse(self):
        self.cases("misuse")

    def test_near(self):
        self.cases("near")

    def test_surroundings(self):
        self.cases("surroundings")

    def test_among_processes(self):
        for processes in (1, 2, 4, 7):
            done = run(processes, PYTHON, os.path.join(TESTS, "among_processes.py"), program=MPIRUN, endpoint=self.service.endpoint)
            self.assertEqual((done.returncode, done.stdout), (0, "all is well\n"), done.stderr)

    def test_a_lost_service_is_told(self):
        """A service that was stopped is waited for; the log says so."""
        with Service(1) as service:
            program = subprocess.Popen([PYTHON, os.path.join(TESTS, "waiting.py")], stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                                       stdin=subprocess.PIPE, text=True, env=dict(os.environ, RCBD_ENDPOINT=service.endpoint))
            try:
                self.assertEqual(program.stdout.readline(), "stepped\n")
                service.ctl("down", check=True)
                text, log = program.communicate("\n", timeout=60)
            finally:
                program.kill()
                program.wait()
        self.assertEqual(program.returncode, 0, log)
        self.assertRegex(log, "^rcbd: .*stopped")
        self.assertRegex(text, "ended: unavailable ")

    def test_the_serial_example(self):
        done = self.python(os.path.join(EXAMPLES, "serial.py"), check=True)
        self.assertIn("has reached the tolerance", done.stdout)
        of_c = run(program=os.path.join(BIN, "serial_c"), endpoint=self.service.endpoint, check=True)
        self.assertEqual(done.stdout, of_c.stdout)
        failed = run(os.path.join(EXAMPLES, "serial.py"), program=PYTHON, endpoint="unix:/nonexistent/rcbd.sock")
        self.assertEqual(failed.returncode, 1)
        self.assertIn("no service answers", failed.stderr)


class Interface(unittest.TestCase):
    def test_structs_and_names(self):
        """As tests/client/c/abi.txt keeps them; and the header's functions have as many arguments as are told to ctypes."""
        table = text_of(ROOT, "tests/client/c/abi.txt").splitlines()
        names = [line for line in table if " " not in line]
        self.assertLessEqual(set(library._SIGNATURES), set(names))
        places = []
        for kind in library.Struct.__subclasses__():
            name = "rcbd" + re.sub("([A-Z])", lambda found: "_" + found[0].lower(), kind.__name__)
            places.append(f"{name} {ctypes.sizeof(kind)}")
            places += [f"{name}.{field} {getattr(kind, field).offset} {getattr(kind, field).size}" for field, _ in kind._fields_]
            self.assertEqual(kind().size, ctypes.sizeof(kind))
            self.assertEqual(library.packing(kind).size, ctypes.sizeof(kind))
        self.assertEqual(sorted(places), sorted(set(table) - set(names)))
        header = re.sub(r"/\*.*?\*/", "", text_of(INCLUDE, "rcbd", "rcbd.h"), flags=re.S)
        for name, (_, arguments) in library._SIGNATURES.items():
            declared = re.search(rf"\b{name}\(([^;]*)\);", header)[1]
            self.assertEqual(len(arguments), 0 if declared == "void" else declared.count(",") + 1, name)

    def test_packed_structs(self):
        """What is packed is what ctypes reads."""
        values = range(1, 9)
        read = library.Positions.from_buffer_copy(library.packing(library.Positions).pack(*values))
        self.assertEqual([read.size, read.count, read.stride, read.dims, read.single, *read.axis], list(values))

    def test_help(self):
        """Whatever is public says what it is."""
        import rcbd.mpi
        for module in (rcbd, rcbd.mpi):
            page = pydoc.plain(pydoc.render_doc(module))
            for name in module.__all__:
                thing = getattr(module, name)
                if isinstance(thing, str):
                    continue
                self.assertIn(name, page)
                self.assertTrue(inspect.getdoc(thing), name)
                for member, value in vars(thing).items() if inspect.isclass(thing) else ():
                    if not member.startswith("_") and (callable(value) or isinstance(value, property)):
                        self.assertTrue(inspect.getdoc(value), f"{name}.{member}")

    def test_types(self):
        if importlib.util.find_spec("mypy") is None:
            print("SKIPPED: no mypy", file=sys.stderr)
            self.skipTest("no mypy")
        with tempfile.TemporaryDirectory() as cache:
            run("-m", "mypy", "--cache-dir", cache, "rcbd", program=PYTHON, cwd=PACKAGE, check=True)

    def test_version(self):
        self.assertIn(f"VERSION {rcbd.__version__} ", text_of(ROOT, "CMakeLists.txt"))

    def test_old_numpy(self):
        """Which has no numpy.typing."""
        run("-c", "import sys; sys.modules['numpy.typing'] = None; import rcbd.mpi", program=PYTHON, check=True)

    def imported(self, **env):
        return run("-c", "import rcbd; print(rcbd.library_path)", program=PYTHON, env=env, cwd="/")

    def test_where_the_library_is(self):
        with tempfile.TemporaryDirectory() as folder:
            def placed(*place):
                path = os.path.join(folder, *place)
                os.makedirs(os.path.dirname(path), exist_ok=True)
                os.symlink(SURROUNDINGS["RCBD_LIBRARY"], path)
                return path
            shutil.copytree(os.path.join(PACKAGE, "rcbd"), os.path.join(folder, "lib", "python3", "rcbd"))
            there = {"PYTHONPATH": os.path.join(folder, "lib", "python3"), "RCBD_LIBRARY": ""}
            for place in (("lib", "librcbd.so.1"), ("lib", "python3", "rcbd", "librcbd.so.1")):  # the last one is nearest
                path = placed(*place)
                self.assertEqual(self.imported(**there).stdout, path + "\n")
            named = placed("elsewhere.so")
            self.assertEqual(self.imported(**dict(there, RCBD_LIBRARY=named)).stdout, named + "\n")
            for wrong, words in ((os.path.join(folder, "none.so"), "none.so"), ("libm.so.6", "no librcbd")):
                failed = self.imported(**dict(there, RCBD_LIBRARY=wrong))
                self.assertEqual(failed.returncode, 1)
                self.assertRegex(failed.stderr.splitlines()[-1], f"^ImportError: rcbd: .*{words}")
            source = os.path.join(folder, "lib", "python3", "rcbd", "_library.py")
            write_text(source, re.sub('__version__ = .*', '__version__ = "1.77.0"', text_of(source)))
            self.assertRegex(self.imported(**there).stderr, "ImportError: rcbd: .* is version .*, and the Python package 1.77.0")

    def test_pip(self):
        """Offline, into an environment of its own; nothing is left in the sources, nor after it is removed."""
        def files():
            return sorted(os.path.join(folder, name) for folder, _, names in os.walk(PACKAGE) for name in names
                          if "__pycache__" not in folder and ".mypy_cache" not in folder)
        before = files()
        with tempfile.TemporaryDirectory() as folder:
            python = os.path.join(folder, "venv", "bin", "python3")
            away = {"PYTHONPATH": "", "PIP_NO_INDEX": "1", "PIP_DISABLE_PIP_VERSION_CHECK": "1"}
            run("-m", "venv", "--system-site-packages", os.path.join(folder, "venv"), program=PYTHON, check=True)
            run("-m", "pip", "wheel", "--no-deps", "-w", folder, PACKAGE, program=python, env=away, check=True)
            (wheel,) = [name for name in os.listdir(folder) if name.endswith(".whl")]
            self.assertEqual(wheel, f"rcbd-{rcbd.__version__}-py3-none-any.whl")
            with zipfile.ZipFile(os.path.join(folder, wheel)) as packed:
                self.assertEqual({name.split("/")[0] for name in packed.namelist()}, {"rcbd", f"rcbd-{rcbd.__version__}.dist-info"})
            for source in (PACKAGE, os.path.join(folder, wheel), "-e" + PACKAGE):
                run("-m", "pip", "install", source, program=python, env=away, check=True)
                told = run("-c", "import rcbd, importlib.metadata as m; print(rcbd.__file__, m.version('rcbd'))", program=python,
                           env=away, cwd=folder, check=True).stdout.split()
                self.assertTrue(told[0].startswith(PACKAGE if source.startswith("-e") else folder), told)
                self.assertEqual(told[1], rcbd.__version__)
                run("-m", "pip", "uninstall", "-y", "rcbd", program=python, env=away, check=True)
                self.assertNotIn("rcbd", " ".join(os.listdir(os.path.join(folder, "venv", "lib", os.path.basename(os.path.dirname(
                    run("-c", "import sysconfig; print(sysconfig.get_path('purelib'))", program=python, check=True).stdout.strip())),
                    "site-packages"))))
        self.assertEqual(files(), before)


if __name__ == "__main__":
    unittest.main(verbosity=2)
