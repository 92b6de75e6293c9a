"""Blocks by every way, from PROTOCOL.md alone: through the endpoint, to the ranks' sockets, and from memory shared with them."""
import dataclasses

import numpy as np
from protocol_client import REQUEST, arrays_of, described, frame
from shared_memory_client import Sharer

WAYS = ("endpoint", "sockets", "shared-memory")


@dataclasses.dataclass
class Block:
    """The rows of one seat. Without ids row k is the particle k."""

    points: np.ndarray
    ids: np.ndarray = None
    weights: np.ndarray = None
    dtype: str = "<f8"

    def columns(self, rows=slice(None)):
        columns = dict(zip("xyz", self.points[rows].T))
        for name, values in (("w", self.weights), ("id", self.ids)):
            if values is not None:
                columns[name] = values[rows]
        return columns

    def arrays(self, rows=slice(None)):
        return described(self.columns(rows), dict.fromkeys("xyz", self.dtype))


class PushClient(Sharer):
    """`way`: of its pushes, where these don't say another. Ranks get rows as `deal` says, else about as many each."""

    def __init__(self, address, way="endpoint", **kwargs):
        super().__init__(address, **kwargs)
        self.way, self.area = way, b""
        if way != "endpoint":
            self.link_ranks()

    def frames(self, scene, number, block, way=None, deal=None, by_socket=(), each=None, **more):
        """The push of a block, but for rows that follow it; these, each with its socket. A rank's slice comes in frames of `each` rows,
        over its connection also by way of memory, where `by_socket` has it."""
        way, n = way or self.way, len(block.points)
        each = each or n + 1
        self.attempts += 1
        self.push_id = {"scene": scene, "step": number, "attempt": self.attempts}
        push = {"command": "push", **self.push_id, "n": n, "way": way, "dtype": block.dtype,
                "ids": block.ids is not None, "weights": block.weights is not None}
        slices, bulk = [], b""
        if way == "endpoint" and n:
            push["arrays"], bulk = block.arrays()
        elif way != "endpoint":
            if not self.links:
                self.link_ranks()
            deal = np.array_split(np.arange(n), len(self.links)) if deal is None else deal
            push["counts"] = [len(rows) for rows in deal]
            if way == "shared-memory":
                push |= {"memory": self.laid_out(block, np.concatenate(deal)), "sockets": list(by_socket)}
            slices = [(self.links[rank].socket, rows[first: first + each], {"rank": rank, "first": first})
                      for rank, rows in enumerate(deal) if way == "sockets" or rank in by_socket
                      for first in range(0, len(rows), each)]
        self.number += 1
        self.begun = self.number
        whole = frame(REQUEST, self.number, push | more, bulk, flags=1)
        if bulk:
            return whole[:-len(bulk) - 8], [(self.socket, whole[-len(bulk) - 8:])]
        return whole, [(link, self.slice(block, *of)) for link, *of in slices]

    def slice(self, block, rows, place):
        arrays, bulk = block.arrays(rows)
        return frame(REQUEST, self.number, {"command": "push.slice", **self.push_id, "count": arrays[0]["shape"][0],
                                            "arrays": arrays, **place}, bulk, flags=1)

    def laid_out(self, block, rows):
        """Where in the memory the block is, column after column, and the list of rows."""
        memory, columns = [], b""
        for name, values in (block.columns() | {"row": rows}).items():
            dtype = block.dtype if name in "xyz" else {"w": "<f8", "id": "<i8", "row": "<u8"}[name]
            columns += bytes(-len(columns) % 8)
            memory.append({"name": name, "offset": len(columns), "stride": np.dtype(dtype).itemsize})
            columns += values.astype(dtype).tobytes()
        if len(columns) >= len(self.area):
            self.area = self.memory(2 * len(columns) + 8)
        self.area[: len(columns)] = columns
        return [array | {"number": self.memories} for array in memory]

    def push_block(self, scene, number, block, **more):
        """(answer, its arrays)."""
        begin, slices = self.frames(scene, number, block, **more)
        self.socket.sendall(begin)
        for link, data in slices:
            link.sendall(data)
        return self.finish()

    def finish(self):
        """The answer to the last push, whatever was asked since."""
        last, self.number = self.number, self.begun
        try:
            answer, bulk = self.answer()
        finally:
            self.number = last
        return answer, arrays_of(answer, bulk)
