"""Kernels need Highway's headers alone, and compile for 64-bit ARM too."""
import glob
import os
import shutil
import subprocess
import tempfile
import unittest

ROOT = os.path.abspath(os.path.join(os.path.dirname(__file__), "..", ".."))
KERNELS = sorted(glob.glob(os.path.join(ROOT, "common", "**", "kernels.cpp"), recursive=True))
OPTIONS = ["-std=c++20", "-ffp-contract=off", "-I", ROOT, "-DXXH_INLINE_ALL", "-DFMT_HEADER_ONLY", "-c"]


class Kernels(unittest.TestCase):
    def compile(self, compiler, *options):
        """The symbols of Highway's that the objects ask for."""
        if shutil.which(compiler) is None:
            self.skipTest(f"no {compiler}")
        asked = ""
        with tempfile.TemporaryDirectory() as folder:
            made = os.path.join(folder, "kernels.o")
            for source in KERNELS:
                subprocess.run([compiler, *OPTIONS, *options, source, "-o", made], check=True)
                asked += subprocess.run(["nm", "-uC", made], check=True, capture_output=True, text=True).stdout
        return [line for line in asked.splitlines() if "hwy" in line]

    def test_nothing_is_asked_of_highways_library(self):
        self.assertGreaterEqual(len(KERNELS), 3)
        for compiler in ("g++", "clang++"):
            with self.subTest(compiler):
                self.assertEqual(self.compile(compiler, "-O0"), [])

    def test_arm(self):
        self.assertEqual(self.compile("aarch64-linux-gnu-g++", "-O1"), [])


if __name__ == "__main__":
    unittest.main(verbosity=2)
