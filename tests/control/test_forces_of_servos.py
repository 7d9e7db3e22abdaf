"""An arm that hangs behind its command is found by how the servos are bent, where the elastic energy is least."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from cells import grasp_at
from odd_cells import one_on_the_first_of_two
from torsos import columns_of, regular, robot_of

from coopqp import LinePath, QPController, RobotCell, Status, SupervisionOptions
from coopqp.model import CellState
from coopqp.scenarios import ring
from coopqp.spatial import Array

TORSOS = {"lift": (("prismatic", "0 0 1"),), "both": (("prismatic", "0 0 1"), ("revolute", "0 1 0"))}
DT = 0.02
GAP = 5e-4  # [m]
#: What the compliance of the arms' structure makes of it, which is beside that of their servos.
SOFT = 0.02


def bent_least(J: Array, off: Array, stiffness: Array) -> Array:
    """Deflections (nv,) of least energy with which arms that are off by (6 N,) meet: ½ yᵀ K y, J y + off = E o."""
    nv, root = J.shape[1], np.sqrt(stiffness.mean())
    A = np.hstack([J * root / np.sqrt(stiffness), -np.tile(np.eye(6), (len(J) // 6, 1))])
    H = np.diag(np.concatenate([np.ones(nv), np.zeros(6)]))
    kkt = np.block([[H, A.T], [A, np.zeros((len(A), len(A)))]])
    x = np.linalg.solve(kkt, np.concatenate([np.zeros(nv + 6), -off * root]))
    return np.asarray(x[:nv] / np.sqrt(stiffness))


@pytest.mark.parametrize(
    ("torso", "arm"),
    [*((torso, arm) for torso in (None, *TORSOS) for arm in (0, 1)), ("one of two", 0), ("one of two", 2)],
)
def test_the_arm_that_hangs_behind_is_named_with_its_gap_and_pull(torso: str | None, arm: int, tmp_path: Path) -> None:
    """The object has moved along a twist to rest; the targets of one arm's servos stay behind on it."""
    if torso == "one of two":  # of the torso's joints the third arm has the first alone
        cell = one_on_the_first_of_two(tmp_path)
    else:
        cell = RobotCell([robot_of(TORSOS[torso], tmp_path)]) if torso else ring(arms=2).cell
    rng = np.random.default_rng(2 + arm)
    q, stiffness = regular(cell, rng), rng.uniform(5e3, 1e4, cell.nv)
    grasp = grasp_at(cell, q)
    way = rng.normal(size=3)
    way *= GAP / np.linalg.norm(way)
    turn = np.array([GAP, 0.0, 0.0])  # [rad]
    T = grasp.carried(CellState(cell, q))[0]
    path = LinePath.displaced(T, translation=20.0 * way, rotation=20.0 * turn, duration=0.4, time_law="linear")
    watch = SupervisionOptions(
        slow_from=None,
        stall_samples=None,
        filter_time=0.0,
        servo_delay=0.0,
        force_limit=1.0,
        stiffness=tuple(stiffness),
    )
    options = {"supervision": watch, "path_gain": 0.0, "grasp_gain": 0.0}
    controller = QPController(cell, grasp, path, dt=DT, options=options)
    controller.reset(q)
    step = controller.step(q)
    while step.clock_next < path.duration:
        step = controller.step(step.q_next)
    q = step.q_next
    T = grasp.carried(CellState(cell, q))[0]
    J, own = columns_of(cell, q, T), np.arange(cell.v_slices[arm].start, cell.v_slices[arm].stop)
    J, R = J.reshape(len(cell), 6, -1), np.kron(np.eye(2), T.rotation)
    behind = np.zeros(cell.nv)  # how far the targets are behind the command
    behind[own] = np.linalg.lstsq(J[arm][:, own], R.T @ np.concatenate([way, turn]), rcond=None)[0]
    J = J.reshape(-1, cell.nv)
    bent = bent_least(J, -J @ behind, stiffness)
    for i in range(15):  # servos settle within 0.2 s
        step = controller.step(pin.integrate(cell.model, q, bent - behind + 1e-10 * i))
    wrenches = np.linalg.solve(J / stiffness @ J.T, J @ (behind - bent)).reshape(-1, 6)
    pull = np.linalg.norm(np.delete(wrenches, arm, axis=0).sum(axis=0)[:3])
    assert step.status is Status.HOLDING
    found = re.match(r"arm (\w+) does not follow .* hangs ([\d.]+) mm behind, .* pull it with (\d+) N", step.reason)
    assert found, step.reason
    assert found[1] == cell.arm_names[arm]
    assert float(found[2]) == pytest.approx(1e3 * GAP, abs=0.025)
    assert float(found[3]) == pytest.approx(pull, rel=SOFT, abs=0.5)
