"""Clients and scenes."""
from __future__ import annotations

import os
import sys
from ctypes import byref, c_int64
from time import monotonic
from types import TracebackType
from typing import TYPE_CHECKING, Any, Optional, Type, TypeVar

import numpy as np

from . import _arrays as arrays
from ._cuts import Cuts
from ._library import ConnectOptions, Error, Handle, Positions, SceneOptions, check, lib
from ._step import Ask, Op, Step, begin, make
from ._waiting import QUICK_SECONDS, interruptible, log_notices

if TYPE_CHECKING:
    from mpi4py import MPI
    from numpy.typing import ArrayLike, DTypeLike, NDArray

_T = TypeVar("_T")


def _text(text: Optional[str], what: str) -> Optional[bytes]:
    if text is not None and not isinstance(text, str):
        raise TypeError(f"{what}: {text!r} is no text")
    if text is not None and "\0" in text:
        raise Error("invalid_argument", f"{what}: a text with a null character")
    return None if text is None else text.encode()


class _Closing:
    """What `with` closes."""

    _handle: Handle

    def close(self) -> None:
        """Ends it; calls fail from then on. Arrays, steps and cuts that it gave stay valid. Waits for a call that is under
        way. May be called again."""
        check(lib.rcbd_close(self._handle.pointer))

    def __enter__(self: _T) -> _T:
        return self

    def __exit__(self, kind: Optional[Type[BaseException]], value: Optional[BaseException],
                 trace: Optional[TracebackType]) -> None:
        self.close()


def connect(endpoint: Optional[str] = None, *, name: Optional[str] = None, token: Optional[str] = None,
            path: Optional[str] = None, deadline_seconds: float = 5.0, outlive: bool = True) -> Client:
    """Connects to a service.

    Args:
        endpoint: "unix:PATH", "HOST:PORT" or "file:PATH"; None: RCBD_ENDPOINT, else the user's socket, else
            127.0.0.1:7470.
        name: how messages of the service call this client; None: as the script's file.
        token: for TCP; None: RCBD_TOKEN, else that of the file RCBD_TOKEN_FILE, else that of a service on this machine.
        path: how positions go to the service's ranks: "auto", "shared", "direct" or "gateway"; None: RCBD_PATH, or auto.
        deadline_seconds: at most this long.
        outlive: calls wait until their deadline for a service that has gone; otherwise that is an error at once.

    Raises:
        Error: unavailable (no service), not_authorised, deadline_exceeded, invalid_argument.
    """
    options = ConnectOptions(name=_text(_own_name() if name is None else name, "name"), token=_text(token, "token"), path=_text(path, "path"),
                             deadline_seconds=deadline_seconds, outlive=bool(outlive))
    where = _text(endpoint, "endpoint")
    handle = Handle()
    interruptible(lambda: check(lib.rcbd_connect(where, byref(options), handle.out())))
    return Client(handle, endpoint or os.environ.get("RCBD_ENDPOINT") or "this machine")


def _own_name() -> str:
    script = os.path.basename(str(getattr(sys, "argv", [""])[0]))
    return script if script.isprintable() and script not in ("", "-c", "-m") else "python"


class Client(_Closing):
    """A connection to a service; rcbd.connect() makes it.

    Any thread may use it, and its scenes. Calls take turns; one that waits for its turn until its deadline fails with
    Error busy. After a fork the child's calls fail; the child may connect by itself. What a call waits for, and that a
    service has come back, is logged as warnings of the logger "rcbd".
    """

    def __init__(self, handle: Handle, where: str) -> None:
        self._handle = handle
        self._where = where

    def __repr__(self) -> str:
        return f"<rcbd.Client of {self._where}>"

    def scene(self, name: str, parts: int = 0, tolerance: float = 0.1, replace: bool = False,
              comm: Optional[MPI.Comm] = None, *, dims: int = 3, method: str = "rcb", policy: str = "tolerance",
              positions: str = "every-step", part_sizes: Optional[ArrayLike] = None, axis_hysteresis: float = 1.2,
              cut_tolerance: float = 0.0, threads: int = 1, seat: int = 0, seats: int = 1,
              deadline_seconds: float = 60.0) -> Scene:
        """Makes the scene, or goes on with the one that is there, from its last step.

        Args:
            name: 1 to 64 of A-Z a-z 0-9 . _ -
            parts: how many parts; 0: the scene must be there, and is taken as it is.
            tolerance: repartition when the error reaches this; infinity: never by itself.
            replace: drop a scene of that name first.
            comm: an mpi4py communicator, all of whose processes call this: each gets one seat, its rank. If one fails,
                all raise an Error.
            dims: of the positions, 1 to 3.
            method: "rcb", or "bands-x", "bands-y", "bands-z".
            policy: "tolerance"; or "cost": repartition by the time that imbalance costs (step_seconds of steps).
            positions: "every-step"; or "when-needed": most steps send a few numbers in place of positions.
            part_sizes: (parts), above 0: the share of each; None: equal shares.
            axis_hysteresis: >= 1; a cut keeps its axis until another is longer by this factor.
            cut_tolerance: 0 to 1; how far off target new cuts may leave a part.
            threads: for counting.
            seat, seats: this process, and how many step the scene together; `comm` sets them. With `replace` seat 0 has to
                open the scene before the others do.
            deadline_seconds: for a scene or seat that somebody else holds, or that seat 0 has still to make.

        Raises:
            Error: already_exists (with other options than these; the message names one), not_found, busy,
                invalid_argument, unavailable, deadline_exceeded.
        """
        if comm is not None:
            from . import mpi

            return mpi.scene_open(comm, self, name, parts, tolerance=tolerance, replace=replace, dims=dims, method=method,
                                  policy=policy, positions=positions, part_sizes=part_sizes,
                                  axis_hysteresis=axis_hysteresis, cut_tolerance=cut_tolerance, threads=threads,
                                  deadline_seconds=deadline_seconds)
        parts = arrays.whole(parts, "parts")
        sizes = None if part_sizes is None else arrays.floats_array(part_sizes, max(parts, 0), "part_sizes", "part")
        options = SceneOptions(
            parts=parts, dims=arrays.whole(dims, "dims"), method=_text(method, "method"), policy=_text(policy, "policy"),
            positions=_text(positions, "positions"), part_sizes=None if sizes is None else arrays.address(sizes),
            tolerance=tolerance, axis_hysteresis=axis_hysteresis, cut_tolerance=cut_tolerance, replace=bool(replace),
            threads=arrays.whole(threads, "threads"), seat=arrays.whole(seat, "seat"), seats=arrays.whole(seats, "seats"),
            deadline_seconds=deadline_seconds)
        called = _text(name, "name")
        handle = Handle(sizes)  # until the call is over, also where Ctrl-C has ended the wait for it
        interruptible(lambda: check(lib.rcbd_scene_open(self._handle.pointer, called, byref(options), handle.out())),
                       self._handle)
        return Scene(handle, self._handle, name)

    def drop(self, name: str) -> None:
        """Drops a scene.

        Raises:
            Error: not_found, busy (somebody has it open).
        """
        called = _text(name, "name")
        interruptible(lambda: check(lib.rcbd_scene_drop(self._handle.pointer, called)), self._handle)

    def interrupt(self) -> None:
        """Ends the call of this client that is under way, or the next one that has to wait, with Error interrupted. For
        other threads and signal handlers."""
        lib.rcbd_interrupt(self._handle.pointer)


class Scene(_Closing):
    """A scene, or a seat of one, that this process steps; Client.scene() makes it.

    Attributes:
        name: its name.
    """

    def __init__(self, handle: Handle, client: Handle, name: str) -> None:
        self._handle = handle
        self._client = client
        self.name = name
        self._cuts_known = False

    def __repr__(self) -> str:
        return f"<rcbd.Scene {self.name!r}>"

    def positions(self, n: int, dtype: DTypeLike = np.float64) -> NDArray[Any]:
        """Memory for n positions, (n, dims), in which to compute. Optional: steps take any array. Where the service is on
        this machine its ranks read this memory in place.

        Asked for once more, the values that are there stay, as far as they are of the same dtype. Where more room is
        needed they are copied into new memory; older arrays stay valid, and are then like any other array.

        Args:
            dtype: numpy.float64 or numpy.float32.

        Raises:
            Error: too_large, invalid_argument (the scene was closed).
        """
        kind = np.dtype(dtype)
        if kind not in (arrays.F8, arrays.F4):
            raise TypeError(f"positions of type {kind}; float64 or float32")
        count = arrays.whole(n, "n", 2**63 - 1)
        handle = Handle()
        interruptible(lambda: check(lib.rcbd_arrays_new(self._handle.pointer, count, 0, kind == arrays.F4, handle.out())),
                       self._client)
        where = Positions()
        check(lib.rcbd_arrays_positions(handle.pointer, byref(where)))
        return arrays.array_at(handle, where.axis[0], (count, where.dims), kind, read_only=False)

    def step(self, xyz: ArrayLike, ids: Optional[ArrayLike] = None, weights: Optional[ArrayLike] = None, *,
             step: Optional[int] = None, inserted: int = 0, removed: int = 0, step_seconds: Optional[float] = None,
             want_parts: bool = True, want_changed: bool = True, send: bool = False, threads: int = 1,
             deadline_seconds: float = 60.0) -> Step:
        """Makes a step with all rows of this process; there may be none. Returns when it is made on all ranks or on none.
        After a failure the step before stands.

        Only after Error deadline_exceeded, unavailable, interrupted (and, with several seats, aborted), and after Ctrl-C,
        the step may have been made: the same call again gives its result then, unless last_step has gone on.

        Args:
            xyz: (n, dims), float64 or float32; also (n) where dims is 1. Read where it is, if it has native byte order and
                its rows are a multiple of its item's size apart, such as slices, columns of a larger array and
                transposed arrays; otherwise, and from integers, a copy is made.
            ids: (n), integers >= 0, distinct: whose positions the rows are. None: row k is particle k, which one seat
                alone can say, as long as its rows keep their number and order.
            weights: (n), finite, >= 0. None: none, or those given last for these rows.
            step: its number, above the last one's; None: the last one's + 1, 0 at first.
            inserted, removed: how many of this process' particles are new since the last step, and how many are gone. Ids
                are required then.
            step_seconds: computing time of the solver since its last step, for the policy "cost".
            want_parts, want_changed: whether Step.parts and Step.changed will be asked for (in the other languages they
                are off unless set). They take about a millisecond for a million rows.
            send: the positions travel, also where the scene ("when-needed") does without.
            threads: at most so many, or as many as the scene's, if that is more.
            deadline_seconds: at most this long.

        Raises:
            Error: not_finite (the message names the row), not_conserved, duplicate_id, stale_step, invalid_argument, busy,
                not_found (the scene was dropped or made anew: open it again), too_large, unsupported,
                deadline_exceeded, unavailable, interrupted, aborted.
            TypeError, ValueError: an array of the wrong type or shape.
        """
        ask = Ask(xyz, ids, weights, step, inserted, removed, step_seconds, want_parts, want_changed, send, threads,
                  deadline_seconds)
        return self._make(ask)

    def _make(self, ask: Ask) -> Step:
        self._cuts_known = ask.wants
        began = monotonic()
        try:
            return make(self._handle, self._client, ask)
        finally:
            if monotonic() - began > QUICK_SECONDS:
                log_notices(self._client)

    def step_begin(self, xyz: ArrayLike, ids: Optional[ArrayLike] = None, weights: Optional[ArrayLike] = None, *,
                   step: Optional[int] = None, inserted: int = 0, removed: int = 0,
                   step_seconds: Optional[float] = None, want_parts: bool = True, want_changed: bool = True,
                   send: bool = False, threads: int = 1, deadline_seconds: float = 60.0) -> Op:
        """The same in a thread of the library; arguments are those of step(). Returns at once. Steps begun with one client
        are made one after another. Until it is done the arrays must not be written to.

        Raises:
            Error: invalid_argument, busy (another step of the scene is not done). Others are raised by Op.wait().
        """
        ask = Ask(xyz, ids, weights, step, inserted, removed, step_seconds, want_parts, want_changed, send, threads,
                  deadline_seconds)
        self._cuts_known = ask.wants
        return begin(self._handle, self._client, ask)

    @property
    def last_step(self) -> Optional[int]:
        """The number of the last step; None: there was none."""
        step = c_int64()
        interruptible(lambda: check(lib.rcbd_last_step(self._handle.pointer, byref(step))), self._client)
        return None if step.value < 0 else step.value

    @property
    def cuts(self) -> Cuts:
        """The cuts after the last step, a value that does not change: ask for it after each step.

        Raises:
            Error: not_found (no positions yet), invalid_argument (the scene was closed).
        """
        handle = Handle()

        def call() -> None:
            check(lib.rcbd_scene_cuts(self._handle.pointer, handle.out()))

        if self._cuts_known:
            call()
        else:  # the service is asked
            interruptible(call, self._client)
        return Cuts(handle)
