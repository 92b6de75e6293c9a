"""Soft spheres in a periodic box, on the processes of mpirun: mpirun -n 4 python3 dem.py. A process computes the spheres of its
own parts; of the others' it has copies of those that may touch them, the ghosts. At the start spheres fill half of the box, in
two layers that flow past each other.

All bits are the same on any number of processes with the same --parts (default: the number of processes), and in the other
languages: a contact is computed once, by the process that has the sphere of the lower id, by + - * / and sqrt alone, one after
the other, and forces are summed as integers."""
import argparse
import math
import os
import sys
import traceback
from contextlib import contextmanager

import numpy as np
from mpi4py import MPI

import rcbd.mpi

# ---- the solver, which knows nothing of processes ----

D = 1.0  # diameter; the mass is 1
K = 1000.0  # stiffness of a contact
C = 2.0  # its damping
DT = 0.005  # a contact lasts for 14 of these
U = 2.0**32  # an integer force of 1 is this part of a unit


def place(ids, sites):
    """Places and velocities of spheres, on a lattice with so many sites along an axis."""
    site = np.stack([ids // (sites * sites), ids // sites % sites, ids % sites], axis=1)
    random, u = (ids + 1) * 69621 % 2147483647, np.empty((len(ids), 6))
    for k in range(-3, 6):  # the first three are thrown away
        random = random * 16807 % 2147483647
        if k >= 0:
            u[:, k] = random / 2147483647.0
    x, v = 1.2 * (site + (0.4 + 0.2 * u[:, :3])), 2 * u[:, 3:] - 1
    v[:, 0] += np.where(site[:, 1] < sites // 2, 1.0, -1.0)
    return x, v


def pairs_within(width, x, ids, rows):
    """Pairs (i, j) that are so near on each axis, ids[i] < ids[j], i one of the first rows. They are in cells next to each other,
    and the three cells along the last axis are one range of the spheres sorted by cell."""
    if rows == 0:
        return np.empty((2, 0), int)
    at = np.floor((x - x.min(axis=0)) / width).astype(int) + 1
    cells = at.max(axis=0) + 2  # an empty one at each end
    cell = (at[:, 0] * cells[1] + at[:, 1]) * cells[2] + at[:, 2]
    order = np.argsort(cell, kind="stable")
    found = []
    for beside in [(p * cells[1] + q) * cells[2] for p in (-1, 0, 1) for q in (-1, 0, 1)]:
        first = np.searchsorted(cell[order], cell[:rows] + beside - 1, "left")
        count = np.searchsorted(cell[order], cell[:rows] + beside + 1, "right") - first
        i = np.repeat(np.arange(rows), count)
        j = order[np.arange(len(i)) + np.repeat(first - (np.cumsum(count) - count), count)]
        near = (ids[i] < ids[j]) & (np.abs(x[j] - x[i]) <= width).all(axis=1)
        found.append((i[near], j[near]))
    return np.concatenate(found, axis=1)


def forces(x, v, pairs):
    """Forces of all spheres and ghosts, [rows + ghosts][3], as integers."""
    f = np.zeros(x.shape, np.int64)
    i, j = pairs
    d = x[j] - x[i]
    q = (d[:, 0] * d[:, 0] + d[:, 1] * d[:, 1]) + d[:, 2] * d[:, 2]
    touch = (q < D * D) & (q != 0)
    i, j, d, r = i[touch], j[touch], d[touch], np.sqrt(q[touch])
    w = v[i] - v[j]
    closing = (w[:, 0] * d[:, 0] + w[:, 1] * d[:, 1]) + w[:, 2] * d[:, 2]
    g = (K * (D - r) + C * closing / r) / r
    force = np.floor(g[:, None] * d * U + 0.5).astype(np.int64)
    np.add.at(f, j, force)
    np.subtract.at(f, i, force)
    return f


# ---- the coupling ----


def push(comm, scene, side, x, v, ids):
    """Tells where my spheres are, and hands over those that leave. Returns what I have then, and the step's report."""
    with rcbd.mpi.together(comm):
        rcbd.wrap(x, 0, side)
    step = rcbd.mpi.step(comm, scene, x, ids)
    x, v, ids = rcbd.mpi.hand_over(comm, step, x, v, ids)
    return x, v, ids, step.report


def check_reach(comm, x, x0, ids, reach):
    far = ids[~(np.abs(x[: len(x0)] - x0) <= reach).all(axis=1)]
    lowest = comm.allreduce(int(far.min(initial=2**63 - 1)), MPI.MIN)
    if lowest < 2**63 - 1:
        raise rcbd.Error("aborted", f"sphere {lowest} has moved by more than {reach:g} since the last push, so the halo may lack "
                         "spheres that it touches", "push more often (--push-every), or give a greater --reach")


def move_until_next_push(comm, cuts, side, x, v, ids, options):
    """Moves my spheres. A sphere of another process and one of mine may both move by the reach until the next push, towards each
    other: so the halo is as wide as it is. The millionth more is for what is lost in rounding."""
    width, rows = 1.000001 * (D + 2 * options.reach), len(x)
    plan = rcbd.mpi.HaloPlan(comm, cuts, x, width, (0, side), ids)
    x0, x, v, all_ids = x, plan.with_room(x), plan.with_room(v), plan.with_room(ids)
    plan.forward(all_ids)
    pairs = None
    for step in range(options.push_every):
        if step > 0:
            check_reach(comm, x, x0, ids, options.reach)
        plan.forward(v, positions=x)
        if pairs is None:
            pairs = pairs_within(width, x, all_ids, rows)
        f = forces(x, v, pairs)
        plan.reverse_add(f)
        v[:rows] += DT * (f[:rows] / U)
        x[:rows] += DT * v[:rows]
    return x[:rows].copy(), v[:rows].copy()


# ---- the trajectory: doubles [pushes][particles][3] ----


@contextmanager
def writing(comm, options):
    with rcbd.mpi.together(comm):
        try:
            yield
        except OSError as fault:
            raise rcbd.Error("io_error", f"the trajectory {options.trajectory} can't be written: {fault.strerror}", "is there room?")


def open_trajectory(comm, options):
    with writing(comm, options):
        if comm.rank == 0:
            with open(options.trajectory, "wb") as file:
                file.truncate(24 * options.particles * options.pushes)
    with writing(comm, options):  # the others open what process 0 has made
        return os.open(options.trajectory, os.O_WRONLY)


def write_trajectory(comm, file, before, x, ids, options):
    with writing(comm, options):
        for sphere, row in zip(ids.tolist(), x):
            os.pwrite(file, row.tobytes(), 24 * (before + sphere))


# ---- the program ----


def options_of(words):
    parser = argparse.ArgumentParser(prog="dem.py", description="Soft spheres in a periodic box, on the processes of mpirun.")
    parser.add_argument("--particles", type=int, default=500, metavar="N")
    parser.add_argument("--pushes", type=int, default=50, metavar="N")
    parser.add_argument("--push-every", type=int, default=10, metavar="TIME_STEPS")
    parser.add_argument("--parts", type=int, default=0, metavar="N", help="0: one a process")
    parser.add_argument("--reach", type=float, metavar="R", help="how far a sphere may move between two pushes")
    parser.add_argument("--when-needed", action="store_true", help="most pushes send a few numbers in place of positions")
    parser.add_argument("--scene", default="spheres", metavar="NAME")
    parser.add_argument("--endpoint", metavar="E")
    parser.add_argument("--trajectory", metavar="FILE")
    options = parser.parse_args(words)
    if options.reach is None:
        options.reach = 6 * DT * options.push_every  # the fastest begin with 2 along an axis
    if min(options.particles, options.pushes, options.push_every) < 1 or options.parts < 0:
        parser.error("--particles, --pushes and --push-every are 1 or more, --parts is 0 or more")
    if not 0 < options.reach < math.inf:
        parser.error("--reach is a length above 0")
    return options


def run(comm, options):
    sites, n = 4, options.particles
    while sites**3 < 2 * n:
        sites += 1
    side = 1.2 * sites
    if not 2 * 1.000001 * (D + 2 * options.reach) < side:
        raise rcbd.Error("invalid_argument", "the halo is as wide as half of the box, so a sphere could meet two images of another",
                         "take a smaller --reach or --push-every, or more --particles")
    scene = rcbd.mpi.connect(comm, options.endpoint).scene(
        options.scene, parts=options.parts or comm.size, tolerance=0.05, replace=True, comm=comm,
        positions="when-needed" if options.when_needed else "every-step")
    file = open_trajectory(comm, options) if options.trajectory else None
    ids = np.arange(n * comm.rank // comm.size, n * (comm.rank + 1) // comm.size)
    x, v = place(ids, sites)
    repartitioned = 0
    for k in range(options.pushes):
        x, v, ids, report = push(comm, scene, side, x, v, ids)
        repartitioned += report.repartitioned
        if file is not None:
            write_trajectory(comm, file, k * n, x, ids, options)
        cuts = scene.cuts
        x, v = move_until_next_push(comm, cuts, side, x, v, ids, options)
    if comm.rank == 0:
        print(f"pushes {options.pushes}\nrepartitioned {repartitioned}\ncuts {cuts.hash}")


def main():
    comm = MPI.COMM_WORLD
    options = options_of(sys.argv[1:])
    try:
        run(comm, options)
    except rcbd.Error as failure:  # of all processes together
        if comm.rank == 0:
            print(f"dem.py: {failure}", file=sys.stderr)
        sys.exit(1)
    except Exception:
        traceback.print_exc()
        comm.Abort(1)


if __name__ == "__main__":
    main()
