"""What cuts tell without the service, and wrap()."""
from __future__ import annotations

from ctypes import byref, c_double, c_int32
from typing import TYPE_CHECKING, Any, Iterator, NamedTuple, Optional, Tuple, Union

import numpy as np

from . import _arrays as arrays
from ._library import AskOptions, CutsInfo, Error, Handle, ListsView, Near, check, lib

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from ._arrays import Periodic

_NORMS = {"max": 0, "euclid": 1}
_ENTRIES_MOST = 268435456


class Narrowest(NamedTuple):
    """The smallest distance between two opposite faces of a region.

    Attributes:
        part, axis: whose region, across which axis.
        width: the distance.
    """

    part: int
    axis: int
    width: float


def _near(width: float, periodic: Periodic, norm: str, dims: int) -> Tuple[Near, Any]:
    """The struct, and what it points to."""
    if norm not in _NORMS:
        raise Error("invalid_argument", f"the norm {norm!r}", "give 'max' or 'euclid'")
    box = arrays.box_arrays(periodic, dims)
    lo, hi = (None, None) if box is None else map(arrays.address, box)
    return Near(width=width, lo=lo, hi=hi, norm=_NORMS[norm]), box


class Halo:
    """Which rows the other parts (or seats) need; Cuts.halo() makes it. `halo[k]` is an array of the rows that part k needs,
    ascending, and len(halo) the number of parts. Its arrays are read-only, are no copies, and stay valid.

    Attributes:
        offset: (len + 1), int64: list k has the entries from offset[k] up to, not including, offset[k + 1].
        rows: (entries), int64: the rows of all lists.
        shifts: (entries, dims), int32: by how many periods an entry is to be moved; None where nothing is periodic.
        box: the periodic box, (lo, hi); None: none.
    """

    def __init__(self, handle: Handle, dims: int, box: Optional[Tuple[NDArray[np.float64], NDArray[np.float64]]]) -> None:
        view = ListsView()
        check(lib.rcbd_lists_read(handle.pointer, byref(view)))
        self.offset: NDArray[np.int64] = arrays.array_at(handle, view.offset, (view.lists + 1,), arrays.I8)
        self.rows: NDArray[np.int64] = arrays.array_at(handle, view.item, (view.entries,), arrays.I8)
        self.shifts: Optional[NDArray[np.int32]] = None
        if box is not None:
            self.shifts = arrays.array_at(handle, view.shift, (view.entries, dims), arrays.I4)
        self.box = box

    def __len__(self) -> int:
        return len(self.offset) - 1

    def _list(self, k: int) -> slice:
        k = arrays.whole(k, "a list of a halo", 2**63 - 1)
        if not -len(self) <= k < len(self):
            raise IndexError(f"list {k} of a halo of {len(self)}")
        k %= len(self)
        return slice(self.offset[k], self.offset[k + 1])

    def __getitem__(self, k: int) -> NDArray[np.int64]:
        return self.rows[self._list(k)]

    def __iter__(self) -> Iterator[NDArray[np.int64]]:
        return (self[k] for k in range(len(self)))

    def shifts_for(self, k: int) -> NDArray[np.int32]:
        """(entries of list k, dims), int32: by how many periods each of the rows halo[k] is to be moved."""
        entries = self._list(k)
        if self.shifts is None:
            raise Error("not_found", "a halo without shifts", "give its periodic box")
        return self.shifts[entries]

    def __repr__(self) -> str:
        return f"<rcbd.Halo of {len(self)} lists, {len(self.rows)} entries>"


class Cuts:
    """The cuts as they were after a step, a value that does not change; Scene.cuts gives it. It never asks the service, and
    many threads may ask it at once.

    Attributes:
        hash: 16 hexadecimal digits, the same for the same cuts.
        epoch: rises whenever there are new cuts.
        parts: how many.
        dims: 1 to 3.
    """

    def __init__(self, handle: Handle) -> None:
        info = CutsInfo()
        check(lib.rcbd_cuts_describe(handle.pointer, byref(info)))
        self._handle = handle
        self.hash = f"{info.hash:016x}"
        self.epoch: int = info.epoch
        self.parts: int = info.parts
        self.dims: int = info.dims

    def __repr__(self) -> str:
        return f"<rcbd.Cuts {self.hash} of {self.parts} parts>"

    def _positions(self, xyz: ArrayLike) -> NDArray[Any]:
        rows = arrays.positions_array(xyz)
        if rows.shape[1] != self.dims:
            raise ValueError(f"positions of shape {np.shape(xyz)} for cuts of {self.dims} dimensions; give (n, {self.dims}), "
                             f"one position as (1, {self.dims})")
        return rows

    def owner(self, xyz: ArrayLike, ids: Optional[ArrayLike] = None, *, last: Optional[ArrayLike] = None,
              threads: int = 1) -> NDArray[np.int32]:
        """(n), int32: the part that owns each position.

        Args:
            xyz: (n, dims), as for Scene.step().
            ids: (n), which decide between particles that are on a cut: give them if steps have them; None: the row is the id.
            last: (n), int32, a hint that changes no answer: the parts of an earlier time make it quicker.
            threads: at most so many.

        Raises:
            Error: not_finite (the message names the row), invalid_argument.
        """
        rows = self._positions(xyz)
        options, _keep = _ask(len(rows), ids, threads)
        if last is not None:
            hint = arrays.parts_array(last, len(rows), "last")
            options.last_part = arrays.address(hint)
        part = np.empty(len(rows), arrays.I4)
        check(lib.rcbd_cuts_owner(self._handle.pointer, arrays.positions_of(rows), byref(options),
                                  arrays.address(part)))
        return part

    def halo(self, xyz: ArrayLike, width: Union[float, ArrayLike], periodic: Periodic = None,
             ids: Optional[ArrayLike] = None, *, norm: str = "max", seats: int = 0, threads: int = 1,
             entries_max: int = _ENTRIES_MOST) -> Halo:
        """Which of these particles, each in the region of its part, the other parts (or seats) need. A particle is needed
        where the part's region is within the width of it or of an image; its own part needs moved images alone.

        Args:
            xyz: (n, dims), as for Scene.step().
            width: in the unit of the positions; or (n), one for each row.
            periodic: (lo, hi), the periodic box, each a number or one an axis; an axis with infinite bounds is not periodic.
            ids: (n), which decide between particles that are on a cut: give them if steps have them; None: the row is the id.
            norm: "max" or "euclid".
            seats: lists for so many seats; 0: for the parts.
            threads: at most so many.
            entries_max: more entries are an error.

        Raises:
            Error: not_finite, invalid_argument, too_large.
        """
        rows = self._positions(xyz)
        options, _keep = _ask(len(rows), ids, threads)
        options.entries_max = arrays.whole(entries_max, "entries_max", 2**63 - 1)
        options.seats = arrays.whole(seats, "seats")
        if np.ndim(width) > 0:
            widths = arrays.floats_array(width, len(rows), "width")
            options.widths = arrays.address(widths)
            width = 0.0
        near, box = _near(width, periodic, norm, self.dims)  # type: ignore[arg-type]
        lists = Handle()
        check(lib.rcbd_cuts_halo(self._handle.pointer, arrays.positions_of(rows), byref(near), byref(options),
                                 lists.out()))
        return Halo(lists, self.dims, box)

    def neighbours(self, part: int, width: float, periodic: Periodic = None, *, norm: str = "max") -> NDArray[np.int64]:
        """int64, ascending: the parts within the width of this part's region. A part that is near by several images is
        there once; itself only by moved images.

        Raises:
            Error: not_found (no such part), invalid_argument.
        """
        return np.unique(self.neighbour_images(part, width, periodic, norm=norm)[0])

    def neighbour_images(self, part: int, width: float, periodic: Periodic = None, *,
                         norm: str = "max") -> Tuple[NDArray[np.int64], NDArray[np.int32]]:
        """The same with an entry for each image: (the parts, and (entries, dims) the shifts in periods by which this part's
        particles are moved to be near them)."""
        near, box = _near(width, periodic, norm, self.dims)
        lists = Handle()
        check(lib.rcbd_cuts_neighbours(self._handle.pointer, arrays.whole(part, "part"), byref(near), lists.out()))
        found = Halo(lists, self.dims, box)
        return found.rows, np.zeros((len(found.rows), self.dims), arrays.I4) if found.shifts is None else found.shifts

    def box(self, lo: ArrayLike, hi: ArrayLike, periodic: Periodic = None) -> NDArray[np.int64]:
        """int64, ascending: the parts whose region touches the box [lo, hi], or one of its images.

        Args:
            lo, hi: (dims), or a number for all axes.
            periodic: as for halo().

        Raises:
            Error: invalid_argument.
        """
        first, last = (arrays.bounds_array(bound, self.dims, what) for bound, what in ((lo, "lo"), (hi, "hi")))
        near, box = _near(0.0, periodic, "max", self.dims)
        lists = Handle()
        check(lib.rcbd_cuts_box(self._handle.pointer, arrays.address(first), arrays.address(last), byref(near),
                                lists.out()))
        return Halo(lists, self.dims, None).rows

    def regions(self) -> Tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(lo, hi), each (parts, dims): the region of each part; infinite where it has no bound. lo > hi: it can own no
        position."""
        lo, hi = np.empty((self.parts, self.dims)), np.empty((self.parts, self.dims))
        check(lib.rcbd_cuts_regions(self._handle.pointer, arrays.address(lo), arrays.address(hi)))
        return lo, hi

    def narrowest(self, periodic: Periodic = None) -> Optional[Narrowest]:
        """The smallest distance between two opposite faces of a region; None: no region has two.

        Raises:
            Error: invalid_argument.
        """
        near, _box = _near(0.0, periodic, "max", self.dims)
        part, axis, width = c_int32(), c_int32(), c_double()
        check(lib.rcbd_cuts_narrowest(self._handle.pointer, byref(near), byref(part), byref(axis), byref(width)))
        return None if part.value < 0 else Narrowest(part.value, axis.value, width.value)


def _ask(count: int, ids: Optional[ArrayLike], threads: int) -> Tuple[AskOptions, Any]:
    """The struct, and what it points to."""
    column = None if ids is None else arrays.ids_array(ids, count)
    return AskOptions(ids=None if column is None else arrays.address(column), entries_max=_ENTRIES_MOST,
                      threads=arrays.whole(threads, "threads")), column


def wrap(xyz: NDArray[Any], lo: ArrayLike, hi: ArrayLike) -> NDArray[Any]:
    """Moves positions that are outside the periodic box [lo, hi) into it, in place, by whole periods hi - lo. Those inside
    stay as they are, to the bit. What lies at hi goes to lo, and so does what is rounded to it.

    Args:
        xyz: (n, dims), or (n), an array of float64 or float32.
        lo, hi: (dims), or a number for all axes; an axis with infinite bounds is not periodic.

    Returns:
        xyz.

    Raises:
        Error: not_finite (then nothing is moved), invalid_argument (a box without length).
    """
    if not isinstance(xyz, np.ndarray) or xyz.dtype.kind != "f" or xyz.dtype.itemsize not in (4, 8):
        raise TypeError("wrap() works in place, on an array of float64 or float32")
    if not xyz.flags.writeable:
        raise ValueError("wrap() works in place, and the array is read-only")
    rows = arrays.positions_array(xyz)
    first, last = (arrays.bounds_array(bound, rows.shape[1], what) for bound, what in ((lo, "lo"), (hi, "hi")))
    check(lib.rcbd_wrap(arrays.positions_of(rows), arrays.address(first), arrays.address(last)))
    if not np.may_share_memory(rows, xyz):  # it was one that the library can't write to
        xyz[...] = rows.reshape(xyz.shape)
    return xyz
