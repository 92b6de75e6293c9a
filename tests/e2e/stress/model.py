"""What a scene must be: the pusher's own copy of it, and the service's answers held against that."""
import dataclasses

import judge
import numpy as np
from protocol_client import arrays_of
from push_client import Step


def tree_of(answer, dims):
    """The judge's tree from the reply to `cuts`."""
    cuts = {cut["node"]: cut for cut in answer["cuts"]}
    found = {}

    def walk(node, first, end):
        cut = cuts[node]
        middle = first + (end - first + 1) // 2
        ties = cut["ties"]
        if ties is None:
            found[first, end] = ([cut["axis"]], None)
        else:
            found[first, end] = ([cut["axis"], *ties["axes"]], [cut["at"], *ties["at"], ties["id"]])
        for child, low, high in ((cut["left"], first, middle), (cut["right"], middle, end)):
            if "node" in child:
                walk(child["node"], low, high)

    if answer["parts"] > 1:
        walk(0, 0, answer["parts"])
    return judge.Tree(dims, answer["parts"], found)


@dataclasses.dataclass
class Model:
    ids: np.ndarray  # ascending
    points: np.ndarray
    weights: np.ndarray = None
    parts: np.ndarray = None  # as the answers' changes tell it
    greatest_id: int = 0

    @staticmethod
    def random(rng, n, dims, own_ids, weighted):
        ids = np.sort(rng.choice(20 * n + 20, n, replace=False)).astype("<i8") if own_ids else np.arange(n)
        weights = rng.integers(0, 40, n) / 4 if weighted else None  # their sums are exact
        points = rng.random((n, dims)) * rng.choice([1, 2, 0.5], dims)
        if rng.integers(3) == 0:
            points = np.round(points, 1)  # ties
        return Model(ids, points, weights, np.full(n, -1), int(ids.max(initial=-1)))

    def next_step(self, rng, base):
        """A step of some kind; the positions that move are moved here already."""
        n, dims = self.points.shape
        kind = rng.choice(["drift", "drift", "jump", "few", "third", "none"])
        dtype = rng.choice(["<f8", "<f8", "<f4"])
        chosen = {"few": min(n, 5), "third": n // 3, "none": 0}.get(kind, n)
        rows = np.arange(n) if chosen == n else np.sort(rng.permutation(n)[:chosen])
        scale = 0.5 if kind == "jump" else 0.02
        moved = self.points[rows] * rng.choice([1, 0.97]) + rng.normal(0, scale, (len(rows), dims))
        self.points = self.points.copy()
        self.points[rows] = moved.astype(dtype)
        if kind in ("drift", "jump") and dtype == "<f4":
            self.points = self.points.astype("<f4").astype("<f8")
        step = Step(self.ids, self.points, moved=None if kind in ("drift", "jump") else self.ids[rows],
                    base_step=base, dtype=str(dtype))
        if self.weights is not None and step.moved is None and rng.integers(4) == 0:
            step.weights = self.weights = rng.integers(0, 40, n) / 4
        if rng.integers(3) == 0:
            self.edit(rng, step)
        return step

    def edit(self, rng, step):
        n, dims = self.points.shape
        count = int(rng.integers(0, 30))
        if count:
            step.inserted = rng.random((count, dims)).astype(step.dtype).astype("<f8")
            if rng.integers(2):
                step.inserted_ids = self.greatest_id + 1 + rng.permutation(3 * count)[:count]
            if self.weights is not None:
                step.inserted_weights = rng.integers(0, 40, count) / 4
        if n > 60:
            step.removed = rng.permutation(self.ids)[: rng.integers(0, 30)]

    def commit(self, step, answer, arrays):
        """What a step that was answered leaves."""
        if step.inserted is not None:
            ids = step.inserted_ids
            if ids is None:
                ids = answer["report"]["first_id"] + np.arange(len(step.inserted))
            self.greatest_id = max(self.greatest_id, int(ids.max()))
            self.ids, self.points = np.append(self.ids, ids), np.concatenate([self.points, step.inserted])
            self.parts = np.append(self.parts, arrays["inserted_part"])
            if self.weights is not None:
                self.weights = np.append(self.weights, step.inserted_weights)
            order = np.argsort(self.ids)
            self.keep(order)
        if len(step.removed):
            self.keep(np.flatnonzero(~np.isin(self.ids, step.removed)))
        self.parts = self.parts.copy()
        self.parts[np.searchsorted(self.ids, arrays["changed_id"])] = arrays["changed_part"]

    def keep(self, rows):
        self.ids, self.points, self.parts = self.ids[rows], self.points[rows], self.parts[rows]
        if self.weights is not None:
            self.weights = self.weights[rows]


def check_report(actor, report, scene, number, n):
    actor.expect((report["scene"], report["step"], report["n"]) == (scene, number, n), "report of", scene, number, n, report)
    actor.expect(report["imbalance"] >= 1 or n == 0, "imbalance below 1", report)
    actor.expect(report["repartitioned"] or report["moved"] == 0, "moved without new cuts", report)


def check_scene(actor, client, scene, model):
    """No particle lost, each where the model has it, and in the part that the cuts give it. Returns the partition's hash."""
    n, dims = model.points.shape
    shown = actor.ask(client, "scene.show", scene=scene)[0]
    actor.expect(shown["n"] == n, "n of", scene, shown["n"], "not", n)
    held = arrays_of(*actor.ask(client, "fetch", scene=scene))
    actor.expect(np.array_equal(held["id"], model.ids), "ids of", scene)
    for axis in range(dims):
        actor.expect(held["xyz"[axis]].tobytes() == model.points[:, axis].astype("<f8").tobytes(), "positions of", scene,
                     "along", "xyz"[axis])
    if model.weights is not None:
        actor.expect(np.array_equal(held["w"], model.weights), "weights of", scene)
    tree = tree_of(actor.ask(client, "cuts", scene=scene)[0], dims)
    expected = tree.assign(model.points, model.ids)
    assigned = arrays_of(*actor.ask(client, "assign", scene=scene))
    actor.expect(np.array_equal(assigned["id"], model.ids), "ids of the assignment of", scene)
    actor.expect(np.array_equal(assigned["part"], expected), "parts of", scene, "against its own cuts")
    actor.expect(np.array_equal(held["part"], expected), "parts that were fetched of", scene)
    actor.expect(np.array_equal(model.parts, expected), "parts of", scene, "as the answers told them")
    counts = actor.ask(client, "counts", scene=scene)[0]
    actor.expect(sum(counts["counts"]) == n, "sum of counts of", scene, counts)
    actor.expect(np.array_equal(np.bincount(expected, minlength=tree.parts), counts["counts"]), "counts of", scene)
    if model.weights is not None and shown["weights"]:
        loads = np.bincount(expected, weights=model.weights, minlength=tree.parts)
        actor.expect(np.array_equal(loads, counts["loads"]), "loads of", scene, counts["loads"], loads)
    elif model.weights is None:
        error = actor.ask(client, "error", scene=scene)[0]["error"]
        actor.expect(error == judge.error_of(counts["counts"], n), "error of", scene, error)
    return shown["hash"]


def check_cut_anew(actor, client, scene, model, parts, method):
    """A rebalance follows the rule alone, whatever came before: the judge finds the same parts."""
    answer = actor.ask(client, "rebalance", scene=scene, parts=parts, method=method)[0]
    if model.weights is None:
        expected = judge.partition(model.points, parts, method, model.ids)[1]
        assigned = arrays_of(*actor.ask(client, "assign", scene=scene))["part"]
        actor.expect(np.array_equal(assigned, expected), "parts of", scene, "after rebalance to", parts, method)
    return answer["hash"]
