"""What is not the loop's own may raise anything: callers, recorders, pages, drivers. The loop says so, and goes on."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, final

from coopqp.errors import said


@final
class Contained:
    """Calls code that is not the loop's own.

    Attributes:
        failures: what it raised first, in a sentence, by the name of who raised it.
    """

    def __init__(self) -> None:
        self.failures: dict[str, str] = {}

    def call(self, name: str, ask: Callable[..., Any], *given: Any) -> bool:
        """Make a call; whether it went well. What it raises first is kept under the name of who raises it."""
        try:
            ask(*given)
        except Exception as error:
            self.failures.setdefault(name, f"{name} raised {said(error)}")
            return False
        return True


def name_of(function: Callable[..., Any]) -> str:
    """A function's name for a message, with its class."""
    return str(getattr(function, "__qualname__", type(function).__name__)).rpartition("<locals>.")[2]
