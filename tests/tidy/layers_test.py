"""The layers hold: a folder includes only what CONTRIBUTING.md's arrows allow, and heavy headers stay in their rooms."""
import os
import re
import unittest

ROOT = os.path.abspath(os.path.join(os.path.dirname(__file__), "..", ".."))

# folder: the folders it may include besides itself (what those include is allowed too).
ARROWS = {
    "common/base": [],
    "common/files": ["common/base"],
    "common/geometry": ["common/base"],
    "common/particles": ["common/geometry"],
    "common/comm": ["common/base"],
    "common/cuts": ["common/particles"],
    "common/partition/balance": ["common/particles", "common/comm"],
    "common/partition/rules": ["common/cuts", "common/partition/balance"],
    "common/partition/kernels": ["common/particles"],
    "common/partition/points": ["common/partition/rules", "common/partition/kernels"],
    "common/partition/sample": ["common/partition/points"],
    "common/partition/buckets": ["common/partition/sample"],
    "common/partition/search": ["common/partition/buckets"],
    "common/partition/quality": ["common/cuts", "common/partition/balance"],
    "common/partition": ["common/partition/search"],
    "common/wire": ["common/base"],
    "common/openssl": ["common/base"],
    "common/auth": ["common/openssl"],
    "common/tls": ["common/openssl"],
    "common/layout": ["common/cuts"],
    "common/io/files": ["common/base", "common/files"],
    "common/io/formats": ["common/io/files"],
    "common/io": ["common/io/formats"],
    "common/hdf5": ["common/io/formats"],
    "server/scene": ["common/wire", "common/files", "common/cuts", "common/partition/balance"],
    "server/api": ["server/scene"],
    "server/service/scene": ["server/api", "common/partition", "common/layout"],
    "server/service/context": ["server/service/scene", "server/api", "common/io"],
    "server/service/push": ["server/service/context"],
    "server/service/step": ["server/service/push"],
    "server/service/commands": ["server/service/step", "common/partition/quality"],
    "server/service": ["server/service/commands"],
    "server/ranks": ["server/service"],
    "server/net/files": ["common/files", "common/wire", "common/auth"],
    "server/net/sockets": ["server/net/files", "common/tls"],
    "server/net/push": ["server/api"],
    "server/net/data": ["server/net/push", "server/net/sockets"],
    "server/net/peers": ["server/net/data"],
    "server/net/control": ["server/net/peers"],
    "server/program": ["server/ranks", "server/net/control"],
    "client/lib": ["common/cuts"],
    "client/lib/connect": ["common/wire", "common/auth", "common/tls", "common/files"],
    "client/lib/session": ["client/lib", "client/lib/connect", "common/layout"],
    "client/lib/scene": ["client/lib/session"],
    "client/include/rcbd": [],
    "client/c": ["client/include/rcbd", "client/lib", "common/wire"],
    "client/launch/job": ["client/lib", "client/lib/connect"],
    "client/launch": ["client/launch/job"],
    "client/cli/print": ["client/lib", "common/io"],
    "client/cli": ["client/launch", "client/cli/print"],
    "client/cli/files": ["client/cli"],
    "client/cli/commands": ["client/cli/files"],
    "client/solvers/mpm": ["common/base", "common/geometry"],
    "client/solvers": ["client/solvers/mpm", "client/lib", "client/lib/connect", "common/io"],
    "client/solvers/mpi": ["client/solvers", "common/layout"],
    "client/examples/cpp": ["client/include/rcbd"],
}

# header: the folders where it may be included.
ROOMS = {
    r"<mpi\.h>": ["server/ranks", "client/solvers/mpi", "tests/support", "tests/bench", "tests/bench/peers"],
    r"<boost/asio": ["server/net/sockets", "client/lib/connect"],
    r"<hwy/": ["common/base"],
    r"<openssl/": ["common/openssl", "tests/common/tls"],
    r"<hdf5\.h>": ["common/hdf5", "tests/common/io"],
}


def reachable(folder):
    seen, queue = {folder}, [folder]
    while queue:
        for other in ARROWS[queue.pop()]:
            if other not in seen:
                seen.add(other)
                queue.append(other)
    return seen


def sources():
    for top in ("common", "server", "client", "tests"):
        for folder, _, names in os.walk(os.path.join(ROOT, top)):
            for name in names:
                if name.endswith((".hpp", ".cpp")):
                    path = os.path.join(folder, name)
                    with open(path) as file:
                        yield os.path.relpath(path, ROOT), file.read()


class Layers(unittest.TestCase):
    def test_includes_follow_the_arrows(self):
        wrong = []
        for path, text in sources():
            folder = os.path.dirname(path)
            if path.startswith("tests/"):
                continue
            self.assertIn(folder, ARROWS, f"{path}: a folder without arrows; add it to CONTRIBUTING.md and here")
            allowed = reachable(folder)
            for include in re.findall(r'#include "([^"]+)"', text):
                if os.path.dirname(include) not in allowed:
                    wrong.append(f"{path} includes {include}")
        self.assertEqual(wrong, [])

    def test_heavy_headers_stay_in_their_rooms(self):
        wrong = []
        for path, text in sources():
            for pattern, rooms in ROOMS.items():
                if re.search("#include " + pattern, text) and os.path.dirname(path) not in rooms:
                    wrong.append(f"{path} includes {pattern}")
        self.assertEqual(wrong, [])

    def test_every_file_says_its_purpose(self):
        silent = [path for path, text in sources()
                  if path.endswith(".hpp") and not text.startswith("//")]
        self.assertEqual(silent, [])

    def test_no_unsafe_floating_point(self):
        for name in ("CMakeLists.txt", "cmake/RcbBuild.cmake", "tests/CMakeLists.txt"):
            with open(os.path.join(ROOT, name)) as file:
                text = file.read()
            self.assertNotIn("-ffast-math", text)
        with open(os.path.join(ROOT, "cmake/RcbBuild.cmake")) as file:
            self.assertIn("-ffp-contract=off", file.read())


if __name__ == "__main__":
    unittest.main(verbosity=2)
