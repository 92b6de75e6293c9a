"""What the documents show works as shown: the README's first session, the example of rcbd.h, a client of the wire
protocol. snippets_test.py has all other blocks."""
from pages import *

WITH_PROGRAMS = dict(os.environ, PATH=f"{os.path.abspath(BIN)}:{os.environ['PATH']}")


def block(document, language, number=0):
    found = [one.text for one in blocks_for(__file__) if (one.page, one.language) == (document, language)]
    return found[number]


# The example of rcbd.h, in C and in C++.
HEADER_SOLVER = """
#include <rcbd/rcbd.h>
#include <stdio.h>
#include <stdlib.h>
static void fail(const char* why) {
  fprintf(stderr, "%s\\n", why);
  exit(1);
}
int main(void) {
  static double my_xyz[80][3];
  const int64_t n = 80;
EXAMPLE
  rcbd_release(scene);
  rcbd_release(client);
  return 0;
}
"""


class Documents(ServiceTest):
    def test_the_example_of_the_header(self):
        header = text_of(ROOT, "client/include/rcbd/rcbd.h")
        example = header[header.index("     rcbd_client *client;"):header.index("   What a scene,")]
        lib = os.path.abspath(os.path.join(BIN, "..", "lib"))
        for compiler, standard, name in (("cc", "c99", "jet.c"), ("c++", "c++11", "jet.cpp")):
            with self.subTest(name):
                source, program = os.path.join(self.dir, name), os.path.join(self.dir, "jet")
                write_text(source, HEADER_SOLVER.replace("EXAMPLE", example))
                run("-std=" + standard, "-Wall", "-Wextra", "-pedantic", "-Werror", "-I", os.path.join(ROOT, "client", "include"),
                    source, "-o", program, "-L", lib, "-lrcbd", "-Wl,-rpath," + lib, program="/usr/bin/" + compiler, check=True)
                done = run(program=program, endpoint=self.service.endpoint, check=True)
                self.assertEqual((done.stdout, done.stderr), ("", ""))
        self.assertEqual(self.service.json("scene", "show", "jet")["step"], 1)

    def test_the_client_of_one_page_that_pushes(self):
        client = os.path.join(ROOT, "client/examples/wire/pushes.py")
        done = subprocess.run(["/usr/bin/python3", client, self.service.endpoint[5:]], capture_output=True, text=True,
                              timeout=60)
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertIn("first positions", done.stdout)


class Sessions(unittest.TestCase):
    """What the README shows for a terminal, line by line in a shell, for a user with nothing but the programs and points."""

    def setUp(self):
        self.dir = tempfile.mkdtemp(prefix="rcb-e2e-")
        self.addCleanup(shutil.rmtree, self.dir)
        # Their default socket and data directory are in here.
        self.user = {name: value for name, value in WITH_PROGRAMS.items() if name != "RCBD_ENDPOINT"}
        self.user |= {"XDG_RUNTIME_DIR": self.dir, "XDG_STATE_HOME": self.dir}
        self.addCleanup(self.said, "rcbctl down", may_fail=True)

    def said(self, line, may_fail=False):
        done = subprocess.run(["bash", "-c", line], capture_output=True, text=True, timeout=120, cwd=self.dir, env=self.user,
                              stdin=subprocess.DEVNULL)
        self.assertTrue(may_fail or done.returncode == 0, f"{line}: {done.stderr}")
        return done.stdout

    def points(self, name):
        np.savetxt(os.path.join(self.dir, name), np.random.default_rng(1).random((100, 3)), delimiter=",", header="x,y,z",
                   comments="")

    def test_the_first_session(self):
        text = block("README.md", "console")
        lines = [command for _, command in commands(text)]
        self.assertEqual(len(lines), len(text.splitlines()))
        said = {line.split()[1]: self.said(line) for line in lines}  # by command
        self.assertIn(f"unix:{self.dir}/rcbd/rcbd.sock", said["up"])
        parts = re.findall(r"^ *(\d+) +(\d+)", said["counts"], re.M)
        self.assertEqual([int(part) for part, _ in parts], list(range(8)))
        self.assertEqual(sum(int(count) for _, count in parts), 2000)
        self.assertRegex(said["owner"], r"\b[0-7]\b")
        self.assertIn("<svg", text_of(self.dir, "jet.svg"))
        self.assertTrue(wait_for(lambda: not processes_of(self.dir)), "all is gone after the last line")

    def test_a_file_divided_once(self):
        lines = re.findall(r"`(rcbctl (?:partition|compare) points\.csv [^`]*)`", text_of(ROOT, "README.md"))
        self.assertEqual(len(lines), 2)
        self.points("points.csv")
        said = [self.said(line) for line in lines]
        counts = np.bincount(np.load(os.path.join(self.dir, "part.npy")), minlength=64)
        self.assertEqual((len(counts), counts.sum(), counts.max() - counts.min()), (64, 100, 1))
        self.assertEqual(json.loads(text_of(self.dir, "cuts.json"))["parts"], 64)
        self.assertIn("bands-x", said[1])

    @unittest.skipUnless(shutil.which("lmp"), "lmp, of Debian's package lammps, isn't installed")
    def test_a_lammps_run(self):
        text = block("docs/coupling.md", "console")
        dump = re.search(r"with the line: (dump .*)$", text, re.M).group(1)
        write_text(os.path.join(self.dir, "in.jet"), lammps_melt(dump, cells=5, steps=500))
        lines = [command for _, command in commands(text)]
        self.said("rcbctl up -n 2")
        # The last line asks for the history of a run that has ended.
        self.said("\n".join(["set -e", *lines[:-1], "wait $!", lines[-1]]))
        history = json.loads(self.said("rcbctl history jet --json"))
        self.assertEqual([(report["step"], report["n"]) for report in history], [(step, 500) for step in range(0, 501, 100)])
        self.assertIn("<svg", text_of(self.dir, "jet.svg"))


class Links(unittest.TestCase):
    def anchors(self, page):
        """Of its headings, as GitHub makes them."""
        text = re.sub(r"(?ms)^ *```.*?^ *```", "", text_of(page))
        headings = re.findall(r"^#+ (.*)$", re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", text), re.M)
        return [re.sub(r"[^\w\- ]", "", heading.strip().lower()).replace(" ", "-") for heading in headings]

    def test_each_leads_somewhere(self):
        broken, seen = [], 0
        for page in pages():
            folder, name = os.path.split(os.path.join(ROOT, page))
            for target, _, anchor in (link.partition("#") for link in re.findall(r"\]\(([^)\s]+)\)", text_of(ROOT, page))):
                if re.match(r"\w+:", target):
                    continue
                path = os.path.join(folder, target or name)
                seen += bool(anchor)
                if not os.path.exists(path) or anchor and anchor not in self.anchors(path):
                    broken.append(f"{page}: {target}#{anchor}")
        self.assertEqual(broken, [])
        self.assertGreater(seen, 50)


if __name__ == "__main__":
    unittest.main(verbosity=2)
