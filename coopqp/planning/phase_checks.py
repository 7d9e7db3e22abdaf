"""The verdict on a program phase by phase: which phase, which arm, and why."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from coopqp.collision.clearance_check import ClearanceCheck
from coopqp.paths.certificate import PathVerdict, worst
from coopqp.paths.path import ObjectPath
from coopqp.planning.arm_check import ArmCheck
from coopqp.programs.program import PhaseSpan, Program

#: A clock this close to the end of a phase belongs to it [s].
_END = 1e-9


@dataclass(frozen=True, kw_only=True)
class PhaseCheck:
    """The verdict on one phase.

    Attributes:
        name, start, end: the phase, and its clocks on the program [s].
        verdict: the worst of the arms and the distances; INFEASIBLE in the phase in which an arm cannot go on, or a
            pair comes inside its margin; None in those after it.
        arm: the arm that makes it; empty if all are alike, or distances make it.
        why: the reason against a better one.
    """

    name: str
    start: float
    end: float
    verdict: PathVerdict | None
    arm: str = ""
    why: str = ""

    def record(self) -> dict[str, Any]:
        """The phase as plain data for JSON."""
        verdict = None if self.verdict is None else self.verdict.value
        return {
            "name": self.name,
            "start_s": self.start,
            "end_s": self.end,
            "verdict": verdict,
            "arm": self.arm,
            "why": self.why,
        }


def phase_checks(
    path: ObjectPath, arms: Sequence[ArmCheck], clearance: ClearanceCheck | None
) -> tuple[PhaseCheck, ...]:
    """The verdict on each phase of a program, its distances included where they were checked; none for other paths."""
    if not isinstance(path, Program):
        return ()
    stops = [
        (0.0 if arm.chosen is None else arm.chosen.until, arm.arm, arm.trouble)
        for arm in arms
        if arm.verdict is PathVerdict.INFEASIBLE
    ]
    near = "" if clearance is None or (by := clearance.stopped_by) is None else f"{by.first} and {by.second}"
    if clearance is not None and clearance.stop is not None and clearance.verdict is PathVerdict.INFEASIBLE:
        stops.append((clearance.stop, "", f"{near} come inside their margin"))
    until, by_arm, trouble = min(stops, key=lambda stop: stop[0]) if stops else (float("inf"), "", "")
    found = []
    for span in path.spans:
        own = {"name": span.name, "start": span.start, "end": span.end}
        if until < span.start - _END:
            found.append(PhaseCheck(**own, verdict=None, why="it is not reached"))  # type: ignore[arg-type]
            continue
        if stops and (until < span.end - _END or span is path.spans[-1]):
            found.append(PhaseCheck(**own, verdict=PathVerdict.INFEASIBLE, arm=by_arm, why=trouble))  # type: ignore[arg-type]
            until = -1.0
            continue
        verdicts = [(_verdict(arm, span.start, span.end), arm.arm) for arm in arms]
        if clearance is not None:
            verdicts.append((_of_distances(clearance, span.start, span.end), ""))
        verdict = worst([v for v, _ in verdicts])
        worse = [name for v, name in verdicts if v is verdict]
        arm = worse[0] if len(worse) == 1 and verdict is not PathVerdict.CERTIFIED else ""
        why = ""
        if near and clearance is not None and verdict is PathVerdict.UNDECIDED and _stops_in(clearance, span):
            why = f"{near} come inside their margin on the motion that was found"
        found.append(PhaseCheck(**own, verdict=verdict, arm=arm, why=why))  # type: ignore[arg-type]
    return tuple(found)


def _verdict(arm: ArmCheck, start: float, end: float) -> PathVerdict:
    """The verdict on an arm from one clock to another [s], before it stops."""
    chosen = arm.chosen
    if chosen is None:
        return PathVerdict.INFEASIBLE
    if any(a < end - _END and b > start + _END for a, b in chosen.undecided):
        return PathVerdict.UNDECIDED
    if arm.verdict in (PathVerdict.CERTIFIED, PathVerdict.SAMPLED):
        return arm.verdict
    proved = sum(max(min(b, end) - max(a, start), 0.0) for a, b in chosen.certified)
    return PathVerdict.CERTIFIED if proved >= (end - start) - _END else PathVerdict.SAMPLED


def _stops_in(clearance: ClearanceCheck, span: PhaseSpan) -> bool:
    """Whether a pair comes inside its margin first in a phase."""
    return clearance.stop is not None and span.start - _END <= clearance.stop < span.end - _END


def _of_distances(clearance: ClearanceCheck, start: float, end: float) -> PathVerdict:
    """The verdict on the distances from one clock to another [s], before a pair comes inside its margin."""
    if any(a < end - _END and b > start + _END for a, b in clearance.undecided):
        return PathVerdict.UNDECIDED
    return PathVerdict.SAMPLED if clearance.verdict is PathVerdict.SAMPLED else PathVerdict.CERTIFIED


def explained(phases: Sequence[PhaseCheck]) -> list[str]:
    """A line for each phase."""
    lines = []
    for p in phases:
        verdict = "not reached" if p.verdict is None else p.verdict.value.lower()
        why = (
            "" if p.verdict is None else "".join(f"; {part}" for part in (p.why or (p.arm and f"arm {p.arm}"),) if part)
        )
        lines.append(f"phase {p.name} ({p.start:.4g}–{p.end:.4g} s): {verdict}{why}.")
    return lines
