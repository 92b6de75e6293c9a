"""An actor: one thing that is done to the service over and over, in a process of its own, and what is expected of it."""
import collections
import faulthandler
import json
import os
import random
import signal
import time
import traceback
import zlib

import numpy as np
from protocol_client import Client, Refused

FAILURES_MAX = 20
LOST = (EOFError, ConnectionError, FileNotFoundError)


class Unexpected(AssertionError):
    """The service did not do what the actor expects of it."""


class Gone(Exception):
    """The service doesn't come back."""


class Actor:
    """`turn` is called until the time is over. It is bounded work, keeps what it knows in `self`, and raises what it did not
    expect. After that, and after a lost connection, `start` is called, which begins with nothing."""

    expects = ""  # one sentence for people
    pause_seconds = 0.0  # between turns, about

    def __init__(self, world, name, number=0):
        self.world, self.name = world, f"{name}-{number}" if number else name
        seed = [world.seed, zlib.crc32(self.name.encode())]
        self.rng = np.random.default_rng(seed)
        self.random = random.Random(seed[0] * 2**32 + seed[1])
        self.counts = collections.Counter()
        self.clients, self.scenes, self.serial = [], [], 0

    # What an actor is made of.

    def start(self):
        pass

    def turn(self):
        raise NotImplementedError

    # What actors say.

    def expect(self, truth, *words):
        if not truth:
            raise Unexpected(" ".join(str(word)[:500] for word in words))

    def count(self, what, by=1):
        self.counts[what] += by

    def note(self, kind, text):
        self.counts["failures"] += kind != "note"
        if self.counts["failures"] <= FAILURES_MAX:
            self.write({"kind": kind, "turn": self.counts["turns"], "at": time.time(), "text": text})

    def write(self, note):
        print(json.dumps(note), file=self.out, flush=True)

    # Speaking to the service.

    def connect(self, make=Client, *arguments, tcp=False, keep=True, **options):
        """A connection, closed when the actor starts anew. Where the service has no seat, it is asked again."""
        options.setdefault("timeout", self.world.answer_seconds + 30 * self.world.patience)
        if tcp:
            options["token"] = self.world.token()
        client = self.patiently(make, self.world.tcp if tcp else self.world.endpoint, *arguments, **options)
        if keep:
            self.clients.append(client)
        return client

    def patiently(self, call, *arguments, **options):
        """Calls again while the service is busy, or has taken the seat from who was too slow to say hello."""
        end = time.monotonic() + self.world.answer_seconds
        while True:
            try:
                return call(*arguments, **options)
            except Refused as refused:
                if refused.args[0] not in ("busy", "unavailable"):
                    raise
                self.count("busy")
                if time.monotonic() > end:
                    raise Unexpected(f"busy for {self.world.answer_seconds:.0f} s: {refused.args[1]}") from None
            time.sleep(self.random.uniform(0.02, 0.2))

    def ask(self, client, command, **arguments):
        self.count("requests")
        arguments.setdefault("deadline_seconds", self.world.answer_seconds)
        return self.patiently(client.ask, command, **arguments)

    def scene_name(self):
        self.serial += 1
        return f"{self.name}-{self.serial}"

    def create(self, client, name=None, **options):
        name = name or self.scene_name()
        self.ask(client, "scene.create", scene=name, **options)
        self.scenes.append(name)
        return name

    def drop_all(self, client):
        while self.scenes:
            name = self.scenes.pop()
            try:
                self.ask(client, "scene.drop", scene=name)
            except Refused as refused:
                self.expect(refused.args[0] == "not_found", "drop of", name, refused.args)

    def close_all(self):
        for client in self.clients:
            client.close()
        self.clients.clear()

    # Its life.

    def live(self, out, turns_max=None):
        """All of it; what happened goes to `out`, a line each, the counts at last."""
        self.out = out
        faulthandler.register(signal.SIGUSR1, file=out, all_threads=True)
        try:
            self.begin()
            while self.world.left() > 0 and (turns_max is None or self.counts["turns"] < turns_max):
                self.guarded(self.turn)
                self.count("turns")
                if self.pause_seconds:
                    time.sleep(max(0, min(self.random.uniform(0.5, 1.5) * self.pause_seconds, self.world.left())))
            self.guarded(self.end)
        except Gone as gone:
            self.note("failure", str(gone))
        self.close_all()
        self.write({"kind": "counts", "counts": self.counts})

    def guarded(self, call):
        try:
            return call()
        except Gone:
            raise
        except Exception as caught:
            fault = caught
        if self.excused():
            self.count("outages")
        else:
            kind = "lost" if isinstance(fault, LOST) else "failure"
            what = "no answer within its deadline: " if isinstance(fault, TimeoutError) else ""
            self.note(kind, what + "".join(traceback.format_exception(fault, limit=-6)))
        self.begin()

    def excused(self):
        """Only a death on purpose excuses a fault. `deaths` is odd from before the kill until the service is back."""
        return self.known_deaths % 2 == 1 or self.world.deaths.value != self.known_deaths

    def begin(self):
        """From nothing; again where the connection is lost meanwhile."""
        end = time.monotonic() + 180 * self.world.patience
        while True:
            self.close_all()
            try:
                self.known_deaths = self.world.deaths.value
                with self.connect(keep=False) as control:
                    self.drop_all(control)
                return self.start()
            except (*LOST, TimeoutError, Refused) as fault:
                if time.monotonic() > end:
                    raise Gone(f"the service doesn't come back: {fault!r}") from None
                time.sleep(0.3)

    def end(self):
        self.close_all()
        with self.connect(keep=False) as control:
            self.drop_all(control)


def run_actor(actor, path, turns_max=None):
    """In the actor's own process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with open(path, "w") as out:
        try:
            actor.live(out, turns_max)
        except BaseException:
            actor.note("failure", traceback.format_exc())
    os._exit(0)
