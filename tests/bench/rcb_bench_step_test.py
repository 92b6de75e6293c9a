"""rcb_bench step: what its rows say holds together, and it runs at services that run already, as the script beside it that
measures what TLS costs uses it. No time is asserted."""
import json
import os
import subprocess
import tempfile
import unittest

BIN = os.environ["RCBD_BIN_DIR"]
from measuring import expect_refused, measure

SCRIPT = os.path.join(os.path.dirname(os.path.abspath(__file__)), "step", "encryption.py")


class Step(unittest.TestCase):
    COUNTED, SENT = ["read", "round_trip"], ["read", "floor", "memory"]
    FLOORS = {"count": COUNTED, "count-permuted": COUNTED, "count-weighted": COUNTED, "count-members": COUNTED, "send": SENT,
              "every-step": SENT, "sockets": SENT, "endpoint": SENT, "every-step-members": SENT, "connect": ["floor", "memory"]}
    EACH = {"every-step": 24, "sockets": 32, "endpoint": 24, "every-step-members": 32}  # bytes that a particle sends

    @classmethod
    def setUpClass(cls):
        cls.document, done = measure("step", "--scenes", "moving-small,moving-shuffled", "--points", "20000", "--parts",
                                     "8,64,1024", "--ranks", "2", "--repeats", "3", "--variants", ",".join(cls.FLOORS))
        cls.text = done.stdout

    def test_each_row_stands_beside_its_floors(self):
        rows = self.document["rows"]
        self.assertEqual([(row["scene"], row["parts"], row["variant"]) for row in rows],
                         [(scene, parts, variant) for scene in ("moving-small", "moving-shuffled") for parts in (8, 64, 1024)
                          for variant in self.FLOORS])
        for row in rows:
            self.assertEqual((row["n"], row["ranks"]), (20000, 2))
            self.assertEqual(list(row["ratio"]), self.FLOORS[row["variant"]])
            for name, ratio in row["ratio"].items():
                self.assertAlmostEqual(ratio, row["seconds"] / row[name + "_seconds"])
                self.assertIn(f"{name} {1e3 * row[name + '_seconds']:.3f} ms", self.text)

    def test_a_count_is_a_small_message(self):
        for row in self.document["rows"]:
            counted = row["variant"].startswith("count")
            self.assertEqual("message_bytes" in row, counted)
            if counted:
                each = 32 if row["variant"] == "count-weighted" else 16
                messages = 4 if row["variant"] == "count-members" else 1
                self.assertLessEqual(row["message_bytes"], each * row["parts"] + 1024 * messages)
                self.assertGreater(row["message_bytes"], 12 * row["parts"])

    def test_floors_have_the_bytes_of_a_step(self):
        for row in self.document["rows"]:
            if row["variant"] in self.EACH:
                self.assertEqual((row["variant"], row["bytes"]), (row["variant"], self.EACH[row["variant"]] * row["n"]))

    def test_only_send_finds_new_cuts(self):
        self.assertEqual({row["variant"] for row in self.document["rows"] if row["repartitioned"]}, {"send"})

    def test_wrong_usage(self):
        expect_refused(self, "rcb_bench", *(["step", *words] for words in (
            ["--scenes", "nowhere"], ["--variants", "magic"], ["--parts", "0"], ["--points", "1.5"], ["--repeats", "0"])))


class Encryption(unittest.TestCase):
    @unittest.skipIf(os.geteuid() != 0, "machines made of namespaces need root")
    def test_services_take_turns(self):
        with tempfile.TemporaryDirectory(dir="/var/tmp") as folder:  # /tmp is each machine's own
            path = os.path.join(folder, "result.json")
            done = subprocess.run([SCRIPT, "--build", os.path.dirname(BIN), "--repeats", "3", "--variants", "sockets,connect",
                                   "--points", "1500", "--json", path], capture_output=True, text=True, timeout=200)
            self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
            with open(path) as file:
                rows = json.load(file)["rows"]
        self.assertEqual([(row["variant"], os.path.basename(row["service"])) for row in rows],
                         [("sockets", "encrypted"), ("sockets", "plain"), ("connect", "encrypted"), ("connect", "plain")])
        for row in rows:
            self.assertEqual((row["n"], row["ranks"]), (1500, 2))
            self.assertGreater(row["seconds"], 0)


if __name__ == "__main__":
    unittest.main(verbosity=2)
