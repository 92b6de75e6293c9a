"""A client that shares memory with the ranks, from PROTOCOL.md alone: write into the arrays, say step."""
import fcntl
import mmap
import os
import socket

import numpy as np
from protocol_client import REQUEST, Client, frame

F_ADD_SEALS, F_SEAL_SHRINK, F_SEAL_GROW = 1033, 2, 4


def memfd(size, seals=F_SEAL_SHRINK | F_SEAL_GROW):
    descriptor = os.memfd_create("positions", os.MFD_ALLOW_SEALING | os.MFD_CLOEXEC)
    os.ftruncate(descriptor, size)
    fcntl.fcntl(descriptor, F_ADD_SEALS, seals)
    return descriptor


class Sharer(Client):
    attempts = memories = 0

    def share(self, descriptor, size, number=1, descriptors=None):
        """Shares a memfd with every rank."""
        for link in self.links:
            link.number += 1
            request = frame(REQUEST, link.number, {"command": "memory.share", "memory": number, "bytes": size})
            socket.send_fds(link.socket, [request], [descriptor] if descriptors is None else descriptors)
        for link in self.links:
            link.answer()

    def memory(self, size):
        """So many bytes that the ranks read."""
        descriptor = memfd(size)
        self.memories += 1
        self.share(descriptor, size, self.memories)
        memory = mmap.mmap(descriptor, size)
        os.close(descriptor)
        return memory


class SharedClient(Sharer):
    def __init__(self, address, **kwargs):
        super().__init__(address, **kwargs)
        self.link_ranks()

    def positions(self, n, dims=3, dtype="<f8"):
        """An array (n, dims) that the ranks read."""
        memory = self.memory(max(1, n) * dims * np.dtype(dtype).itemsize)
        return np.frombuffer(memory, dtype, n * dims).reshape(n, dims)

    def begin(self, scene, step, array, arrays=None, **more):
        """The push of the last array of positions, with its request number."""
        n, dims = array.shape
        width = array.dtype.itemsize
        arrays = arrays or [{"name": "xyz"[a], "offset": a * width, "stride": dims * width} for a in range(dims)]
        memory = [{"number": self.memories} | array for array in arrays]
        self.attempts += 1
        self.number += 1
        return frame(REQUEST, self.number, {
            "command": "push", "scene": scene, "step": step, "attempt": self.attempts,
            "n": n, "way": "shared-memory", "dtype": array.dtype.str, "memory": memory} | more)

    def step(self, scene, step, array, arrays=None, **more):
        self.write(self.begin(scene, step, array, arrays, **more))
        return self.answer()
