"""The command line, as people and scripts call it."""
import json
import os
import subprocess

import numpy as np
from actor import Actor

NASTY = ("", "-1", "nan", "inf", "1e400", "x", "--", "nowhere/f.csv", "0x7", "1,2,3", "99999999999999999999", "a\nb",
         "é" * 80, "'; ls")


class Commands(Actor):
    expects = "a right command does it, a wrong one says why; always one JSON document, and the exit code that it names"

    def start(self):
        with self.connect(keep=False) as control:
            self.drop_all(control)
        self.folder = os.path.join(self.world.work, "commands", self.name)
        os.makedirs(self.folder, exist_ok=True)
        points = self.rng.random((500, 3))
        self.npy, self.csv = os.path.join(self.folder, "points.npy"), os.path.join(self.folder, "points.csv")
        np.save(self.npy, np.stack([points, points * 0.99, points**2]))
        np.savetxt(self.csv, points, delimiter=",", header="x,y,z", comments="")
        self.scene = self.scene_name()
        self.scenes.append(self.scene)
        self.right(["replay", self.scene, self.npy, "--parts", "7"])

    def turn(self):
        command = self.random.choice(self.commands())
        if self.rng.integers(2):
            return self.right(command)
        command = command.copy()
        for _ in range(self.rng.integers(1, 3)):
            command[self.random.randrange(len(command))] = self.random.choice(NASTY)
        if command[0] not in ("up", "down", "watch"):
            self.count("wrong commands")
            self.call(command)

    def commands(self):
        scene, out = self.scene, os.path.join(self.folder, "out")
        return [
            ["status"], ["scene", "list"], ["scene", "show", scene], ["error", scene], ["counts", scene], ["cuts", scene],
            ["stats", scene], ["quality", scene], ["owner", scene, "0.5", "0.25", "-1e-3"],
            ["box", scene, "0", "0", "0", ".5", ".5", ".5"], ["history", scene, "--last", "2"],
            ["history", scene, "--csv", out + ".csv"], ["assign", scene, "--out", out + ".npy"],
            ["rebalance", scene, "--dry-run", "--parts", "3"], ["push", scene, self.csv],
            ["export", scene, out, "--format", "npy,vtk"], ["partition", self.csv, "--parts", "5", "--assign", out + ".npy"],
            ["compare", self.csv, "--parts", "4"], ["watch", scene, "--for", "1"],
        ]

    def right(self, command):
        code, document, errors = self.call(command)
        failure = document.get("failure", {}) if isinstance(document, dict) else {}
        # rcbctl's own deadline knows nothing of a build with sanitizers.
        fair = ("busy",) if self.world.patience == 1 else ("busy", "deadline_exceeded")
        self.expect(code == 0 or failure.get("code") in fair, command, "ended with", code, document, errors)

    def call(self, command):
        """(exit code, its document, what it said to people)."""
        self.count("commands")
        try:
            done = subprocess.run([os.path.join(self.world.programs, "rcbctl"), *command, "--json", "--endpoint",
                                   self.world.endpoint], stdin=subprocess.DEVNULL, capture_output=True,
                                  timeout=self.world.answer_seconds, cwd=self.folder)
        except subprocess.TimeoutExpired:
            self.expect(False, command, f"did not end within {self.world.answer_seconds:.0f} s")
        errors = done.stderr.decode(errors="replace")
        self.expect(0 <= done.returncode <= 5, command, "ended with", done.returncode, errors)
        if command[0] == "watch" or not done.stdout:
            self.expect(command[0] == "watch" or done.returncode == 2, command, "says nothing", errors)
            return done.returncode, None, errors
        document = json.loads(done.stdout)
        if done.returncode:
            self.expect(document["failure"]["exit"] == done.returncode, command, "ended with", done.returncode, document)
        return done.returncode, document, errors
