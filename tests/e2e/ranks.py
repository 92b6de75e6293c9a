"""A service's processes, found from the service itself: its ranks are what its mpirun has started."""
import os
import signal

from protocol_client import Client


def children(pid):
    try:
        with open(f"/proc/{pid}/task/{pid}/children") as file:
            return [int(word) for word in file.read().split()]
    except OSError:
        return []


def parent(pid):
    with open(f"/proc/{pid}/stat") as file:
        return int(file.read().rsplit(")", 1)[1].split()[1])


def supervisor(path):
    """Of the service that answers on this socket: it outlives its job's deaths."""
    with Client(path) as client:
        return parent(parent(client.ask("status")[0]["pid"]))


def ranks(of_supervisor):
    """Those that run just now."""
    return [rank for job in children(of_supervisor) for rank in children(job)]


def kill(pid):
    """False: it has ended already."""
    try:
        os.kill(pid, signal.SIGKILL)
    except ProcessLookupError:
        return False
    return True
