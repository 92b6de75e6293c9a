"""rcbd watches a run of LAMMPS, which keeps its own decomposition. INPUT sets all up, but has no `run` (docs/lammps.md):
       mpirun -n 4 python3 watch.py INPUT STEPS EVERY"""
import sys

import numpy as np
import rcbd.mpi
from lammps import lammps
from mpi4py import MPI


class Watch:
    """Every so many time steps of the runs of `lmp` are a step of the scene, in which each process has a seat. Then
    told(time_step, ids, step, imbalance) is called, the last being that of LAMMPS. After a run see whether it has `failed`."""

    def __init__(self, lmp, comm, scene, every, told, **options):
        if lmp.extract_setting("triclinic"):
            raise rcbd.Error("unsupported", "the box is triclinic", "parts are boxes along x, y and z: use an orthogonal box")
        self.lmp, self.comm, self.told, self.dims, self.failed = lmp, comm, told, lmp.extract_setting("dimension"), False
        self.scene = rcbd.mpi.connect(comm, name="LAMMPS").scene(scene, comm=comm, dims=self.dims, replace=True, **options)
        lmp.command(f"fix rcbd all external pf/callback {every} 1")
        lmp.set_fix_external_callback("rcbd", self.push)

    def push(self, _, time_step, count, ids, x, force):
        step = None
        try:  # exceptions that are raised from here LAMMPS takes no notice of
            force[:] = 0
            lo, hi, *_, periodic, _ = self.lmp.extract_box()
            lo, hi = np.where(periodic, lo, -np.inf), np.where(periodic, hi, np.inf)
            inside = rcbd.wrap(x[:, :self.dims].copy(), lo[:self.dims], hi[:self.dims])
            step = self.scene.step(inside, ids)
        except BaseException as failure:
            print(f"rcbd, on process {self.comm.rank}: {failure!s}", file=sys.stderr, flush=True)
            self.scene.close()  # so that no other process waits for this one
        fullest = self.comm.allreduce(count if step else np.inf, MPI.MAX)
        self.failed = fullest == np.inf
        if self.failed:
            self.lmp.force_timeout()  # on all processes: the run ends with this time step
        else:
            self.told(time_step, ids, step, fullest * self.comm.size / step.report.n)


def tell(time_step, ids, step, imbalance):
    if MPI.COMM_WORLD.rank == 0:
        print(f"time step {time_step}: imbalance {imbalance:.3f}, of the parts of rcbd {step.report.imbalance:.3f}")


if __name__ == "__main__":
    run = lammps(cmdargs=["-screen", "none"])  # its words, and its errors, are in log.lammps
    run.file(sys.argv[1])
    watch = Watch(run, MPI.COMM_WORLD, "lammps", sys.argv[3], tell, parts=MPI.COMM_WORLD.size)
    run.command(f"run {sys.argv[2]}")
    sys.exit(watch.failed)
