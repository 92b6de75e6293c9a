"""Scenes whose positions travel when needed: a step is a count, and the history is that of a scene that is sent them all."""
from protocol_client import Client
from support import *

# What a step with its positions and a step without them tell alike.
FIELDS = ("step", "epoch", "n", "parts", "error_before", "error", "imbalance", "repartitioned", "reason", "axes_flipped",
          "drifted", "moved")


def history(reports):
    return [[report[field] for field in FIELDS] for report in reports]


class Counts(ServiceTest):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.trajectory = os.path.join(cls.dir, "t.npy")
        cls.runs = {}
        for positions in ("every-step", "when-needed"):
            done = run("--points", 1500, "--steps", 200, "--parts", 8, "--positions", positions, "--scene", positions,
                       "--trajectory", cls.trajectory, "--json", endpoint=cls.service.endpoint, check=True,
                       program=os.path.join(BIN, "two_spheres"))
            cls.runs[positions] = json.loads(done.stdout)

    def test_one_history(self):
        sent, counted = self.runs["every-step"], self.runs["when-needed"]
        self.assertEqual([sent["positions"], counted["positions"]], ["every-step", "when-needed"])
        self.assertEqual(history(counted["reports"]), history(sent["reports"]))
        self.assertEqual(counted["repartitions"], 36)
        self.assertEqual(self.service.json("cuts", "when-needed")["hash"], self.service.json("cuts", "every-step")["hash"])

    def test_positions_travel_for_new_cuts_alone(self):
        last = None
        for report in self.runs["when-needed"]["reports"]:
            self.assertEqual(report["sent"], report["repartitioned"], report)
            self.assertEqual(report["way"] == "count", not report["sent"], report)
            last = report["step"] if report["sent"] else last
            self.assertEqual(report["positions_step"], last, report)
            self.assertEqual("positions" in report["skipped"], not report["sent"], report)
            if not report["sent"]:
                self.assertLessEqual(report["bytes"], 16 * 8 + 1024)
        for report in self.runs["every-step"]["reports"]:
            self.assertTrue(report["sent"])
            self.assertEqual(report["positions_step"], report["step"])

    def test_the_program_tells_which_way_a_step_went(self):
        table = self.service.ctl("history", "when-needed", check=True).stdout
        counts = sum(not report["sent"] for report in self.runs["when-needed"]["reports"])
        self.assertEqual(sum("  count  " in line for line in table.splitlines()), counts)
        shown = self.service.json("scene", "show", "when-needed")
        self.assertEqual((shown["positions"], shown["step"]), ("when-needed", 200))
        self.assertEqual(shown["positions_step"], self.runs["when-needed"]["reports"][-1]["positions_step"])

    def test_a_question_takes_what_the_ranks_hold(self):
        """A solver that has the scene open, but makes no step, lets it wait."""
        held = self.runs["when-needed"]["reports"][-1]["positions_step"]
        self.assertLess(held, 200)
        out = os.path.join(self.dir, "held")
        with Client(self.service.endpoint) as solver:
            solver.ask("scene.open", scene="when-needed")
            for question in (["quality"], ["halo", "--width", 0.05], ["assign", "--out", out + ".npy"],
                             ["export", out], ["rebalance", "--dry-run"]):
                ask = [question[0], "when-needed", *question[1:]]
                waited = self.service.failure(*ask, "--deadline", 0.5)
                self.assertEqual((waited["code"], waited["exit"]), ("deadline_exceeded", 5), question)
                self.assertIn("--held", waited["hint"], question)
                told = self.service.json(*ask, "--held")
                self.assertEqual(told.get("positions_step", told.get("step")), held, question)

    def test_a_replay_counts_too(self):
        table = os.path.join(self.dir, "replayed.csv")
        self.service.json("replay", "replayed", self.trajectory, "--parts", 8, "--tolerance", "0.1", "--positions",
                          "when-needed", "--history", table)
        self.assertEqual(history(self.service.json("history", "replayed")), history(self.runs["every-step"]["reports"]))
        rows = np.genfromtxt(table, delimiter=",", names=True, dtype=None, encoding="utf-8")
        reports = self.runs["when-needed"]["reports"]
        self.assertEqual([way == "count" for way in rows["way"]], [not report["sent"] for report in reports])
        self.assertEqual(list(rows["positions_step"]), [report["positions_step"] for report in reports])

    def test_a_client_of_one_page_counts(self):
        client = subprocess.run([sys.executable, os.path.join(os.path.dirname(__file__), "../../client/examples/wire/counts.py"),
                                 self.service.endpoint[len("unix:"):], "by-hand", self.trajectory],
                                stdout=subprocess.PIPE, text=True, timeout=120, check=True)
        reports = [json.loads(line) for line in client.stdout.splitlines()]
        expected = [report | {"drifted": reports[k]["drifted"]} for k, report in enumerate(self.runs["when-needed"]["reports"])]
        self.assertEqual(history(reports), history(expected))
        self.assertEqual([report["way"] == "count" for report in reports],
                         [not report["sent"] for report in self.runs["when-needed"]["reports"]])

    def test_holders_count_together(self):
        for seats in (1, 3):
            scene = f"of-{seats}"
            subprocess.run(["mpirun", "--allow-run-as-root", "--bind-to", "none", "--oversubscribe", "-n", str(seats),
                            os.path.join(BIN, "slope_mpi"), "--points", "4000", "--steps", "30", "--parts", "6", "--tolerance",
                            "0.05", "--positions", "when-needed" if seats > 1 else "every-step", "--scene", scene,
                            "--endpoint", self.service.endpoint], stdout=subprocess.DEVNULL, timeout=240, check=True)
        one, three = (self.service.json("history", f"of-{seats}") for seats in (1, 3))
        fields = [field for field in FIELDS if field != "drifted"]  # which several processes don't count
        self.assertEqual([[report[f] for f in fields] for report in three], [[report[f] for f in fields] for report in one])
        self.assertEqual([report["sent"] for report in three], [report["repartitioned"] for report in three[:-1]] + [True])

    def test_wrong_words(self):
        for failure in (self.service.failure("scene", "create", "s", "--parts", 2, "--positions", "never"),
                        self.service.failure("replay", "s", self.trajectory, "--positions", "")):
            self.assertEqual((failure["code"], failure["exit"]), ("usage", 2))
            self.assertIn("every-step, when-needed", failure["message"])


if __name__ == "__main__":
    unittest.main(verbosity=2)
