"""tests/client/c/history.c in Python: one of `seats` processes that step a trajectory. history.py ENDPOINT SCENE FILE N DIMS STEPS
PARTS POSITIONS SEAT SEATS."""
import sys

import numpy as np

import rcbd


def main(endpoint, name, file, n, dims, steps, parts, positions, seat, seats):
    n, dims, steps, parts, seat, seats = map(int, (n, dims, steps, parts, seat, seats))
    path = np.fromfile(file).reshape(steps, n, dims)
    seat_of = ((np.arange(parts) + 1) * seats - 1) // parts
    ids = np.arange(seat, n, seats, dtype=np.int32)
    with rcbd.connect(endpoint) as client:
        scene = client.scene(name, parts, replace=True, dims=dims, positions=positions, seat=seat, seats=seats)
        print("made", flush=True)
        for k, xyz in enumerate(path):
            step = scene.step(xyz[ids], ids, send=k == steps - 1)
            told, cuts = step.report, scene.cuts
            assert cuts.epoch == told.epoch
            before = float("nan") if told.error_before is None else told.error_before
            print(told.step, told.n, told.parts, *(format(value, ".17g") for value in (before, told.error, told.imbalance)),
                  int(told.repartitioned), told.epoch, told.moved, told.axes_flipped, cuts.hash, int(told.sent))
            owner = cuts.owner(xyz)
            np.testing.assert_array_equal(step.parts, owner[ids])
            goes = seat_of[owner[ids]]
            rows, to = step.leaving
            np.testing.assert_array_equal(rows, np.flatnonzero(goes != seat))
            np.testing.assert_array_equal(to, goes[rows])
            ids = np.flatnonzero(seat_of[owner] == seat).astype(np.int32)


main(*sys.argv[1:])
