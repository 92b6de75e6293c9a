"""What the documents show works as shown: the README's program and first session, the programs of the page on coupling,
a client of the wire protocol."""
import re

from support import *

ROOT = os.path.abspath(os.path.join(os.path.dirname(__file__), "..", ".."))

WITH_PROGRAMS = dict(os.environ, PATH=f"{os.path.abspath(BIN)}:{os.environ['PATH']}")


def block(document, language, number=0):
    return re.findall(r"^```" + language + r"\n(.*?)^```", text_of(ROOT, document), re.S | re.M)[number]


# What a solver has and the README doesn't show.
SOLVER = """
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <vector>
std::vector<double> initial_positions() {
  std::vector<double> xyz;
  for (int i = 0; i < 3000; ++i) xyz.push_back(std::fmod(i * 0.61803398875, 1.0));
  return xyz;
}
int handed_over = 0;
void hand_over(std::uint64_t, std::int32_t) { ++handed_over; }
void advance(std::vector<double>& xyz) {
  for (std::size_t i = 0; i < xyz.size() / 2; ++i) xyz[i] *= 0.99;
}
"""

# One seat in a box that is periodic along its first axis.
C_SOLVER = """
#include <inttypes.h>
#include <math.h>
static int left = 0;
static void hand_over(int64_t row, int seat) { left += (int)row + seat + 1; }
int main(void) {
  double xyz[24] = {0}, lo[3] = {0, -HUGE_VAL, -HUGE_VAL}, hi[3] = {8, HUGE_VAL, HUGE_VAL};
  int64_t ids[8], k;
  rcbd_lists_view view = RCBD_LISTS_VIEW;
  rcbd_lists *lists;
  rcbd_scene *scene;
  for (k = 0; k < 8; ++k) xyz[3 * k] = (double)(ids[k] = k);
  scene = open_scene("wrapped", 2, 0, 1);
  step(scene, xyz, ids, 8, hand_over);
  lists = halo(scene, xyz, ids, 8, 1.5, lo, hi, 1);
  must(rcbd_lists_read(lists, &view));
  printf("%d %d\\n", left, (int)view.entries);
  for (k = 0; k < view.entries; ++k)
    printf("%d: %d %d %d\\n", (int)view.item[k], view.shift[3 * k], view.shift[3 * k + 1], view.shift[3 * k + 2]);
  rcbd_release(lists);
  rcbd_release(scene);
  return 0;
}
"""

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

FORTRAN_SOLVER = """
program solver
  use iso_c_binding
  implicit none
INTERFACE
  type(rcbd_positions) :: at
  at = rcbd_positions(int(c_sizeof(at), c_size_t), 0, 3, 3, 0, [c_null_ptr, c_null_ptr, c_null_ptr])
  print '(i0)', rcbd_step(c_null_ptr, at, c_null_ptr, c_null_ptr)
end program
"""

CUTS_SOLVER = """
#include <cstdio>
#include "client/lib/client.hpp"
int main() {
  std::vector<double> xyz;
  for (int i = 0; i < 30000; ++i) xyz.push_back(double(i * 7919LL % 30011) / 30011);
  auto client = rcb::client::Client::connect({});
  if (!client->create_scene("cube", {.parts = 8, .replace = true})) return 1;
  auto scene = client->open_scene("cube");
  const auto positions = rcb::client::Positions::rows(xyz.data(), 10000, 3);
  if (!scene->step(positions)) return 1;
  std::vector<std::int32_t> part(10000);
PASSAGE
  if (!asked || !halo) return 1;
  for (int p = 0; p < 8; ++p) {
    int owned = 0, own = 0;
    for (const auto q : part) owned += q == p;
    for (const auto row : halo->rows_for(p)) own += part[row] == p;
    std::printf("%d %d %d\\n", owned, int(halo->rows_for(p).size()), own);
  }
}
"""


class Documents(ServiceTest):
    def compile(self, compiler, text):
        source, program = os.path.join(self.dir, "solver.cpp"), os.path.join(self.dir, "solver")
        write_text(source, text)
        build = os.path.dirname(BIN)
        libraries = [os.path.join(build, f"librcb_{name}.a")
                     for name in ("client_lib", "common_layout", "common_wire", "common_auth", "common_tls",
                                  "common_openssl", "common_cuts", "common_particles", "common_files", "common_base")]
        compiled = subprocess.run([compiler, "-std=c++20", "-I", ROOT, source, "-o", program,
                                   *filter(os.path.exists, libraries),
                                   "-lpthread"],
                                  capture_output=True, text=True, timeout=200)
        self.assertEqual(compiled.returncode, 0, compiled.stderr)
        return program

    def test_the_passage_of_the_parallel_example(self):
        self.assertIn(block("docs/coupling.md", "cpp"), text_of(ROOT, "client", "examples", "cpp", "dem.cpp"))

    def test_a_seat_in_c(self):
        source, program, lib = os.path.join(self.dir, "solver.c"), os.path.join(self.dir, "solver"), os.path.join(BIN, "..", "lib")
        write_text(source, block("docs/coupling.md", "c") + C_SOLVER)
        run("-std=c99", "-Wall", "-Wextra", "-pedantic", "-Werror", "-I", os.path.join(ROOT, "client", "include"), source, "-o",
            program, "-L", lib, "-lrcbd", "-Wl,-rpath," + os.path.abspath(lib), program="/usr/bin/cc", check=True)
        done = run(program=program, endpoint=self.service.endpoint, check=True)
        # Eight places on a line. Both halves are this seat's, so it needs only images: those within 1.5 of the line.
        self.assertEqual(done.stdout.splitlines(), ["0 3", "0: 1 0 0", "1: 1 0 0", "7: -1 0 0"])

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

    @unittest.skipUnless(shutil.which("gfortran"), "gfortran isn't installed")
    def test_the_interface_in_fortran(self):
        """By its messages: a scene that is NULL."""
        source, program, lib = os.path.join(self.dir, "f.f90"), os.path.join(self.dir, "f"), os.path.abspath(os.path.join(BIN, "..", "lib"))
        write_text(source, FORTRAN_SOLVER.replace("INTERFACE", block("docs/coupling.md", "fortran")))
        run("-std=f2008", "-Wall", "-Wextra", "-Werror", "-J", self.dir, source, "-o", program, "-L", lib, "-lrcbd", "-Wl,-rpath," + lib,
            program=shutil.which("gfortran"), check=True)
        self.assertEqual(run(program=program, check=True).stdout.split(), ["1"])

    def test_the_readme_program(self):
        program = self.compile("c++", SOLVER + block("README.md", "cpp"))
        done = run(program=program, endpoint=self.service.endpoint, check=True)
        self.assertIn("has reached the tolerance", done.stdout)
        history = self.service.json("history", "jet")
        self.assertEqual([report["step"] for report in history], list(range(201)))

    def test_the_passage_of_the_readme_on_cuts(self):
        """Ten thousand points in a cube: eight parts, each of which needs some points of the others, and not its own."""
        program = self.compile("c++", CUTS_SOLVER.replace("PASSAGE", block("README.md", "cpp", 1)))
        done = run(program=program, endpoint=self.service.endpoint, check=True)
        counts = self.service.json("counts", "cube")["counts"]
        lines = [list(map(int, line.split())) for line in done.stdout.splitlines()]
        self.assertEqual([owned for owned, _, _ in lines], counts)
        self.assertTrue(all(0 < needed < 5000 and own == 0 for _, needed, own in lines), lines)

    def test_the_python_example(self):
        """It runs, and says why where the service refuses."""
        script = os.path.join(self.dir, "example.py")
        write_text(script, block("README.md", "python"))

        def example(endpoint):
            return run(script, program="/usr/bin/python3", endpoint=endpoint, cwd=self.dir,
                       env={"PATH": BIN + ":" + os.environ["PATH"]})

        done = example(self.service.endpoint)
        self.assertEqual((done.returncode, done.stdout, done.stderr), (0, "", ""))
        history = self.service.json("history", "cloud")
        self.assertEqual([report["step"] for report in history], list(range(10)))
        self.assertGreater(sum(report["repartitioned"] for report in history), 1)
        part = np.load(os.path.join(self.dir, "part.npy"))
        self.assertEqual(np.bincount(part).tolist(), self.service.json("counts", "cloud")["counts"])
        done = example("unix:/nonexistent/s")
        self.assertEqual((done.returncode, done.stderr), (1, "no service answers at unix:/nonexistent/s\n"))

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
        text = re.search(r"## A first session\n\n```\n(.*?)^```", text_of(ROOT, "README.md"), re.S | re.M).group(1)
        lines = re.findall(r"^\$ (.*)$", text, re.M)
        self.assertEqual(len(lines), len(text.splitlines()))
        self.points("positions.csv")
        said = {line.split()[1]: self.said(line) for line in lines}  # by command
        self.assertIn(f"unix:{self.dir}/rcbd/rcbd.sock", said["up"])
        parts = re.findall(r"^ *(\d+) +(\d+)", said["counts"], re.M)
        self.assertEqual([int(part) for part, _ in parts], list(range(8)))
        self.assertEqual(sum(int(count) for _, count in parts), 100)
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
        text = re.search(r"```\n(\$ mkfifo.*?)^```", text_of(ROOT, "docs/coupling.md"), re.S | re.M).group(1)
        dump = re.search(r"with the line: (dump .*)$", text, re.M).group(1)
        write_text(os.path.join(self.dir, "in.jet"), lammps_melt(dump, cells=5, steps=500))
        lines = re.findall(r"^\$ (.*)$", text, re.M)
        self.said("rcbctl up -n 2")
        # The last line asks for the history of a run that has ended.
        self.said("\n".join(["set -e", *lines[:-1], "wait $!", lines[-1]]))
        history = json.loads(self.said("rcbctl history jet --json"))
        self.assertEqual([(report["step"], report["n"]) for report in history], [(step, 500) for step in range(0, 501, 100)])
        self.assertIn("<svg", text_of(self.dir, "jet.svg"))


if __name__ == "__main__":
    unittest.main(verbosity=2)
