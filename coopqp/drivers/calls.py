"""The calls of an operator to a running loop, from any thread: they are queued, and made between two periods."""

from __future__ import annotations

import abc
import functools
import math
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

from coopqp.checks import ArrayLike, as_scalar
from coopqp.control.operator.calls import DEADMAN
from coopqp.control.operator.hands import HAND_SILENCE
from coopqp.errors import InvalidInputError
from coopqp.spatial import Placement


class LoopCalls(abc.ABC):
    """What an operator may ask of a loop.

    Each call comes back at once, with a future: its ``result()`` waits until the controller has taken the call, and
    raises what the controller raises; the loop goes on. A call that nobody waits for and that is refused stands in the
    report. The calls from :meth:`reverse` on are those of the controller, with its arguments.

    Attributes:
        controller: the controller.
        refused_calls: what the controller refused in this run, a sentence each.
    """

    controller: Any

    def __init__(self) -> None:
        self._calls: deque[Callable[[], None]] = deque()
        self.refused_calls: list[str] = []
        self._now, self._silent_at = -math.inf, math.inf
        self._silent: Callable[[], object] = self._end_silence

    @abc.abstractmethod
    def _go_on(self) -> None:
        """Go on after a pause or a stop."""

    @abc.abstractmethod
    def _end(self, reason: str, *, failed: bool) -> None:
        """Brake, and end the run at rest."""

    def _queued(self, call: Callable[[], object], name: str) -> Future[None]:
        future: Future[None] = Future()

        def make() -> None:
            try:
                call()
            except InvalidInputError as error:
                self.refused_calls.append(f"{name}: {error}")
                future.set_exception(error)
            else:
                future.set_result(None)

        self._calls.append(make)
        return future

    def _drain(self) -> None:
        """Make the calls that wait."""
        while self._calls:
            self._calls.popleft()()

    def _ask_for_a_while(self, longest: float, silent: Callable[[], object], call: Future[None]) -> Future[None]:
        """A call that has to be repeated within a time [s]; else ``silent`` is called.

        The controller counts such times on its own clock, which the slowest robot slows.
        """

        def watch(done: Future[None]) -> None:
            if done.exception() is None:
                self._silent_at, self._silent = self._now + longest, silent

        call.add_done_callback(watch)
        return call

    def _end_silence(self) -> None:
        """Brake where a call was to be repeated, and was not."""
        if self._now >= self._silent_at:
            self._silent_at = math.inf
            self._silent()

    def _ask(self, name: str, *given: Any, **more: Any) -> Future[None]:
        call = getattr(self.controller, name, None)
        if not callable(call):
            raise InvalidInputError(
                f"a {type(self.controller).__name__} has no {name}()", f"ControlLoop.{name}", "Give a QPController."
            )
        return self._queued(functools.partial(call, *given, **more), name)

    def pause(self) -> Future[None]:
        """Bring the object to rest on its path, until :meth:`resume`."""
        return self._queued(self.controller.pause, "pause")

    def resume(self) -> Future[None]:
        """Go on after :meth:`pause`, and by hand after a stop, where no robot says any more that it stands."""
        return self._queued(self._go_on, "resume")

    def set_override(self, share: float) -> Future[None]:
        """The largest rate of the object, 0 to 1.

        Raises:
            InvalidInputError: not a number from 0 to 1.
        """
        share = as_scalar(share, "ControlLoop.set_override: share", open_low=False, high=1.0)
        return self._queued(lambda: self.controller.set_override(share), "set_override")

    def stop(self, reason: str = "stopped by its operator") -> Future[None]:
        """Brake all arms together, and end the run at rest."""
        return self._queued(lambda: self._end(reason, failed=True), "stop")

    def reverse(self, to: float = 0.0) -> Future[None]:
        """Go back along the program to a clock [s], and rest there."""
        return self._ask("reverse", to)

    def forward(self) -> Future[None]:
        """Go on along the program to its end."""
        return self._ask("forward")

    def run_to(self, clock: float) -> Future[None]:
        """Go along the program to a clock [s], in either direction, and rest there."""
        return self._ask("run_to", clock)

    def step_to_mark(self) -> Future[None]:
        """Go on to the next mark of the program, and rest there."""
        return self._ask("step_to_mark")

    def shift_path(self, T_world_shift: Placement, *, over: float = 0.1) -> Future[None]:
        """Lead the program over to ``T_world_shift`` times itself, over a length of path [m]."""
        return self._ask("shift_path", T_world_shift, over=over)

    def jog(self, twist: ArrayLike, *, frame: str = "object", deadman_s: float = DEADMAN) -> Future[None]:
        """Move the object by hand with a twist (6,) [m/s, rad/s]; the command holds for a moment of real time [s]."""
        longest = as_scalar(deadman_s, "ControlLoop.jog: deadman_s", high=1.0)
        return self._ask_for_a_while(
            longest, lambda: self.controller.jog([0.0] * 6), self._ask("jog", twist, frame=frame, deadman_s=longest)
        )

    def return_to_path(self) -> Future[None]:
        """Lead the object back to where it left its program."""
        return self._ask("return_to_path")

    def gear(self, position: float, *, speed: float = 1.0) -> Future[None]:
        """Let the program's clock follow a belt's position [s of it]; after 0.1 s without one the object pauses."""
        return self._ask_for_a_while(DEADMAN, self.controller.pause, self._ask("gear", position, speed=speed))

    def engage(self, T_world_hand: Placement) -> Future[None]:
        """Let the object follow a hand."""
        return self._ask_for_a_while(HAND_SILENCE, self.controller.release, self._ask("engage", T_world_hand))

    def target(self, T_world_hand: Placement) -> Future[None]:
        """Where the hand is now; after 0.25 s of real time without it the hand is released."""
        return self._ask_for_a_while(HAND_SILENCE, self.controller.release, self._ask("target", T_world_hand))

    def release(self) -> Future[None]:
        """Let the object follow no hand any more."""
        return self._ask("release")
