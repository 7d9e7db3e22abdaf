"""Verdict on a run, from its recording only: on the end, limits, grasp, path, distances and loads; its key figures."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from coopqp.checks import Doc, as_options, documented, keep_scalars
from coopqp.collision.clearance_check import remark
from coopqp.collision.pairs import pairs_said
from coopqp.control.interface import Status
from coopqp.model.cell import RobotCell, slides, standing
from coopqp.model.limits import LimitKind
from coopqp.simulation.evaluation import metrics
from coopqp.simulation.evaluation.metrics import Readings, error_text
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
        try:
            known = {
                name: value for name, value in dict(given or ()).items() if name in Tolerances.__dataclass_fields__
            }
            return Tolerances(**known)
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
        *_joints(cell, recording),
        *_object(cell, recording, readings, t),
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


def _finished(recording: Recording) -> Finding:
    end = float(recording.metadata.get("duration", math.nan))
    took = f"{recording.time[-1]:.4g} s" + (f" for a path of {end:.4g} s" if math.isfinite(end) else "")
    begun, ended = ramps(recording)
    steps = Counter(recording.statuses)
    slowed = steps[Status.SLOWED] + steps[Status.BLOCKED] - begun - ended
    text = f"{took}, {slowed} of {recording.n_steps} steps slowed"
    text += f", {begun} to speed up" if begun else ""
    text += f", {ended} to brake at the end" if ended else ""
    endless = end == math.inf
    if endless:
        text += "; the path has no end"
    elif not recording.finished:
        text = f"the object's clock stands at {recording.clock[-1]:.4g} s after {took}"
    stopped = steps[Status.HOLDING] + steps[Status.FAULT]
    for number, what in (
        (stopped, "steps stopped by a failure"),
        (steps[Status.PAUSED], "paused"),
        (steps[Status.JOGGING], "led by hand"),
        (steps[Status.WAITING], "waiting"),
        (steps[Status.OFF_PATH], "off the path"),
    ):
        text += f", {number} {what}" if number else ""
    arrived = recording.finished or endless
    holds = arrived and not stopped
    return Finding(_ARRIVED, holds, text, "" if holds else _why_not(recording, arrived=arrived))


def _carried_load(cell: RobotCell, recording: Recording) -> Iterator[Finding]:
    """Findings on forces and torques; none for a recording without them."""
    loads = read_loads(cell, recording)
    if loads is None:
        return
    torques, *of_arms = loads.checks(cell)
    use = torques.values
    j = int(use.max(axis=0).argmax())
    heavy = np.flatnonzero(~(use[:, j] <= 1.0))
    cause = f"{cell.joint_names[j]}: torque, since {loads.time[heavy[0]]:.3f} s" if heavy.size else ""
    text = f"at most {100.0 * use[:, j].max():.1f} % of a torque ({cell.joint_names[j]})"
    yield Finding("Do the arms carry the load?", not cause, text, cause)
    palms, moves = loads.palm_use is not None, loads.moves < recording.n_steps
    values = of_arms[-1].values
    # Friction may be used up for moments. The object is lost when a palm no longer presses.
    over = ~(values <= (np.finfo(float).max if palms else loads.internal_limit))
    first = int(over.any(axis=1).argmax())
    arm = f"arm {cell.arm_names[int(values[first].argmax())]}"
    if palms:
        kind, most = "friction", cell.arm_names[int(values.max(axis=0).argmax())]
        text = f"{arm} let go" if over.any() else f"at most {100.0 * values.max():.0f} % of a palm's friction ({most})"
    else:
        kind, text = "internal force", f"internal force ≤ {values.max():.1f} N in motion"
        text += f" (accepted: {loads.internal_limit:g} N)" if np.isfinite(loads.internal_limit) else ""
    cause = f"{arm}: {kind}, since {loads.time[first]:.3f} s" if over.any() else ""
    question = "Do the palms hold the object?" if palms else "Is the object held without squeezing?"
    yield Finding(question, not cause, text if moves else "the object did not move", cause)


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


def _why_not(recording: Recording, *, arrived: bool) -> str:
    """Why a run did not finish, or what failed in it: the status, its limits or its reason, and since when."""
    statuses = recording.statuses
    if not statuses:
        return "no step was made"
    if arrived:  # it went on after a failure
        first = next(i for i, s in enumerate(statuses) if s in (Status.HOLDING, Status.FAULT))
        return f"{statuses[first].value} from {_at(recording, first)} on{_blame(recording, first, first + 1)}"
    stopped = (Status.BLOCKED, Status.HOLDING, Status.FAULT)
    kinds = stopped if statuses[-1] in stopped else (statuses[-1],)
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


def _joints(cell: RobotCell, recording: Recording) -> Iterator[Finding]:
    """Findings on positions, and on speeds and accelerations. A run starts at rest."""
    v, limits, samples, steps = recording.velocity, cell.limits, len(recording.time), recording.n_steps

    def largest(
        count: int, values: Callable[[slice], Array], allowed: float, least: float
    ) -> tuple[int, float, str, str]:
        """The joint with the largest of values (T, nv); the value; where it is not allowed whose it is, and since when.

        NaN is not allowed, and counts as the largest; ``least`` is what the largest is without rows.
        """
        most, first = np.full(cell.nv, least), np.full(cell.nv, -1)
        for part in recording.parts(count):
            rows = values(part)
            bad = ~(rows <= allowed)
            most = np.maximum(most, rows.max(axis=0))
            first = np.where((first < 0) & bad.any(axis=0), part.start + bad.argmax(axis=0), first)
        j = int(most.argmax())
        arm, _, joint = cell.joint_names[j].partition("/")
        since = f"since {_at(recording, int(first[j]))}" if first[j] >= 0 else ""
        return j, float(most[j]), f"arm {arm} joint {joint}", since

    def excess(part: slice) -> Array:
        """Joints that move no tool, such as fingers, are where they stand: −inf inside their limits."""
        rows = metrics.outside(limits, cell.positions(recording.q_command[part]))
        for own, still in zip(cell.columns, standing(cell), strict=True):
            stands = rows[:, own[still]]
            rows[:, own[still]] = np.where(stands <= POSITION_ROUNDING, -np.inf, stands)
        return rows

    def acceleration(part: slice) -> Array:
        before = np.vstack([v[part.start - 1] if part.start else np.zeros(cell.nv), v[part.start : part.stop - 1]])
        return metrics.acceleration_use(limits, v[part], before, np.diff(recording.time[part.start : part.stop + 1]))

    j, value, who, since = largest(samples, excess, POSITION_ROUNDING, -np.inf)
    amount = f"{1e3 * abs(value):.4g} mm" if slides(cell)[j] else f"{np.rad2deg(abs(value)):.4g}°"
    name, cause = cell.joint_names[j], f"{who}: position, {since}" if since else ""
    answer = f"{name} is {amount} outside" if since else f"closest: {name}, {amount} inside"
    if not np.isfinite(value):
        answer, cause = ("not finite", f"not finite {since}") if since else ("no joint has a limit", "")
    yield Finding("Are the joints inside their positions?", not cause, answer, cause)
    texts, causes = [], []
    for name, kind, limit, use in (
        ("speed", "velocity", limits.velocity, lambda part: np.abs(v[part]) / limits.velocity),
        ("acceleration", "acceleration", limits.acceleration, acceleration),
    ):
        if not np.isfinite(limit).any():
            texts.append(f"no limit of {name}")
            continue
        j, value, who, since = largest(steps, use, 1.0 + RATE_ROUNDING, 0.0)
        texts.append(f"{name} ≤ {100.0 * value:.4g} % of the limit ({cell.joint_names[j]})")
        causes += [f"{who}: {kind}, {since}"] if since else []
    question = "Are the joints within speed and acceleration?"
    yield Finding(question, not causes, "; ".join(texts), "; ".join(causes))


def _object(cell: RobotCell, recording: Recording, readings: Readings, t: Tolerances) -> Iterator[Finding]:
    """Findings on the chain, which commands close, and on the path, which the measured object follows."""
    names, (i, j) = cell.arm_names, np.triu_indices(len(cell), 1)
    pairs = [f"arms {names[a]} and {names[b]}" for a, b in zip(i, j, strict=True)]
    for question, what, q, who in (
        ("Do the arms agree on where the object is?", "chain", recording.q_command, slice(len(pairs))),
        ("Is the object on its path?", "object", recording.q, slice(len(pairs), None)),
    ):
        mm, degrees = getattr(readings, f"{what}_mm"), getattr(readings, f"{what}_deg")
        most_mm, most_degrees = getattr(t, f"{what}_mm"), getattr(t, f"{what}_deg")
        text = f"{_within(float(mm.max()), float(degrees.max()))} (asked: {most_mm:g} mm, {most_degrees:g}°)"
        bad, cause = ~((mm <= most_mm) & (degrees <= most_degrees)), ""
        if bad.any():
            first = int(bad.argmax())
            at = slice(first, first + 1)
            reference, shift = recording.reference[at], recording.shift_at(at)
            gaps = np.hypot(*metrics.object_gaps(cell, recording.grasp, q[at], reference, shift))[0, who]
            named = [*pairs, *(f"the object at arm {name}" for name in names)][who]
            cause = f"{named[int(gaps.argmax())]}, beyond the tolerance since {_at(recording, first)}"
        yield Finding(question, not cause, text, cause)


def _within(mm: float, degrees: float) -> str:
    one, other = error_text(mm, " mm"), error_text(degrees, "°")
    both = f"within {one}" if not one.startswith("below") else one
    joined = not other.startswith("below") and both == one  # each has its own word
    return f"{both} and {'within ' if joined else ''}{other}"


def why(findings: Sequence[Finding]) -> list[str]:
    """One line for every check that does not hold: the question, why, where and since when."""
    return [f"{finding.question} No: {finding.cause or finding.answer}." for finding in findings if not finding.holds]


# -- key figures -------------------------------------------------------------------------------------------------------


def ramps(recording: Recording) -> tuple[int, int]:
    """Numbers of steps with a lower rate in which the object only speeds up from rest, and only brakes for its end.

    They are part of every healthy run. The first are those before the first step at full rate, if the rate rises and no
    limit binds but accelerations; the others are those in which no limit binds but the end of the path.
    """
    slowed = np.asarray(recording.status) == Status.SLOWED.code
    if not slowed.any():
        return 0, 0
    bindings = recording.bindings or [()] * recording.n_steps
    ends = [len(b) > 0 and all(limit.kind is LimitKind.PATH_END for limit in b) for b in bindings]
    full = np.flatnonzero(recording.status == Status.TRACKING.code)
    first = int(full[0]) if len(full) else 0
    rises = bool((np.diff(recording.rate[:first]) >= -metrics.ROUNDING).all())
    free = all(limit.kind is LimitKind.ACCELERATION for b in bindings[:first] for limit in b)
    begun = first if rises and free and bool(slowed[:first].all()) else 0
    return begun, int(np.count_nonzero(slowed & ends)) if recording.finished else 0


def worst_status(recording: Recording) -> str:
    """``"ok"`` if every step tracked and the object arrived, otherwise the worst status of the run.

    Steps of :func:`ramps` count as tracking.
    """
    statuses = recording.statuses
    worst = max(statuses, key=lambda status: status.precedence, default=Status.TRACKING)
    if worst is Status.SLOWED and statuses.count(worst) == sum(ramps(recording)):
        worst = Status.TRACKING
    return "ok" if worst is Status.TRACKING and recording.finished else worst.value


def run_figures(cell: RobotCell, recording: Recording, readings: Readings) -> dict[str, str]:
    """The key figures of a run by name, with their units."""
    sigma = readings.sigma_min
    arm = int(np.unravel_index(int(np.nanargmin(sigma)), sigma.shape)[1]) if np.isfinite(sigma).any() else 0
    figures = {
        "largest ε_p": error_text(readings.eps_p_mm.max(), " mm"),
        "largest ε_o": error_text(readings.eps_o_deg.max(), "°"),
        "arms against each other": error_text(readings.chain_mm.max(), " mm"),
        "object off its path": error_text(readings.object_mm.max(), " mm"),
        "object off at the end": error_text(readings.object_mm[-1], " mm"),
        "smallest rate σ": f"{100.0 * float(recording.rate.min(initial=1.0)):.3g} %",
        "smallest singular value": f"{error_text(sigma.min())} ({cell.arm_names[arm]})",
        "time": f"{float(recording.time[-1]):.4g} s",
        "steps": f"{recording.n_steps} of {1e3 * float(np.median(np.diff(recording.time))):.4g} ms",
        "worst status": worst_status(recording),
    }
    loads = read_loads(cell, recording)
    if loads is None:
        return figures

    def largest(values: Array, unit: str, names: Sequence[str], first: int = 0) -> str:
        i, j = map(int, np.unravel_index(int(values[first:].argmax()), values[first:].shape))
        return f"{values[first + i, j]:.1f} {unit} ({names[j]}, {loads.time[first + i]:.2f} s)"

    use, palms = 100.0 * loads.torque_use, loads.palm_use
    figures["torque, most used"] = largest(use, "%", cell.joint_names)
    for name, own in zip(cell.arm_names, cell.v_slices, strict=True):
        figures[f"torque of {name}"] = f"{use[:, own].max():.1f} % of its limit"
    if loads.moves < recording.n_steps and palms is not None:
        figures["friction, most used"] = largest(100.0 * palms, "%", cell.arm_names, loads.moves)
    elif loads.moves < recording.n_steps:
        figures["internal force in motion"] = largest(loads.internal, "N", cell.arm_names, loads.moves)
    squeeze = "internal force" if palms is None else "squeeze"
    figures[f"{squeeze} at the end"] = f"{loads.internal[-1].max():.1f} N"
    return figures
