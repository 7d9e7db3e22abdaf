"""The calls of an operator to a running loop, from any thread: they are queued, and made between two periods."""

from __future__ import annotations

import abc
import functools
import math
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

from coopqp.checks import ArrayLike, as_scalar
from coopqp.control.operator.calls import DEADMAN
from coopqp.control.operator.hands import HAND_SILENCE
from coopqp.control.operator.waiting import Waiting, kind_of
from coopqp.drivers.contained import Contained
from coopqp.errors import InvalidInputError
from coopqp.spatial import Placement

#: Sentences of refused calls that are kept.
_MOST_REFUSED = 100


class LoopCalls(abc.ABC):
    """What an operator may ask of a loop.

    Each call comes back at once, with a future: its ``result()`` waits until the controller has taken the call, and
    raises what the controller raises; the loop goes on. Of calls that decide the same (pause or resume, the override,
    the way to go, a twist) and come between two periods the last one is made, and answers for all. A call whose future
    is cancelled by then is not made. A call that nobody waits for and that is refused stands in the report. The calls
    from :meth:`reverse` on are those of the controller, with its arguments.

    Attributes:
        controller: the controller.
        refused_calls: what the controller refused in this run, a sentence each, the first hundred.
        outside: what others raised in this run.
    """

    controller: Any

    def __init__(self) -> None:
        self._calls: Waiting[tuple[Future[None], Callable[[], object]]] = Waiting()
        self.refused_calls: list[str] = []
        self.outside = Contained()
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
        self._calls.put(kind_of(name), (future, functools.partial(self._make, name, call)))
        return future

    def _make(self, name: str, call: Callable[[], object]) -> None:
        try:
            call()
        except Exception as error:
            if len(self.refused_calls) < _MOST_REFUSED:
                self.refused_calls.append(f"{name}: {error}")
            raise

    def _drain(self) -> None:
        """Make the calls that wait now."""
        for calls in self._calls.take():
            asked = [(future, make) for future, make in calls if _is_wanted(future)]
            if not asked:
                continue
            refused: Exception | None = None
            try:
                asked[-1][1]()
            except Exception as error:
                refused = error
            for future, _ in asked:
                if refused is None:
                    self.outside.call("a caller", future.set_result, None)
                else:
                    self.outside.call("a caller", future.set_exception, refused)

    def _end_silence(self) -> None:
        """Brake where a call was to be repeated, and was not."""
        if self._now >= self._silent_at:
            self._silent_at = math.inf
            self.outside.call("the end of a call by hand", self._silent)

    def _ask(self, name: str, *given: Any, **more: Any) -> Future[None]:
        return self._queued(self._call_of(name, *given, **more), name)

    def _ask_for_a_while(
        self, longest: float, silent: Callable[[], object], name: str, *given: Any, **more: Any
    ) -> Future[None]:
        """A call that has to be repeated within a time [s]; else ``silent`` is called.

        The controller counts such times on its own clock, which the slowest robot slows.
        """
        call = self._call_of(name, *given, **more)

        def made() -> None:
            call()
            self._silent_at, self._silent = self._now + longest, silent

        return self._queued(made, name)

    def _call_of(self, name: str, *given: Any, **more: Any) -> Callable[[], object]:
        call = getattr(self.controller, name, None)
        if not callable(call):
            raise InvalidInputError(
                f"a {type(self.controller).__name__} has no {name}()", f"ControlLoop.{name}", "Give a QPController."
            )
        return functools.partial(call, *given, **more)

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
        return self._queued(lambda: self._end(reason or "stopped by its operator", failed=True), "stop")

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
            longest, lambda: self.controller.jog([0.0] * 6), "jog", twist, frame=frame, deadman_s=longest
        )

    def return_to_path(self) -> Future[None]:
        """Lead the object back to where it left its program."""
        return self._ask("return_to_path")

    def gear(self, position: float, *, speed: float = 1.0) -> Future[None]:
        """Let the program's clock follow a belt's position [s of it]; after 0.1 s without one the object pauses."""
        return self._ask_for_a_while(DEADMAN, lambda: self.controller.pause(), "gear", position, speed=speed)

    def engage(self, T_world_hand: Placement) -> Future[None]:
        """Let the object follow a hand."""
        return self._ask_for_a_while(HAND_SILENCE, lambda: self.controller.release(), "engage", T_world_hand)

    def target(self, T_world_hand: Placement) -> Future[None]:
        """Where the hand is now; after 0.25 s of real time without it the hand is released."""
        return self._ask_for_a_while(HAND_SILENCE, lambda: self.controller.release(), "target", T_world_hand)

    def release(self) -> Future[None]:
        """Let the object follow no hand any more."""
        return self._ask("release")


def _is_wanted(future: Future[None]) -> bool:
    """Whether somebody waits for a call; from now on it cannot be cancelled."""
    try:
        return future.set_running_or_notify_cancel()
    except RuntimeError:  # its caller has answered it
        return False
