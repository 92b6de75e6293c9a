"""Steps: one that is being made, and what it told."""
from __future__ import annotations

import ctypes
import struct
from ctypes import byref, c_int64, c_void_p
from typing import TYPE_CHECKING, Any, Callable, NamedTuple, Optional, Tuple

import numpy as np

from . import _arrays as arrays
from . import _library as library
from ._library import PENDING, Error, Handle, StepOptions, check, error_of, lib, packing
from ._waiting import SLICE_SECONDS, log_notices, watched

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

_pack_options = packing(StepOptions).pack
_OPTIONS_SIZE = ctypes.sizeof(StepOptions)
_NO_REPORT = bytes(library.Report())  # quicker to copy than to make


def _field(name: str, kind: Callable[[Any], Any], meaning: str) -> Any:
    raw = getattr(library.Report, name)
    return property(lambda report: kind(raw.__get__(report)), doc=meaning)


def _known(told: float) -> Optional[float]:
    return told if told >= 0 else None  # NaN, or below 0


def _text(told: Any) -> str:
    return str(told, errors="replace")


class Report(library.Report):
    """What the service tells of a step. Times are in seconds.

    Attributes:
        step: its number.
        epoch: rises whenever there are new cuts.
        n: particles, of all seats.
        error: the largest abs(load - target) / target, now.
        imbalance: the largest load / target, now.
        moved: particles whose part new cuts changed.
        migrated: of these, those that changed the service's rank.
        inserted, removed: particles.
        strangers: particles that were outside their seat's parts.
        weights_as_zero: particles whose weight is too far below the greatest one to count.
        bytes: that travelled.
        scanned, searched, rounds, reductions: the work of the service.
        seconds_receive, seconds_exchange, seconds_search, seconds_migrate, seconds_total: its time.
        parts: how many parts there are after the step.
        axes_flipped: cuts that changed their axis.
    """

    if TYPE_CHECKING:  # otherwise the fields of the C struct
        step: int
        epoch: int
        n: int
        error: float
        imbalance: float
        moved: int
        migrated: int
        inserted: int
        removed: int
        strangers: int
        weights_as_zero: int
        bytes: int
        scanned: int
        searched: int
        rounds: int
        reductions: int
        seconds_receive: float
        seconds_exchange: float
        seconds_search: float
        seconds_migrate: float
        seconds_total: float
        parts: int
        axes_flipped: int
    error_before: Optional[float] = _field("error_before", _known, "when the positions arrived; None in the first step")
    drifted: Optional[int] = _field("drifted", _known, "particles that moved across a cut since the last step; None: not known")
    positions_step: Optional[int] = _field("positions_step", _known, "whose positions the ranks hold; None: no step's")
    repartitioned: bool = _field("repartitioned", bool, "there are new cuts")
    sent: bool = _field("sent", bool, "positions travelled in this step")
    reason: str = _field("reason", _text, "of the decision, in words")
    way: str = _field("way", _text, "\"count\", \"shared-memory\", \"sockets\" or \"endpoint\"")
    json: str = _field("json", _text, "the whole report, as the service sent it")

    def __repr__(self) -> str:
        return f"Report({', '.join(f'{name}={getattr(self, name)!r}' for name, *_ in library.Report._fields_[1:-1])})"

    def __reduce__(self) -> Tuple[Any, ...]:
        return _report_again, (bytes(self), *(getattr(library.Report, name).__get__(self) for name in _TEXTS))


_TEXTS = ("reason", "way", "json")


def _report_again(numbers: bytes, *texts: bytes) -> Report:
    """A copy, or what was pickled."""
    told = Report.from_buffer_copy(numbers)
    for name, text in zip(_TEXTS, texts):
        getattr(library.Report, name).__set__(told, text)
    return told


def _report_of(result: Handle) -> Report:
    told = Report.from_buffer_copy(_NO_REPORT)
    check(lib.rcbd_result_report(result.pointer, byref(told)))
    told._result = result  # whose texts it has
    return told


class Leaving(NamedTuple):
    """The rows that belong to other seats, and these.

    Attributes:
        rows: int64, ascending.
        seats: int32, as many.
    """

    rows: NDArray[np.int64]
    seats: NDArray[np.int32]


class Step:
    """The result of a step; Scene.step() makes it. Its arrays are read-only, are no copies, and stay valid.

    Attributes:
        rows: how many positions were given.
    """

    def __init__(self, handle: Handle, rows: int) -> None:
        self._handle = handle
        self.rows = rows
        self._report: Optional[Report] = None

    def __repr__(self) -> str:
        return f"<rcbd.Step {self.report.step}: {self.report.reason}>"

    def _pairs(self, function: Any) -> Tuple[NDArray[np.int64], NDArray[np.int32]]:
        rows, numbers, count = c_void_p(), c_void_p(), c_int64()
        check(function(self._handle.pointer, byref(rows), byref(numbers), byref(count)))
        return (arrays.array_at(self._handle, rows.value, (count.value,), arrays.I8),
                arrays.array_at(self._handle, numbers.value, (count.value,), arrays.I4))

    @property
    def report(self) -> Report:
        """What the service tells of the step."""
        if self._report is None:
            self._report = _report_of(self._handle)
        return self._report

    @property
    def parts(self) -> NDArray[np.int32]:
        """(n), int32: the part of each row, under the cuts after the step.

        Raises:
            Error: not_found (want_parts was False).
        """
        part, count = c_void_p(), c_int64()
        check(lib.rcbd_result_parts(self._handle.pointer, byref(part), byref(count)))
        return arrays.array_at(self._handle, part.value, (count.value,), arrays.I4)

    @property
    def changed(self) -> NDArray[np.int64]:
        """int64, ascending: the rows whose part differs from what this scene told last; all rows where they are other
        particles than then.

        Raises:
            Error: not_found (want_changed was False).
        """
        return self._pairs(lib.rcbd_result_changed)[0]

    @property
    def changed_parts(self) -> NDArray[np.int32]:
        """int32: the parts of the rows `changed`."""
        return self._pairs(lib.rcbd_result_changed)[1]

    @property
    def leaving(self) -> Leaving:
        """The rows that belong to other seats, and these. Hand them over (rcbd.mpi.hand_over); what isn't handed over is
        named again."""
        return Leaving(*self._pairs(lib.rcbd_result_leaving))


class Op:
    """A step that is being made; Scene.step_begin() makes it. Letting go of one that isn't done cancels it."""

    def __init__(self, handle: Handle, client: Handle, rows: int) -> None:
        self._handle = handle
        self._client = client
        self._rows = rows

    def wait(self, seconds: Optional[float] = None) -> Optional[Step]:
        """The result of the step; None: it isn't done after so many seconds. Without `seconds` waits until it is done,
        which the step's deadline bounds. May be asked again, by any thread. Ctrl-C ends the wait, not the step.

        Raises:
            Error: what Scene.step() raises.
        """
        left = float("inf") if seconds is None else seconds
        result = Handle()
        while True:
            slice_seconds = SLICE_SECONDS if left > SLICE_SECONDS else max(left, 0.0)
            code = lib.rcbd_wait(self._handle.pointer, slice_seconds, result.out())
            if code == 0:
                return Step(result, self._rows)
            if code != PENDING:
                raise error_of(code)
            left -= slice_seconds
            if not left > 0:
                return None
            log_notices(self._client)

    @property
    def done(self) -> bool:
        """Whether wait() would return or raise at once."""
        code: int = lib.rcbd_wait(self._handle.pointer, 0.0, None)
        return code != PENDING

    def cancel(self) -> None:
        """Ends the step with Error interrupted, unless it is done before that is noticed. It may have been made all the
        same. Of several seats the step then fails for all."""
        lib.rcbd_cancel(self._handle.pointer)


class Ask:
    """What a step is asked, for the library, and the arrays to which that points."""

    __slots__ = ("rows", "ids", "weights", "positions", "options", "wants")

    def __init__(self, xyz: ArrayLike, ids: Optional[ArrayLike], weights: Optional[ArrayLike], step: Optional[int] = None,
                 inserted: int = 0, removed: int = 0, step_seconds: Optional[float] = None, want_parts: bool = True,
                 want_changed: bool = True, send: bool = False, threads: int = 1, deadline_seconds: float = 60.0) -> None:
        if step is not None and step < 0:
            raise Error("invalid_argument", f"step {step}", "steps count from 0")
        if step_seconds is not None and not step_seconds >= 0:
            raise Error("invalid_argument", f"a step of {step_seconds} seconds", "give a finite number >= 0, or None")
        self.rows = arrays.positions_array(xyz)
        count = len(self.rows)
        self.ids = None if ids is None else arrays.ids_array(ids, count)
        self.weights = None if weights is None else arrays.floats_array(weights, count, "weights")
        self.positions = arrays.positions_of(self.rows)
        self.wants = want_parts or want_changed  # with either the library has the cuts after each step
        try:
            self.options = _pack_options(
                _OPTIONS_SIZE, -1 if step is None else step, 0 if self.ids is None else arrays.address(self.ids),
                0 if self.weights is None else arrays.address(self.weights), inserted, removed,
                -1.0 if step_seconds is None else step_seconds, bool(want_parts), bool(want_changed), bool(send), threads,
                deadline_seconds)
        except struct.error as fault:
            raise Error("invalid_argument", f"an option of the step is no number, or too large: {fault}") from None


def begin(scene: Handle, client: Handle, ask: Ask) -> Op:
    handle = Handle(ask)  # until it is released, which waits for the step
    try:
        check(lib.rcbd_step_begin(scene.pointer, ask.positions, ask.options, handle.out()))
        return Op(handle, client, len(ask.rows))
    except BaseException:  # KeyboardInterrupt, which may come after the call
        handle.release()
        raise


def make(scene: Handle, client: Handle, ask: Ask) -> Step:
    result = Handle()
    code = watched(client, lib.rcbd_step, scene.pointer, ask.positions, ask.options, result.out())
    if code == 0:
        return Step(result, len(ask.rows))
    if code is not None:
        raise error_of(code)
    op = begin(scene, client, ask)
    try:
        made = op.wait()
        assert made is not None
        return made
    except BaseException:  # what a handler of signals raises: the step is cancelled, and that waited for
        op._handle.release()
        raise
