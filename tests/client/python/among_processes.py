"""rcbd.mpi on any number of processes, against one that knows all: hand_over, plans, and failures that all are told."""
import sys

import numpy as np
from mpi4py import MPI

import rcbd.mpi

COMM = MPI.COMM_WORLD
SEED, N, BOX = 4305, 900, (np.array([0, -np.inf, 0]), np.array([1.1, np.inf, 2.3]))
LENGTH = np.array([1.1, 0, 2.3])


def raised(code, call):
    """All processes meet a failure of this kind."""
    try:
        call()
    except (rcbd.Error, TypeError, ValueError) as failure:
        found = getattr(failure, "code", type(failure).__name__)
        assert found in code, (found, failure)
        return failure
    raise AssertionError(f"no failure; {code} was expected")


def check_hand_over(step, x, ids):
    """Several arrays at once, of several kinds; compared with what all together have."""
    rows, seats = step.leaving
    arrays = (ids, x, x.astype(np.float32), ids.astype(np.int32)[:, None, None] * np.ones((1, 2, 2), np.int32), ids % 2 == 0)
    everything = COMM.allgather((ids, rows, seats))
    stay = np.ones(len(ids), bool)
    stay[rows] = False
    expected = [ids[stay]] + [theirs[leave[to == COMM.rank]] for theirs, leave, to in everything]
    result = rcbd.mpi.hand_over(COMM, step, *arrays)
    np.testing.assert_array_equal(result[0], np.concatenate(expected))
    for made, array in zip(result, arrays):
        assert made.dtype == array.dtype and made.shape[1:] == array.shape[1:]
    np.testing.assert_array_equal(result[1].astype(np.float32), result[2])
    np.testing.assert_array_equal(result[3][:, 1, 0], result[0])
    np.testing.assert_array_equal(result[4], result[0] % 2 == 0)
    return result[1], result[0]


def check_plan(cuts, x, ids):
    plan = rcbd.mpi.HaloPlan(COMM, cuts, x, 0.1, BOX, ids)
    halos = COMM.allgather(cuts.halo(x, 0.1, BOX, ids, seats=COMM.size))
    all_ids = COMM.allgather(ids)
    sources = [(p, row, shift) for p, halo in enumerate(halos)
               for row, shift in zip(halo[COMM.rank], halo.shifts_for(COMM.rank))]
    assert plan.rows == len(x) and plan.ghosts == len(sources) >= (10 if len(x) else 0)
    all_x = COMM.allgather(x)
    expected = np.array([all_x[p][row] + np.where(shift, shift * LENGTH, 0) for p, row, shift in sources]).reshape(-1, 3)
    ghosts_of = np.array([all_ids[p][row] for p, row, _ in sources], np.int64)
    place, single = plan.with_room(x), plan.with_room(x.astype(np.float32))
    number, speed = plan.with_room(ids), plan.with_room(x[:, 0] * 3)
    fortran = np.asfortranarray(plan.with_room(x))
    for _ in range(2):
        plan.forward(number, speed, positions=(place, single, fortran))
        np.testing.assert_array_equal(place[len(x):], expected)
        np.testing.assert_array_equal(fortran, place)
        wide = np.array([all_x[p][row].astype(np.float32) + shift * LENGTH for p, row, shift in sources]).reshape(-1, 3)
        np.testing.assert_array_equal(single[len(x):], wide.astype(np.float32))
        np.testing.assert_array_equal(number[len(x):], ghosts_of)
        np.testing.assert_array_equal(speed[len(x):], [all_x[p][row, 0] * 3 for p, row, _ in sources])
    check_sums(plan, ids, ghosts_of)
    wrong = [lambda: plan.forward(x), lambda: plan.reverse_add(x), lambda: plan.forward(), lambda: plan.with_room(place),
             lambda: plan.forward(positions=number), lambda: plan.forward(place.astype(object))]
    for call in wrong if plan.ghosts else ():  # is told before anything is sent
        raised(("TypeError", "ValueError"), call)
    for call in (plan.forward, plan.reverse_add):
        place.flags.writeable = False
        raised("ValueError", lambda: call(place))
    check_counts(cuts, x, ids)


def check_counts(cuts, x, ids):
    """Process 0 sends a row less than was agreed: those who receive it say so."""
    plan = rcbd.mpi.HaloPlan(COMM, cuts, x, 0.1, BOX, ids)
    field = plan.with_room(x)
    if COMM.rank == 0:
        plan._send = [rows if p == 0 or rows.stop - rows.start < 2 else slice(rows.start, rows.stop - 1)
                      for p, rows in enumerate(plan._send)]
    coming = plan._receive[0].stop - plan._receive[0].start
    if COMM.rank > 0 and coming > 1:
        failure = raised("invalid_argument", lambda: plan.forward(field))
        assert failure.message == f"process 0 has sent {24 * coming - 24} bytes, where {24 * coming} were expected", failure
    else:
        plan.forward(field)


def check_sums(plan, ids, ghosts_of):
    """Each ghost gives 1 + its id mod 7 to its owner's row: whole numbers, which have one sum in each kind."""
    given = np.zeros(N, np.int64)
    everywhere = COMM.allgather(ghosts_of)
    for ghosts in everywhere:
        np.add.at(given, ghosts, 1 + ghosts % 7)
    for kind in (np.int32, np.int64, np.float32, np.float64):
        field = np.zeros((plan.rows + plan.ghosts, 2), kind)
        field[:plan.rows] = 5
        field[plan.rows:, 1] = 1 + ghosts_of % 7
        before = field[plan.rows:].copy()
        plan.reverse_add(field)
        np.testing.assert_array_equal(field[:plan.rows, 1], 5 + given[ids])
        np.testing.assert_array_equal(field[:plan.rows, 0], 5)
        np.testing.assert_array_equal(field[plan.rows:], before)
    small = np.random.default_rng(SEED).random(plan.rows + plan.ghosts)
    sums = [small.copy(), small.copy()]
    for one in sums:
        plan.reverse_add(one)
    np.testing.assert_array_equal(*sums)


def check_failures(scene, step, x, ids):
    """Of the last process alone; all are told."""
    last = COMM.rank == COMM.size - 1
    alone = ("invalid_argument", "aborted", "TypeError", "ValueError", "not_finite")
    raised(alone, lambda: rcbd.mpi.hand_over(COMM, step, x[:-1] if last else x))
    raised(alone, lambda: rcbd.mpi.hand_over(COMM, step, x.astype(object) if last else x))
    raised(alone, lambda: rcbd.mpi.hand_over(COMM, step))
    if COMM.size > 1:
        raised(alone, lambda: rcbd.mpi.hand_over(COMM, step, x.astype(np.float32) if last else x))
    raised(alone, lambda: rcbd.mpi.HaloPlan(COMM, scene.cuts, x * np.nan if last else x, 0.1, BOX, ids))
    raised(alone, lambda: rcbd.mpi.HaloPlan(COMM, scene.cuts, x, -0.1, BOX, ids))
    if COMM.size > 1:  # rows that were not handed over
        failure = raised(("invalid_argument", "aborted"), lambda: rcbd.mpi.HaloPlan(COMM, scene.cuts, x, 0.1, BOX, ids))
        assert len(step.leaving.rows) == 0 or f"{len(step.leaving.rows)} of {len(x)} rows belong to other" in failure.message, failure
    failure = raised("busy", lambda: rcbd.mpi.agree(COMM, rcbd.Error("busy", "m\u00e4ssage", "hint") if last else None))
    assert (failure.message, failure.hint) == ("m\u00e4ssage", "hint")
    raised("unavailable", lambda: rcbd.mpi.connect(COMM, "unix:/nonexistent" if last else None))


def main():
    all_x = np.random.default_rng(SEED).random((N, 3)) * [1.1, 1, 2.3]
    client = rcbd.mpi.connect(COMM)
    raised("not_found", lambda: client.scene("nowhere", comm=COMM))
    raised(("invalid_argument", "TypeError", "aborted"), lambda: client.scene("among", -1 if COMM.rank else "x", comm=COMM))
    ids = mine = np.arange(COMM.rank, N, COMM.size)
    last = COMM.rank == COMM.size - 1
    raised(("TypeError", "aborted", "invalid_argument"),
           lambda: rcbd.mpi.step(COMM, client.scene("among", 5, replace=True, comm=COMM), "x" if last else all_x[mine], mine))
    scene = client.scene("among", 5, replace=True, comm=COMM)
    for k in range(4):
        if k:
            all_x[:400] = all_x[:400] * 0.8
        x = all_x[ids]
        step = rcbd.mpi.step(COMM, scene, x, ids)
        check_failures(scene, step, x, ids) if k == 0 else None
        x, ids = check_hand_over(step, x, ids)
        np.testing.assert_array_equal(x, all_x[ids])
        check_plan(scene.cuts, x, ids)
    if COMM.rank == 0:
        print("all is well")


try:
    main()
except BaseException:
    import traceback

    traceback.print_exc()
    sys.stderr.flush()
    COMM.Abort(1)
