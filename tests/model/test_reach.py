"""Where an arm's reach ends: what the chain says of it, and targets that are streamed along it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
import target_cases as cases
from marks import slow_but_first

from coopqp import ObjectPath, PostureOptions, PreviewOptions
from coopqp.control.lookahead.preview import PathPreview
from coopqp.model.chain import Chain
from coopqp.model.inverse_kinematics import newton
from coopqp.model.posture import Posture
from coopqp.scenarios import Scenario, dual_arm7, mixed_cell, paper_lift, ur5_table
from coopqp.spatial import Array

CELLS = [paper_lift, dual_arm7, mixed_cell, ur5_table]


def stretched(task: Scenario, rng: np.random.Generator, elbow: float) -> tuple[Array, int]:
    """Random positions with an arm whose elbow is this far from where it is straight, and that arm."""
    x, k = task.cell.positions(task.q_start), int(rng.integers(len(task.cell)))
    columns = task.cell.v_slices[k]
    n = columns.stop - columns.start
    x[columns] += rng.uniform(-0.4, 0.4, n)
    x[columns.start + (2 if n == 6 else 3)] = elbow
    return x, k


def about_the_object(task: Scenario, chain: Chain, x: Array) -> Array:
    """The chain's edges at positions, from Jacobians about the object."""
    q = task.cell.configuration(x)
    chain.evaluate(q, chain.carried(q)[0].translation)
    return chain.to_reach_end()


@pytest.mark.slow
@pytest.mark.parametrize("make", CELLS, ids=lambda make: make.__name__)
def test_at_the_edge_the_object_turns_back(make: Callable[[], Scenario], rng: np.random.Generator) -> None:
    """Along the joint motion to it and beyond the tool goes to and fro where it moves least: by Pinocchio's frames."""
    task = make()
    cell, chain, seen = task.cell, Chain(task.cell, task.grasp), 0
    data = cell.model.createData()
    for _ in range(60):
        x, k = stretched(task, rng, float(rng.uniform(0.002, 0.01)) * rng.choice([-1.0, 1.0]))
        columns = cell.v_slices[k]
        way = np.zeros(cell.nv)
        way[columns] = about_the_object(task, chain, x)[columns]
        if not np.abs(way).max() < 0.02:
            continue  # another singularity is nearer
        seen += 1

        frame, q = cell.tool_frames[k], cell.configuration(x)
        J = pin.computeFrameJacobian(cell.model, data, q, frame, pin.LOCAL)[:, columns]
        least = np.linalg.svd(J)[0][:, -1]  # where the tool moves least
        pin.framesForwardKinematics(cell.model, data, q)
        start = pin.SE3(data.oMf[frame])
        ways = []
        for s in (0.4, 0.6, 1.4, 1.6):
            pin.framesForwardKinematics(cell.model, data, cell.configuration(x + s * way))
            ways.append(float(least @ pin.log6(start.actInv(data.oMf[frame])).vector))
        assert (ways[1] - ways[0]) * (ways[3] - ways[2]) < 0.0
    assert seen > 20


@pytest.mark.parametrize("make", slow_but_first([paper_lift, ur5_table]), ids=lambda make: make.__name__)
def test_a_wrist_singularity_is_no_edge(make: Callable[[], Scenario], rng: np.random.Generator) -> None:
    task = make()
    chain = Chain(task.cell, task.grasp)
    for size in (1e-2, 1e-4, 1e-6):
        x, k = stretched(task, rng, 1.0)
        columns = task.cell.v_slices[k]
        x[columns.start + 4] = size
        assert np.abs(about_the_object(task, chain, x)[columns]).max() > 0.1


class Grazing(ObjectPath):
    """Straight on to a depth, and back again."""

    def __init__(self, start: pin.SE3, way: Array, depth: float) -> None:
        self._start, self._way, self._depth, self.duration = start, way, depth, depth / 0.1

    def pose(self, clock: float) -> pin.SE3:
        share = clock / self.duration
        return pin.SE3(
            self._start.rotation, self._start.translation + 4.0 * self._depth * share * (1.0 - share) * self._way
        )

    def twist(self, clock: float) -> Array:
        speed = 4.0 * self._depth * (1.0 - 2.0 * clock / self.duration) / self.duration
        return np.concatenate([self._start.rotation.T @ (speed * self._way), np.zeros(3)])


def reach(task: Scenario, way: Array) -> float:
    """How far the object goes before an arm's reach ends [m]: by Newton's method in ever shorter steps."""
    chain, start, q = Chain(task.cell, task.grasp), task.path.pose(0.0), task.q_start
    depth, step = 0.0, 0.02
    while step > 1e-7:
        pose = pin.SE3(start.rotation, start.translation + (depth + step) * way)
        there, errors = newton(chain, pose, q, tolerance=1e-12, max_iter=12)
        if np.abs(errors).max() < 1e-9 and np.abs(pin.difference(task.cell.model, q, there)).max() < 0.3:
            q, depth = there, depth + step
        else:
            step *= 0.5
    return depth


@pytest.mark.parametrize("make", CELLS[:3], ids=lambda make: make.__name__)
def test_the_look_ahead_comes_back_from_the_end_of_the_reach_as_it_went_there(make: Callable[[], Scenario]) -> None:
    """There and back, 2 µm inside it, an arm is seen at the same positions, not on the branch beyond."""
    task = make()
    task = replace(task, cell=task.cell.with_limits(lower=-np.inf, upper=np.inf))
    way = np.random.default_rng(0).normal(size=3)
    way /= np.linalg.norm(way)
    path = Grazing(task.path.pose(0.0), way, reach(task, way) - 2e-6)
    posture = Posture(task.cell, PostureOptions(gain=0.0))
    posture.reset(task.q_start)
    preview = PathPreview(Chain(task.cell, task.grasp), path, posture, dt=0.002, options=PreviewOptions())
    preview.reset(task.q_start, 0.0)
    clocks, seen, clock = [0.0], [task.cell.positions(task.q_start)], 0.0
    while not preview.horizon.complete:
        preview.cap(clock, 0.002)
        for knot in preview.horizon.knots:
            if knot.clock > clocks[-1]:
                clocks.append(knot.clock)
                seen.append(task.cell.positions(knot.q))
        clock += 0.002
    assert clocks[-1] > 0.8 * path.duration
    back = path.duration - np.array(clocks)
    for joint in np.array(seen).T:
        np.testing.assert_allclose(
            np.interp(back, clocks, joint)[back < clocks[-1]], joint[back < clocks[-1]], atol=0.02
        )


#: Once a joint jumped: an arm came too close to the end of its reach on a way along it; a redundant arm was seen ahead
#: on its other branch; self-motion stopped at once where a way began at rest; a large jump led to a larger one.
JUMPED = [
    ("paper_lift", cases.OUT_OF_REACH, 100, 7),
    ("dual_arm7", cases.OUT_OF_REACH, 100, 12),
    ("mixed_cell", cases.IN_REACH, 100, 10),
    ("panda_bar", cases.OUT_OF_REACH, 100, 13),
]


@pytest.mark.core
@pytest.mark.parametrize(("name", "kind", "hertz", "seed"), JUMPED)
@pytest.mark.slow
def test_no_joint_without_acceleration_limit_jumps(name: str, kind: str, hertz: int, seed: int) -> None:
    seen = cases.chase(cases.CELLS[name](), kind, np.inf, hertz, seed)
    assert (seen.flips, seen.nameless) == (0, 0)
    assert max(seen.apart, seen.off, seen.swing) <= 1e-5
