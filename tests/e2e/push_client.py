"""Steps of a single client, from PROTOCOL.md alone: all positions, few or none, float32, weights, insertions and removals;
in the order of the ids or of the plan, by the endpoint or straight to the ranks."""
import dataclasses

import numpy as np
from protocol_client import REQUEST, Client, arrays_of, described, frame

WAYS = ("by-id", "gateway", "direct")


@dataclasses.dataclass
class Step:
    """What a push brings. `points[k]` is where the particle `ids[k]` is after it; `ids` ascend (not at a first push)."""

    ids: np.ndarray
    points: np.ndarray
    weights: np.ndarray = None
    moved: np.ndarray = None  # ids; None: all
    base_step: int = None
    dtype: str = "<f8"
    inserted: np.ndarray = None
    inserted_ids: np.ndarray = None
    inserted_weights: np.ndarray = None
    removed: tuple = ()
    own_ids: bool = False  # said at a first push


class PushClient(Client):
    """Knows no plan by itself: it fetches it before every push."""

    def __init__(self, address, way="by-id", **kwargs):
        super().__init__(address, **kwargs)
        self.way, self.attempts = way, 0
        if way == "direct":
            kwargs.pop("session", None)
            self.link_ranks(**kwargs)

    def layout(self, scene, step):
        """(the rows of `step` that each rank holds, in slot order; the plan's name)."""
        n = len(step.ids)
        if step.own_ids or self.ask("scene.show", scene=scene)[0]["step"] is None:
            ranks = self.hello["ranks"]
            rows = [np.arange(r * n // ranks, (r + 1) * n // ranks) for r in range(ranks)]
            return rows, {"version": 0, "checksum": "0" * 16}
        answer, bulk = self.ask("plan", scene=scene)
        held = np.searchsorted(step.ids, arrays_of(answer, bulk)["id"])
        return np.split(held, np.cumsum(answer["counts"])[:-1]), answer["plan"]

    def frames(self, scene, number, step, each=None, **more):
        """The push of a step: its begin; the slices that insert and remove, and those of positions, each with its socket.
        On the direct path a rank's slice comes in frames of `each` particles."""
        rows, plan = self.layout(scene, step)
        if self.way == "by-id":
            rows = [np.arange(len(step.ids))]
        slots = [np.arange(len(of)) for of in rows]
        if step.moved is not None:
            slots = [np.flatnonzero(np.isin(step.ids[of], step.moved)) for of in rows]
        rows = [of[at] for of, at in zip(rows, slots)]
        some = step.moved is not None and any(map(len, rows))
        direct = self.way == "direct" and (some or step.moved is None)
        self.attempts += 1
        self.number += 1
        self.push_id = {"scene": scene, "session": self.session, "step": number, "attempt": self.attempts, "plan": plan}
        edits = list(self.edit_slices(step))
        begin = {"command": "push.begin", **self.push_id, "n": len(step.ids), "dtype": step.dtype,
                 "order": "id" if self.way == "by-id" else "plan", "path": "direct" if direct else "gateway",
                 "moved": "all" if step.moved is None else "some" if some else "none", "base_step": step.base_step,
                 "counts": [len(of) for of in rows] if some else None, "changes": True,
                 "ids": step.own_ids, "weights": step.weights is not None,
                 "inserted": 0 if step.inserted is None else len(step.inserted), "removed": len(step.removed),
                 "inserted_ids": step.inserted_ids is not None,
                 "slices": len(edits) + (0 if direct else sum(1 for of in rows if len(of))), **more}
        slices = [self.position_slices(step, rank, of, at, some, each if direct else None)
                  for rank, (of, at) in enumerate(zip(rows, slots)) if len(of)]
        return frame(REQUEST, self.number, begin), edits, [one for of_rank in slices for one in of_rank]

    def slice(self, step, columns, **more):
        arrays, bulk = described(columns, dict.fromkeys("xyz", step.dtype))
        count = len(next(iter(columns.values())))
        return frame(REQUEST, self.number, {"command": "push.slice", **self.push_id, "count": count, "arrays": arrays,
                                            **more}, bulk, flags=1)

    def edit_slices(self, step):
        if step.inserted is not None and len(step.inserted):
            columns = dict(zip("xyz", step.inserted.T))
            if step.inserted_weights is not None:
                columns["w"] = step.inserted_weights
            if step.inserted_ids is not None:
                columns["id"] = step.inserted_ids
            yield self.socket, self.slice(step, columns, holds="inserted")
        if len(step.removed):
            yield self.socket, self.slice(step, {"id": np.asarray(step.removed)}, holds="removed")

    def position_slices(self, step, rank, rows, slots, some, each):
        link = self.links[rank] if self.way == "direct" else self
        for first in range(0, len(rows), each or len(rows)):
            of = slice(first, first + (each or len(rows)))
            columns = dict(zip("xyz", step.points[rows[of]].T))
            if step.weights is not None:
                columns["w"] = step.weights[rows[of]]
            if some and self.way != "by-id":
                columns["slot"] = slots[of]
            elif some or step.own_ids:
                columns["id"] = step.ids[rows[of]]
            yield link.socket, self.slice(step, columns, rank=rank, **({"first": first} if each else {}))

    def push_step(self, scene, number, step, **more):
        """(answer, its arrays)."""
        begin, edits, slices = self.frames(scene, number, step, **more)
        self.socket.sendall(begin)
        for link, data in edits + slices:
            link.sendall(data)
        answer, bulk = self.answer()
        return answer, arrays_of(answer, bulk)
