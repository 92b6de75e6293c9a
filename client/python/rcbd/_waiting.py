"""Waiting so that Ctrl-C ends it, and telling what is waited for."""
from __future__ import annotations

import logging
import threading
from typing import Callable, List, Optional, TypeVar

from ._library import Handle, lib

SLICE_SECONDS = 0.1  # how long a wait may keep Python from running signal handlers
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
        raise fault[0]
    return result[0]
