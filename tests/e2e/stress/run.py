"""One run: the service, the actors, the watcher, the verdict."""
import collections
import ctypes
import json
import multiprocessing
import os
import signal
import sys
import time

import watcher
from actor import run_actor
from protocol_client import Client
from sanitizers import PATIENCE, of_build
from service import Service
from world import World

PR_SET_PDEATHSIG = 1
SHOWN_MAX = 3  # failures of an actor that are printed in full


class Run:
    def __init__(self, build, seed, ranks, folder, data, seconds, interval):
        self.seed, self.folder, self.seconds, self.interval = seed, folder, seconds, interval
        self.sanitizers = of_build(build)
        patience = PATIENCE[self.sanitizers]
        programs = os.path.join(build, "bin")
        self.service = Service(programs, folder, data, ranks, patience)
        self.world = World(endpoint=self.service.endpoint, tcp=self.service.tcp, data=data, work=folder,
                           programs=programs, ranks=ranks, seed=seed, patience=patience,
                           deaths=multiprocessing.Value("q", 0))
        self.watcher = watcher.Watcher(self.service, self.world)
        self.wrong = []
        self.actors = {}  # name: (process, path of its notes)

    def play(self, classes):
        """Runs one actor of each class (or more: a name may come several times). True if nothing failed."""
        self.service.start()
        try:
            self.service.note_places(self.world.rank_pids())
            self.watcher.sample()
            self.before = self.descriptors()
            self.world.end = time.monotonic() + self.seconds
            self.start_actors(classes)
            self.watch()
            self.join_actors()
            self.settle()
            self.watcher.sample()
            self.wrong += self.watcher.judge()
        finally:
            self.end_actors()
            self.wrong += self.service.stop()
            self.watcher.read_findings()  # leaks are told at a program's end
            self.wrong += [f"sanitizer report {path}:\n{text[:3000]}" for path, text in self.watcher.findings.items()]
        return self.report()

    def start_actors(self, classes):
        numbers = collections.Counter()
        for name, kind in classes:
            actor = kind(self.world, name, numbers[name])
            numbers[name] += 1
            path = os.path.join(self.folder, f"actor-{actor.name}.jsonl")
            process = multiprocessing.get_context("fork").Process(target=self.in_actor, args=(actor, path))
            process.start()
            self.actors[actor.name] = (process, path)

    def in_actor(self, actor, path):
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        run_actor(actor, path)

    def watch(self):
        """Until the time is over; the first and the last look are the callers'."""
        while self.world.left() > 0:
            begin = time.monotonic()
            self.watcher.sample()
            self.progress()
            time.sleep(max(0, min(begin + self.interval - time.monotonic(), self.world.left())))

    def progress(self):
        if sys.stderr.isatty() or self.seconds > 300:
            failed = sum(self.notes(path)[1].get("failures", 0) for _, path in self.actors.values())
            reports = len(self.watcher.findings)
            print(f"{self.seconds - self.world.left():6.0f} s  {failed} failures, {reports} sanitizer reports",
                  end="\r" if sys.stderr.isatty() else "\n", file=sys.stderr, flush=True)

    def join_actors(self):
        """Each ends its turn. One that doesn't hangs, which is said with where it stands."""
        end = time.monotonic() + 90 * self.world.patience
        for name, (process, path) in self.actors.items():
            process.join(max(0, end - time.monotonic()))
            if process.is_alive():
                os.kill(process.pid, signal.SIGUSR1)
                time.sleep(1)
                with open(path) as file:
                    self.wrong.append(f"{name} hangs:\n" + file.read()[-3000:])

    def end_actors(self):
        for process, _ in self.actors.values():
            process.kill()
            process.join()

    def descriptors(self):
        return {pid: len(os.listdir(f"/proc/{pid}/fd")) for pid in self.world.rank_pids()}

    def settle(self):
        """Once everybody has gone the service is as it was before: no scenes, no sessions, no descriptors more."""
        end = time.monotonic() + 100 * self.world.patience
        while True:
            with Client(self.world.endpoint, timeout=self.world.answer_seconds) as client:
                status = client.ask("status")[0]
                left = {"sessions": status["sessions"] - 1, "scenes": len(status["scenes"])}
            after = self.descriptors()
            left["descriptors"] = max((after[pid] - self.before.get(pid, after[pid]) for pid in after), default=0)
            if not any(count > 0 for count in left.values()):
                return
            if time.monotonic() > end:
                self.wrong.append(f"left when all had gone: {left}, scenes {status['scenes'][:3]}")
                return
            time.sleep(0.5)

    # What people read.

    def notes(self, path):
        """(failures, counts) that an actor noted."""
        failures, counts = [], collections.Counter()
        if os.path.exists(path):
            with open(path) as file:
                for line in file:
                    try:
                        note = json.loads(line)
                    except ValueError:
                        continue  # a stack, or half a line
                    if note["kind"] == "counts":
                        counts.update(note["counts"])
                    else:
                        failures.append(note)
        counts["failures"] = max(counts["failures"], len(failures))
        return failures, counts

    def report(self):
        print(f"\nseed {self.seed}, {self.seconds:.0f} s, {self.world.ranks} ranks, "
              f"sanitizers: {self.sanitizers or 'none'}")
        print()
        failed = []
        for name, (_, path) in sorted(self.actors.items()):
            failures, counts = self.notes(path)
            if not counts["turns"]:
                failures.append({"kind": "failure", "turn": 0, "text": "it did nothing"})
            print(f"{name:12} {'ok' if not failures else 'FAILED':7} " +
                  ", ".join(f"{count} {what}" for what, count in counts.items() if count))
            if failures:
                failed.append((name, failures, counts["failures"]))
        print()
        for line in self.watcher.table():
            print(line)
        for name, failures, count in failed:
            print(f"\n{name} failed {count} times; alone: {sys.argv[0]} --only {name.split('-')[0]} --seed {self.seed} "
                  f"--seconds {self.seconds:.0f}")
            for failure in failures[:SHOWN_MAX]:
                print(f"  turn {failure['turn']}, {failure['kind']}: " + failure["text"].replace("\n", "\n    "))
        for line in self.wrong:
            print("\nWRONG: " + line)
        return not failed and not self.wrong
