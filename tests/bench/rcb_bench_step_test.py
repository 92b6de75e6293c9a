"""rcb_bench step at running services, as the script beside it that measures what TLS costs uses it."""
import json
import os
import subprocess
import tempfile
import unittest

BIN = os.environ["RCBD_BIN_DIR"]
SCRIPT = os.path.join(os.path.dirname(os.path.abspath(__file__)), "step", "encryption.py")


class Encryption(unittest.TestCase):
    @unittest.skipIf(os.geteuid() != 0, "machines made of namespaces need root")
    def test_services_take_turns(self):
        with tempfile.TemporaryDirectory(dir="/var/tmp") as folder:  # /tmp is each machine's own
            path = os.path.join(folder, "result.json")
            done = subprocess.run([SCRIPT, "--build", os.path.dirname(BIN), "--repeats", "3", "--variants", "rows,connect",
                                   "--points", "1500", "--json", path], capture_output=True, text=True, timeout=200)
            self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
            with open(path) as file:
                rows = json.load(file)["rows"]
        self.assertEqual([(row["variant"], os.path.basename(row["service"])) for row in rows],
                         [("rows", "encrypted"), ("rows", "plain"), ("connect", "encrypted"), ("connect", "plain")])
        for row in rows:
            self.assertEqual((row["n"], row["ranks"]), (1500, 2))
            self.assertGreater(row["seconds"], 0)


if __name__ == "__main__":
    unittest.main(verbosity=2)
