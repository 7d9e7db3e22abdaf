"""An operator's calls in a run: recorded, made again, and read from a script."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, final

import numpy as np

from coopqp.control.operator.operator import REFUSED
from coopqp.errors import CoopqpError, InvalidInputError
from coopqp.reading import read_file
from coopqp.simulation.recording.recording import Recording

#: A call of an operator ahead of a step: the controller, and how many steps are done.
Operate = Callable[[Any, int], None]
_PLAIN = ("pause", "resume", "forward", "step_to_mark", "return_to_path", "release")
_NUMBER = ("set_override", "reverse", "run_to")
_POSE = ("retarget", "engage", "target")
_CALLS = (*_PLAIN, *_NUMBER, *_POSE, "shift_path", "jog", "gear", "signal")
#: What a script may call.
_IN_SCRIPTS = (*_PLAIN, *_NUMBER, "signal", "shift_path", "jog")
#: Largest accepted script [bytes].
_MOST_BYTES = 1_000_000
#: Between two jog commands of a script [s].
_COMMANDS_APART = 0.05


@final
@dataclass(frozen=True)
class Event:
    """A call of an operator.

    Attributes:
        step: number of the step ahead of which it was made.
        call: name of the method.
        value: its arguments, as plain data.
        clock: the program's clock then [s].
        place: where a script says so, for messages; else empty.
    """

    step: int
    call: str
    value: Any = None
    clock: float = 0.0
    place: str = field(default="", compare=False)

    def make(self, controller: Any) -> None:
        """Make the call.

        Raises:
            InvalidInputError: the controller takes no such call, or the values are wrong.
        """
        try:
            self._make(controller)
        except CoopqpError as error:
            if not self.place:
                raise
            raise InvalidInputError(str(error).rstrip("."), self.place, "Change this line.") from error

    def _make(self, controller: Any) -> None:
        if self.call == REFUSED:  # it has changed nothing
            return
        method = getattr(controller, self.call, None)
        if self.call not in _CALLS or method is None:
            what = f"a {type(controller).__name__} takes no call '{self.call}' from a recording or a script"
            raise InvalidInputError(what, "Event", f"Calls are {', '.join(_CALLS)}.")
        if self.call in _PLAIN:
            method()
        elif self.call == "gear":
            method(self.value[0], speed=self.value[1])
        elif self.call == "jog":
            method(self.value[0], frame=self.value[1], deadman_s=max(self.value[2], 1e-9))
        elif self.call == "shift_path":
            method(np.array(self.value[0]), over=self.value[1])
        else:
            method(np.array(self.value) if self.call in _POSE else self.value)


def events_of(recording: Recording) -> tuple[Event, ...]:
    """The calls that an operator made in a run."""
    return tuple(
        Event(int(i), str(call), value, float(clock)) for i, call, value, clock in recording.metadata.get("calls", ())
    )


def operating(events: Iterable[Event], begun: dict[str, Any] | None = None) -> Operate:
    """Make calls at their steps, for :func:`coopqp.simulate`.

    Args:
        events: the calls, in order.
        begun: override and pause at the start, as in a recording's metadata; None to leave them.
    """
    waiting = sorted(events, key=lambda event: event.step)

    def operate(controller: Any, done: int) -> None:
        if done == 0 and begun is not None:
            now = {"override": controller.override, "paused": controller.paused}
            if now != {name: begun[name] for name in now}:
                raise InvalidInputError(
                    f"the run began with an override of {begun['override']:g}, paused: {begun['paused']}",
                    "replay", "Set them on the controller before simulate: begin_as.",
                )  # fmt: skip
        while waiting and waiting[0].step <= done:
            waiting.pop(0).make(controller)

    return operate


def begin_as(controller: Any, begun: dict[str, Any] | None) -> None:
    """Set override and pause of a controller as a recorded run began, entry ``begun`` of its metadata."""
    if begun is not None and begun["override"] != 1.0:
        controller.set_override(begun["override"])
    if begun is not None and begun["paused"]:
        controller.pause()


def differs_from(first: Recording, second: Recording) -> int | None:
    """The first step in which two runs differ in a bit of what was commanded or measured; None if none does."""
    most = min(first.n_steps, second.n_steps)
    pairs = [(getattr(first, name), getattr(second, name)) for name in ("q", "q_command", "clock", "velocity", "rate")]
    for i in range(most):
        if any(not np.array_equal(a[i], b[i]) for a, b in pairs):
            return i
    last = any(not np.array_equal(a[most], b[most]) for a, b in pairs[:3])
    return most if last or first.n_steps != second.n_steps else None


def read_script(file: Path, dt: float) -> tuple[Event, ...]:
    """Calls from a script: a line is a time [s], a call, its numbers, and for a jog a frame and ``for SECONDS``.

    ``1.5 jog 0 0 0.05 0 0 0 world for 2`` repeats its command every 50 ms for 2 s. ``#`` begins a comment.

    Args:
        file: the script.
        dt: length of a step [s].

    Raises:
        InvalidInputError: a line that is no call, by its number.
    """
    found: list[Event] = []
    try:
        lines = read_file(file, _MOST_BYTES).decode("utf-8-sig").splitlines()
    except OSError as error:
        why = f"{error.filename} cannot be read: {error.strerror}"
        raise InvalidInputError(why, "script", "Give a text file.") from error
    except UnicodeDecodeError as error:
        raise InvalidInputError(f"{file} cannot be read ({error})", "script", "Give a text file.") from error
    for number, line in enumerate(lines, 1):
        words = line.partition("#")[0].split()
        if not words:
            continue
        try:
            found += [replace(event, place=f"{file}, line {number}") for event in _events(words, dt)]
        except (ValueError, IndexError) as error:
            what = f"{file}, line {number}: {line.strip()}"
            remedy = f"Write a time [s], a call, and its numbers; calls are {', '.join(_IN_SCRIPTS)}."
            raise InvalidInputError(what, "script", remedy) from error
    return tuple(sorted(found, key=lambda event: event.step))


def _events(words: Sequence[str], dt: float) -> list[Event]:
    time, call, values = float(words[0]), words[1], list(words[2:])
    step = round(time / dt)
    if not 0 <= step < 1e9:
        raise ValueError(words[0])
    if call in _PLAIN and not values:
        return [Event(step, call)]
    if call in _NUMBER and (len(values) == 1 or (call == "reverse" and not values)):
        return [Event(step, call, float(values[0]) if values else 0.0)]
    if call == "signal" and values:
        return [Event(step, call, " ".join(values))]
    if call == "shift_path" and len(values) == 3:
        T = np.eye(4)
        T[:3, 3] = [float(value) for value in values]
        return [Event(step, call, [T.tolist(), 0.1])]
    if call == "jog":
        lasts = 0.0
        if "for" in values:
            i = values.index("for")
            lasts = float(values[i + 1])
            values = [*values[:i], *values[i + 2 :]]
        frame = values.pop() if len(values) == 7 else "object"
        twist = [float(value) for value in values]
        if len(twist) != 6 or not 0.0 <= lasts < 1e4:
            raise ValueError(call)
        every = max(1, round(_COMMANDS_APART / dt))
        times = range(step, step + max(1, round(lasts / dt)), every)
        return [Event(i, call, [twist, frame, 0.1]) for i in times]
    raise ValueError(call)
