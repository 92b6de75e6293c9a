"""Members of a parallel solver, from PROTOCOL.md alone."""
import numpy as np
from push_client import Block, PushClient


def owner(parts, count, members):
    """The member of each part."""
    of_part = np.concatenate([np.full((k + 1) * count // members - k * count // members, k) for k in range(members)])
    return of_part[parts]


class Member(PushClient):
    """Member k of M. What it has is said by ids, which are the rows of all positions."""

    def __init__(self, path, scene, member, members, generation=None, **kwargs):
        super().__init__(path, **kwargs)
        self.scene, self.member, self.members = scene, member, members
        self.opened = self.ask("scene.open", scene=scene, member=member, members=members, generation=generation)[0]

    def begin(self, number, rows, points, cut=None, **more):
        """Of the push all but the last `cut` bytes; None: the begin alone."""
        begin, slices = self.frames(self.scene, number, Block(points[rows], rows), **{"deadline_seconds": 20, **more})
        self.socket.sendall(begin)
        self.slices = slices
        if cut is not None:
            self.socket.sendall(slices[0][1][:-cut])

    def rest(self):
        for link, data in self.slices:
            link.sendall(data)

    def start(self, number, rows, points, **more):
        self.begin(number, rows, points, **more)
        self.rest()
