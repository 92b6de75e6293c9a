"""rcbd.hpp as programs in C++14 and later see it: one history, every misuse an rcbd::Error, arrays that stay, and no warning
from either compiler."""
import re

from languages import *

CLANG = shutil.which("clang++")
WARNINGS = ("-Wall", "-Wextra", "-pedantic", "-Wshadow", "-Wconversion", "-Werror")
LINK = ("-I", INCLUDE, "-L", LIB, "-lrcbd", "-Wl,-rpath," + LIB, "-pthread")
# All that is made of templates; and from C++20 on, options by name.
USES = """
#include <rcbd/rcbd.hpp>
std::uint64_t uses(const rcbd::Client& client, std::vector<double>& xyz, std::vector<std::array<float, 2>>& flat, double (*table)[3]) {
  rcbd::SceneOptions options;
  options.parts = 8;
  rcbd::Scene scene = client.scene_open("uses", options);
  rcbd::wrap(xyz, {0, 0, 0}, {1, 1, 1});
  rcbd::wrap(rcbd::WritablePositions::axes(xyz, xyz), {0, 0}, {1, 1});
  scene.step({table, 5});
  scene.step(flat);
  scene.step(scene.arrays<float>(5, rcbd::Layout::axes));
  scene.step(rcbd::Positions::axes({xyz.data(), xyz.data()}, 5, 2));
  std::int64_t sum = 0;
  for (std::int64_t row : scene.cuts().halo(xyz, {0.1}).items(3)) sum += row;
  for (std::int64_t part : scene.cuts().neighbours(3, 0.1)[0]) sum += scene.cuts().halo(xyz, 0.1)[3][0] + part;
  options.part_sizes.assign(xyz.begin(), xyz.end());
  rcbd::View<double> view = rcbd::View<double>(xyz.data(), 3);
  const auto parts = scene.step(view).parts();
  rcbd::AskOptions ask;
  ask.last_part = parts;
  for (std::int64_t row : scene.step(xyz).leaving().rows) sum += row;
#if __cplusplus >= 202002L
  scene = client.scene_open("uses", {.parts = 8, .replace = true});
  scene.step(xyz, {.step = sum, .want_changed = true});
  scene.cuts().halo(xyz, {.width = 0.1, .norm = rcbd::Norm::euclid}, {.seats = 2});
#endif
  return scene.cuts().hash() + static_cast<std::uint64_t>(sum);
}
"""
# What would refer to a vector that is gone, or write where it may not.
REFUSED = ("scene.step(std::vector<double>(3))", "ask.last_part = scene.step(constant).parts()", "scene.step(std::array<double, 3>())",
           "ask.widths = std::array<double, 3>()", "ask.ids = scene.step(constant).leaving().rows", "options.ids = std::vector<std::int64_t>(3)", "rcbd::wrap(constant, {0}, {1})",
           "scene.step(std::vector<int>(3))", "rcbd::Scene s = nullptr", "scene.arrays<int>(3)", "scene.step(whole)")
# What the example of rcbd.hpp doesn't show.
SOLVER = """
#include <cmath>
#include <cstdio>
#include <rcbd/rcbd.hpp>
std::vector<double> initial_positions() {
  std::vector<double> xyz;
  for (int i = 0; i < 3000; ++i) xyz.push_back(std::fmod(i * 0.61803398875, 1.0));
  return xyz;
}
void advance(std::vector<double>& xyz) {
  for (std::size_t i = 0; i < xyz.size() / 2; ++i) xyz[i] *= 0.99;
}
int main() {
EXAMPLE
}
"""


class CppLibrary(LanguageTest):
    def compiled(self, compiler, *words, text=None):
        """Compiles, and returns what was wrong."""
        return subprocess.run([compiler, *words], input=text, capture_output=True, text=True, timeout=200).stderr

    def test_every_standard_and_compiler(self):
        self.assertIsNotNone(shutil.which("g++"))
        for compiler in ("g++", CLANG):
            for standard in ("c++14", "c++17", "c++20", "c++2b"):
                for kind in ((), ("-fno-rtti", "-ffast-math")):
                    with self.subTest(compiler, standard=standard, kind=kind):
                        if compiler is None:
                            self.skipTest("clang++ isn't installed")
                        words = (f"-std={standard}", *WARNINGS, *kind, "-I", INCLUDE, "-fsyntax-only", "-x", "c++", "-")
                        self.assertEqual(self.compiled(compiler, *words, text=USES), "")

    def test_each_header_by_itself(self):
        headers = [name for name in os.listdir(os.path.join(INCLUDE, "rcbd")) if name.endswith(".hpp") and "mpi" not in name]
        self.assertIn("rcbd.hpp", headers)
        for name in headers:
            with self.subTest(name):
                text = f"#include <rcbd/{name}>\n#include <rcbd/rcbd.hpp>\n"
                self.assertEqual(self.compiled("g++", "-std=c++14", *WARNINGS, "-I", INCLUDE, "-fsyntax-only", "-x", "c++", "-", text=text), "")

    def test_what_the_compiler_refuses(self):
        function = """
#include <rcbd/rcbd.hpp>
void refused(rcbd::Scene& scene, rcbd::StepOptions& options, const std::vector<double>& constant, std::vector<long>& whole) {
  rcbd::AskOptions ask;
  LINE;
  (void)ask, (void)scene, (void)options, (void)constant, (void)whole;
}
"""
        words = ("-std=c++14", "-I", INCLUDE, "-fsyntax-only", "-x", "c++", "-")
        self.assertEqual(self.compiled("g++", *words, text=function.replace("LINE", "scene.step(constant)")), "")
        for line in REFUSED:
            with self.subTest(line):
                self.assertIn("error: ", self.compiled("g++", *words, text=function.replace("LINE", line)))
        self.assertIn("reports failures by exceptions", self.compiled("g++", "-fno-exceptions", *words, text="#include <rcbd/rcbd.hpp>"))

    def test_one_history(self):
        self.one_history([os.path.join(BIN, "cpp_history")])

    def test_one_history_under_traps(self):
        self.one_history([os.path.join(BIN, "cpp_history")], "hard")

    def test_one_history_with_fast_math(self):
        """By Clang, where it is installed."""
        program = os.path.join(self.dir, "history")
        source = os.path.join(ROOT, "tests", "client", "cpp", "history.cpp")
        complaints = self.compiled(CLANG or "g++", "-std=c++17", "-O3", "-ffast-math", source, "-o", program, *LINK)
        self.assertEqual(complaints, "")
        self.one_history([program])

    def test_misuse(self):
        self.cases_of("cpp_misuse", 7)

    def test_lifetime(self):
        self.cases_of("cpp_lifetime", 7, MALLOC_PERTURB_="165")  # memory that was freed is filled with this byte

    def test_surroundings(self):
        self.cases_of("cpp_surroundings", 4)

    def test_the_example_of_the_header(self):
        header = text_of(INCLUDE, "rcbd", "rcbd.hpp")
        example = re.search(r"(?m)^//   std::vector<double> xyz(?:.*\n//   )*.*", header)[0].replace("//   ", "")
        source, program = os.path.join(self.dir, "jet.cpp"), os.path.join(self.dir, "jet")
        write_text(source, SOLVER.replace("EXAMPLE", example))
        self.assertEqual(self.compiled("g++", "-std=c++14", *WARNINGS, source, "-o", program, *LINK), "")
        done = run(program=program, endpoint=self.service.endpoint, check=True)
        self.assertRegex(done.stdout, r"step 0: .*\n(.*\n)*part 3 needs particle \d+\n")
        self.assertEqual(self.service.json("scene", "show", "jet")["step"], 99)

    def test_the_serial_example(self):
        self.serial_example(os.path.join(BIN, "serial_cpp"))


if __name__ == "__main__":
    unittest.main(verbosity=2)
