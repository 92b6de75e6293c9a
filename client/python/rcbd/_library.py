"""librcbd.so.1: where it is, what it declares (client/include/rcbd/rcbd.h), and its failures as exceptions."""
from __future__ import annotations

import ctypes
import os
import struct
import sys
from ctypes import POINTER, c_char_p, c_double, c_int, c_int32, c_int64, c_size_t, c_uint64, c_void_p
from pathlib import Path
from typing import Any, Iterator, Tuple, Type

__version__ = "1.0.0"
NAME = "librcbd.so.1"


class Error(Exception):
    """What the service or the library refused, or could not do.

    Attributes:
        code: one word for programs, such as "not_finite", "busy", "unavailable", "deadline_exceeded", "aborted",
            "interrupted"; rcbd.h has all of them, enum rcbd_code.
        message: what was wrong, and where.
        hint: what to do; may be "".
    """

    def __init__(self, code: str, message: str, hint: str = "") -> None:
        super().__init__(code, message, hint)
        self.code = code
        self.message = message
        self.hint = hint

    def __str__(self) -> str:
        return f"{self.message}; {self.hint}" if self.hint else self.message


# ---- the structs of rcbd.h; tests/client/c/abi.txt has the place of each field ----


class Struct(ctypes.Structure):
    """A struct that begins with its size."""

    def __init__(self, **fields: Any) -> None:
        super().__init__(size=ctypes.sizeof(self))
        for name, value in fields.items():
            try:
                setattr(self, name, value)
            except TypeError as fault:  # ctypes doesn't say which
                raise TypeError(f"{name}: {fault}") from None


class ConnectOptions(Struct):
    _fields_ = [("size", c_size_t), ("name", c_char_p), ("token", c_char_p), ("path", c_char_p),
                ("deadline_seconds", c_double), ("outlive", c_int32), ("reserved", c_int32)]


class SceneOptions(Struct):
    _fields_ = [("size", c_size_t), ("parts", c_int32), ("dims", c_int32), ("method", c_char_p), ("policy", c_char_p),
                ("positions", c_char_p), ("part_sizes", c_void_p), ("tolerance", c_double),
                ("axis_hysteresis", c_double), ("cut_tolerance", c_double), ("replace", c_int32), ("threads", c_int32),
                ("seat", c_int32), ("seats", c_int32), ("deadline_seconds", c_double)]


class Positions(Struct):
    _fields_ = [("size", c_size_t), ("count", c_int64), ("stride", c_int64), ("dims", c_int32), ("single", c_int32),
                ("axis", c_void_p * 3)]


class StepOptions(Struct):
    _fields_ = [("size", c_size_t), ("step", c_int64), ("ids", c_void_p), ("weights", c_void_p), ("inserted", c_int64),
                ("removed", c_int64), ("step_seconds", c_double), ("want_parts", c_int32), ("want_changed", c_int32),
                ("send", c_int32), ("threads", c_int32), ("deadline_seconds", c_double)]


class Report(Struct):
    _fields_ = [("size", c_size_t), ("step", c_int64), ("epoch", c_int64), ("n", c_int64), ("error_before", c_double),
                ("error", c_double), ("imbalance", c_double),
                *((name, c_int64) for name in ("drifted", "moved", "migrated", "inserted", "removed", "strangers",
                                               "weights_as_zero", "positions_step", "bytes", "scanned", "searched",
                                               "rounds", "reductions")),
                *((f"seconds_{name}", c_double) for name in ("receive", "exchange", "search", "migrate", "total")),
                ("parts", c_int32), ("axes_flipped", c_int32), ("repartitioned", c_int32), ("sent", c_int32),
                ("reason", c_char_p), ("way", c_char_p), ("json", c_char_p)]


class CutsInfo(Struct):
    _fields_ = [("size", c_size_t), ("epoch", c_int64), ("hash", c_uint64), ("parts", c_int32), ("dims", c_int32)]


class Near(Struct):
    _fields_ = [("size", c_size_t), ("width", c_double), ("lo", c_void_p), ("hi", c_void_p), ("norm", c_int32),
                ("reserved", c_int32)]


class AskOptions(Struct):
    _fields_ = [("size", c_size_t), ("ids", c_void_p), ("last_part", c_void_p), ("widths", c_void_p),
                ("entries_max", c_int64), ("seats", c_int32), ("threads", c_int32)]


class ListsView(Struct):
    _fields_ = [("size", c_size_t), ("lists", c_int64), ("entries", c_int64), ("offset", c_void_p), ("item", c_void_p),
                ("shift", c_void_p)]


_CODES = {c_size_t: "N", c_int64: "q", c_int32: "i", c_double: "d", c_void_p: "P", c_char_p: "P", c_void_p * 3: "3P"}


def packing(kind: Type[Struct]) -> struct.Struct:
    """The same struct for Python's module struct, which makes and reads the values of all fields at once: for what is made
    in each step. A ctypes.Structure takes three times as long."""
    return struct.Struct("@" + "".join(_CODES[field[1]] for field in kind._fields_))


# ---- the library ----

_OUT = POINTER(c_void_p)  # where a handle or an array is given
_PACKED = c_char_p  # a packed struct, as bytes
_SIGNATURES = {
    "rcbd_version": (c_int, []),
    "rcbd_code_name": (c_char_p, [c_int]),
    "rcbd_message": (c_char_p, []),
    "rcbd_hint": (c_char_p, []),
    "rcbd_release": (None, [c_void_p]),
    "rcbd_close": (c_int, [c_void_p]),
    "rcbd_connect": (c_int, [c_char_p, POINTER(ConnectOptions), _OUT]),
    "rcbd_notice": (c_char_p, [c_void_p]),
    "rcbd_interrupt": (None, [c_void_p]),
    "rcbd_scene_open": (c_int, [c_void_p, c_char_p, POINTER(SceneOptions), _OUT]),
    "rcbd_scene_drop": (c_int, [c_void_p, c_char_p]),
    "rcbd_last_step": (c_int, [c_void_p, POINTER(c_int64)]),
    "rcbd_arrays_new": (c_int, [c_void_p, c_int64, c_int, c_int32, _OUT]),
    "rcbd_arrays_positions": (c_int, [c_void_p, POINTER(Positions)]),
    "rcbd_wrap": (c_int, [_PACKED, c_void_p, c_void_p]),
    "rcbd_step": (c_int, [c_void_p, _PACKED, _PACKED, _OUT]),
    "rcbd_step_begin": (c_int, [c_void_p, _PACKED, _PACKED, _OUT]),
    "rcbd_wait": (c_int, [c_void_p, c_double, _OUT]),
    "rcbd_cancel": (None, [c_void_p]),
    "rcbd_result_report": (c_int, [c_void_p, POINTER(Report)]),
    "rcbd_result_parts": (c_int, [c_void_p, _OUT, POINTER(c_int64)]),
    "rcbd_result_changed": (c_int, [c_void_p, _OUT, _OUT, POINTER(c_int64)]),
    "rcbd_result_leaving": (c_int, [c_void_p, _OUT, _OUT, POINTER(c_int64)]),
    "rcbd_scene_cuts": (c_int, [c_void_p, _OUT]),
    "rcbd_cuts_describe": (c_int, [c_void_p, POINTER(CutsInfo)]),
    "rcbd_cuts_regions": (c_int, [c_void_p, c_void_p, c_void_p]),
    "rcbd_cuts_owner": (c_int, [c_void_p, _PACKED, POINTER(AskOptions), c_void_p]),
    "rcbd_cuts_halo": (c_int, [c_void_p, _PACKED, POINTER(Near), POINTER(AskOptions), _OUT]),
    "rcbd_cuts_neighbours": (c_int, [c_void_p, c_int32, POINTER(Near), _OUT]),
    "rcbd_cuts_box": (c_int, [c_void_p, c_void_p, c_void_p, POINTER(Near), _OUT]),
    "rcbd_cuts_narrowest": (c_int, [c_void_p, POINTER(Near), POINTER(c_int32), POINTER(c_int32), POINTER(c_double)]),
    "rcbd_lists_read": (c_int, [c_void_p, POINTER(ListsView)]),
}


def _candidates(package: Path) -> Iterator[Path]:
    """Where the library is tried before it is left to the system: beside the package, in the `lib` that the package is
    below, and, in a checkout, in the build folder that was built last."""
    yield package / NAME
    for folder in package.parents:
        if folder.name in ("lib", "lib64"):
            yield folder / NAME
            yield folder / getattr(sys.implementation, "_multiarch", "") / NAME  # Debian's
            break
    if len(package.parents) > 2 and (package.parents[2] / "client" / "c" / "librcbd.map").exists():
        builds = package.parents[2] / "build"
        found = [*builds.glob(f"lib/{NAME}"), *builds.glob(f"*/lib/{NAME}")]
        yield from sorted(found, key=lambda path: path.stat().st_mtime, reverse=True)


def _load() -> Tuple[ctypes.CDLL, str]:
    named = os.environ.get("RCBD_LIBRARY", "")
    package = Path(__file__).resolve().parent
    path = named or next((str(path) for path in _candidates(package) if path.exists()), NAME)
    try:
        return ctypes.CDLL(path), path
    except OSError as fault:
        if named:
            raise ImportError(f"rcbd: RCBD_LIBRARY names {named}, which can't be loaded: {fault}") from None
        raise ImportError(f"rcbd: {NAME} can't be loaded: {fault}; install librcbd1, or build rcbd, and let RCBD_LIBRARY "
                          f"name the file (build/lib/{NAME})") from None


def _declare(library: ctypes.CDLL, path: str) -> None:
    """Tells ctypes the types of all functions. A library that is too old or too new is refused."""
    try:
        library.rcbd_version.restype = c_int
        found = library.rcbd_version()
        major, minor, _ = map(int, __version__.split("."))
        if found // 10000 != major or found < 10000 * major + 100 * minor:
            told = f"{found // 10000}.{found // 100 % 100}.{found % 100}"
            raise ImportError(f"rcbd: {path} is version {told}, and the Python package {__version__}; install both from "
                              "one release")
        for name, (result, arguments) in _SIGNATURES.items():
            function = getattr(library, name)
            function.restype, function.argtypes = result, arguments
    except AttributeError as fault:
        raise ImportError(f"rcbd: {path} is no librcbd of version {__version__}: {fault}") from None


if sys.maxsize < 2**32:
    raise ImportError("rcbd: needs a 64-bit Python")
lib, library_path = _load()
_declare(lib, library_path)

PENDING = -1


def error_of(code: int) -> Error:
    """The failure of this thread's last call."""
    text = [lib.rcbd_code_name(code), lib.rcbd_message(), lib.rcbd_hint()]
    return Error(*(part.decode(errors="replace") for part in text))


def check(code: int) -> None:
    """Raises Error where a function of the library failed."""
    if code:
        raise error_of(code)


class Handle:
    """One holder of a handle of the library, which it lets go of in the end; and what has to live as long."""

    __slots__ = ("pointer", "keep")

    def __init__(self, keep: Any = None) -> None:
        self.pointer = c_void_p()
        self.keep = keep

    def out(self) -> Any:
        """For the function that gives the handle: held from the moment when it is there."""
        return ctypes.byref(self.pointer)

    def __del__(self, _release: Any = lib.rcbd_release) -> None:
        value, self.pointer.value = self.pointer.value, None
        if value:
            _release(value)

    release = __del__  # earlier than that
