"""Wrong command lines of every kind: exit 2, plain words, before anything is done; and --help in the same words."""
import re

from support import *

NOWHERE = "unix:/nonexistent/rcbd.sock"
COMMANDS = ("up", "down", "status", "partition", "compare", "scene create", "scene list", "scene show", "scene drop",
            "push", "replay", "stream", "error", "counts", "cuts", "history", "stats", "owner", "box", "halo",
            "neighbours", "assign", "quality", "rebalance", "export", "watch", "completion")
# The parser's own words for types and faults, which are for those who write such parsers.
PARSER_WORDS = re.compile(r"\b(TEXT|FLOAT|INT|UINT|REQUIRED|OPTIONS:|Could not convert|in \[\d|not in range|\(\d+x\)|"
                          r"is required|were not expected|was not expected)")
# What stands for a number in --help.
NUMBERS = {"P", "R", "D", "K", "I", "T", "H", "E", "SECONDS", "X", "LIST", "IDS"}


def page(command):
    done = run(*command.split(), "--help")
    assert done.returncode == 0, done.stderr
    return done.stdout


def numeric_options(command):
    """The options of a command that take a number: ("--parts", "P")."""
    found = re.findall(r"^  (?:-\w, )?(--[a-z-]+) ([A-Z]+)\b", page(command), re.M)
    return [(option, kind) for option, kind in found if kind in NUMBERS and option != "--endpoint"
            and (command, option) != ("export", "--format")]


class Usage(unittest.TestCase):
    def refuse(self, *args, says=(), env=None):
        done = run("--json", *args, endpoint=NOWHERE, env=env)
        self.assertEqual(done.returncode, 2, (args, done.stdout, done.stderr))
        failure = json.loads(done.stdout)["failure"]
        self.assertEqual((failure["code"], failure["exit"]), ("usage", 2))
        self.assertNotRegex(done.stderr, PARSER_WORDS, args)
        for word in says:
            self.assertIn(word, failure["message"] + " | " + failure["hint"], args)

    def line(self, command):
        """A line of that command which is right but for what is added."""
        needed = {"partition": ["p.csv", "--parts", "2"], "compare": ["p.csv", "--parts", "2"],
                  "scene create": ["s", "--parts", "2"], "replay": ["s", "p.npy"], "stream": ["s", "-"], "owner": ["s", "0"],
                  "box": ["s", "0", "1"], "halo": ["s", "--width", "1"], "neighbours": ["s", "--width", "1"],
                  "assign": ["s", "--out", "a.npy"], "export": ["s", "d"], "completion": ["bash"]}
        alone = ("up", "down", "status", "scene list")
        return command.split() + needed.get(command, [] if command in alone else ["s"])

    def test_help_speaks_plainly(self):
        for command in COMMANDS:
            text = page(command)
            self.assertNotRegex(text, PARSER_WORDS, command)
            self.assertIn("Usage: rcbctl " + command, text)
            self.assertIn("Examples:", text, command)
            self.assertLessEqual(max(map(len, text.splitlines())), 110, command)
        self.assertEqual(set(COMMANDS) - {c for c in COMMANDS if re.search(rf"^  {c.split()[0]}\b", page(""), re.M)},
                         set())

    def test_every_number_is_checked(self):
        seen = 0
        for command in COMMANDS:
            for option, kind in numeric_options(command):
                seen += 1
                wrong = ["abc", "nan", "1,5x"]
                if kind in ("P", "R", "D", "K", "I", "IDS"):
                    wrong += ["-1", "1.5", "99999999999999999999"]
                if kind in ("P", "R", "D", "SECONDS") and option != "--step-seconds" or command == "watch":
                    wrong += ["0", "-0.5"]
                line = [word for word in self.line(command)]
                for value in wrong:
                    at = line.index(option) if option in line else None
                    full = line[:at] + line[at + 2:] if at is not None else line
                    self.refuse(*full, f"{option}={value}", says=[option])
        self.assertGreater(seen, 30, "the pages of --help are not understood")

    def test_lists(self):
        for wrong in ("1,,2", ",1", "1,", "", ","):
            self.refuse("scene", "create", "s", "--parts", "2", f"--part-sizes={wrong}", says=["--part-sizes"])
        # A list is one word, so what follows it is something else.
        done = run("partition", "--parts", "2", "--part-sizes", "1,2", "/nonexistent.csv", "--json", endpoint=NOWHERE)
        self.assertEqual(json.loads(done.stdout)["failure"]["code"], "not_found")

    def test_options_behind_two_dashes(self):
        self.refuse("scene", "create", "--", "-x", "--parts", "8", says=["--parts stands behind --"])

    def test_any_number_syntax(self):
        for value in ("8", "8.0", "8e0", "+8"):
            done = run("partition", "/nonexistent.csv", "--parts", value, "--json", endpoint=NOWHERE)
            self.assertEqual(json.loads(done.stdout)["failure"]["code"], "not_found", value)

    def test_positions_are_numbers(self):
        for position in (("a",), ("nan", 0, 0), (0, "inf"), ("a,b,c",), (0, 0, "1e999")):
            self.refuse("owner", "s", *position, says=["is not a number"])
            if "inf" not in position:
                self.refuse("box", "s", *position, 1, 1, says=["is not a number"])
        self.refuse("owner", "s", "-inf", 0, says=["'-inf' is not a number"])
        self.refuse("box", "s", 0, "inf", 1, 1, says=["low corner"])
        self.refuse("box", "s", 0, 0, "-INF", 1, says=["high corner"])
        self.refuse("owner", "s", says=["X is missing"])
        self.refuse("box", "s", 1, 2, 3, says=["two corners"])

    def test_bytes_are_memory_that_there_is(self):
        for text in ("-1", "0", "1.5gb", "18446744073709551615", "99999tb", "1e30", "many"):
            self.refuse("up", f"--bulk-bytes={text}", says=["--bulk-bytes"])
        self.refuse("up", "--keep-reports", 2 ** 63 - 1, says=["--keep-reports"])
        self.refuse("scene", "create", "s", "--parts", 2, "--tolerance", "1e400", says=["--tolerance", "1e400"])

    def test_words(self):
        self.refuse("sttus", says=["there is no command sttus", "did you mean status?"])
        self.refuse("scene", "crate", "s", says=["there is no command scene crate", "did you mean create?"])
        self.refuse("scene", says=["create, list, show, drop"])
        self.refuse("--endpoint", NOWHERE, "sttus", says=["there is no command sttus"])
        self.refuse("partition", "p.csv", "--part", 8, says=["there is no option --part", "did you mean --parts?"])
        self.refuse("partition", "p.csv", says=["--parts is missing"])
        self.refuse("partition", "p.csv", "--parts", says=["--parts", "value is missing"])
        self.refuse("partition", "p.csv", "q.csv", "--parts", 8, says=["'q.csv'"])
        self.refuse("scene", "create", "s", "--parts", 2, "--method", "rbc", says=["--method", "'rbc'", "bands-x"])
        self.refuse("push", "s", "f.csv", "--inserted", -1, says=["--inserted"])
        self.refuse("push", "s", "", says=["empty"])

    def test_endpoints(self):
        for endpoint in ("nonsense", "unix:", "host:0", "host:70000", "host:", ":7470", "host:port", "::1:7470", "",
                         "unix:/" + "x" * 200):
            for command in (("status",), ("push", "s", "f.csv"), ("down",), ("up",),
                            ("partition", "f.csv", "--parts", 2)):
                self.refuse("--endpoint", endpoint, *command, says=["endpoint"])
        for endpoint in ("nonsense", "unix:", "host:0"):
            done = subprocess.run([RCBCTL, "status"], capture_output=True, text=True, timeout=60,
                                  env=dict(os.environ, RCBD_ENDPOINT=endpoint))
            self.assertEqual(done.returncode, 2, (endpoint, done.stderr))
            self.assertIn(f"'{endpoint}'", done.stderr)

    def test_an_ending_that_names_another_format(self):
        for args in (("history", "s", "--plot", "x.eps"), ("history", "s", "--plot", "x.PDF"),
                     ("history", "s", "--csv", "x.npy"), ("history", "s", "--csv", "x.json"),
                     ("replay", "s", "f.npy", "--history", "h.svg"), ("assign", "s", "--out", "a.csv"),
                     ("partition", "f.csv", "--parts", 2, "--assign", "a.csv"),
                     ("partition", "f.csv", "--parts", 2, "--cuts", "c.npy"),
                     ("compare", "f.csv", "--parts", 2, "--save", "c.csv")):
            self.refuse(*args, says=[args[-2], args[-1], "names another format"])
        for args in (("history", "s", "--plot", "x.svg"), ("history", "s", "--plot", "x.PNG"), ("history", "s", "--csv", "x.txt"),
                     ("assign", "s", "--out", "/dev/null"), ("assign", "s", "--out", "./a.b/part")):
            self.assertEqual(run(*args, endpoint=NOWHERE).returncode, 3, args)

    def test_the_points_are_not_overwritten(self):
        with tempfile.TemporaryDirectory() as folder:
            points = os.path.join(folder, "p.npy")
            np.save(points, np.zeros((4, 3)))
            with open(points, "rb") as file:
                before = file.read()
            os.link(points, os.path.join(folder, "link.npy"))
            os.symlink(points, os.path.join(folder, "p.json"))
            for option, name in (("--assign", "p.npy"), ("--assign", "link.npy"), ("--cuts", "p.json")):
                self.refuse("partition", points, "--parts", 2, option, os.path.join(folder, name),
                            says=[option, name, "overwrite"])
            with open(points, "rb") as file:
                self.assertEqual(file.read(), before)

    def test_nothing_is_left_of_it(self):
        with tempfile.TemporaryDirectory() as folder:
            run("partition", "f.csv", "--parts", 0, "--ranks", 2, "--out", "out", cwd=folder)
            run("up", "-n", 0, "--data-dir", "data", cwd=folder)
            self.assertEqual(os.listdir(folder), [])


if __name__ == "__main__":
    unittest.main(verbosity=2)
