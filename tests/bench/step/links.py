#!/usr/bin/python3
"""Steps and partitions of a service over several machines (tests/hosts), whose links have a delay and a bandwidth,
beside what the model of docs/scale.md says. Needs root.

    predicted = time on one machine  +  chain * latency  +  bytes on the links  +  frames * work

    time on one machine   of the same, with as many ranks, measured
    chain                 messages of which each waits for the one before it, from machine to machine. The switch counts
                          them, at a delay beside which all else is short
    latency               half of a round trip of 8 bytes over one TCP connection, measured at each setting
    bytes on the links    the longer of two: the bytes that the busiest direction of a link carries, counted, at the speed
                          of a TCP connection that has sent for a while, measured at each setting; and the bytes of all
                          links at that speed without limits, since all machines and the switch are one machine. Less the
                          time of the busiest link's bytes within a machine, which the first term has already
    frames                that all links carry, counted, but for those of the chain
    work                  what one costs this machine: the reciprocal of the 8-byte messages a second that it carries if
                          every machine asks every other at once

With --keep-windows TCP does not begin anew after a pause (net.ipv4.tcp_slow_start_after_idle=0 on all machines).
`rcb_bench hosts` is this program.

    tests/bench/step/links.py [--hosts 2,3,5] [--latency MS,...] [--bandwidth GBIT,...] [--points N] [--repeats K]
                              [--keep-windows] [--counts-alone] [--build DIR] [--json FILE]
"""
import argparse
import itertools
import json
import os
import shutil
import socket
import statistics
import subprocess
import sys
import time

ROOT = os.path.abspath(os.path.join(os.path.dirname(__file__), "..", "..", ".."))
sys.path.insert(0, os.path.join(ROOT, "tests", "hosts"))
from hosts import Hosts

# Variant of rcb_bench step: the machine of its solver. Rank 0 is on a; a solver that counts is put on another one, so that
# its messages cross a link.
STEPS = {"sockets": "a", "count-members": "b"}
DIMS, PARTS = 3, 8  # of the scene `moving` of rcb_bench step
SETTINGS = [(0, 10), (0.5, 10), (1, 10), (5, 10), (1, 1), (1, 0.1)]  # round trip in ms, Gbit/s
COUNTED_AT = 0.04  # seconds from machine to machine
CHUNK, TIMED = 8 << 20, 3  # bytes, and how often they are sent after a first time
ECHO = """
import os, signal, socket
signal.signal(signal.SIGCHLD, signal.SIG_IGN)
listener, room = socket.create_server(("", 9000)), bytearray(1 << 20)
while True:
    connection, _ = listener.accept()
    if os.fork():
        connection.close()
        continue
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    while count := connection.recv_into(room):
        if room[count - 1] == ord("?"):
            connection.send(b"answered")
    break
"""
ASK = """
import socket, sys
with socket.create_connection((sys.argv[1], 9000)) as made:
    made.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    while made.send(b"asked: ?"):
        made.recv(8)
"""
ASKED_FOR = 1.0  # seconds
ASKING = 8  # connections at least, so that all processors are busy


class Bench:
    def __init__(self, hosts, told):
        self.hosts, self.told = hosts, told
        self.steps_of = ["count-members"] if told.counts_alone else list(STEPS)
        self.kinds = self.steps_of + ([] if told.counts_alone else ["partition"])
        self.environment = hosts.environment(RCBD_BIN_DIR=hosts.shared,
                                             RCBD_ENDPOINT="file:" + os.path.join(hosts.shared, "where"))
        for program in ("rcbd", "rcbctl", "rcb_bench"):
            shutil.copy(os.path.join(told.build, "bin", program), hosts.shared)

    def run(self, program, *args, machine="a"):
        return self.hosts.run(machine, os.path.join(self.hosts.shared, program), *args, env=self.environment, check=True,
                              stdout=subprocess.PIPE, text=True).stdout

    def up(self, *ranks):
        self.run("rcbctl", "up", *ranks, "--endpoint", f"{self.hosts.address('a')}:7470", "--trusted-network",
                 "--data-dir", os.path.join(self.hosts.shared, "data"),
                 "--publish", self.environment["RCBD_ENDPOINT"].removeprefix("file:"))

    def step(self, variant, repeats, machine):
        """The median seconds of a step: the least would be those of a step with fewer messages than most."""
        file = os.path.join(self.hosts.shared, "steps.json")
        self.run("rcb_bench", "step", "--scenes", "moving", "--variants", variant, "--ranks", 1, "--points", self.told.points,
                 "--services", self.environment["RCBD_ENDPOINT"], "--repeats", repeats, "--json", file, machine=machine)
        with open(file) as written:
            return json.load(written)["rows"][0]["seconds"]

    def partition(self):
        return json.loads(self.run("rcbctl", "rebalance", "step-sockets", "--json"))["seconds"]

    def seconds(self, machines):
        found = {variant: self.step(variant, self.told.repeats, machines[variant]) for variant in self.steps_of}
        if "partition" in self.kinds:
            found["partition"] = statistics.median(self.partition() for _ in range(self.told.repeats))
        return found

    def links(self, delay, rate):
        for name in self.hosts.names:
            self.hosts.set_link(name, delay / 2, 0, rate)

    def counts(self):
        """The chain, the frames and bytes of all links, and the bytes of each link in each direction."""
        chain, links = self.hosts.counts()
        sent = [sum(link[field] for link in links.values()) for field in ("frames_sent", "bytes_sent")]
        return [chain, *sent] + [link[field] for link in links.values() for field in ("bytes_sent", "bytes_received")]

    def counted(self):
        """(chain, frames, bytes of all links, bytes of the busiest) of each kind: what some more of them add."""
        self.links(COUNTED_AT / 2, 0)
        found = {}
        for kind in self.kinds:
            most, counts = min(20, 2 * self.told.repeats), []
            for repeats in (1, 1 + most):
                before = self.counts()
                if kind == "partition":
                    for _ in range(repeats):
                        self.partition()
                else:
                    self.step(kind, repeats, STEPS[kind])
                counts.append([after - first for after, first in zip(self.counts(), before)])
            chain, frames, size, *sizes = [(many - few) / most for few, many in zip(*counts)]
            found[kind] = round(chain), frames, size, max(sizes)  # a heartbeat may be between two of a chain
        return found

    def work(self):
        """Seconds that this machine takes for a frame, with all its processors."""
        pairs = [(name, other) for name in self.hosts.names for other in self.hosts.names if name < other]
        asking = [subprocess.Popen(self.hosts.command(name, sys.executable, "-c", ASK, self.hosts.address(other)),
                                   stderr=subprocess.DEVNULL)
                  for name, other in pairs * -(-ASKING // len(pairs))]
        first, end = self.counts()[1], time.monotonic() + 60
        while self.counts()[1] < first + 1000:  # a few frames are the systems' own
            assert time.monotonic() < end, "the machines don't answer one another"
            time.sleep(0.1)
        time.sleep(1)
        before, start = self.counts()[1], time.perf_counter()
        time.sleep(ASKED_FOR)
        frames, seconds = self.counts()[1] - before, time.perf_counter() - start
        for process in asking:
            process.kill()
            process.wait()
        return seconds / frames

    def wires(self, to="b"):
        """(latency, speed) of a TCP connection from a to another machine or to itself."""
        with self.hosts.network("a"):
            made = socket.create_connection((self.hosts.address(to), 9000))
        with made:
            made.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            trips = []
            for _ in range(200):
                start = time.perf_counter()
                made.send(b"asked: ?")
                made.recv(8)
                trips.append(time.perf_counter() - start)
            latency = min(trips) / 2
            data, speeds = bytes(CHUNK - 1) + b"?", []
            for _ in range(1 + TIMED):
                start = time.perf_counter()
                made.sendall(data)
                made.recv(8)
                speeds.append(CHUNK / (time.perf_counter() - start - 2 * latency))
            return latency, statistics.median(speeds[1:])


def row(count, told, kind, setting, counted, predicted, seconds, within, latency):
    """within: the seconds on one machine; latency: as measured."""
    trip, rate = setting
    chain, frames, _, size = counted
    return {"scene": "moving", "n": int(told.points), "dims": DIMS, "parts": PARTS, "ranks": count, "hosts": count,
            "tool": "rcbd", "method": "rcb", "work": "partition" if kind == "partition" else "step", "variant": kind,
            "cut_tolerance": 0, "latency": trip / 2000, "bandwidth": rate * 1e9 / 8, "rounds": chain, "frames": frames,
            "bytes": size, "seconds": seconds, "seconds_within": within, "seconds_predicted": predicted,
            "round_trips": (seconds - within) / (2 * latency), "ratio": {"model": seconds / predicted}}


def measure(count, told):
    """The rows of this number of machines; latency is one way, in seconds, bandwidth in bytes a second."""
    rows = []
    with Hosts(count, os.path.join(told.build, "bin", "rcb_switch")) as hosts:
        for name in hosts.names if told.keep_windows else ():
            hosts.run(name, "sh", "-c", "echo 0 >/proc/sys/net/ipv4/tcp_slow_start_after_idle", check=True)
        bench = Bench(hosts, told)
        echoes = [subprocess.Popen(hosts.command(name, sys.executable, "-c", ECHO), stderr=subprocess.DEVNULL)
                  for name in hosts.names]
        bench.up("-n", count)
        alone = bench.seconds(dict.fromkeys(STEPS, "a"))
        bench.run("rcbctl", "down")
        work = bench.work()
        _, speed_within = bench.wires("a")
        _, speed_of_all = bench.wires()
        bench.up("--hosts", ",".join(f"{name}:1" for name in hosts.names))
        counted = bench.counted()
        print(f"{count} machines: {1e6 * work:.1f} us of work a frame, {8e-9 * speed_of_all:.2f} Gbit/s without limits, "
              f"{8e-9 * speed_within:.2f} within one")
        for kind, (chain, frames, all_links, size) in counted.items():
            print(f"{count} machines, {kind}: {1e3 * alone[kind]:.2f} ms on one, chain {chain}, {frames:.0f} frames, "
                  f"{all_links:.0f} bytes, {size:.0f} on a link", flush=True)
        for trip, rate in told.settings:
            bench.links(trip / 2000, 1e9 * rate)
            latency, speed = bench.wires()
            seconds = bench.seconds(STEPS)
            cells = []
            for kind, (chain, frames, all_links, size) in counted.items():
                carried = max(size / speed, all_links / speed_of_all) - size / speed_within
                predicted = alone[kind] + chain * latency + max(0, carried) + max(0, frames - chain) * work
                rows.append(row(count, told, kind, (trip, rate), counted[kind], predicted, seconds[kind], alone[kind], latency))
                cells.append(f"{1e3 * predicted:7.2f} {1e3 * seconds[kind]:7.2f} {seconds[kind] / predicted:5.2f}")
            print(f"{count} | {trip} ms | {rate} | {1e3 * latency:.3f} ms, {8e-9 * speed:.2f} | {' | '.join(cells)}",
                  flush=True)
        bench.run("rcbctl", "down")
        for echo in echoes:
            echo.kill()
    return rows


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hosts", default="2,3,5")
    parser.add_argument("--latency", help="round trips in milliseconds")
    parser.add_argument("--bandwidth", help="Gbit/s")
    parser.add_argument("--points", default="100000")
    parser.add_argument("--repeats", type=int, default=15)
    parser.add_argument("--keep-windows", action="store_true")
    parser.add_argument("--counts-alone", action="store_true", help="no step that sends, and no partition")
    parser.add_argument("--build", default=os.path.join(ROOT, "build", "release"))
    parser.add_argument("--json")
    parser.add_argument("--document", type=json.loads, default={"bench": "hosts"}, help=argparse.SUPPRESS)
    told = parser.parse_args()
    told.settings = SETTINGS
    if told.latency or told.bandwidth:
        lists = [[float(word) for word in (words or "").split(",") if word] for words in (told.latency, told.bandwidth)]
        told.settings = list(itertools.product(lists[0] or [0.5], lists[1] or [10]))
    print(f"machines | round trip | Gbit/s | measured latency, Gbit/s | predicted ms, measured ms, ratio: "
          f"{' | '.join(['count-members'] if told.counts_alone else [*STEPS, 'partition'])}")
    rows = [row for count in told.hosts.split(",") for row in measure(int(count), told)]
    if told.json:
        with open(told.json, "w") as written:
            json.dump({**told.document, "rows": rows}, written, indent=1)


if __name__ == "__main__":
    sys.exit(main())
