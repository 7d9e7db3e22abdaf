"""How sure a calibration is, by numerical derivatives; a slip that is told; and what the report says."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from coopqp import Grasp, RobotCell, inverse_kinematics
from coopqp.forces import ArmCorrection, Calibration, CalibrationOptions, calibrate, undetermined_by
from coopqp.forces.loop_residual import Closure
from coopqp.model import CellState
from coopqp.scenarios import Scenario
from coopqp.spatial import Array

#: Deviations of bases and grips before the run: 2 mm and 0.2°, 2 mm and 0.3°.
PRIOR = np.repeat([2e-3, np.deg2rad(0.2), 2e-3, np.deg2rad(0.3)], 3)
STRUCTURE = 5e-6


@pytest.fixture(scope="module")
def pair(paper: Scenario) -> tuple[RobotCell, Grasp]:
    return RobotCell(paper.cell.arms[:2]), Grasp(paper.grasp.T_object_tool[:2])


def motion(pair: tuple[RobotCell, Grasp], paper: Scenario, n: int, *, size: float = 1.0, later: Any = None) -> Array:
    """Configurations (n, 12) of tilts about two axes; in the last third with another grasp, if one is given."""
    start, q, rows = paper.path.pose(0.0), paper.q_start[:12], []
    for i, u in enumerate(np.linspace(0.0, 2.0 * np.pi, n)):
        turn = size * np.array([-0.35 + 0.35 * np.cos(u), 0.1 * np.sin(2.0 * u), 0.1 * np.sin(u)])
        up = np.array([0.0, 0.0, 0.1 * size * (1.0 - np.cos(u))])
        pose = pin.SE3(pin.exp3(turn) @ start.rotation, start.translation + up)
        grasp = pair[1] if later is None or i < 2 * n // 3 else later
        q = inverse_kinematics(pair[0], grasp, pose, q, limits=False)
        rows.append(q)
    return np.array(rows)


def parted(pair: tuple[RobotCell, Grasp], q: Array, x: Array) -> Array:
    """Where the second arm sees the object from the first one, after corrections of bases and grips (2, 2, 6)."""
    T = CellState(pair[0], q).T_world_tool
    O = []
    for arm, tool, X, (b, g) in zip(pair[0].arms, T, pair[1].T_object_tool, x.reshape(2, 2, 6), strict=True):
        moved = arm.T_world_base * pin.exp6(b) * arm.T_world_base.inverse() * tool
        O.append(moved * (X * pin.exp6(g)).inverse())
    return np.asarray(pin.log6(O[0].actInv(O[1])).vector)


def relative(pair: tuple[RobotCell, Grasp], x: Array) -> Array:
    """The corrections of the second arm that leave the first one where it is (12,)."""
    (b0, g0), (b1, g1) = x.reshape(2, 2, 6)
    (B0, B1), (X0, X1) = (arm.T_world_base for arm in pair[0].arms), pair[1].T_object_tool
    base = B1.actInv(B0 * pin.exp6(-b0) * B0.inverse() * B1 * pin.exp6(b1))
    grip = X1.actInv(X0 * pin.exp6(-g0) * X0.inverse() * X1 * pin.exp6(g1))
    return np.concatenate([pin.log6(base).vector, pin.log6(grip).vector])


def slope(f: Any, x: Array, h: float = 1e-6) -> Array:
    return np.column_stack([(f(x + h * e) - f(x - h * e)) / (2 * h) for e in np.eye(len(x))])


class Certainty:
    """The covariance of the second arm's corrections after a run, and before it, by numerical derivatives."""

    def __init__(self, pair: tuple[RobotCell, Grasp], rows: Array) -> None:
        self.M = slope(lambda x: relative(pair, x), np.zeros(24))
        self.by_joints = [slope(lambda q: parted(pair, q, np.zeros(24)), q) for q in rows]
        self.by_errors = [slope(lambda x, q=q: parted(pair, q, x), np.zeros(24)) for q in rows]

    def after(self, noise: float) -> tuple[Array, int]:
        """The covariance (12, 12), and how many directions keep more than half of their prior variance."""
        H = np.diag(np.tile(PRIOR, 2) ** -2.0)
        for A, J in zip(self.by_joints, self.by_errors, strict=True):
            spread = noise**2 / 3.0 * A @ A.T + STRUCTURE**2 * np.eye(6)
            H += J.T @ np.linalg.solve(spread, J)
        C, P = self.M @ np.linalg.solve(H, self.M.T), self.M @ np.diag(np.tile(PRIOR, 2) ** 2) @ self.M.T
        return C, int((np.linalg.eigvals(np.linalg.solve(P, C)).real > 0.5).sum())


@pytest.fixture(scope="module")
def certainty(pair: tuple[RobotCell, Grasp], paper: Scenario) -> tuple[Array, Certainty]:
    rows = motion(pair, paper, 5, size=0.2)
    return rows, Certainty(pair, rows)


def test_deviations_are_those_of_encoders_with_uniform_noise(
    pair: tuple[RobotCell, Grasp], certainty: tuple[Array, Certainty]
) -> None:
    """Relative to the first arm; and of what keeps half of its variance or more it is said that nothing is known."""
    rows, sure = certainty
    for noise in (2e-5, 1e-3):
        found = calibrate(*pair, rows, options={"encoder_noise": noise})
        C, loose = sure.after(noise)
        (arm,) = found.corrections
        spread = np.concatenate([arm.base_deviation, arm.grip_deviation])
        np.testing.assert_allclose(spread, np.sqrt(np.diag(C)), rtol=2e-3)
        assert len(found.undetermined) == loose
        assert found.determined_share == pytest.approx(1.0 - loose / 12.0)
        assert not arm.significant
        np.testing.assert_allclose([arm.base, arm.grip], 0.0, atol=1e-6)


def test_more_is_left_open_by_noisier_encoders(
    pair: tuple[RobotCell, Grasp], certainty: tuple[Array, Certainty]
) -> None:
    rows, sure = certainty
    noises = np.geomspace(2e-5, 5e-3, 40)
    expected = [sure.after(noise)[1] for noise in noises]
    found = [len(undetermined_by(*pair, rows, options={"encoder_noise": noise})) for noise in noises]
    assert found == expected
    assert min(found) < 4 < max(found) <= 12


def test_an_arm_is_corrected_from_the_99_percent_on(pair: tuple[RobotCell, Grasp], paper: Scenario) -> None:
    """Its corrections, squared over their own covariance, against the quantile of 12 numbers: 26.217."""
    rows, noise = motion(pair, paper, 6), 1e-3
    sure = Certainty(pair, rows)
    C, way = sure.after(noise)[0], np.array([1.0, -0.5, 0.8, 1e-3, 0.5, -1.0, 0.3, 1.0, -1.0, 0.5, 0.0, 1.0]) * PRIOR
    sizes, told = [], []
    for size in (0.02, 0.05, 0.1, 0.2, 0.6):
        base, grip = np.split(size * way, 2)
        real = [pair[0].arms[0], pair[0].arms[1].placed(pair[0].arms[1].T_world_base * pin.exp6(base))]
        held = Grasp((pair[1].T_object_tool[0], pair[1].T_object_tool[1] * pin.exp6(grip)))
        found = calibrate(*pair, motion((RobotCell(real), held), paper, 6), options={"encoder_noise": noise})
        (arm,) = found.corrections
        change = np.concatenate([arm.base, arm.grip])
        sizes.append(change @ np.linalg.solve(C, change))
        told.append(arm.significant)
        if arm.significant:
            expected = pair[0].arms[1].T_world_base * pin.exp6(arm.base)
            np.testing.assert_allclose(found.cell.arms[1].T_world_base.homogeneous, expected.homogeneous, atol=1e-9)
            expected = pair[1].T_object_tool[1] * pin.exp6(arm.grip)
            np.testing.assert_allclose(found.grasp.T_object_tool[1].homogeneous, expected.homogeneous, atol=1e-9)
            assert found.after[:, 0].max() < 0.5 * found.before[:, 0].max()
        else:
            np.testing.assert_array_equal(found.after, found.before)
    assert told == [size > 26.217 for size in sizes]
    assert set(told) == {False, True}


def test_a_slip_is_told_by_its_sample_and_its_size(pair: tuple[RobotCell, Grasp], paper: Scenario) -> None:
    """The first sample after it, in the numbering of the run; and by how much the arms' views shift there."""
    X = pair[1].T_object_tool
    slipped = Grasp((X[0], X[1] * pin.exp6(np.array([0.0, 0.0, 4e-4, 0.0, 0.0, 0.0]))))
    rows = motion(pair, paper, 36, later=slipped)
    for samples, at, noise in ((36, 24, 1e-4), (18, 25, 1e-4)):
        found = calibrate(*pair, rows, options={"samples": samples, "encoder_noise": noise})
        assert found.slip is not None
        assert found.slip[0] == next(i for i in found.samples if i >= 24)
        assert found.slip[0] <= at
        assert found.samples[0] == 0
        assert found.samples[-1] == 35
        assert len(found.samples) == samples
        views = []
        for q in rows[found.samples]:
            moved = [
                b.T_world_base * a.T_world_base.inverse() for a, b in zip(pair[0].arms, found.cell.arms, strict=True)
            ]
            T = [M * tool for M, tool in zip(moved, CellState(pair[0], q).T_world_tool, strict=True)]
            O = [tool * Y.inverse() for tool, Y in zip(T, found.grasp.T_object_tool, strict=True)]
            views.append(pin.log6(O[0].actInv(O[1])).vector[:3])
        after = found.samples >= 24
        shift = np.linalg.norm(np.mean(np.array(views)[after], axis=0) - np.mean(np.array(views)[~after], axis=0))
        assert found.slip[1] == pytest.approx(shift, rel=0.02)
        assert 1e-5 < shift < 1e-3
    assert calibrate(*pair, rows[:24]).slip is None


def test_the_report_says_all_of_it(pair: tuple[RobotCell, Grasp]) -> None:
    still = ArmCorrection("b", np.zeros(6), np.zeros(6), np.ones(6), np.ones(6), False)
    moved = ArmCorrection(
        "a", np.array([1e-3, -2e-3, 0.5e-3, 0.01, 0.0, -0.02]), np.array([0.0, 1e-4, 0.0, 0.0, 1e-3, 0.0]),
        np.array([1e-4, 2e-4, 3e-4, 1e-3, 2e-3, 3e-3]), np.full(6, 1e-3), True,
    )  # fmt: skip
    before, after = np.array([[1e-3, 0.01], [4.321e-3, 0.02]]), np.array([[2e-5, 1e-4], [1e-5, 3e-4]])
    open_ = ("shift of the base of a along x", "turn of the grip of a about z")
    found = Calibration(*pair, (still, moved), before, after, np.array([0, 1]), open_, 0.9, (7, 3e-4))
    assert found.explain().splitlines() == [
        "closure: 4.32 mm, 1.1° before; 0.02 mm, 0.017° after (2 samples)",
        "b: no more than its own uncertainty; its base and grip stay as given",
        "a, base: (1.00, -2.00, 0.50) ± (0.10, 0.20, 0.30) mm, (0.57, 0.00, -1.15) ± (0.06, 0.11, 0.17)°",
        "a, grip: (0.00, 0.10, 0.00) ± (1.00, 1.00, 1.00) mm, (0.00, 0.06, 0.00) ± (0.06, 0.06, 0.06)°",
        "the arms' views of the object shift by 0.3 mm at sample 7: did a grip slip? Bases and grips then hold for "
        "neither part of the run",
        "not determined by this motion, kept as believed (2):",
        "  shift of the base of a along x",
        "  turn of the grip of a about z",
    ]
    plain = Calibration(*pair, (still,), before, after, np.array([0, 1]), (), 1.0, None)
    assert len(plain.explain().splitlines()) == 2


def test_settings_of_a_calibration() -> None:
    """The priors of every arm alike; at most 200 samples, unless told otherwise."""
    np.testing.assert_allclose(CalibrationOptions().prior(3), np.tile(PRIOR, 3))
    own = CalibrationOptions(base_position=1.0, base_angle=2.0, grip_position=3.0, grip_angle=4.0)
    np.testing.assert_array_equal(own.prior(1), np.repeat([1.0, 2.0, 3.0, 4.0], 3))
    assert CalibrationOptions().samples == 200
    assert CalibrationOptions().encoder_noise == 1e-4


def test_views_of_any_two_arms_are_compared(paper: Scenario) -> None:
    """The largest distance and angle between the object poses of two arms, after corrections, at each sample."""
    q, rng = paper.q_start, np.random.default_rng(0)
    closure = Closure(paper.cell, paper.grasp, np.array([q, q]), np.full(18, 1e-4))
    x = 1e-2 * rng.normal(size=36)
    O = []
    T = CellState(paper.cell, q).T_world_tool
    for arm, tool, X, (b, g) in zip(paper.cell.arms, T, paper.grasp.T_object_tool, x.reshape(3, 2, 6), strict=True):
        O.append(arm.T_world_base * pin.exp6(b) * arm.T_world_base.actInv(tool) * (X * pin.exp6(g)).inverse())
    far = [a.actInv(b) for i, a in enumerate(O) for b in O[i + 1 :]]
    expected = [
        max(np.linalg.norm(M.translation) for M in far),
        max(np.linalg.norm(pin.log3(M.rotation)) for M in far),
    ]
    np.testing.assert_allclose(closure.distances(x), [expected, expected])
    np.testing.assert_allclose(closure.errors(x)[1], [pin.log6(O[0].actInv(o)).vector for o in O[1:]], atol=1e-12)
