"""The loop's process: what of the operating system keeps it on time. All of it is asked for, reported, never fatal."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import os
from collections.abc import Callable, Iterator

from coopqp.checks import as_count
from coopqp.errors import InvalidInputError

#: mlockall: what is in memory now, and what will be.
_CURRENT, _FUTURE = 1, 2

#: FIFO priority of a loop beside a browser: without it drawing delays steps by 3 ms on two cores.
BESIDE_PAGE = 20


def prepare_process(*, realtime: int | None, lock_memory: bool, core: int | None) -> dict[str, str]:
    """Freeze Python's garbage collection, and ask for what else is wanted.

    Args:
        realtime: priority of the FIFO scheduler, 1 to 99; None for the ordinary one.
        lock_memory: keep all memory out of the swap.
        core: the only core to run on; None for any.

    Returns:
        What came of each, in words.
    """
    gc.collect()
    gc.freeze()
    found = {"garbage collection": "frozen"}
    if realtime is not None:
        found["realtime"] = _tried(lambda: _fifo(realtime), f"FIFO, priority {realtime}")
    if lock_memory:
        found["memory"] = _tried(_lock_memory, "locked")
    if core is not None:
        found["core"] = _tried(lambda: os.sched_setaffinity(0, {core}), f"core {core}")
    return found


@contextlib.contextmanager
def keeps_scheduler() -> Iterator[None]:
    """After the block this thread has the scheduler again that it had before."""
    known = hasattr(os, "sched_getscheduler")
    before = (os.sched_getscheduler(0), os.sched_getparam(0)) if known else None
    try:
        yield
    finally:
        if before is not None:
            with contextlib.suppress(OSError):  # not allowed any more
                os.sched_setscheduler(0, *before)


def as_priority(value: int | None, where: str) -> int | None:
    """Return a priority of the FIFO scheduler, 1 to 99, or None.

    Raises:
        InvalidInputError: it is none.
    """
    if value is not None and not 1 <= as_count(value, where) <= 99:
        raise InvalidInputError(f"realtime is {value}", where, "Give a priority from 1 to 99.")
    return value


def _tried(call: Callable[[], object], done: str) -> str:
    try:
        call()
    except (OSError, AttributeError, ValueError) as error:
        return f"not granted ({error})"
    return done


def _fifo(priority: int) -> None:
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))


def _lock_memory() -> None:
    if ctypes.CDLL(None, use_errno=True).mlockall(_CURRENT | _FUTURE) != 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
