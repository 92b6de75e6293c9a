"""What all actors of a run share, by value: each of them is a process of its own."""
import dataclasses
import os
import time


@dataclasses.dataclass
class World:
    endpoint: str  # unix:PATH
    tcp: str  # HOST:PORT, the same service
    data: str  # the service's data directory
    work: str  # the run's own; below it the service may read and write files
    programs: str
    ranks: int
    seed: int
    patience: float  # how much longer than an optimised build this one may take
    end: float = 0.0  # of time.monotonic()
    deaths: object = None  # a shared counter: ranks that were killed on purpose

    @property
    def answer_seconds(self):
        """What a request is given; that it is not answered then is a failure."""
        return 60 * self.patience

    def left(self):
        return self.end - time.monotonic()

    def token(self):
        with open(os.path.join(self.data, "token")) as file:
            return file.read().strip()

    def rank_pids(self):
        """The pids of the ranks, by rank."""
        found = {}
        for pid in filter(str.isdigit, os.listdir("/proc")):
            try:
                with open(f"/proc/{pid}/cmdline", "rb") as file:
                    line = file.read().split(b"\0")
                if not line[0].endswith(b"/rcbd") or self.data.encode() not in line:
                    continue
                with open(f"/proc/{pid}/environ", "rb") as file:
                    variables = file.read().split(b"\0")
            except OSError:
                continue
            rank = next((v for v in variables if v.startswith(b"OMPI_COMM_WORLD_RANK=")), b"=-1")
            found[int(rank.split(b"=")[1])] = int(pid)
        return [found[rank] for rank in sorted(found)]
