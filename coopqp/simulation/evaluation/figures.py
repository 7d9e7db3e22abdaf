"""Key figures of a run: its worst status, and the largest errors in words."""

from __future__ import annotations

import numpy as np

from coopqp.control.interface import Status
from coopqp.model.cell import RobotCell
from coopqp.model.limits import LimitKind
from coopqp.simulation.evaluation import metrics
from coopqp.simulation.evaluation.metrics import error_text
from coopqp.simulation.evaluation.readings import Readings
from coopqp.simulation.evaluation.wrenches import read_loads
from coopqp.simulation.recording.recording import Recording


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
    sigma, loads = readings.sigma_min, read_loads(cell, recording)
    arm = int(np.unravel_index(int(np.nanargmin(sigma)), sigma.shape)[1]) if np.isfinite(sigma).any() else 0
    return {
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
        **({} if loads is None else loads.figures(cell)),
    }
