"""Rounded corners, and pieces of a user's geometry that tell bounds of their motion, are proved as lines are."""

from __future__ import annotations

from typing import final

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray

from coopqp import check_path
from coopqp.paths.geometry import Blend, MotionBounds, PathGeometry, Piece, Straight, blended
from coopqp.paths.segments import segments_of
from coopqp.planning import PathVerdict
from coopqp.planning.planner import some_timing
from coopqp.scenarios import Scenario

Array = NDArray[np.float64]


def random_blend(rng: np.random.Generator) -> Blend:
    turns, ways = rng.uniform(0.0, 1.2) * rng.normal(size=(2, 3)), rng.uniform(0.01, 0.3) * rng.normal(size=(2, 3))
    return Blend(pin.exp3(rng.normal(size=3)), rng.normal(size=3), turns, ways, float(rng.uniform(0.05, 1.0)))


@pytest.mark.parametrize("seed", range(25))
def test_bounds_of_a_blend_hold_and_are_close(seed: int) -> None:
    """Dense samples of twists stay within them, and so do differences of the twists' derivatives."""
    rng = np.random.default_rng(seed)
    blend = random_blend(rng)
    low = float(rng.uniform(0.0, 0.9 * blend.length))
    high = float(rng.uniform(low, blend.length))
    found = blend.bounds(np.array([low]), np.array([high]))
    s = np.linspace(low, high, 401)
    V, dV = blend.twists(s)
    second = np.diff(dV, axis=0) / (s[1] - s[0])  # a mean of V″ over a step
    for bound, values in (
        (found.way, V[:, :3]), (found.turn, V[:, 3:]),
        (found.way_change, second[:, :3]), (found.turn_change, second[:, 3:]),
    ):  # fmt: skip
        most = np.linalg.norm(values, axis=1).max()
        assert most <= bound[0] * (1.0 + 1e-6) + 1e-9
    short = blend.bounds(np.array([low]), np.array([low + 1e-6]))
    np.testing.assert_allclose(
        short.way_change, np.linalg.norm(second[0, :3]), rtol=0.1, atol=1e-2 * found.way_change[0]
    )


@final
class Arc(Piece):
    """A user's piece: the object moves on an arc of a circle in the plane of its x and y axes, without turning."""

    def __init__(self, start: pin.SE3, *, radius: float, angle: float) -> None:
        self._start, self._radius, self.length = start, radius, radius * angle

    def poses(self, s: Array) -> tuple[Array, Array]:
        x = s / self._radius
        own = self._radius * np.column_stack([np.sin(x), 1.0 - np.cos(x), 0.0 * x])
        return np.tile(self._start.rotation, (len(s), 1, 1)), self._start.translation + own @ self._start.rotation.T

    def twists(self, s: Array) -> tuple[Array, Array]:
        x, R = s / self._radius, self._start.rotation.T
        still = np.zeros((len(s), 3))
        V = np.column_stack([np.cos(x), np.sin(x), 0.0 * x]) @ R
        dV = np.column_stack([-np.sin(x), np.cos(x), 0.0 * x]) @ R / self._radius
        return np.hstack([V, still]), np.hstack([dV, still])

    def bounds(self, low: Array, high: Array) -> MotionBounds:
        one = np.ones(len(low))
        return MotionBounds(one, 0.0 * one, one / self._radius**2, 0.0 * one)

    def numbers(self) -> Array:
        return np.zeros(0)


def least_margins(task: Scenario, geometry: PathGeometry, q_start: Array) -> Array:
    """The least margins of all joints (nv,) along a geometry, by Newton's method with Pinocchio alone."""
    cell = task.cell
    model, data, q = cell.model, cell.model.createData(), q_start.copy()
    least = np.full(cell.nv, np.inf)
    for R, p in zip(*geometry.poses(np.linspace(0.0, geometry.length, 500)), strict=True):
        goal = pin.SE3(R, p)
        for _ in range(5):
            pin.computeJointJacobians(model, data, q)
            pin.updateFramePlacements(model, data)
            J = np.vstack([pin.getFrameJacobian(model, data, f, pin.LOCAL) for f in cell.tool_frames])
            away = [
                pin.log6(data.oMf[f].actInv(goal * X)).vector
                for f, X in zip(cell.tool_frames, task.grasp.T_object_tool, strict=True)
            ]
            q = q + np.linalg.solve(J, np.concatenate(away))
        least = np.minimum(least, np.minimum(q - cell.limits.lower, cell.limits.upper - q))
    return least


def corner(task: Scenario, *, angle: float) -> list[Straight]:
    """Two lines with turns from the start of a task."""
    T = task.path.pose(0.0)
    lines = []
    for way, turn in (((0.05, 0.1, 0.15), (0.0, angle, 0.0)), ((-0.1, 0.1, 0.05), (angle, 0.0, -angle))):
        lines.append(Straight(T.rotation, T.translation, np.array(turn), np.array(way), 0.2))
        T = pin.SE3(T.rotation @ pin.exp3(np.array(turn)), T.translation + np.array(way))
    return lines


@pytest.mark.parametrize("size", [0.003, 0.03])
@pytest.mark.parametrize("angle", [0.0, 0.2])
def test_blends_are_certified_where_their_corners_are(paper: Scenario, size: float, angle: float) -> None:
    lines = corner(paper, angle=angle)
    sharp = check_path(paper.cell, paper.grasp, some_timing(PathGeometry(tuple(lines))), q_start=paper.q_start)
    geometry = blended(lines, distance=size, angle=size / 0.3)
    assert any(isinstance(piece, Blend) for piece in geometry.pieces)
    path = some_timing(geometry)
    check = check_path(paper.cell, paper.grasp, path, q_start=paper.q_start)
    assert sharp.verdict is check.verdict is PathVerdict.CERTIFIED
    margins = least_margins(paper, geometry, paper.q_start)
    for arm, own in zip(check.arms, paper.cell.v_slices, strict=True):
        assert arm.chosen is not None
        np.testing.assert_allclose(arm.chosen.certified, [[0.0, path.duration]], rtol=0, atol=1e-9)
        apart = margins[own] - arm.chosen.margins
        assert apart.min() > -1e-9
        assert apart[margins[own].argmin()] < 0.005  # the least margin is close to the truth


def test_an_arc_of_a_users_is_certified_by_its_bounds(paper: Scenario) -> None:
    geometry = PathGeometry((Arc(paper.path.pose(0.0), radius=0.3, angle=1.0),))
    check = check_path(paper.cell, paper.grasp, some_timing(geometry), q_start=paper.q_start)
    assert check.verdict is PathVerdict.CERTIFIED
    margins = least_margins(paper, geometry, paper.q_start)
    for arm, own in zip(check.arms, paper.cell.v_slices, strict=True):
        assert arm.chosen is not None
        assert (margins[own] - arm.chosen.margins).min() > -1e-9


def test_the_proof_counts_with_the_bounds(paper: Scenario) -> None:
    """With larger bounds it halves more."""

    class Loose(Piece):
        def __init__(self, arc: Arc, factor: float) -> None:
            self._arc, self._factor, self.length = arc, factor, arc.length

        def poses(self, s: Array) -> tuple[Array, Array]:
            return self._arc.poses(s)

        def twists(self, s: Array) -> tuple[Array, Array]:
            return self._arc.twists(s)

        def bounds(self, low: Array, high: Array) -> MotionBounds:
            found = self._arc.bounds(low, high)
            return MotionBounds(found.way, found.turn, self._factor * found.way_change, found.turn_change)

        def numbers(self) -> Array:
            return np.zeros(0)

    arc = Arc(paper.path.pose(0.0), radius=0.3, angle=1.0)
    counts = []
    for factor in (1.0, 1000.0):
        path = some_timing(PathGeometry((Loose(arc, factor),)))
        arm = check_path(paper.cell, paper.grasp, path, q_start=paper.q_start).arms[0]
        assert arm.chosen is not None
        counts.append(len(arm.chosen.clocks))
    assert counts[1] > counts[0]


def test_shares_of_lines_do_not_hang_on_their_length(paper: Scenario) -> None:
    """Segments of a path with a time law and of its geometry have the same poses and twists per share."""
    here, other = segments_of(paper.path), segments_of(some_timing(paper.path.geometry()))  # type: ignore[arg-type]
    assert here is not None
    assert other is not None
    segment, share = np.zeros(7, dtype=np.intp), np.linspace(0.0, 1.0, 7)
    np.testing.assert_allclose(here.poses(segment, share), other.poses(segment, share), rtol=0, atol=1e-15)
    np.testing.assert_allclose(here.twists(segment, share)[0], other.twists(segment, share)[0], rtol=0, atol=1e-14)
