"""Notes of a run: one for each change of status or binding limits, and one for changes that alternate."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import final

from coopqp.control.interface import ControlStep, Status
from coopqp.model.limits import BindingLimit

#: Subject of a note.
Kind = tuple[Status, tuple[BindingLimit, ...]]
#: Changes that follow each other within this time are one episode [s].
_TOGETHER = 0.1
#: An episode alternates from this number of changes on, between at most this number of kinds.
_FEWEST_CHANGES, _MOST_KINDS = 6, 4


@dataclass(frozen=True)
class _Change:
    step: int
    time: float
    kind: Kind
    text: str


@final
@dataclass
class Notes:
    """Gathers the changes of status and binding limits of a run, step by step."""

    _changes: list[_Change] = field(default_factory=list)
    _last: Kind = (Status.TRACKING, ())
    _steps: int = 0
    _time: float = 0.0

    def take(self, step: ControlStep) -> None:
        """One more step."""
        kind = (step.status, step.binding)
        if kind != self._last or (not self._steps and step.reason):  # a start may have warnings while its step tracks
            self._changes.append(_Change(self._steps, self._time, kind, step.explain()))
            self._last = kind
        self._steps, self._time = self._steps + 1, self._time + step.dt

    def lines(self) -> tuple[str, ...]:
        """``"step: explanation"`` for each change; changes that alternate within a tenth of a second make one line."""
        lines, i = [], 0
        while i < len(self._changes):
            end = _episode(self._changes, i)
            if end - i >= _FEWEST_CHANGES:
                lines.append(_in_turn(self._changes[i:end]))
            else:
                end = i + 1
                lines.append(f"{self._changes[i].step}: {self._changes[i].text}")
            i = end
        return tuple(lines)


def _episode(changes: list[_Change], first: int) -> int:
    """End of the changes from ``first`` on that follow each other closely and are of few kinds."""
    kinds, end = {changes[first].kind}, first + 1
    while end < len(changes) and changes[end].time - changes[end - 1].time <= _TOGETHER:
        kinds.add(changes[end].kind)
        if len(kinds) > _MOST_KINDS:
            break
        end += 1
    return end


def _in_turn(changes: list[_Change]) -> str:
    """One line for changes that alternate: the statuses, how often, from when to when, and the most frequent cause."""
    often = Counter(change.kind for change in changes)
    statuses = sorted({status for status, _ in often}, key=lambda status: -status.precedence)
    names = " and ".join(status.name for status in statuses)
    most = max(often, key=lambda kind: (kind[0] is not Status.TRACKING, often[kind]))
    text = next(change.text for change in changes if change.kind == most)
    turns = f"{names} in turn" if len(statuses) > 1 else f"{names} for several reasons in turn"
    when = f"{len(changes)} changes from {changes[0].time:.3f} s to {changes[-1].time:.3f} s"
    return f"{changes[0].step}: {turns}, {when}; most often: {text}"
