"""Paths that are too quick for their joints: the object goes slowly, and never stands still for ever."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from coopqp import LinePath, ObjectPath, QPController, RobotCell, check_path
from coopqp.planning import PathVerdict
from promise_cases import Promise, chain_cells

_DT = 0.004
#: An object that stands still for so long does so for ever [s].
_FOR_EVER = 2.0
#: A run takes no longer [s].
_LONGEST = 800.0


def _time(task: chain_cells.Task, cell: RobotCell, path: ObjectPath, oracle: chain_cells.Oracle) -> tuple[float, float]:
    """When the path is finished [s], NaN if the object stands still before, and how far arms part on the way [m]."""
    controller = QPController(cell, task.grasp, path, dt=_DT)
    controller.reset(task.q)
    still, apart = 0, 0.0
    for i in range(round(_LONGEST / _DT)):
        step = controller.step()
        still = 0 if step.rate > 0.0 else still + 1
        if i % 20 == 0:
            apart = max(apart, oracle.apart(step.q_next))
        if step.finished:
            return i * _DT, apart
        if still * _DT > _FOR_EVER:
            break
    return np.nan, apart


def promises(quick: bool) -> Iterator[Promise]:
    """Random certified lines, at their joints' own pace and 10 to 10⁴ times as quick."""
    cells = 2 if quick else 200
    stand, parted, slower, found = 0, 0.0, 1.0, 0
    for seed in itertools.count():
        if found == cells:
            break
        rng, task = np.random.default_rng(5000 + seed), chain_cells.long_steps(seed)
        scale, law = float(rng.choice([1.0, 0.1, 0.01])), str(rng.choice(["linear", "quintic"]))
        cell = task.cell.with_limits(velocity=scale * task.cell.limits.velocity)
        if rng.random() < 0.7:
            cell = cell.with_limits(acceleration=scale * float(rng.choice([5.0, 20.0])))
        ends = task.path.pose(0.0), task.path.pose(task.path.duration)
        slow = LinePath(*ends, duration=2.0 / scale, time_law=law)
        if check_path(cell, task.grasp, slow, q_start=task.q).verdict is not PathVerdict.CERTIFIED:
            continue
        oracle = chain_cells.Oracle(cell, task.grasp)
        own, _ = _time(task, cell, slow, oracle)
        found += 1
        if np.isnan(own):
            stand += 1
            continue
        least, _ = _time(task, cell, LinePath(*ends, duration=0.2 * own, time_law=law), oracle)
        took, apart = _time(
            task, cell, LinePath(*ends, duration=own * 10.0 ** -rng.uniform(1.0, 4.0), time_law=law), oracle
        )
        stand += bool(np.isnan(took))
        slower, parted = max(slower, took / least), max(parted, apart)
    case = f"{cells} paths 10 to 10⁴ times too quick for their joints"
    yield Promise(f"{case}: stand still for ever", stand, 0, "")
    yield Promise(f"{case}: time over that of 5 times too quick", slower, 1.5, "")
    yield Promise(f"{case}: chain", 1e6 * parted, 1.0, "µm")
