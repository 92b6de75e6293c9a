"""A trajectory told by any number of seats, from PROTOCOL.md alone: any split of the rows, by any ways, sent or counted."""
import contextlib

import judge
import numpy as np
from seat_client import Seat, id_sum
from protocol_client import Client, count_record

FIELDS = ("step", "n", "parts", "error_before", "error", "imbalance", "repartitioned", "reason", "epoch", "moved", "axes_flipped")


class Seats:
    """The solver's processes. `network(k)`: where seat k connects from."""

    def __init__(self, address, scene, seats, positions, rng, ways, network=lambda k: contextlib.nullcontext(), **options):
        self.scene, self.positions, self.rng, self.ways, self.tree, self.known = scene, positions, rng, ways, None, {}
        with network(0):
            self.control = Client(address, token=options.get("token"))
        self.control.ask("scene.create", scene=scene, replace=True, positions=positions, **options.pop("scene_options"))
        self.team = []
        for k in range(seats):
            with network(k):
                self.team.append(Seat(address, scene, k, seats, **options))
                self.team[-1].link_ranks()
        self.incarnation = self.team[0].opened["incarnation"]

    def step(self, number, points):
        """What is one history, and whether the step was sent."""
        order = self.rng.permutation(len(points))
        shares = np.split(order, np.sort(self.rng.integers(0, len(points) + 1, len(self.team) - 1)))
        answer = self.count(number, shares, points) if self.positions == "when-needed" and self.tree else {}
        if "report" not in answer:
            answer = self.send(number, shares, points)
        shown = self.control.ask("scene.show", scene=self.scene)[0]
        return [answer["report"][field] for field in FIELDS] + [shown["hash"]], answer["report"]["sent"]

    def start_count(self, one, number, ids, points, **more):
        counts = np.bincount(self.tree.assign(points[ids], ids), minlength=self.tree.parts)
        counts = {int(part): int(counts[part]) for part in np.flatnonzero(counts)}
        one.send({"command": "count", "scene": self.scene, **more},
                 count_record(number, {**self.known, "incarnation": self.incarnation}, counts, id_sum=id_sum(ids)))

    def count(self, number, shares, points):
        for one, ids in zip(self.team, shares):
            self.start_count(one, number, ids, points)
        answers = [one.answer()[0] for one in self.team]
        assert all(answer == answers[0] for answer in answers), answers
        return answers[0]

    def send(self, number, shares, points):
        for one, ids in zip(self.team, shares):
            one.start(number, ids, points, way=str(self.rng.choice(self.ways)), cuts_known=self.known)
        answers = [one.finish() for one in self.team]
        assert all(answer["report"] == answers[0][0]["report"] for answer, _ in answers), answers
        answer, arrays = answers[0]
        if "cuts" in answer:
            self.known = {name: answer["cuts"][name] for name in ("epoch", "hash")}
            self.tree = judge.Tree.of_arrays(arrays, points.shape[1])
        return answer

    def close(self):
        for one in [*self.team, self.control]:
            one.close()


def history(trajectory, *args, **options):
    """(the history, how many of its steps were sent)"""
    seats = Seats(*args, **options)
    try:
        steps = [seats.step(number, points) for number, points in enumerate(trajectory)]
    finally:
        seats.close()
    return [told for told, _ in steps], sum(sent for _, sent in steps)
