"""Seats of a parallel solver, from PROTOCOL.md alone."""
import numpy as np
from protocol_client import count_record
from push_client import Block, PushClient


def owner(parts, count, seats):
    """The seat of each part."""
    of_part = np.concatenate([np.full((k + 1) * count // seats - k * count // seats, k) for k in range(seats)])
    return of_part[parts]


def id_sum(ids):
    """Of SplitMix64's finaliser over the ids, mod 2^64, as a count says it."""
    v = np.asarray(ids).astype(np.uint64) + np.uint64(0x9E3779B97F4A7C15)
    v = (v ^ v >> np.uint64(30)) * np.uint64(0xBF58476D1CE4E5B9)
    v = (v ^ v >> np.uint64(27)) * np.uint64(0x94D049BB133111EB)
    return int((v ^ v >> np.uint64(31)).sum(dtype=np.uint64))


class Seat(PushClient):
    """Seat k of M. What it has is said by ids, which are the rows of all positions."""

    def __init__(self, path, scene, seat, seats, generation=None, **kwargs):
        super().__init__(path, **kwargs)
        self.scene, self.seat, self.seats = scene, seat, seats
        self.opened = self.ask("scene.open", scene=scene, seat=seat, seats=seats, generation=generation)[0]

    def begin(self, number, rows, points, cut=None, **more):
        """Of the push all but the last `cut` bytes; None: all but the rows."""
        begin, slices = self.frames(self.scene, number, Block(points[rows], rows), **{"deadline_seconds": 20, **more})
        self.socket.sendall(begin)
        self.slices = slices
        if cut is not None:
            self.socket.sendall(slices[0][1][:-cut])

    def rest(self):
        for link, data in self.slices:
            link.sendall(data)

    def count(self, number, ids, inserted=0, removed=0):
        """In a scene of one part."""
        cuts = self.ask("cuts", scene=self.scene)[0]
        self.send({"command": "count", "scene": self.scene},
                  count_record(number, {**self.opened, **cuts}, [len(ids)][:len(ids)], inserted=inserted, removed=removed,
                               id_sum=id_sum(ids)))
        self.begun = self.number

    def start(self, number, rows, points, **more):
        self.begin(number, rows, points, **more)
        self.rest()
