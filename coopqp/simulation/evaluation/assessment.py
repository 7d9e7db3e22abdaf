"""Verdict on a run, from its recording only: on the end, limits, grasp, path, distances and loads."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from coopqp.checks import Doc, as_options, documented, keep_scalars
from coopqp.collision.clearance_check import remark
from coopqp.collision.pairs import pairs_said
from coopqp.control.interface import Status
from coopqp.model.cell import RobotCell, slides, standing
from coopqp.simulation.evaluation import metrics
from coopqp.simulation.evaluation.figures import ramps
from coopqp.simulation.evaluation.metrics import error_text
from coopqp.simulation.evaluation.readings import Readings
from coopqp.simulation.evaluation.wrenches import read_loads
from coopqp.simulation.recording.recording import Recording, RecordingError
from coopqp.spatial import Array

#: Excess over a position limit [rad or m] and over a speed or acceleration limit [share] that counts as rounding.
POSITION_ROUNDING, RATE_ROUNDING = 1e-6, 1e-6
#: Distances this much below their margin count as rounding [m].
MARGIN_ROUNDING = 1e-6
#: Largest number of limits in a cause.
MAX_BLAMED = 3


#: A clock this close to the end of a phase belongs to it [s].
AT_PHASE_END = 1e-9


@documented
@dataclass(frozen=True)
class Tolerances:
    """Accepted errors of a run."""

    chain_mm: Annotated[float, Doc("distance between the object poses of any two arms [mm]")] = 0.1
    chain_deg: Annotated[float, Doc("angle between the object poses of any two arms [deg]")] = 0.1
    object_mm: Annotated[float, Doc("distance between the object and its path [mm]")] = 1.0
    object_deg: Annotated[float, Doc("angle between the object and its path [deg]")] = 0.5

    def __post_init__(self) -> None:
        keep_scalars(self, *self.__dataclass_fields__)

    @staticmethod
    def of(recording: Recording) -> Tolerances:
        """The tolerances that a recording was made with (table ``verdict`` of a cell file); else the defaults.

        Raises:
            RecordingError: the entry ``verdict`` of the settings is damaged.
        """
        settings = recording.metadata.get("settings")
        given = settings.get("verdict") if isinstance(settings, Mapping) else None
        if given is None:
            return Tolerances()
        known = {field.name for field in fields(Tolerances)}
        try:
            return Tolerances(**{name: value for name, value in dict(given).items() if name in known})
        except (TypeError, ValueError, OverflowError) as error:
            raise RecordingError(f"'verdict' in the recording's settings is damaged ({error}).") from error


#: Questions on how far a run came, which is an operator's affair.
_ARRIVED, _ENDED = ARRIVALS = ("Did the object arrive?", "Did all phases end?")


@dataclass(frozen=True)
class Finding:
    """One line of a verdict.

    Attributes:
        question: the question.
        holds: the answer, True for yes.
        answer: the answer with its figures.
        cause: if the answer is no: why, where (arm, joint, limit) and since when [s]; else empty.
    """

    question: str
    holds: bool
    answer: str
    cause: str = ""


def evaluate(
    cell: RobotCell,
    recording: Recording,
    readings: Readings,
    *,
    tolerances: Tolerances | Mapping[str, Any] | None = None,
) -> tuple[Finding, ...]:
    """The verdict on a run: the end, the limits, the grasp, the path, and distances where the run has measured them.

    Args:
        cell, recording: the run.
        readings: result of :func:`coopqp.simulation.read_run`.
        tolerances: accepted errors; by default :meth:`Tolerances.of` the recording.
    """
    t = Tolerances.of(recording) if tolerances is None else as_options(Tolerances, tolerances, "evaluate: tolerances")
    return (
        _finished(recording),
        *_phases(recording),
        _positions(cell, recording),
        _rates(cell, recording),
        _held(
            "Do the arms agree on where the object is?",
            recording,
            (readings.chain_mm, readings.chain_deg),
            (t.chain_mm, t.chain_deg),
            lambda i: _parted(cell, recording, i),
        ),
        _held(
            "Is the object on its path?",
            recording,
            (readings.object_mm, readings.object_deg),
            (t.object_mm, t.object_deg),
            lambda i: _strayed(cell, recording, i),
        ),
        *_apart(recording),
        *_carried_load(cell, recording),
    )


def _phases(recording: Recording) -> tuple[Finding, ...]:
    """Finding on the phases of a program: the time in each, and at its gate; empty for other runs."""
    phases = recording.metadata.get("phases")
    if not phases:
        return ()
    try:
        rows = [(str(p["name"]), float(p["start_s"]), float(p["end_s"])) for p in phases]
    except (KeyError, TypeError, ValueError) as error:
        raise RecordingError(f"'phases' in the recording's metadata is damaged ({error}).") from error
    steps, clock = np.diff(recording.time), recording.clock[1:]
    waits = recording.status == Status.WAITING.code
    own = np.searchsorted([end for _, _, end in rows[:-1]], clock - AT_PHASE_END, side="left")
    texts = []
    for i, (name, _, _) in enumerate(rows):
        there = own == i
        if not there.any():
            texts.append(f"{name} was not reached")
            continue
        moved, waited = (float(steps[there & part].sum()) for part in (~waits, waits))
        texts.append(f"{name} {moved:.3g} s" + f", then waiting {waited:.3g} s" * (waited > 0.0))
    return (Finding(_ENDED, bool(recording.finished), "; ".join(texts)),)


_STOPPED = (Status.BLOCKED, Status.HOLDING, Status.FAULT)


def _finished(recording: Recording) -> Finding:
    question = _ARRIVED
    end = float(recording.metadata.get("duration", math.nan))
    took = f"{recording.time[-1]:.4g} s" + (f" for a path of {end:.4g} s" if math.isfinite(end) else "")
    begun, ended = ramps(recording)
    slowed = sum(s in (Status.SLOWED, Status.BLOCKED) for s in recording.statuses) - begun - ended
    stopped = sum(s in (Status.HOLDING, Status.FAULT) for s in recording.statuses)
    text = f"{took}, {slowed} of {recording.n_steps} steps slowed"
    text += f", {begun} to speed up" if begun else ""
    text += f", {ended} to brake at the end" if ended else ""
    endless = end == math.inf
    if endless:
        text += "; the path has no end"
    elif not recording.finished:
        text = f"the object's clock stands at {recording.clock[-1]:.4g} s after {took}"
    if stopped:
        text += f", {stopped} steps stopped by a failure"
    text += _counted(recording, Status.PAUSED, "paused") + _counted(recording, Status.JOGGING, "led by hand")
    text += _counted(recording, Status.WAITING, "waiting") + _counted(recording, Status.OFF_PATH, "off the path")
    arrived = recording.finished or endless
    cause = "" if arrived and not stopped else _why_not(recording, arrived=arrived)
    return Finding(question, arrived and not stopped, text, cause)


def _carried_load(cell: RobotCell, recording: Recording) -> tuple[Finding, ...]:
    """Findings on forces and torques; empty for a recording without them."""
    loads = read_loads(cell, recording)
    if loads is None:
        return ()
    asked = (
        ("Do the arms carry the load?", loads.overloaded(cell)),
        ("Is the object held without squeezing?", loads.squeezed(cell))
        if loads.palm_use is None
        else ("Do the palms hold the object?", loads.held(cell)),
    )
    return tuple(Finding(question, not cause, text, cause) for question, (text, cause) in asked)


def _apart(recording: Recording) -> tuple[Finding, ...]:
    """Finding on distances; empty for a recording without them."""
    entry = recording.metadata.get("clearance")
    if entry is None:
        return ()
    try:
        left_out = [(str(first), str(second)) for first, second in entry["left_out"]]
        measured = "closest_m" in entry
        closest, at = (float(entry[key]) if measured else math.nan for key in ("closest_m", "time_s"))
        names = " and ".join(map(str, entry["between"])) if measured else ""
        margin = float(entry["margin_m"]) if measured and entry["avoided"] else 0.0
        notes = [str(note) for note in entry.get("notes", ())]
    except (KeyError, TypeError, ValueError, OverflowError, AttributeError) as error:
        raise RecordingError(f"'clearance' in the recording's metadata is damaged ({error}).") from error
    where = f"{names} at {at:.3g} s"
    inside = closest < margin - MARGIN_ROUNDING
    touched = closest <= 0.0 and (inside or not (entry["avoided"] and entry.get("starts_inside", False)))
    texts = [f"{where} touched" if touched else f"nothing touched: closest {1e3 * closest:.3g} mm, {where}"]
    if closest <= 0.0 and not touched:
        texts = [f"{names} overlap at the start, as they may, and come no closer"]
    texts = texts[: int(measured)]
    causes = [where if touched else f"{where}, inside the margin of {1e3 * margin:.3g} mm"][: int(touched or inside)]
    if left_out:
        overlap = f"{pairs_said(left_out)} overlap at the start"
        texts = [f"{overlap} and are not judged", *(f"else {text}" for text in texts)]
        causes.insert(0, overlap)
    texts += remark(notes)
    return (Finding("Did all keep clear?", not causes, "; ".join(texts), "; ".join(causes)),)


def _counted(recording: Recording, status: Status, what: str) -> str:
    steps = sum(s is status for s in recording.statuses)
    return f", {steps} {what}" if steps else ""


def _why_not(recording: Recording, *, arrived: bool) -> str:
    """Why a run did not finish, or what failed in it: the status, its limits or its reason, and since when."""
    statuses = recording.statuses
    if not statuses:
        return "no step was made"
    if arrived:  # it went on after a failure
        first = next(i for i, s in enumerate(statuses) if s in (Status.HOLDING, Status.FAULT))
        return f"{statuses[first].value} from {_at(recording, first)} on{_blame(recording, first, first + 1)}"
    kinds = _STOPPED if statuses[-1] in _STOPPED else (statuses[-1],)
    first = len(statuses)
    while first and statuses[first - 1] in kinds:
        first -= 1
    if statuses[-1] is Status.TRACKING:
        return f"the run ended before the path did, at {recording.time[-1]:.3f} s"
    return f"{statuses[-1].value} since {_at(recording, first)}{_blame(recording, first, len(statuses))}"


def _at(recording: Recording, sample: int) -> str:
    return f"{float(recording.time[sample]):.3f} s"


def _blame(recording: Recording, first: int, last: int) -> str:
    """The limits that bound in the steps [first, last), longest first; else the note of the run for them."""
    seconds: dict[Any, float] = {}
    for i, limits in enumerate(recording.bindings[first:last], start=first):
        for limit in limits:
            seconds[limit] = seconds.get(limit, 0.0) + float(recording.time[i + 1] - recording.time[i])
    if seconds:
        worst = sorted(seconds, key=lambda limit: (-seconds[limit], str(limit)))
        return " by " + ", ".join(map(str, worst[:MAX_BLAMED]))
    notes = [note.partition(": ") for note in recording.notes]
    reasons = [text for step, _, text in notes if step.isdigit() and first <= int(step) < last]
    return f": {reasons[-1].rstrip('.')}" if reasons else ""


def _positions(cell: RobotCell, recording: Recording) -> Finding:
    question = "Are the joints inside their positions?"
    parts = recording.parts(len(recording.time))
    none = np.full(cell.nv, -np.inf)
    outside, since = _largest(parts, lambda part: -_within_limits(cell, recording, part), POSITION_ROUNDING, none)
    j = int(outside.argmax())
    margin, name, at = -float(outside[j]), cell.joint_names[j], _at(recording, max(int(since[j]), 0))
    if not np.isfinite(margin):
        if since[j] >= 0:
            return Finding(question, False, "not finite", f"not finite since {at}")
        return Finding(question, True, "no joint has a limit")
    unit = _amount(cell, j, abs(margin))
    if margin < -POSITION_ROUNDING:
        return Finding(question, False, f"{name} is {unit} outside", f"{_joint(cell, j)}: position, since {at}")
    return Finding(question, True, f"closest: {name}, {unit} inside")


def _largest(
    parts: Iterable[slice], values: Callable[[slice], Array], allowed: float, least: Array
) -> tuple[Array, npt.NDArray[np.intp]]:
    """The largest value of each joint (nv,) over all rows, and the first row with one that is not allowed; −1 for none.

    Args:
        parts: the rows; ``values(part)`` has some of them (T, nv). NaN is not allowed, and counts as the largest.
        allowed: largest value that is allowed.
        least: what the largest is without rows (nv,).
    """
    largest, first = least, np.full(len(least), -1)
    for part in parts:
        rows = values(part)
        bad = ~(rows <= allowed)
        largest = np.maximum(largest, rows.max(axis=0))
        first = np.where((first < 0) & bad.any(axis=0), part.start + bad.argmax(axis=0), first)
    return largest, first


def _within_limits(cell: RobotCell, recording: Recording, part: slice) -> Array:
    """Distance of the commanded joints from the nearer position limit (T, nv) [rad or m]; inf without limit.

    Joints that move no tool, such as fingers, are where they stand: inf inside their limits.
    """
    q = cell.positions(recording.q_command[part])
    margins = np.minimum(q - cell.limits.lower, cell.limits.upper - q)
    for own, still in zip(cell.columns, standing(cell), strict=True):
        stands = margins[:, own[still]]
        margins[:, own[still]] = np.where(stands >= -POSITION_ROUNDING, np.inf, stands)
    return margins


def _rates(cell: RobotCell, recording: Recording) -> Finding:
    question = "Are the joints within speed and acceleration?"
    texts, causes = [], []
    for name, kind, share, limit in (
        ("speed", "velocity", _speed, cell.limits.velocity),
        ("acceleration", "acceleration", _acceleration, cell.limits.acceleration),
    ):
        if not np.isfinite(limit).any():
            texts.append(f"no limit of {name}")
            continue
        shares = functools.partial(share, cell, recording)
        largest, since = _largest(recording.parts(recording.n_steps), shares, 1.0 + RATE_ROUNDING, np.zeros(cell.nv))
        j = int(largest.argmax())
        texts.append(f"{name} ≤ {100.0 * largest[j]:.4g} % of the limit ({cell.joint_names[j]})")
        if since[j] >= 0:
            causes.append(f"{_joint(cell, j)}: {kind}, since {_at(recording, int(since[j]))}")
    return Finding(question, not causes, "; ".join(texts), "; ".join(causes))


def _speed(cell: RobotCell, recording: Recording, part: slice) -> Array:
    """Joint speeds of steps as shares of their limits (T, nv)."""
    return np.abs(recording.velocity[part]) / cell.limits.velocity


def _acceleration(cell: RobotCell, recording: Recording, part: slice) -> Array:
    """Accelerations of steps as shares of their limits (T, nv). A run starts at rest."""
    v = recording.velocity[part]
    before = np.vstack([recording.velocity[part.start - 1] if part.start else np.zeros(cell.nv), v[:-1]])
    dt = np.diff(recording.time[part.start : part.stop + 1])[:, None]
    return np.abs(v - before) / dt / cell.limits.acceleration


def _held(
    question: str,
    recording: Recording,
    errors: tuple[Array, Array],
    largest: tuple[float, float],
    where: Callable[[int], str],
) -> Finding:
    a, b = (float(np.max(error)) for error in errors)
    text = f"{_within(a, ' mm', b, '°')} (asked: {largest[0]:g} mm, {largest[1]:g}°)"
    bad = ~((errors[0] <= largest[0]) & (errors[1] <= largest[1]))
    if not bad.any():
        return Finding(question, True, text)
    first = int(bad.argmax())
    return Finding(question, False, text, f"{where(first)}, beyond the tolerance since {_at(recording, first)}")


def _within(a: float, of_a: str, b: float, of_b: str) -> str:
    one, other = error_text(a, of_a), error_text(b, of_b)
    both = f"within {one}" if not one.startswith("below") else one
    joined = not other.startswith("below") and both == one  # each has its own word
    return f"{both} and {'within ' if joined else ''}{other}"


def _joint(cell: RobotCell, j: int) -> str:
    arm, _, joint = cell.joint_names[j].partition("/")
    return f"arm {arm} joint {joint}"


def _parted(cell: RobotCell, recording: Recording, sample: int) -> str:
    """The two arms that are farthest from each other at a sample."""
    carried = _carried(cell, recording, recording.q_command[sample])
    pairs = [(i, j) for i in range(len(carried)) for j in range(i + 1, len(carried))]
    i, j = max(pairs, key=lambda p: _distance(carried[p[0]], carried[p[1]]), default=(0, 0))
    return f"arms {cell.arm_names[i]} and {cell.arm_names[j]}"


def _strayed(cell: RobotCell, recording: Recording, sample: int) -> str:
    """The arm whose object pose is farthest from the path at a sample."""
    carried = _carried(cell, recording, recording.q[sample])
    pose = pin.SE3(recording.reference[sample])
    k = max(range(len(carried)), key=lambda k: _distance(pose, carried[k]))
    return f"the object at arm {cell.arm_names[k]}"


def _carried(cell: RobotCell, recording: Recording, q: Array) -> Sequence[pin.SE3]:
    """The object pose of every arm."""
    tools = metrics.tool_placements(cell, q[None])[0]
    return [T * X.inverse() for T, X in zip(tools, recording.grasp.T_object_tool, strict=True)]


def _distance(a: pin.SE3, b: pin.SE3) -> float:
    """Length of the displacement between two poses, metres and radians added; inf if it is not finite."""
    size = float(np.linalg.norm(pin.log6(a.actInv(b)).vector))
    return size if math.isfinite(size) else math.inf


def why(findings: Sequence[Finding]) -> list[str]:
    """One line for every check that does not hold: the question, why, where and since when."""
    return [f"{finding.question} No: {finding.cause or finding.answer}." for finding in findings if not finding.holds]


def _amount(cell: RobotCell, j: int, value: float) -> str:
    """A joint position with its unit: degrees, or millimetres for a prismatic joint."""
    return f"{1e3 * value:.4g} mm" if slides(cell)[j] else f"{np.rad2deg(value):.4g}°"
