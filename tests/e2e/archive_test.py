"""The archive of deploy/archive: what it needs and shows, and that all of it works where it is unpacked. `deploy/archive --try`
runs it on an older system."""
import re

from support import *

ROOT = os.path.abspath(os.path.join(os.path.dirname(__file__), "..", ".."))
PYTHON = "/usr/bin/python3"


class Archive(ServiceTest):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        made = run("-c", f"umask 077; exec {ROOT}/deploy/archive", program="/bin/sh", check=True, timeout=600)
        path, cls.needs = made.stdout.splitlines()
        cls.held = run("-tvzf", path, program="/usr/bin/tar", check=True).stdout.splitlines()
        folder = os.path.join(cls.dir, "anywhere")
        os.mkdir(folder)
        run("-C", folder, "-xzf", path, program="/usr/bin/tar", check=True)
        cls.prefix = os.path.join(folder, os.path.basename(path).removesuffix(".tar.gz"))
        cls.library = os.path.join(cls.prefix, "lib", "librcbd.so.1")

    def flags(self):
        return run("--cflags", "--libs", "rcbd", program="/usr/bin/pkg-config", check=True,
                   env={"PKG_CONFIG_PATH": os.path.join(self.prefix, "lib", "pkgconfig")}).stdout.split()

    def compiled(self, compiler, *words):
        program = os.path.join(self.dir, "program")
        run(*words, *self.flags(), f"-Wl,-rpath,{self.prefix}/lib", "-o", program, program="/usr/bin/" + compiler, check=True)
        loaded = run(program, program="/usr/bin/ldd", check=True).stdout
        self.assertIn(self.library, loaded)
        return program, loaded

    def test_what_it_needs_and_shows(self):
        dynamic = run("-d", self.library, program="/usr/bin/readelf", check=True).stdout
        self.assertEqual(set(re.findall(r"NEEDED.*\[(.*)\]", dynamic)),
                         {"libpthread.so.0", "libdl.so.2", "libm.so.6", "libc.so.6", "ld-linux-x86-64.so.2"})
        self.assertNotRegex(dynamic, "RPATH|RUNPATH")
        symbols = run("-T", self.library, program="/usr/bin/objdump", check=True).stdout
        versions = {tuple(map(int, version.split("."))) for version in re.findall(r"GLIBC_([\d.]+)", symbols)}
        self.assertLessEqual(max(versions), (2, 27))
        self.assertIn("glibc %d.%d or later" % max(versions), self.needs)
        shown = {line.split()[-1] for line in symbols.splitlines()[4:] if line and "*UND*" not in line}
        promised = set(re.findall(r"^rcbd_\w+$", text_of(ROOT, "tests/client/c/abi.txt"), re.M))
        self.assertEqual(shown - {"RCBD_1"}, promised)

    def test_all_may_read_it_and_what_is_inside_is_named(self):
        modes = {line.split()[0] for line in self.held}
        self.assertEqual(modes - {"-rw-r--r--", "-rwxr-xr-x", "drwxr-xr-x", "lrwxrwxrwx"}, set())
        notices = text_of(self.prefix, "share", "doc", "rcbd", "copyright")
        for words in ("---- libfmt-dev ----", "---- nlohmann-json3-dev ----", "---- libxxhash-dev ----", "GCC Runtime Library Exception"):
            self.assertIn(words, notices)

    def test_programs(self):
        """In C, and in C++, whose own libstdc++ and exceptions are beside those of the library."""
        examples = os.path.join(self.prefix, "share", "doc", "rcbd", "examples")
        for compiler, words in (("cc", ("-std=c99", "c/serial.c", "-lm")), ("c++", ("-std=c++14", "cpp/serial.cpp"))):
            with self.subTest(compiler):
                program, loaded = self.compiled(compiler, *(os.path.join(examples, word) if "/" in word else word for word in words))
                self.assertEqual(compiler == "c++", "libstdc++" in loaded)
                done = run(program=program, endpoint=self.service.endpoint, check=True)
                self.assertIn("has reached the tolerance", done.stdout)
                failed = run(program=program, endpoint="unix:/nonexistent/rcbd.sock")
                self.assertEqual(failed.returncode, 1)
                self.assertIn("no service answers", failed.stderr)

    def test_misuse_and_surroundings(self):
        env = {"LD_LIBRARY_PATH": os.path.join(self.prefix, "lib")}
        for name in ("c_misuse", "c_surroundings"):
            program = os.path.join(BIN, name)
            self.assertIn(self.library, run(program, program="/usr/bin/ldd", env=env, check=True).stdout)
            for case in run(program=program, check=True).stdout.split():
                with self.subTest(case):
                    done = run(self.service.endpoint, case, program=program, env=env)
                    self.assertEqual((done.returncode, done.stdout, done.stderr), (0, "", ""))

    def test_python_and_an_exception_inside(self):
        done = run(os.path.join(ROOT, "tests", "client", "python", "old_system.py"), program=PYTHON, endpoint=self.service.endpoint,
                   env={"PYTHONPATH": os.path.join(self.prefix, "lib", "python3", "dist-packages")}, check=True)
        self.assertIn(f"particles in 64 parts with {self.library}", done.stdout)


if __name__ == "__main__":
    unittest.main(verbosity=2)
