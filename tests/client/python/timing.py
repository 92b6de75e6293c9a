"""What Python adds to C: a count step, Cuts.owner and Cuts.halo from both, in turn; medians in microseconds.

    RCBD_BIN_DIR=build/release/bin /usr/bin/python3 tests/client/python/timing.py
"""
import os
import sys
import time

sys.path[:0] = [os.path.join(os.path.dirname(__file__), *place) for place in (["..", "..", "e2e"], ["..", "..", "..", "client", "python"])]
from support import *  # which finds the programs

import rcbd

WORK = ("step", "owner", "halo")


def medians(endpoint, n, repeats, want):
    took = {name: [] for name in WORK}
    with rcbd.connect(endpoint) as client:
        scene = client.scene("timing", parts=8, replace=True, positions="when-needed")
        xyz = (np.arange(3 * n) * 0.61803398875 % 1).reshape(n, 3)
        scene.step(xyz)
        for _ in range(repeats):
            begin = time.perf_counter()
            step = scene.step(xyz, want_parts=want, want_changed=want)
            sent = step.report.sent
            del step
            took["step"].append(time.perf_counter() - begin)
            assert not sent
        cuts = scene.cuts
        for name, work in (("owner", lambda: cuts.owner(xyz)), ("halo", lambda: cuts.halo(xyz, 0.02))):
            for _ in range(repeats):
                begin = time.perf_counter()
                work()
                took[name].append(time.perf_counter() - begin)
    return [float(np.median(took[name])) * 1e6 for name in WORK]


def main():
    """In turns, of which the least disturbed one counts: its median."""
    with Service(2) as service:
        for n, repeats, turns in ((1500, 500, 15), (1_000_000, 15, 5)):
            for want in (False, True):
                of_c, of_python = [], []
                for _ in range(turns):
                    of_c.append([float(took) for took in run(service.endpoint, n, repeats, int(want), check=True,
                                                             program=os.path.join(BIN, "python_timing")).stdout.split()])
                    of_python.append(medians(service.endpoint, n, repeats, want))
                for name, c, python in zip(WORK, np.min(of_c, axis=0), np.min(of_python, axis=0)):
                    print(f"{n:8} particles, parts {'wanted' if want else 'not wanted':10}  {name:5}  C {c:9.1f}  "
                          f"Python {python:9.1f}  {python - c:+9.1f} us  {100 * (python / c - 1):+6.1f} %")


if __name__ == "__main__":
    main()
