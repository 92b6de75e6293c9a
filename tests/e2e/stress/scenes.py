"""Scenes that come, change and go, by the hundreds."""
import os

import numpy as np
from actor import Actor
from model import Model, check_cut_anew, check_scene
from protocol_client import Refused
from push_client import Block, PushClient

MANY = 900  # of the 1,024 that there may be; others have some


class Scenes(Actor):
    expects = "a thousand scenes are created, pushed, replaced, cut anew and dropped, and none is forgotten or mixed up"

    def start(self):
        self.control = self.connect(PushClient)
        self.drop_all(self.control)
        self.known = {}  # name: (parts, n)
        self.many = int(self.rng.choice([60, 200, MANY], p=[0.5, 0.4, 0.1]))

    def turn(self):
        """Up to `many`, then down to none: a few at a time."""
        for _ in range(5):
            if len(self.known) < self.many:
                self.make()
            else:
                self.empty()
        for _ in range(3):
            if self.known:
                self.change(self.random.choice(list(self.known)))
        if self.counts["turns"] % 20 == 0:
            self.check_list()

    def make(self):
        parts = int(self.rng.integers(1, 40))
        name = self.create(self.control, parts=parts)
        self.known[name] = (parts, 0, 0)
        if self.rng.integers(2):
            self.push(name)
        with_same_name = {"scene": name, "parts": 2}
        if self.rng.integers(20) == 0:
            try:
                self.ask(self.control, "scene.create", **with_same_name)
                self.expect(False, name, "was created twice")
            except Refused as refused:
                self.expect(refused.args[0] == "already_exists", refused.args)

    def push(self, name):
        parts, n, step = self.known[name]
        n = n or int(self.rng.integers(1, 200))
        points = self.rng.random((n, 3))
        answer, _ = self.patiently(self.control.push_block, name, step + 1, Block(points))
        self.expect(answer["report"]["n"] == n, "n of", name, answer["report"], n)
        self.known[name] = (parts, n, step + 1)
        self.count("steps")

    def change(self, name):
        parts, n, step = self.known[name]
        kind = self.random.choice(["push", "replace", "parts", "drop", "look"])
        if kind == "push":
            self.push(name)
        elif kind == "replace":
            self.ask(self.control, "scene.create", scene=name, parts=7, replace=True)
            self.known[name] = (7, 0, 0)
        elif kind == "parts" and n:
            parts = int(self.rng.integers(1, 40))
            answer = self.ask(self.control, "rebalance", scene=name, parts=parts)[0]
            self.expect(answer["parts"] == parts, "parts of", name, answer)
            self.known[name] = (parts, n, step)
        elif kind == "drop":
            self.drop(name)
        elif kind == "look":
            shown = self.ask(self.control, "scene.show", scene=name)[0]
            self.expect((shown["parts"], shown["n"], shown["step"] or 0) == (parts, n, step), "scene", name, shown)
            self.expect(sum(shown["counts"]) == n if n else True, "counts of", name, shown)

    def drop(self, name):
        self.ask(self.control, "scene.drop", scene=name)
        self.scenes.remove(name)
        del self.known[name]
        self.count("dropped")

    def empty(self):
        for name in list(self.known):
            self.drop(name)
        self.many = int(self.rng.choice([60, 200, MANY], p=[0.5, 0.4, 0.1]))

    def check_list(self):
        listed = {scene["scene"]: scene for scene in self.ask(self.control, "scene.list")[0]["scenes"]}
        for name, (parts, n, _) in self.known.items():
            self.expect(name in listed, name, "isn't listed")
            self.expect((listed[name]["parts"], listed[name]["n"]) == (parts, n), "listed", listed[name])


class Files(Actor):
    """Positions by way of files that the ranks read and write themselves."""

    expects = "what is loaded from a file is what would be pushed, and what is written is what the scene holds"
    pause_seconds = 0.5

    def start(self):
        self.control = self.connect()
        self.drop_all(self.control)
        self.folder = os.path.join(self.world.work, "files", self.name)
        os.makedirs(self.folder, exist_ok=True)

    def turn(self):
        dims, parts = int(self.rng.integers(1, 4)), int(self.rng.integers(1, 9))
        self.model = Model.random(self.rng, int(self.rng.integers(1, 2000)), dims, False, False)
        scene = self.create(self.control, parts=parts, dims=dims)
        path = os.path.join(self.folder, "points.npy")
        np.save(path, self.model.points)
        answer = self.ask(self.control, "load", scene=scene, path=path)[0]
        self.expect(answer["report"]["n"] == len(self.model.ids), "loaded", answer["report"])
        hash_of_file = check_scene(self, self.control, scene, self.model)
        self.expect(hash_of_file == check_cut_anew(self, self.control, scene, self.model, parts, "rcb"), "hash of", scene)
        written = self.ask(self.control, "write_parts", scene=scene, directory=self.folder)[0]["files"]
        self.expect(len(written) == parts, "files written", written)
        rows = sum(self.rows(os.path.join(self.folder, name)) for name in written)
        self.expect(rows == len(self.model.ids), "rows written", rows, "of", len(self.model.ids))
        for name in written:
            os.unlink(os.path.join(self.folder, name))
        self.drop_all(self.control)

    def rows(self, path):
        with open(path) as file:
            return sum(1 for _ in file) - 1
