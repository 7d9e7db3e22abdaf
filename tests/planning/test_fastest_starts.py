"""The fastest of several starts of arms, against the times of every branch."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from coopqp import Grasp, LinePath, RobotCell, find_start
from coopqp.paths import PathGeometry
from coopqp.planning import ArmStart, BranchAlongPath, Start, time_path
from coopqp.planning.fastest_start import faster_start
from coopqp.scenarios import dual_arm7
from coopqp.spatial import Array

LIFT = dual_arm7()
PATH = LinePath.displaced(LIFT.path.pose(0.0), translation=(0.0, 0.05, 0.1), duration=2.0)


def task(arms: int, branches: int) -> tuple[RobotCell, PathGeometry, Start]:
    """The first arms, with so many branches each that follow the path, the best one first."""
    cell = RobotCell(list(LIFT.cell.arms)[:arms])
    cell = cell.with_limits(acceleration=np.repeat([4.0, 9.0], 7)[: cell.nv])  # the second arm is quicker
    geometry = PATH.geometry()
    assert geometry is not None
    start = find_start(cell, Grasp(LIFT.grasp.T_object_tool[:arms]), PATH)
    few = [replace(arm, branches=rows_of(arm)[:branches]) for arm in start.arms]
    return cell, geometry, replace(start, arms=tuple(few))


def rows_of(arm: ArmStart) -> tuple[BranchAlongPath, ...]:
    return (arm.chosen, *(row for row in arm.branches if row.feasible and row is not arm.chosen))


def times_of(cell: RobotCell, geometry: PathGeometry, start: Start) -> list[Array]:
    """Time of each arm by itself on each of its branches [s]."""
    out = []
    for k, (arm, own) in enumerate(zip(start.arms, cell.v_slices, strict=True)):
        alone = RobotCell([cell.arms[k]]).with_limits(acceleration=cell.limits.acceleration[own])
        grasp = Grasp((LIFT.grasp.T_object_tool[k],))
        starts = [alone.configuration(row.q) for row in rows_of(arm)]
        out.append(np.array([time_path(alone, grasp, geometry, q_start=q, knots=60).duration for q in starts]))
    return out


@pytest.mark.parametrize(("arms", "count"), [(1, 8), (1, 2), (1, 3), (2, 4)])
def test_the_slowest_arm_is_on_its_fastest_branch_of_those_looked_at(arms: int, count: int) -> None:
    """They are spread from the best branch to the last; the others are no slower, at the best branch that is not."""
    cell, geometry, start = task(arms, 8 if arms == 1 else 5)
    looked = [np.unique(np.linspace(0, len(rows_of(arm)) - 1, count).astype(int)) for arm in start.arms]
    times = [own[at] for own, at in zip(times_of(cell, geometry, start), looked, strict=True)]
    found = faster_start(cell, geometry, start, count)
    slowest = max(own.min() for own in times)
    for arm, before, at, own in zip(found.arms, start.arms, looked, times, strict=True):
        first = int((own <= slowest * 1.001).argmax())
        assert arm.chosen is rows_of(before)[at[first]]
    assert slowest < 0.99 * times[0][0]  # it pays
    assert arms == 1 or found.arms[1].chosen is start.arms[1].chosen
    x = np.concatenate([arm.chosen.q for arm in found.arms])
    np.testing.assert_allclose(cell.positions(found.q), x, atol=1e-6)
    np.testing.assert_allclose(found.margins, np.concatenate([arm.chosen.margins for arm in found.arms]))
    for k, arm in enumerate(found.arms):
        np.testing.assert_array_equal(found.sigma_min[:, k], arm.chosen.sigma_min)


def test_one_start_is_the_best_branch() -> None:
    cell, geometry, start = task(1, 8)
    found = faster_start(cell, geometry, start, 1)
    assert found.arms[0].chosen is start.arms[0].chosen
    np.testing.assert_allclose(found.q, start.q, atol=1e-9)
