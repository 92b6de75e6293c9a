"""Members of a parallel solver, from PROTOCOL.md alone."""
import numpy as np
from protocol_client import REQUEST, Client, arrays_of, described, frame


def owner(parts, count, members):
    """The member of each part."""
    of_part = np.concatenate([np.full((k + 1) * count // members - k * count // members, k) for k in range(members)])
    return of_part[parts]


def handed_over(held, answers):
    """What each member has once all have handed over, by the changes that they were told of what they had."""
    count = len(held)
    to = [owner(news["changed_part"], answer["report"]["parts"], count) for answer, news in answers]
    stay = [np.setdiff1d(ids, news["changed_id"][to[k] != k]) for k, (ids, (_, news)) in enumerate(zip(held, answers))]
    return [np.concatenate([stay[k], *(news["changed_id"][to[other] == k] for other, (_, news) in enumerate(answers)
                                       if other != k)]) for k in range(count)]


class Member(Client):
    """Member k of M, from PROTOCOL.md alone."""

    def __init__(self, path, scene, member, members, **kwargs):
        self.more = {k: kwargs.pop(k) for k in ("follow", "generation") if k in kwargs}
        super().__init__(path, **kwargs)
        self.scene, self.member, self.members = scene, member, members
        self.opened = self.ask("scene.open", scene=scene, member=member, members=members, **self.more)[0]

    def begin(self, step, ids, attempt=0, **more):
        self.push_id = {"scene": self.scene, "session": self.session, "step": step, "attempt": attempt}
        self.send({"command": "push.begin", **self.push_id, "n": len(ids), "slices": int(len(ids) > 0), "order": "id",
                   "ids": True, "changes": True, "deadline_seconds": 20, **more})
        self.begun = self.number

    def slice(self, ids, points, cut=None):
        if len(ids) == 0:
            return
        arrays, bulk = described({**dict(zip("xyz", points[ids].T)), "id": ids})
        document = {"command": "push.slice", **self.push_id, "rank": 0, "count": len(ids), "arrays": arrays}
        if cut is None:
            return self.send(document, bulk)
        self.socket.sendall(frame(REQUEST, self.number + 1, document, bulk)[:-cut])

    def start(self, step, ids, points, attempt=0, **more):
        self.begin(step, ids, attempt, **more)
        self.slice(ids, points)

    def edit(self, holds, columns):
        """Sends what this push inserts or removes."""
        arrays, bulk = described(columns)
        self.send({"command": "push.slice", **self.push_id, "holds": holds, "count": arrays[0]["shape"][0],
                   "arrays": arrays}, bulk)

    def finish(self):
        """(answer with its arrays, by name)."""
        last, self.number = self.number, self.begun
        try:
            answer, bulk = self.answer()
        finally:
            self.number = last
        return answer, arrays_of(answer, bulk)


class DirectMember(Member):
    """Follows its parts, and knows the places of what it holds from the answers, by PROTOCOL.md alone."""

    def __init__(self, path, scene, member, members, **kwargs):
        super().__init__(path, scene, member, members, follow=True, **kwargs)
        self.link_ranks(token=self.token)
        self.places = None  # of each id its rank and slot
        self.removed = ()  # in this step

    def start(self, step, ids, points, attempt=0, **more):
        super().start(step, ids, points, attempt, places=True, **more)

    def begin_directly(self, step, points, attempt=0, few=None, **more):
        """few: the ids of those that moved; None: all."""
        slots = [sorted((slot, i) for i, (at, slot) in self.places.items() if at == rank and (few is None or i in few))
                 for rank in range(len(self.links))]
        self.rows = [np.array([i for _, i in of_rank], int) for of_rank in slots]
        self.slots = None if few is None else [np.array([slot for slot, _ in of_rank], np.uint64) for of_rank in slots]
        counts = [len(rows) for rows in self.rows]
        if few is not None:
            more = {"moved": "some" if few else "none", **more}
        if few is not None and not few:  # then they tell how many stand on each rank
            ranks = [rank for rank, _ in self.places.values()]
            counts = [ranks.count(rank) for rank in range(len(self.links))]
        self.push_id = {"scene": self.scene, "session": self.session, "step": step, "attempt": attempt,
                        "plan": self.plan}
        self.send({"command": "push.begin", **self.push_id, "n": len(self.places), "slices": 0, "order": "plan",
                   "path": "direct", "counts": counts, "epoch": self.epoch,
                   "base_step": self.step, "places": True, "changes": True, "deadline_seconds": 20, **more})
        self.begun = self.number

    def slices(self, points, each=70):
        """(connection, frame) for all that goes to the ranks."""
        for rank, rows in enumerate(self.rows):
            for first in range(0, len(rows), each):
                part = points[rows[first: first + each]]
                columns = dict(zip("xyz", part.T))
                if self.slots is not None:
                    columns["slot"] = self.slots[rank][first: first + each]
                arrays, bulk = described(columns)
                yield self.links[rank].socket, frame(
                    REQUEST, self.number, {"command": "push.slice", **self.push_id, "rank": rank, "first": first,
                                           "count": len(part), "arrays": arrays}, bulk, flags=first % 2)

    def start_directly(self, step, points, attempt=0, **more):
        self.begin_directly(step, points, attempt, **more)
        for link, data in self.slices(points):
            link.sendall(data)

    def finish(self):
        answer, news = super().finish()
        if "place_id" not in news:  # not all have asked for them
            self.places = None
            return answer, news
        if answer["places"] == "all":
            self.places = {}
        to = owner(news["changed_part"], answer["report"]["parts"], self.members)
        for i in news["changed_id"][to != self.member].tolist() + list(self.removed):
            self.places.pop(i, None)
        self.removed = ()
        self.places.update(zip(news["place_id"].tolist(), zip(news["place_rank"].tolist(), news["place_slot"].tolist())))
        self.step, self.epoch, self.plan = answer["report"]["step"], answer["report"]["epoch"], answer["plan"]
        return answer, news
