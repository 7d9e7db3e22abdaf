"""A control loop that an operator's page leads: see :class:`coopqp.drivers.real_time.RealTimeRun`, its counterpart."""

from __future__ import annotations

from concurrent.futures import Future, TimeoutError as NotYet
from typing import Any, final

from coopqp.drivers.loop import ControlLoop
from coopqp.drivers.real_time import CALLS
from coopqp.errors import InvalidInputError

#: A call's answer is waited for so long [s]; a later refusal stands in the loop's report.
_PATIENCE = 0.2


@final
class LedLoop:
    """Passes calls by name to a :class:`ControlLoop`.

    Args:
        loop: the loop; its controller begins paused.
    """

    def __init__(self, loop: ControlLoop) -> None:
        self._loop, self.controller = loop, loop.controller
        self.controller.pause()

    def call(self, name: str, *values: Any, **named: Any) -> None:
        """Make an operator's call, from any thread; it takes effect in the next period.

        Where all arms stand behind a robot that stopped, ``forward`` and ``reset`` go on by hand, as ``resume`` does.

        Raises:
            InvalidInputError: no such call, a bad value, or a ``reset`` where no robot has stopped; nothing changes.
        """
        loop = self._loop
        if name not in CALLS:
            raise InvalidInputError(f"there is no call '{name}'", "call", f"Calls are {', '.join(CALLS)}.")
        if name == "reset" and not loop.stands:
            raise InvalidInputError("no robot has stopped", "reset", "After a fault start the command again.")
        if loop.stands and name in ("forward", "reset"):
            _answer(loop.resume())
        if name != "reset":
            _answer(getattr(loop, name)(*values, **named))

    def lateness(self, last: int) -> None:
        """It stands in the loop's report, after the run."""


def _answer(future: Future[None]) -> None:
    try:
        future.result(_PATIENCE)
    except NotYet:
        return
