"""What a scene must be: the pusher's own copy of it, and the service's answers held against that."""
import dataclasses

import judge
import numpy as np
from protocol_client import arrays_of
from push_client import Block


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
    ids: np.ndarray
    points: np.ndarray
    weights: np.ndarray = None

    @staticmethod
    def random(rng, n, dims, own_ids, weighted):
        ids = rng.choice(20 * n + 20, n, replace=False).astype("<i8") if own_ids else np.arange(n)
        weights = rng.integers(0, 40, n) / 4 if weighted else None  # their sums are exact
        points = rng.random((n, dims)) * rng.choice([1, 2, 0.5], dims)
        if rng.integers(3) == 0:
            points = np.round(points, 1)  # ties
        return Model(ids, points, weights)

    def move_on(self, rng):
        """Moves the particles, and now and then lets some come and go. Gives how many, as a push says it."""
        n, dims = self.points.shape
        kind, dtype = rng.choice(["drift", "drift", "jump", "few", "none"]), rng.choice(["<f8", "<f8", "<f4"])
        moving = np.flatnonzero(rng.random(n) < {"few": 0.01, "none": 0}.get(kind, 1))
        self.points = self.points.copy()
        self.points[moving] = self.points[moving] * rng.choice([1, 0.97]) + rng.normal(
            0, 0.5 if kind == "jump" else 0.02, (len(moving), dims))
        said = {}
        if rng.integers(3) == 0:
            gone, come = (int(rng.integers(30)) if n > 60 else 0), int(rng.integers(30))
            stay = rng.permutation(n)[gone:]
            self.points = np.concatenate([self.points[stay], rng.random((come, dims))])
            self.ids = np.append(self.ids[stay], self.ids.max(initial=-1) + 1 + rng.permutation(3 * come)[:come])
            if self.weights is not None:
                self.weights = np.append(self.weights[stay], rng.integers(0, 40, come) / 4)
            said = {"inserted": come, "removed": gone}
        elif self.weights is not None and rng.integers(4) == 0:
            self.weights = rng.integers(0, 40, n) / 4
        if dtype == "<f4":
            self.points = self.points.astype("<f4").astype("<f8")
        self.dtype = str(dtype)
        return said

    def block(self, rng):
        """The rows in some order, without ids where these say nothing."""
        n = len(self.ids)
        if np.array_equal(self.ids, np.arange(n)) and rng.integers(2):
            return Block(self.points, None, self.weights, self.dtype)
        rows = rng.permutation(n)
        return Block(self.points[rows], self.ids[rows], None if self.weights is None else self.weights[rows], self.dtype)

    dtype = "<f8"


class Told:
    """The cuts, as the answers to pushes tell them."""

    known, tree = {}, None

    def take(self, answer, arrays):
        if "cuts" in answer:
            self.known = {name: answer["cuts"][name] for name in ("epoch", "hash")}
            self.tree = judge.Tree.of_arrays(arrays, answer["cuts"]["dims"])


def check_report(actor, report, scene, number, n):
    actor.expect((report["scene"], report["step"], report["n"]) == (scene, number, n), "report of", scene, number, n, report)
    actor.expect(report["imbalance"] >= 1 or n == 0, "imbalance below 1", report)
    actor.expect(report["repartitioned"] or report["moved"] == 0, "moved without new cuts", report)


def check_scene(actor, client, scene, model, told=None):
    """No particle lost, each where the model has it, and in the part that the cuts give it. Returns the partition's hash."""
    n, dims = model.points.shape
    rows = np.argsort(model.ids)
    model = Model(model.ids[rows], model.points[rows], None if model.weights is None else model.weights[rows])
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
    if told:
        actor.expect(told.known["hash"] == shown["hash"], "cuts of", scene, "as told", told.known, "not", shown["hash"])
        actor.expect(np.array_equal(told.tree.assign(model.points, model.ids), expected), "parts by the cuts told of", scene)
    counts = actor.ask(client, "counts", scene=scene)[0]
    actor.expect(sum(counts["counts"]) == n, "sum of counts of", scene, counts)
    actor.expect(np.array_equal(np.bincount(expected, minlength=tree.parts), counts["counts"]), "counts of", scene)
    if model.weights is not None and shown["weights"]:
        weights = model.weights if len(set(model.weights)) > 1 else np.ones(n)  # equal ones count as none
        loads = np.bincount(expected, weights=weights, minlength=tree.parts)
        actor.expect(np.array_equal(loads, counts["loads"]), "loads of", scene, counts["loads"], loads)
    elif model.weights is None:
        error = actor.ask(client, "error", scene=scene)[0]["error"]
        actor.expect(error == judge.error_of(counts["counts"], n), "error of", scene, error)
    return shown["hash"]


def check_cut_anew(actor, client, scene, model, parts, method):
    """A rebalance follows the rule alone, whatever came before: the judge finds the same parts."""
    answer = actor.ask(client, "rebalance", scene=scene, parts=parts, method=method)[0]
    if model.weights is None:
        rows = np.argsort(model.ids)
        expected = judge.partition(model.points[rows], parts, method, model.ids[rows])[1]
        assigned = arrays_of(*actor.ask(client, "assign", scene=scene))["part"]
        actor.expect(np.array_equal(assigned, expected), "parts of", scene, "after rebalance to", parts, method)
    return answer["hash"]
