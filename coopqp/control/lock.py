"""One thread at a time: a controller that another thread works in refuses the call before anything is touched.

Calls of an operator from another thread than the one that steps wait for the next step.
"""

from __future__ import annotations

import functools
import threading
from collections.abc import Callable
from typing import Any, Concatenate, ParamSpec, Protocol, TypeVar, cast

from coopqp.errors import BusyError

_P = ParamSpec("_P")
_R = TypeVar("_R")


class Lock:
    """The lock of a controller. The thread that holds it may take it again, and releases it as often."""

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._stepper: int | None = None

    def hold(self) -> None:
        """Take the lock.

        Raises:
            BusyError: another thread holds it.
        """
        if not self._lock.acquire(blocking=False):
            raise BusyError

    def release(self) -> None:
        """Release the lock."""
        self._lock.release()

    def steps_here(self) -> None:
        """This thread steps."""
        self._stepper = threading.get_ident()

    def steps_elsewhere(self) -> bool:
        """Whether another thread made the last step."""
        return self._stepper not in (None, threading.get_ident())

    def __reduce__(self) -> tuple[type[Lock], tuple[()]]:
        return Lock, ()


class _Locked(Protocol):
    @property
    def _turn(self) -> Any: ...


_Self = TypeVar("_Self", bound=_Locked)


def alone(method: Callable[Concatenate[_Self, _P], _R]) -> Callable[Concatenate[_Self, _P], _R]:
    """A method of an object with a ``_turn`` that raises BusyError while another thread works in the object."""

    @functools.wraps(method)
    def guarded(self: _Self, *arguments: _P.args, **options: _P.kwargs) -> _R:
        lock = self._turn
        lock.hold()
        try:
            return method(self, *arguments, **options)
        finally:
            lock.release()

    return cast(Callable[Concatenate[_Self, _P], _R], guarded)
