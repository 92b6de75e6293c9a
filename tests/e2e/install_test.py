"""What cmake --install puts into a prefix, after the prefix was moved: programs, CMake package, pkg-config, Python, pages."""
import glob
import gzip
import shlex

from pages import *

BUILD = os.path.abspath(os.path.join(BIN, ".."))
PROJECT = os.path.join(ROOT, "tests", "installed")


def cmake(*args):
    done = subprocess.run(["cmake", *args], capture_output=True, text=True, timeout=280, env=dict(os.environ, CMAKE_GENERATOR="Ninja"))
    if done.returncode != 0:
        raise AssertionError(f"cmake {args}: {done.stdout}{done.stderr}")
    return done


def installed(prefix):
    return sorted(os.path.relpath(os.path.join(folder, name), prefix) for folder, _, names in os.walk(prefix) for name in names)


class Install(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.dir = tempfile.mkdtemp(prefix="rcb-e2e-install-")
        cls.addClassCleanup(shutil.rmtree, cls.dir)
        first, cls.prefix = (os.path.join(cls.dir, name) for name in ("first", "moved there"))
        cmake("--install", BUILD, "--prefix", first)
        os.rename(first, cls.prefix)
        cls.library = os.path.dirname(glob.glob(os.path.join(cls.prefix, "lib*", "**", "librcbd.so.1"), recursive=True)[0])
        cls.examples = os.path.join(cls.prefix, "share", "doc", "rcbd", "examples")
        # None of the build's programs can be found.
        cls.environment = {"PATH": f"{cls.prefix}/bin:/usr/bin:/bin", "RCBD_BIN_DIR": "", "LD_LIBRARY_PATH": ""}

    def output(self, *words, env=None, endpoint=None):
        return run(*words[1:], program=words[0], endpoint=endpoint, env={**self.environment, **(env or {})}, check=True,
                   cwd=self.dir).stdout

    def ctl(self, *words):
        return run(*words, program=os.path.join(self.prefix, "bin", "rcbctl"), endpoint=f"unix:{self.dir}/s", env=self.environment,
                   cwd=self.dir)

    def service(self):
        """A service of the installed programs; its endpoint."""
        up = self.ctl("up", "-n", 2, "--data-dir", os.path.join(self.dir, "data"))
        self.addCleanup(self.ctl, "down")
        self.assertEqual(up.returncode, 0, up.stderr)
        return f"unix:{self.dir}/s"

    def test_projects_that_find_the_package(self):
        build = os.path.join(self.dir, "build")
        cmake("-S", PROJECT, "-B", build, f"-DCMAKE_PREFIX_PATH={self.prefix}", f"-DEXAMPLES={self.examples}")
        cmake("--build", build)
        endpoint = self.service()
        programs = sorted(glob.glob(os.path.join(build, "serial_*")))
        languages = [os.path.basename(program).removeprefix("serial_") for program in programs]
        self.assertLess({"c", "cpp"}, {*languages, "fortran"})
        if "fortran" not in languages:
            print("no Fortran compiler: not tried in Fortran")
        said = {self.output(program, endpoint=endpoint) for program in programs}
        self.assertEqual(len(said), 1, said)
        self.assertIn("step 0: ", said.pop())

    def test_pkg_config(self):
        settings = {"PKG_CONFIG_PATH": os.path.join(self.library, "pkgconfig")}
        words = shlex.split(self.output("pkg-config", "--cflags", "--libs", "rcbd", env=settings))
        program = os.path.join(self.dir, "serial")
        self.output("cc", "-o", program, os.path.join(self.examples, "c", "serial.c"), *words, "-lm",
                           f"-Wl,-rpath,{self.library}")
        self.assertIn("step 0: ", self.output(program, endpoint=self.service()))
        for name in ("fortran", "fortran_mpi"):
            path, = shlex.split(self.output("pkg-config", f"--variable={name}", "rcbd", env=settings))
            self.assertEqual(os.path.normpath(path), os.path.join(self.prefix, "include", "rcbd", f"{'rcbd_mpi' if 'mpi' in name else 'rcbd'}.f90"))

    def test_a_program_finds_the_one_that_reads_hdf5(self):
        write_text(os.path.join(self.dir, "x.h5"), "")
        with open(os.path.join(self.dir, "x.h5"), "wb") as file:
            file.write(b"\x89HDF\r\n\x1a\n" + bytes(100))
        refused = self.ctl("partition", "x.h5:/points", "--parts", 2, "--ranks", 1)
        self.assertIn("x.h5", refused.stderr)
        self.assertNotIn("rcb_read_hdf5", refused.stderr)

    def test_python(self):
        folder = glob.glob(os.path.join(self.prefix, "lib*", "python3*", "*-packages"))
        code = "import rcbd, importlib.metadata; print(rcbd.__file__, importlib.metadata.version('rcbd'))"
        said = self.output("/usr/bin/python3", "-c", code, env={"PYTHONPATH": folder[0]})
        self.assertTrue(said.startswith(self.prefix), said)

    def test_the_first_array_of_the_page(self):
        block, = blocks_for(__file__)
        settings = {**self.environment, "PYTHONPATH": os.path.join(self.prefix, "lib", "python3", "dist-packages")}
        for _, line in commands(block.text):
            words = line.replace("/usr/share", os.path.join(self.prefix, "share").replace(" ", "\\ "))
            run("-c", words, program="sh", endpoint=f"unix:{self.dir}/first", cwd=self.dir, check=True,
                env={**settings, "XDG_STATE_HOME": self.dir})
        self.assertIn("<svg", text_of(self.dir, "first.svg"))

    def test_the_module_file(self):
        module = shutil.which("modulecmd", path=os.environ["PATH"] + ":/usr/lib/x86_64-linux-gnu")
        if not module:
            self.skipTest("no modulecmd: deploy/dependencies --tests installs it")
        done = run("sh", "load", "rcbd", program=module, check=True,
                   env={"MODULEPATH": os.path.join(self.prefix, "share", "modulefiles"), "LOADEDMODULES": "", "_LMFILES_": ""})
        settings = dict(re.findall(r"^(\w+)=(.*?); export \1", done.stdout.replace("\\ ", " "), re.M))
        self.assertEqual(settings["PATH"].split(":")[0], f"{self.prefix}/bin")
        for name in ("LD_LIBRARY_PATH", "LIBRARY_PATH", "CPATH", "CMAKE_PREFIX_PATH", "PKG_CONFIG_PATH"):
            first = settings[name].split(":")[0]
            self.assertTrue(first.startswith(self.prefix) and os.path.isdir(first), (name, first))

    def test_pages_and_completions(self):
        pages = glob.glob(os.path.join(self.prefix, "share", "man", "man1", "*.1.gz"))
        names = {os.path.basename(page).removesuffix(".1.gz") for page in pages}
        self.assertLess({"rcbd", "rcbctl", "rcbctl-up", "rcbctl-scene-create"}, names)
        for page in pages:
            with gzip.open(page, "rt") as file:
                text = file.read()
            self.assertRegex(text, r"\n\.SH NAME\n\S+ \\- \S")
            self.assertIn("\n.SH OPTIONS\n.TP\n", text, page)
            if shutil.which("man"):
                complaints = run("--warnings", "-l", page, program="man", env={"MANPAGER": "cat"}, check=True).stderr
                self.assertEqual(complaints, "", page)
        for name in ("bash-completion/completions/rcbctl", "zsh/site-functions/_rcbctl", "fish/vendor_completions.d/rcbctl.fish"):
            self.assertIn("rcbctl", text_of(self.prefix, "share", name))

    def test_links_of_the_documents(self):
        documents = os.path.join(self.prefix, "share", "doc", "rcbd")
        found = [os.path.join(documents, name) for name in installed(documents) if name.endswith(".md")]
        self.assertGreater(len(found), 10)
        broken = []
        for document in found:
            for link in re.findall(r"\]\(([^)#:\s]+)(?:#[^)]*)?\)", text_of(document)):
                if not os.path.exists(os.path.join(os.path.dirname(document), link)):
                    broken.append((os.path.relpath(document, documents), link))
        self.assertEqual(broken, [])

    def test_the_library_alone(self):
        build, prefix = os.path.join(self.dir, "library"), os.path.join(self.dir, "alone")
        cmake("-S", ROOT, "-B", build, "-DRCB_SERVICE=OFF")
        shutil.copytree(os.path.join(BUILD, "lib"), os.path.join(build, "lib"), symlinks=True, dirs_exist_ok=True)  # as if it had been built
        cmake("--install", build, "--prefix", prefix)
        names = installed(prefix)
        wanted = r"include/rcbd/|lib[^/]*/(.*/)?(librcbd\.so|cmake/rcbd/|pkgconfig/rcbd\.pc)|lib/python3/|share/doc/rcbd/examples/"
        self.assertEqual([name for name in names if not re.match(wanted, name)], [])
        self.assertIn("include/rcbd/rcbd.h", names)

    def test_a_folder_that_could_not_be_moved(self):
        refused = subprocess.run(["cmake", "-S", ROOT, "-B", os.path.join(self.dir, "refused"), "-DRCB_SERVICE=OFF",
                                  "-DCMAKE_INSTALL_INCLUDEDIR=/elsewhere"], capture_output=True, text=True, timeout=280)
        self.assertNotEqual(refused.returncode, 0)
        self.assertRegex(refused.stderr, r"CMAKE_INSTALL_INCLUDEDIR is /elsewhere\.\s+Give\s+a\s+folder\s+below")

    def test_a_component(self):
        for component, held in (("library", "librcbd.so.1"), ("dev", "rcbd.h"), ("runtime", "rcbctl")):
            prefix = os.path.join(self.dir, component)
            cmake("--install", BUILD, "--prefix", prefix, "--component", component)
            names = {os.path.basename(name) for name in installed(prefix)}
            self.assertIn(held, names)
            self.assertEqual(len(names & {"librcbd.so.1", "rcbd.h", "rcbctl", "__init__.py"}), 1, component)


if __name__ == "__main__":
    unittest.main(verbosity=2)
