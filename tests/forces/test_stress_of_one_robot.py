"""Internal stress where arms share joints: by the least elastic energy of all joints, each counted once."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from cells import grasp_at, on_another_joint
from torsos import columns_of, regular, robot_of

from coopqp import RobotCell
from coopqp.control.monitoring.stress import servo_wrenches, whole_compliance
from coopqp.forces import StressModel
from coopqp.forces.presses import PressPlan, of_grip
from coopqp.model import CellState, Chain
from coopqp.spatial import Array, for_twists

#: What the compliance of the arms' structure makes of it, which is beside that of their servos.
SOFT = 2e-2
TORSOS = {
    "lift": (("prismatic", "0 0 1"),),
    "waist": (("revolute", "0 0 1"),),
    "both": (("prismatic", "0 0 1"), ("revolute", "0 1 0")),
}


def cell_of(torso: str, folder: Path, *, beside: bool) -> RobotCell:
    robot = robot_of(TORSOS[torso], folder)
    return RobotCell([on_another_joint("0", pin.JointModelRZ(), pin.SE3.Identity()), robot] if beside else [robot])


@pytest.fixture(params=[(torso, beside) for torso in TORSOS for beside in (False, True)], ids=str)
def cell(request: pytest.FixtureRequest, tmp_path: Path) -> RobotCell:
    torso, beside = request.param
    return cell_of(torso, tmp_path, beside=beside)


def settled(cell: RobotCell, q: Array, R: pin.SE3, e: Array, stiffness: Array) -> tuple[Array, Array]:
    """Deflections (nv,) of least energy with which arms that are off by e (N, 6) meet, and their wrenches (N, 6)."""
    n, nv, A = len(cell), cell.nv, columns_of(cell, q, R)
    root = np.sqrt(stiffness.mean())
    E = np.tile(np.eye(6), (n, 1))
    # y = Kp^½ δq / root, o and the multipliers: A δq + e = E o.
    system = np.hstack([A * root / np.sqrt(stiffness), -E])
    H = np.diag(np.concatenate([np.ones(nv), np.zeros(6)]))
    kkt = np.block([[H, system.T], [system, np.zeros((6 * n, 6 * n))]])
    x = np.linalg.solve(kkt, np.concatenate([np.zeros(nv + 6), -e.ravel() * root]))
    return x[:nv] / np.sqrt(stiffness), x[nv + 6 :].reshape(n, 6) * root


def stiff(cell: RobotCell, rng: np.random.Generator) -> Array:
    return rng.uniform(5e3, 1e4, cell.nv)


def test_the_object_settles_where_the_elastic_energy_is_least(cell: RobotCell, rng: np.random.Generator) -> None:
    q, stiffness = regular(cell, rng), stiff(cell, rng)
    model = StressModel(cell, grasp_at(cell, q), stiffness=stiffness)
    q_command = pin.integrate(cell.model, q, rng.uniform(-1e-3, 1e-3, cell.nv))
    stress = model.estimate(q_command)
    O = model.grasp.carried(CellState(cell, q_command))
    e = np.array([pin.log6(O[0].actInv(o)).vector for o in O])
    expected = settled(cell, q_command, O[0], e, stiffness)[1]
    scale = np.abs(expected).max()
    np.testing.assert_allclose(stress.wrenches, expected, atol=1e-6 * scale)
    np.testing.assert_allclose(stress.wrenches.sum(axis=0), 0.0, atol=1e-8 * scale)


def test_motions_of_grasps_cause_the_wrenches_of_the_grip(cell: RobotCell, rng: np.random.Generator) -> None:
    """What the grasps' motions do by :func:`of_grip` is the least energy; a press makes the wrenches that it says."""
    q, stiffness = regular(cell, rng), stiff(cell, rng)
    grasp = grasp_at(cell, q)
    chain = Chain(cell, grasp)
    R = chain.carried(q)[0]
    chain.evaluate(q, about=R.translation)
    turn = for_twists(R.rotation)
    own = turn.T @ chain.compliances(1.0 / stiffness) @ turn
    shared = chain.shared_compliance(1.0 / stiffness, turn)
    assert shared is not None
    G, e = of_grip(own, shared), 1e-4 * rng.normal(size=(len(cell), 6))
    expected = settled(cell, q, R, e, stiffness)[1]
    np.testing.assert_allclose((G @ e.ravel()).reshape(-1, 6), expected, atol=SOFT * np.abs(expected).max())
    yielded = (whole_compliance(own, shared) @ expected.ravel()).reshape(-1, 6)
    np.testing.assert_allclose(servo_wrenches(own, yielded, shared), expected, atol=SOFT * np.abs(expected).max())
    for ways in PressPlan(grasp, own, shared).ways:
        pressed = (G @ ways.ravel()).reshape(-1, 6)  # they cancel, so nothing moves the object:
        np.testing.assert_allclose(pressed.sum(axis=0), 0.0, atol=1e-6)
        moved = (whole_compliance(own, shared) @ pressed.ravel()).reshape(-1, 6)
        np.testing.assert_allclose(moved, ways, atol=SOFT * np.abs(ways).max())
