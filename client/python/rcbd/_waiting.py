"""Waiting so that Ctrl-C ends it, and telling what is waited for."""
from __future__ import annotations

import logging
import os
import signal
import threading
from _signal import getsignal as _getsignal  # type: ignore[import]  # that of signal makes an enum of it, which takes 3 us
from typing import Any, Callable, List, Optional, Sequence, TypeVar

from ._library import Handle, lib

SLICE_SECONDS = 0.1  # how long a wait may keep Python from running signal handlers
QUICK_SECONDS = 0.0005  # a call that takes less has waited for nothing, so there is nothing to tell
_log = logging.getLogger("rcbd")
_T = TypeVar("_T")


def log_notices(client: Handle) -> None:
    while True:
        text = lib.rcbd_notice(client.pointer)
        if text is None:
            return
        _log.warning("%s", text.decode(errors="replace"))


def interruptible(call: Callable[[], _T], client: Optional[Handle] = None) -> _T:
    """Makes a call that may wait. Python's signal handlers run between the main thread's own instructions, so the call is
    made in another thread, and this one waits in slices."""
    if threading.current_thread() is not threading.main_thread():
        return call()
    result: List[_T] = []
    fault: List[BaseException] = []
    done = threading.Event()

    def work() -> None:
        try:
            result.append(call())
        except BaseException as found:
            fault.append(found)
        finally:
            done.set()

    threading.Thread(target=work, name="rcbd", daemon=True).start()
    try:
        while not done.wait(SLICE_SECONDS):
            if client:
                log_notices(client)
    except BaseException:
        if client and not done.is_set():
            lib.rcbd_interrupt(client.pointer)
            done.wait(3)  # a call to a service that has gone takes up to 2 s
        raise
    if client:
        log_notices(client)
    if fault:
        raise fault.pop()  # so that no list here holds it, and so this frame, in a circle
    return result[0]


class _Watch:
    """Ends the main thread's call after Ctrl-C, if it goes on for longer than a slice. Without another thread that makes the
    call: from one to the other and back takes longer than most steps that send some numbers only.

    Python writes the number of a signal to a pipe at once, and runs the handler after the call.
    """

    def __init__(self) -> None:
        read_end, self.pipe = os.pipe()
        self.identity: Sequence[int] = os.fstat(self.pipe)[1:3]  # inode and device, those of both ends
        os.set_blocking(self.pipe, False)
        self.client: Optional[Handle] = None  # whose call is under way
        self.calls = 0
        threading.Thread(target=self._run, args=(read_end,), name="rcbd-watch", daemon=True).start()

    def owns(self, end: int) -> bool:
        """Whether the file is the pipe still: a program may close all files, and open others."""
        try:
            return os.fstat(end)[1:3] == self.identity
        except OSError:
            return False

    def _run(self, read_end: int) -> None:
        wake = threading.Event()
        while self.owns(read_end):
            came = os.read(read_end, 64)
            if not came:
                break
            call, client = self.calls, self.client
            if signal.SIGINT not in came or client is None:
                continue
            wake.wait(SLICE_SECONDS)
            if self.calls == call and self.client is client:
                lib.rcbd_interrupt(client.pointer)
        self.identity = ()  # the next call makes another watch


_watch: Optional[_Watch] = None
_main_thread = threading.main_thread().ident


def _forget_watch() -> None:
    """A forked child has no such thread, and the pipe is its parent's."""
    global _watch, _main_thread
    if _watch is not None:
        signal.set_wakeup_fd(-1)
    _watch, _main_thread = None, threading.get_ident()


os.register_at_fork(after_in_child=_forget_watch)


def watched(client: Handle, function: Callable[..., int], *arguments: Any) -> Optional[int]:
    """Makes a call that waits, in this thread. None: it was not made, since this program has its own handler of Ctrl-C, or
    asks the system itself which signals come (asyncio does); then the caller waits in slices."""
    global _watch
    if threading.get_ident() != _main_thread:  # signals are the main thread's
        return function(*arguments)
    if _getsignal(signal.SIGINT) is not signal.default_int_handler:
        return None
    if _watch is None or not _watch.owns(_watch.pipe):
        _watch = _Watch()
    watch = _watch
    before = signal.set_wakeup_fd(watch.pipe, warn_on_full_buffer=False)
    if before not in (-1, watch.pipe):
        signal.set_wakeup_fd(before)
        return None
    try:
        watch.calls += 1
        watch.client = client
        return function(*arguments)
    finally:
        watch.client = None
        signal.set_wakeup_fd(-1)
