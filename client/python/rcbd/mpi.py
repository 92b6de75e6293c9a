"""What a solver of several processes needs besides, over its own communicator (mpi4py).

    comm = MPI.COMM_WORLD
    client = rcbd.mpi.connect(comm)
    scene = client.scene("jet", parts=64, comm=comm)           # a seat for each process
    step = rcbd.mpi.step(comm, scene, xyz, ids)
    xyz, ids, velocity = rcbd.mpi.hand_over(comm, step, xyz, ids, velocity)
    plan = rcbd.mpi.HaloPlan(comm, scene.cuts, xyz, 0.05, periodic=(0, 1), ids=ids)
    xyz, velocity = plan.with_room(xyz), plan.with_room(velocity)
    plan.forward(velocity, positions=xyz)                      # many times, until lists are rebuilt
    plan.reverse_add(forces)

All processes of the communicator make these calls, in the same order. What fails on one process in connect, scene(comm=...),
step, hand_over and HaloPlan all raise, but for what has no memory after the numbers of rows were exchanged.
HaloPlan.forward() and reverse_add() only check their arguments before anything is sent, and how many rows have come: then one
process alone raises. So run such a program by `mpirun python3 -m mpi4py PROGRAM`, by which an error ends all. Messages have the tag 7470: no receive for any tag may wait
on the communicator meanwhile; else give a duplicate, comm.Dup().
"""
from __future__ import annotations

import zlib
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Iterator, List, Optional, Sequence, Tuple, Union

import numpy as np
from mpi4py import MPI
from mpi4py.util import dtlib

from ._client import Client, Scene
from ._client import connect as connect_alone
from ._cuts import Cuts
from ._library import Error
from ._step import Ask, Step

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from ._arrays import Periodic

__all__ = ["HaloPlan", "agree", "connect", "hand_over", "scene_open", "step", "together"]

_TAG = 7470
_TEXT_BYTES = 2048


def agree(comm: MPI.Comm, failure: Optional[BaseException] = None) -> None:
    """All processes go on, or all raise: who has failed alone gives its exception here, the others None.

    Raises:
        Error: that of the lowest rank that failed; by that process what it gave.
    """
    mine, first = np.array([comm.rank if failure else comm.size]), np.empty(1, int)
    comm.Allreduce(mine, first, MPI.MIN)
    if first[0] == comm.size:
        return
    text = np.zeros(_TEXT_BYTES, np.uint8)
    if first[0] == comm.rank:
        words = "\0".join(_words_of(failure)).encode()[: _TEXT_BYTES - 1]
        text[: len(words)] = np.frombuffer(words, np.uint8)
    comm.Bcast(text, int(first[0]))
    if failure:
        raise failure
    raise Error(*text.tobytes().decode(errors="replace").split("\0")[:3])


def _words_of(failure: Optional[BaseException]) -> Tuple[str, str, str]:
    if isinstance(failure, Error):
        return failure.code, failure.message, failure.hint
    code = "invalid_argument" if isinstance(failure, (TypeError, ValueError)) else "aborted"
    return code, f"{type(failure).__name__}: {failure}", ""


@contextmanager
def together(comm: MPI.Comm) -> Iterator[None]:
    """`with together(comm):` around what may fail on one process alone: then all raise (agree) at its end."""
    failure = None
    try:
        yield
    except Exception as fault:
        failure = fault
    agree(comm, failure)


def connect(comm: MPI.Comm, endpoint: Optional[str] = None, **options: Any) -> Client:
    """rcbd.connect() on all processes; if one fails, all raise an Error."""
    with together(comm):
        client = connect_alone(endpoint, **options)
    return client


def scene_open(comm: MPI.Comm, client: Client, name: str, parts: int = 0, **options: Any) -> Scene:
    """Client.scene() with a seat for each process, its rank; seat 0 makes the scene. If one fails, all raise an Error. The same
    as client.scene(name, parts, ..., comm=comm)."""
    scene: Optional[Scene] = None
    for turn in (comm.rank == 0, comm.rank > 0):
        try:
            with together(comm):
                if turn:
                    scene = client.scene(name, parts, seat=comm.rank, seats=comm.size, **options)
        except BaseException:
            if scene is not None:
                scene.close()
            raise
    assert scene is not None
    return scene


def step(comm: MPI.Comm, scene: Scene, xyz: ArrayLike, ids: Optional[ArrayLike] = None, weights: Optional[ArrayLike] = None,
         **options: Any) -> Step:
    """Scene.step() on all processes. Where an argument is wrong on one, nothing is sent, and all raise an Error. Where the step
    fails on one, that one closes its scene, so that the others do not wait for it, and all raise an Error."""
    with together(comm):
        ask = Ask(xyz, ids, weights, **options)
    with together(comm):
        try:
            made = scene._make(ask)
        except BaseException:
            scene.close()
            raise
    return made


# ---- rows between processes ----


def _record(fields: Sequence[NDArray[Any]], rows: int) -> np.dtype[Any]:
    """A row of all these arrays together. They are checked."""
    kinds = []
    if not fields:
        raise ValueError("no arrays are given")
    for k, field in enumerate(fields):
        if not isinstance(field, np.ndarray) or field.dtype.kind not in "biufc" or not field.dtype.isnative:
            what = field.dtype if isinstance(field, np.ndarray) else type(field).__name__
            raise TypeError(f"array {k} is {what}; give arrays of numbers in this machine's byte order")
        if field.ndim == 0 or len(field) != rows:
            raise ValueError(f"array {k} of shape {field.shape} has not the {rows} rows that are told")
        kinds.append((f"f{k}", field.dtype, field.shape[1:]))
    return np.dtype(kinds, align=True)


def _record_in_place(fields: Sequence[NDArray[Any]], rows: int) -> np.dtype[Any]:
    record = _record(fields, rows)
    for k, field in enumerate(fields):
        if not field.flags.writeable:
            raise ValueError(f"array {k} is read-only, and would be written to")
    return record


def _numbers(comm: MPI.Comm, numbers: Optional[NDArray[Any]], layout: int, failure: Optional[Exception]) -> NDArray[Any]:
    """What each process has for this one, of what each tells the others. None: this process failed; then all raise."""
    mine, theirs = np.full((comm.size, 2), -1), np.empty((comm.size, 2), int)
    if numbers is not None:
        mine[:, 0], mine[:, 1] = numbers, layout
    comm.Alltoall(mine, theirs)
    if failure is not None:
        raise failure
    gave_up = np.flatnonzero(theirs[:, 0] < 0)
    if len(gave_up):
        raise Error("aborted", f"process {gave_up[0]} of the communicator has failed and can't take part",
                    "its own message says why")
    if (theirs[:, 1] != layout).any():
        other = np.flatnonzero(theirs[:, 1] != layout)[0]
        raise Error("invalid_argument", f"process {other} gives arrays of other kinds than process {comm.rank}",
                    "all processes give arrays of the same types and shapes")
    return theirs[:, 0]


def _check_numbers(numbers: NDArray[Any], size: int) -> None:
    if len(numbers) != size:
        raise Error("invalid_argument", f"rows for process {len(numbers) - 1} of a communicator of {size}",
                    "a scene has a seat for each process: open it with this communicator")
    if numbers.sum() > 2**31 - 1:
        raise Error("too_large", f"{numbers.sum()} rows for other processes at once", "at most 2147483647")


def _ends(numbers: NDArray[Any]) -> List[slice]:
    last = np.cumsum(numbers)
    return [slice(int(end - number), int(end)) for number, end in zip(numbers, last)]


def _exchange(comm: MPI.Comm, sent: NDArray[Any], send: List[slice], received: NDArray[Any], receive: List[slice]) -> None:
    """Rows sent[send[p]] go to process p, received[receive[p]] come from it; a message where there are any."""
    kind = dtlib.from_numpy_dtype(sent.dtype).Commit()
    row = sent.dtype.itemsize
    out, into = sent.view(np.uint8), received.view(np.uint8)
    sources = [p for p in range(comm.size) if p != comm.rank and receive[p].stop > receive[p].start]
    requests: List[MPI.Request] = []
    statuses = [MPI.Status() for _ in sources]
    try:
        for p in sources:
            part = into[receive[p].start * row : receive[p].stop * row]
            requests.append(comm.Irecv([part, receive[p].stop - receive[p].start, kind], p, _TAG))
        sends = []
        for p in range(comm.size):
            if p != comm.rank and send[p].stop > send[p].start:
                part = out[send[p].start * row : send[p].stop * row]
                sends.append(comm.Isend([part, send[p].stop - send[p].start, kind], p, _TAG))
        received[receive[comm.rank]] = sent[send[comm.rank]]
        MPI.Request.Waitall(requests, statuses)
        MPI.Request.Waitall(sends)
        for p, status in zip(sources, statuses):
            if status.Get_count(kind) != receive[p].stop - receive[p].start:
                raise Error("invalid_argument", f"process {p} has sent {status.Get_count(MPI.BYTE)} bytes, where "
                            f"{(receive[p].stop - receive[p].start) * row} were expected",
                            "give the same arrays in the same order everywhere, and make plans anew after each step")
    finally:
        kind.Free()


def hand_over(comm: MPI.Comm, step: Step, *arrays: NDArray[Any]) -> Tuple[NDArray[Any], ...]:
    """Gives the rows that step.leaving names to their seats, and takes over those that come: all of these arrays in one
    message to each process that gets any.

    Args:
        comm: the communicator with which the scene was opened.
        step: what Scene.step() gave; the arrays have the rows of that step.
        arrays: (n, ...), of numbers; the same types and shapes of rows on all processes.

    Returns:
        New arrays, as many. Rows that stay keep their order; those that come are behind them, by process, then by their order
        there.

    Raises:
        Error, TypeError, ValueError: by all processes; "aborted" where another one failed.
    """
    numbers = failure = None
    layout = 0
    try:
        rows, seats = step.leaving
        record = _record(arrays, step.rows)
        layout = zlib.crc32(repr(record.descr).encode())
        numbers = np.bincount(seats, minlength=comm.size)
        _check_numbers(numbers, comm.size)
    except Exception as fault:
        numbers, failure = None, fault
    coming = _numbers(comm, numbers, layout, failure)
    assert numbers is not None
    order = rows[np.argsort(seats, kind="stable")]
    sent, received = np.empty(len(rows), record), np.empty(int(coming.sum()), record)
    for k, array in enumerate(arrays):
        sent[f"f{k}"] = array[order]
    _exchange(comm, sent, _ends(numbers), received, _ends(coming))
    stays = np.ones(step.rows, bool)
    stays[rows] = False
    return tuple(np.concatenate([array[stays], received[f"f{k}"]]) for k, array in enumerate(arrays))


def _check_own(comm: MPI.Comm, part: NDArray[np.int32], parts: int) -> None:
    """Seat k of M has the parts [kP/M, (k+1)P/M)."""
    first, last = (parts * k // comm.size for k in (comm.rank, comm.rank + 1))
    others = np.count_nonzero((part < first) | (part >= last))
    if others:
        raise Error("invalid_argument", f"{others} of {len(part)} rows belong to other processes",
                    "hand them over after the step (hand_over), and give the step's ids")


class HaloPlan:
    """Who sends which rows to whom as halo: made when lists are rebuilt, used many times until then. The particles that this
    process needs of others, and images of its own across a periodic border, are its ghosts: the rows behind its own, by
    process, then by row and shift.

    Attributes:
        rows: how many particles this process has.
        ghosts: how many rows are behind them.
    """

    def __init__(self, comm: MPI.Comm, cuts: Cuts, xyz: ArrayLike, width: Union[float, ArrayLike], periodic: Periodic = None,
                 ids: Optional[ArrayLike] = None, *, norm: str = "max", threads: int = 1) -> None:
        """Arguments are those of Cuts.halo(); xyz has the rows of this process, all of which are its own: handed over
        after the last step, and not moved since. Give ids if steps have them.

        Raises:
            Error, TypeError, ValueError: by all processes; "aborted" where another one failed.
        """
        numbers = failure = None
        try:
            _check_own(comm, cuts.owner(xyz, ids, threads=threads), cuts.parts)
            halo = cuts.halo(xyz, width, periodic, ids, norm=norm, seats=comm.size, threads=threads)
            numbers = np.diff(halo.offset)
            _check_numbers(numbers, comm.size)
        except Exception as fault:
            numbers, failure = None, fault
        coming = _numbers(comm, numbers, 0, failure)
        assert numbers is not None
        self._comm = comm
        self._sent, self._send, self._receive = halo.rows, _ends(numbers), _ends(coming)
        self.rows = len(np.asarray(xyz))
        self.ghosts = int(coming.sum())
        self._moves: List[Tuple[int, NDArray[Any], NDArray[Any]]] = []  # axis, entries, by how much
        if halo.shifts is not None and halo.box is not None:
            for axis in range(cuts.dims):
                entries = np.flatnonzero(halo.shifts[:, axis])
                if len(entries):
                    length = halo.box[1][axis] - halo.box[0][axis]
                    self._moves.append((axis, entries, halo.shifts[entries, axis] * length))
        self._rounds = _rounds_of(self._sent)

    def __repr__(self) -> str:
        return f"<rcbd.mpi.HaloPlan of {self.rows} rows and {self.ghosts} ghosts>"

    def with_room(self, array: NDArray[Any]) -> NDArray[Any]:
        """A copy of an array (rows, ...) with room for the ghosts behind, which are 0: (rows + ghosts, ...)."""
        _record([array], self.rows)
        return np.concatenate([array, np.zeros((self.ghosts, *array.shape[1:]), array.dtype)])

    def forward(self, *fields: NDArray[Any], positions: Union[None, NDArray[Any], Sequence[NDArray[Any]]] = None) -> None:
        """Fills the rows of the ghosts from those of their owners, in place: all fields in one message to each process that
        needs any.

        Args:
            fields: (rows + ghosts, ...), of numbers; the same types and shapes of rows on all processes.
            positions: one such array, or several, (rows + ghosts, dims) of floats, to which the images' periods are
                added, each in float64 and then rounded.

        Raises:
            TypeError, ValueError: before anything is sent.
        """
        moved = [positions] if isinstance(positions, np.ndarray) else list(positions or ())
        together_ = [*moved, *fields]
        record = _record_in_place(together_, self.rows + self.ghosts)
        for field in moved:
            if field.dtype.kind != "f" or field.ndim != 2 or any(axis >= field.shape[1] for axis, _, _ in self._moves):
                raise ValueError(f"positions of type {field.dtype} and shape {field.shape}; give (rows + ghosts, dims) of floats")
        sent, received = np.empty(len(self._sent), record), np.empty(self.ghosts, record)
        for k, field in enumerate(together_):
            block = field[self._sent]
            for axis, entries, by in self._moves if k < len(moved) else ():
                block[entries, axis] = block[entries, axis].astype(np.float64) + by
            sent[f"f{k}"] = block
        _exchange(self._comm, sent, self._send, received, self._receive)
        for k, field in enumerate(together_):
            field[self.rows :] = received[f"f{k}"]

    def reverse_add(self, *fields: NDArray[Any]) -> None:
        """Adds the ghosts' rows to those of their owners, in place, such as forces: by process, then by row and shift, so the
        same sums each time. Sums of floats depend on the number of processes, those of integers do not.

        Args:
            fields: (rows + ghosts, ...), of numbers.

        Raises:
            TypeError, ValueError: before anything is sent.
        """
        record = _record_in_place(fields, self.rows + self.ghosts)
        sent, received = np.empty(self.ghosts, record), np.empty(len(self._sent), record)
        for k, field in enumerate(fields):
            sent[f"f{k}"] = field[self.rows :]
        _exchange(self._comm, sent, self._receive, received, self._send)
        for k, field in enumerate(fields):
            values = received[f"f{k}"]
            for entries in self._rounds:
                field[self._sent[entries]] += values[entries]


def _rounds_of(rows: NDArray[np.int64]) -> List[NDArray[np.int64]]:
    """Entries in groups in which no row is twice; of each row the first entry is in the first group, and so on."""
    order = np.argsort(rows, kind="stable")
    new = np.ones(len(rows), bool)
    new[1:] = rows[order][1:] != rows[order][:-1]
    place = np.arange(len(rows))
    nth = np.empty(len(rows), np.int64)
    nth[order] = place - np.maximum.accumulate(np.where(new, place, 0))
    return [np.flatnonzero(nth == n) for n in range(int(nth.max(initial=-1)) + 1)]
