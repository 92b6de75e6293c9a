"""Looks at the service's processes every so often, at its log and at what the sanitizers wrote; judges at the end."""
import collections
import os
import re
import time

import numpy as np
import sanitizers
from protocol_client import Client, Refused
from support import processes_of

# What may grow over the second half of a run: the least memory in use, by a straight line through it.
GROWTH_BYTES_MAX = 24 << 20
GROWTH_SHARE_MAX = 0.1
WINDOWS = 12  # of the second half; each gives its least value, so that what comes and goes doesn't count
LOUD = re.compile(r" (error|critical): ")


def proportional_private_bytes(pid):
    with open(f"/proc/{pid}/smaps_rollup") as file:
        for line in file:
            if line.startswith("Pss_Anon:"):
                return int(line.split()[1]) << 10
    return 0


class Watcher:
    def __init__(self, service, world):
        self.service, self.world = service, world
        self.samples = collections.defaultdict(list)  # by process: (time, memory, descriptors, threads)
        self.names = {}
        self.latencies = []
        self.loud, self.findings = [], {}
        self.lines = 0
        self.log_at, self.log_inode = 0, None
        self.unexpected = []

    def processes(self):
        """The service's processes by pid: rank k, mpirun, supervisor."""
        found = {pid: f"rank {k}" for k, pid in enumerate(self.world.rank_pids())}
        for pid, line in processes_of(self.world.data):
            program = os.path.basename(line.split()[0])
            if pid not in found and program in ("mpirun", "rcbctl"):
                found[pid] = "mpirun" if program == "mpirun" else "supervisor"
        return found

    def sample(self):
        now = time.monotonic()
        present = self.processes()
        self.look_for_deaths(present)
        for pid, name in present.items():
            try:
                one = (now, proportional_private_bytes(pid), len(os.listdir(f"/proc/{pid}/fd")),
                       len(os.listdir(f"/proc/{pid}/task")))
            except OSError:
                continue
            self.names[pid] = name
            self.samples[pid].append(one)
        self.ask()
        self.read_log()
        self.read_findings()

    def look_for_deaths(self, present):
        for pid, name in [item for item in self.names.items() if item[0] not in present]:
            if self.world.deaths.value == 0:
                self.unexpected.append(f"{name} (pid {pid}) ended")
            del self.names[pid]

    def ask(self):
        """How long `status` takes; a service that doesn't answer at all is the actors' to notice."""
        begin = time.monotonic()
        try:
            with Client(self.world.endpoint, timeout=self.world.answer_seconds) as client:
                client.ask("status")
            self.latencies.append(time.monotonic() - begin)
        except (OSError, EOFError, Refused):
            self.latencies.append(float("nan"))

    def read_log(self):
        """New lines, those of a log that was rotated meanwhile included."""
        path = os.path.join(self.world.data, "rcbd.log")
        try:
            inode = os.stat(path).st_ino
            if self.log_inode not in (None, inode):
                self.take_lines(path + ".1", self.log_at)
                self.log_at = 0
            self.log_inode = inode
            self.log_at = self.take_lines(path, self.log_at)
        except OSError:
            pass

    def take_lines(self, path, offset):
        with open(path, "rb") as file:
            file.seek(offset)
            data = file.read()
        whole = data.rfind(b"\n") + 1
        for line in data[:whole].decode(errors="replace").splitlines():
            self.lines += 1
            if LOUD.search(line) or "CHECK" in line:
                self.loud.append(line)
        return offset + whole

    def read_findings(self):
        self.findings = sanitizers.findings(self.service.reports)

    # The verdict.

    def growth(self, pid):
        """(growth over the second half, allowed) in bytes, of a process that was there all the time; else nothing."""
        samples = np.array([sample[:2] for sample in self.samples[pid]])
        first, last = samples[0, 0], samples[-1, 0]
        half = samples[samples[:, 0] >= (first + last) / 2]
        if len(half) < 2 * WINDOWS:
            return None
        windows = np.array_split(half, WINDOWS)
        times = np.array([window[:, 0].mean() for window in windows])
        least = np.array([window[:, 1].min() for window in windows])
        slope = np.polyfit(times - times[0], least, 1)[0]
        return slope * (last - first) / 2, max(GROWTH_BYTES_MAX, GROWTH_SHARE_MAX * least.mean())

    def judge(self):
        """What is wrong, a line each."""
        wrong = list(self.unexpected)
        for pid, name in self.names.items():
            grown = self.growth(pid)
            if grown and grown[0] > grown[1]:
                wrong.append(f"memory of {name} grew by {grown[0] / 2**20:.1f} MiB over the second half "
                             f"(allowed: {grown[1] / 2**20:.1f})")
        if self.world.deaths.value == 0:
            wrong += [f"in the log: {line}" for line in self.loud[:20]]
        return wrong

    def table(self):
        """Lines for people."""
        yield f"{'process':12} {'MiB first':>10} {'most':>8} {'last':>8} {'growth':>8} {'files':>7} {'threads':>8}"
        for pid, name in sorted(self.names.items(), key=lambda item: item[1]):
            samples = self.samples[pid]
            grown = self.growth(pid)
            memory = [sample[1] / 2**20 for sample in samples]
            yield (f"{name:12} {memory[0]:10.1f} {max(memory):8.1f} {memory[-1]:8.1f} "
                   f"{'-' if grown is None else format(grown[0] / 2**20, '.1f'):>8} "
                   f"{max(sample[2] for sample in samples):7} {max(sample[3] for sample in samples):8}")
        known = [latency for latency in self.latencies if latency == latency]
        if known:
            unanswered = len(self.latencies) - len(known)
            yield (f"status: median {np.median(known) * 1e3:.1f} ms, 99 % {np.quantile(known, 0.99) * 1e3:.0f} ms, "
                   f"longest {max(known):.2f} s, {unanswered} of {len(self.latencies)} without answer")
        yield f"log: {self.lines} lines, {len(self.loud)} of them errors"
