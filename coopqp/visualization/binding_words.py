"""What a step of a run does and what binds it, as a sentence for readers of a page."""

from __future__ import annotations

from collections.abc import Sequence

from coopqp.control.interface import Status
from coopqp.model.limits import BindingLimit, LimitKind
from coopqp.simulation.evaluation.assessment import ramps
from coopqp.simulation.recording.recording import Recording

#: What a joint, an arm or the path does where a limit of a kind binds; {} is its name.
_WORDS = {
    LimitKind.POSITION: "{} is at the end of its range",
    LimitKind.VELOCITY: "{} is at its largest speed",
    LimitKind.ACCELERATION: "{} is at its largest acceleration",
    LimitKind.JERK: "{} is at its largest jerk",
    LimitKind.TORQUE: "{} is at its largest torque",
    LimitKind.SINGULARITY: "{} is near a singularity",
    LimitKind.REACH: "{} is at the end of its reach",
    LimitKind.OUT_OF_STEP: "{} is out of step",
    LimitKind.PATH_END: "the path ends",
    LimitKind.OVERRIDE: "the operator's speed override",
    LimitKind.PATH_JUMP: "the path jumps",
}
_DOES = {
    Status.TRACKING: "The object follows its path at full speed",
    Status.BLOCKED: "The object cannot go on",
    Status.HOLDING: "All arms brake together and hold",
    Status.FAULT: "Stopped until a reset",
    Status.PAUSED: "Paused: the object rests on its path",
    Status.OFF_PATH: "The object is off its path",
    Status.JOGGING: "The operator leads the object",
    Status.WAITING: "The object waits at a gate",
}
#: Largest number of limits in a sentence.
MOST = 3


def limit_words(limit: BindingLimit) -> str:
    """A binding limit in words, e.g. ``joint 3 of slave 1 is at its largest speed``."""
    if limit.between:
        apart = "" if limit.distance is None else f" ({1e3 * limit.distance:.1f} mm)"
        return _spaced(f"{limit.between[0]} and {limit.between[1]} are as near as they may be{apart}")
    if limit.kind is LimitKind.CONSTRAINT:
        return f"the constraint {limit.name} binds"
    who = f"{limit.joint} of {limit.arm}" if limit.joint else f"arm {limit.arm}" if limit.arm else "the path"
    return _spaced(_WORDS.get(limit.kind, f"the {limit.kind.value} of {{}} is at its limit").format(who))


class Why:
    """Sentences for the steps of a run: what the object does, and what binds.

    Args:
        recording: the run.

    Raises:
        RecordingError: the recording's limits are damaged.
    """

    def __init__(self, recording: Recording) -> None:
        self._run = recording
        self._bindings = recording.bindings
        self._begun, _ = ramps(recording)
        self._notes = [
            (int(begun), text)
            for begun, _, text in (note.partition(": ") for note in recording.notes)
            if begun.isdecimal() and len(begun) < 18
        ]

    def limits(self, sample: int) -> tuple[BindingLimit, ...]:
        """What binds in the step that starts at a sample; at the last sample in the last step."""
        step = self._step(sample)
        return self._bindings[step] if 0 <= step < len(self._bindings) else ()

    def status(self, sample: int) -> Status:
        """Status of the step that starts at a sample."""
        step = self._step(sample)
        return list(Status)[int(self._run.status[step])] if step >= 0 else Status.TRACKING

    def reason(self, sample: int) -> str:
        """What the run itself says about the step that starts at a sample, where it does not track; else empty."""
        if self.status(sample) is Status.TRACKING:
            return ""
        step = self._step(sample)
        return next((text for begun, text in reversed(self._notes) if begun <= step), "")

    def __call__(self, sample: int) -> str:
        """One sentence: what the object does in the step that starts at a sample, and why."""
        status, limits, step = self.status(sample), self.limits(sample), self._step(sample)
        what = _DOES.get(status, "")
        if status is Status.SLOWED:
            if step < self._begun:
                return "The object speeds up from rest."
            what = f"The object is slowed to {100.0 * float(self._run.rate[step]):.3g} % of its path's speed"
        if not limits:
            said = self.reason(sample)
            if status is Status.TRACKING:
                return f"{what}; no limit binds."
            return said if said and status is not Status.SLOWED else f"{what}{_rest(said)}."
        words = [limit_words(limit) for limit in limits[:MOST]]
        more = f", and {len(limits) - MOST} more" if len(limits) > MOST else ""
        return f"{what}{';' if status is Status.TRACKING else ':'} {_listed(words)}{more}."

    def _step(self, sample: int) -> int:
        return min(sample, self._run.n_steps - 1)


def _rest(said: str) -> str:
    """What a note says after its first part, as the end of a sentence."""
    rest = said.partition("; ")[2].rstrip(". ")
    return f": {rest}" if rest else ""


def _listed(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


def _spaced(name: str) -> str:
    return name.replace("_", " ")
