"""Arrays of the caller's as the library takes them, and the library's memory as arrays, without copies where possible."""
from __future__ import annotations

import ctypes
from typing import TYPE_CHECKING, Any, Optional, Tuple

import numpy as np

from ._library import Error, Handle, Positions, packing

if TYPE_CHECKING:  # which NumPy has since 1.21
    from numpy.typing import ArrayLike, NDArray

    Periodic = Optional[Tuple[ArrayLike, ArrayLike]]

F8, F4 = np.dtype(np.float64), np.dtype(np.float32)
I8, I4 = np.dtype(np.int64), np.dtype(np.int32)
_any_bytes: Any = ctypes.c_char.from_buffer
_pack_positions = packing(Positions).pack
_SIZE = ctypes.sizeof(Positions)
_EXACT = 2**53  # integers up to this are exact as float64


def address(array: NDArray[Any]) -> int:
    try:
        return ctypes.addressof(_any_bytes(array))  # a fifth of the time of the other way
    except (TypeError, ValueError, BufferError):  # empty, read-only or not contiguous
        return array.ctypes.data


def _plain(values: ArrayLike, what: str) -> NDArray[Any]:
    if isinstance(values, np.ma.MaskedArray) and np.ma.is_masked(values):  # type: ignore[no-untyped-call]
        raise TypeError(f"{what}: some are masked; leave these rows out")
    return np.asarray(values)


def _as_floats(values: ArrayLike, what: str) -> NDArray[Any]:
    """float64 or float32 of this machine's byte order, exactly the values given."""
    array = _plain(values, what)
    if array.dtype.kind == "f" and array.itemsize <= 8:
        return array.astype(F8 if array.itemsize == 8 else F4, copy=False)
    if array.dtype.kind in "iu":
        if array.size and array.itemsize == 8 and (int(array.max()) > _EXACT or int(array.min()) < -_EXACT):
            raise TypeError(f"{what}: integers beyond 2^53, which float64 does not have; convert them yourself")
        return array.astype(F8)
    raise TypeError(f"{what} of type {array.dtype}; give float64, float32 or integers (array.astype(float))")


def positions_array(xyz: ArrayLike) -> NDArray[Any]:
    """(n, dims) of float64 or float32 that the library can read in place: the caller's own array wherever possible."""
    usual = type(xyz) is np.ndarray and (xyz.dtype is F8 or xyz.dtype is F4)
    array: NDArray[Any] = xyz if usual else _as_floats(xyz, "positions")  # type: ignore[assignment]
    if array.ndim == 1:
        array = array[:, None]
    if array.ndim != 2 or not 1 <= array.shape[1] <= 3:
        raise ValueError(f"positions of shape {np.shape(xyz)}; give (n, dims), dims being 1 to 3")
    stride = array.strides[0]
    if array.shape[0] > 1 and (stride <= 0 or stride % array.itemsize):
        array = np.ascontiguousarray(array)
    return array if array.flags.aligned else array.copy()


def positions_of(array: NDArray[Any]) -> bytes:
    """The struct that says where the rows of a positions_array() are. The array is to be kept until the call is over."""
    count, dims = array.shape
    stride, across = array.strides
    first, size = address(array), array.itemsize
    return _pack_positions(_SIZE, count, stride // size if count > 1 else 1, dims, size == 4, first,
                           first + across if dims > 1 else 0, first + 2 * across if dims > 2 else 0)


def ids_array(ids: ArrayLike, count: int) -> NDArray[np.int64]:
    """(count) of int64, contiguous. Integers of other sizes are converted."""
    return _integers(ids, I8, count, "ids")


def parts_array(parts: ArrayLike, count: int, what: str) -> NDArray[np.int32]:
    """(count) of int32, likewise."""
    return _integers(parts, I4, count, what)


def _integers(values: ArrayLike, dtype: np.dtype[Any], count: int, what: str) -> NDArray[Any]:
    array = _plain(values, what)
    if array.dtype.kind not in "iu" and array.size:
        raise TypeError(f"{what} of type {array.dtype}; give integers")
    if array.size and not np.can_cast(array.dtype, dtype):
        least, most = np.iinfo(dtype).min, np.iinfo(dtype).max
        if int(array.min()) < least or int(array.max()) > most:
            raise TypeError(f"{what} beyond {least} to {most}")
    return _column(array, dtype, count, what)


def floats_array(values: ArrayLike, count: int, what: str, each: str = "row") -> NDArray[np.float64]:
    """(count) of float64, contiguous."""
    return _column(_as_floats(values, what), F8, count, what, each)


def _column(array: NDArray[Any], dtype: np.dtype[Any], count: int, what: str, each: str = "row") -> NDArray[Any]:
    if array.shape != (count,):
        raise ValueError(f"{what} of shape {array.shape} for {count} {each}s; give one a {each}")
    return np.require(array, dtype, ["C", "A"])


def bounds_array(bounds: ArrayLike, dims: int, what: str) -> NDArray[np.float64]:
    """(dims) of float64; one number stands for all axes."""
    array = _as_floats(bounds, what)
    if array.shape not in ((), (dims,)):
        raise ValueError(f"{what} of shape {array.shape}; give a number, or one an axis ({dims})")
    return np.ascontiguousarray(np.broadcast_to(array, (dims,)), F8)


def box_arrays(box: Periodic, dims: int) -> Optional[Tuple[NDArray[np.float64], NDArray[np.float64]]]:
    if box is None:
        return None
    try:
        lo, hi = box
    except (TypeError, ValueError):
        raise ValueError("a periodic box is (lo, hi), each a number or one an axis") from None
    return bounds_array(lo, dims, "lo"), bounds_array(hi, dims, "hi")


class _Memory:
    """Memory of a handle. Arrays made of it have this as base, which holds the handle."""

    __slots__ = ("__array_interface__", "handle")

    def __init__(self, interface: Any, handle: Handle) -> None:
        self.__array_interface__ = interface
        self.handle = handle


def array_at(handle: Handle, pointer: Optional[int], shape: Tuple[int, ...], dtype: np.dtype[Any],
             read_only: bool = True) -> NDArray[Any]:
    """The memory as an array, which keeps the handle."""
    if not pointer or 0 in shape:
        return np.empty(shape, dtype)
    interface = {"version": 3, "shape": shape, "typestr": dtype.str, "data": (pointer, read_only)}
    return np.asarray(_Memory(interface, handle))


def whole(number: Any, what: str, most: int = 2**31 - 1) -> int:
    """An integer that the library's field can hold."""
    try:
        value = int(number.__index__())
    except AttributeError:
        raise TypeError(f"{what}: {number!r} is no integer") from None
    if not -most - 1 <= value <= most:
        raise Error("invalid_argument", f"{what}: {value} is out of range")
    return value
