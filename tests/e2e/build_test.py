"""The build as others meet it: as a guest in another project's build, and with no more installed than it asks for."""
import re

from support import *

ROOT = os.path.abspath(os.path.join(os.path.dirname(__file__), "..", ".."))

# A project with its own idea of warnings and asserts, and a macro that many test libraries and loggers have, too. It may
# put the library into a shared one.
HOST = f"""
cmake_minimum_required(VERSION 3.25)
project(host LANGUAGES C CXX)
set(CMAKE_EXPORT_COMPILE_COMMANDS ON)
add_subdirectory("{ROOT}" rcbd)
add_library(host SHARED EXCLUDE_FROM_ALL main.cpp)
target_compile_options(host PRIVATE -Wall -Wextra -Wpedantic -Wshadow -Wconversion -Werror)
target_link_libraries(host PRIVATE rcb::client_lib)
"""
MAIN = """
#define CHECK(condition) static_assert(condition)
#include "client/lib/client.hpp"
CHECK(sizeof(rcb::client::ConnectOptions) > 0);
#ifdef NDEBUG
#error "the asserts of this project are gone"
#endif
#if defined(BOOST_ASIO_NO_DEPRECATED) || defined(FMT_HEADER_ONLY) || defined(XXH_INLINE_ALL)
#error "how this project uses other libraries is its own affair"
#endif
bool reaches() { return rcb::client::Client::connect({.name = "host"}).ok(); }
"""


def cmake(*args):
    return subprocess.run(["cmake", *args], capture_output=True, text=True, timeout=250,
                          env=dict(os.environ, CMAKE_GENERATOR="Ninja"))


class Builds(unittest.TestCase):
    def setUp(self):
        self.dir = tempfile.mkdtemp(prefix="rcb-e2e-")
        self.addCleanup(shutil.rmtree, self.dir)
        self.build = os.path.join(self.dir, "build")

    def configured(self, source, *options):
        done = cmake("-S", source, "-B", self.build, *options)
        self.assertEqual(done.returncode, 0, done.stderr)

    def planned(self):
        """All that a whole build would compile."""
        return subprocess.run(["ninja", "-C", self.build, "-t", "inputs", "all"], capture_output=True, text=True,
                              check=True).stdout

    def test_a_guest_in_another_build(self):
        write_text(os.path.join(self.dir, "CMakeLists.txt"), HOST)
        write_text(os.path.join(self.dir, "main.cpp"), MAIN)
        self.configured(self.dir, "-DCMAKE_DISABLE_FIND_PACKAGE_spdlog=ON", "-DCMAKE_DISABLE_FIND_PACKAGE_MPI=ON")
        self.assertRegex(text_of(self.build, "CMakeCache.txt"), r"(?m)^CMAKE_BUILD_TYPE:\w+=$")
        ours = [entry["command"] for entry in json.loads(text_of(self.build, "compile_commands.json"))
                if re.search(r"rcb_common_\w+\.dir", entry["command"])]
        self.assertGreater(len(ours), 5)
        for command in ours:
            self.assertNotIn(" -Werror", command)
            self.assertIn(" -fPIC", command)
        compiled = cmake("--build", self.build, "--target", "CMakeFiles/host.dir/main.cpp.o")
        self.assertEqual(compiled.returncode, 0, compiled.stdout)

    def test_without_tests_neither_their_libraries_nor_benchmarks(self):
        hidden = [f"-DCMAKE_DISABLE_FIND_PACKAGE_{name}=ON" for name in ("GTest", "rapidcheck")]
        self.configured(ROOT, "-DRCB_TESTS=OFF", *hidden)
        targets = set(re.findall(r"CMakeFiles/(rcb\w+)\.dir/", self.planned()))
        self.assertLess({"rcbctl", "rcbd"}, targets)
        self.assertFalse(targets & {"rcb_bench", "rcb_contest", "rcb_test_support"})
        # As in the folder that deploy/demo has made, and deploy/test then takes.
        refused = cmake(self.build, "-DRCB_TESTS=ON")
        self.assertNotEqual(refused.returncode, 0)
        self.assertIn("deploy/dependencies --tests", refused.stderr)

    def test_packages(self):
        def packages(*options):
            return set(run(*options, "--list", program=os.path.join(ROOT, "deploy", "dependencies"), check=True).stdout.split())

        for_tests = packages("--tests") - packages()
        self.assertLess({"libgtest-dev", "slurm-wlm", "munge"}, for_tests)
        self.assertFalse(any(re.search("trilinos", name) for name in packages("--tests")))
        self.assertTrue(any(re.search("trilinos", name) for name in packages("--peers") - for_tests))


if __name__ == "__main__":
    unittest.main(verbosity=2)
