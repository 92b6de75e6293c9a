"""rcbd divides the particles of a simulation into balanced parts, and keeps them balanced while they move.

It is a service; this package is its client, over the C library librcbd.so.1:

    import rcbd

    with rcbd.connect() as client:
        scene = client.scene("jet", parts=8, tolerance=0.1, replace=True)
        for k in range(101):
            step = scene.step(xyz)                # xyz: (n, dims)
            if step.report.repartitioned:
                print(k, step.report.reason)
            part = step.parts                     # (n): the part of each row
            advance(xyz)                          # your solver's work

Which part owns a position, and which particles other parts need as halo, the cuts tell without the service:

    part = scene.cuts.owner(xyz)
    halo = scene.cuts.halo(xyz, 0.05, periodic=(0, 1))
    halo[3]                                       # the rows that part 3 needs of others

A solver of several processes, with mpi4py, has a seat of the scene for each: client.scene(..., comm=comm); help(rcbd.mpi)
says how particles and halos go from one to another.

To see the parts of a plane, with matplotlib:

    step = client.scene("plane", parts=8, dims=2, replace=True).step(xy)
    plt.scatter(xy[:, 0], xy[:, 1], c=step.parts, cmap="tab20", s=2)

In a notebook connect once, and open a scene again with the same client: for another one it is held open by the first.

Failures are rcbd.Error, also a step's positions of other dims than the scene's; wrong types and shapes of arrays TypeError and
ValueError. Ctrl-C ends a call that waits. What is
waited for is logged as warnings of the logger "rcbd" (logging). Arrays that the package gives are no copies, and stay valid
whatever happens to what gave them. Lengths are in the unit of the positions, times in seconds; rows, parts, seats and steps
count from 0. The library is looked for as RCBD_LIBRARY says, else beside the package, in the `lib` that it is below, in the
build folder of a checkout, and by the system.
"""
from ._client import Client, Scene, connect
from ._cuts import Cuts, Halo, Narrowest, wrap
from ._library import Error, __version__, library_path
from ._step import Leaving, Op, Report, Step

__all__ = ["Client", "Cuts", "Error", "Halo", "Leaving", "Narrowest", "Op", "Report", "Scene", "Step", "__version__",
           "connect", "library_path", "wrap"]
for _name in __all__:
    if getattr(globals()[_name], "__module__", "").startswith("rcbd."):
        globals()[_name].__module__ = "rcbd"  # as whom users and help() know it
