"""The paper's example: three Stäubli RX-90L arms lift a plate by 30 cm and turn it by 40°.

The paper does not give the base distances, the grasp triangle and the start. The values here satisfy its claims. The
rotation is −40° about the master's x axis through A.

Other triads make the same lift: KUKA KR 16-2, ABB IRB 1600-6/1.2, and one arm of each maker. Places of their bases were
found with :mod:`coopqp.studies`, and rounded.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from coopqp.model.cell import RobotCell
from coopqp.model.grasp import Grasp
from coopqp.model.inverse_kinematics import inverse_kinematics
from coopqp.paths.path import LinePath
from coopqp.paths.scenario import Scenario
from coopqp.paths.time_law import TimeLaw
from coopqp.scenarios.arms import robot_arm
from coopqp.scenarios.units import Metres, RadiansPerSecond, Seconds

#: Base distances of Eq. (3) [m].
BASE_DISTANCE_H, BASE_OFFSET_B = 3.60, 0.50
#: The plate of the paper: length, width, thickness [m].
PLATE_SIZE = (1.80, 0.80, 0.04)
DURATION = 3.0
#: The grasp triangle of Eq. (6) [m].
ALPHA, BETA = 0.60, 0.30

_NEAR_START_DEG = (
    (0.0, 65.4, 76.0, 180.0, 51.3, -90.0),
    (13.8, 67.4, 71.9, -162.1, 50.7, -101.6),
    (-13.8, 67.4, 71.9, 162.1, 50.7, -78.4),
)


def slave_base(b: float, h: Metres = BASE_DISTANCE_H) -> pin.SE3:
    """S_i of Eq. (3): a slave's base in the master's base, turned by π about z. S_i is its own inverse."""
    return pin.SE3(np.diag([-1.0, -1.0, 1.0]), np.array([h, b, 0.0]))


def three_rx90l(*, h: Metres = BASE_DISTANCE_H, b: Metres = BASE_OFFSET_B) -> RobotCell:
    """The master at the origin, the slaves opposite at x = h, y = ±b (Figure 1) [m]."""
    master = robot_arm("rx90l", name="master")
    return RobotCell(
        [
            master,
            master.placed(slave_base(b, h), name="slave_1"),
            master.placed(slave_base(-b, h), name="slave_2"),
        ]
    )


def lift_path(reach: Metres, height: Metres, duration: Seconds, time_law: TimeLaw | str) -> LinePath:
    """The lift by 30 cm with a turn by −40°; A starts ahead of the master's base by ``reach``, at ``height`` [m]."""
    R = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    return LinePath.displaced(
        pin.SE3(R, np.array([reach, 0.0, height])),
        translation=(0.0, 0.0, 0.30),
        rotation=(-np.deg2rad(40.0), 0.0, 0.0),
        duration=duration,
        time_law=time_law,
    )


def paper_lift(
    *,
    alpha: Metres = ALPHA,
    beta: Metres = BETA,
    h: Metres = BASE_DISTANCE_H,
    b: Metres = BASE_OFFSET_B,
    time_law: TimeLaw | str = TimeLaw.LINEAR,
    duration: Seconds = DURATION,
) -> Scenario:
    """The paper's lift.

    Args:
        alpha, beta: the grasp triangle of Eq. (6) [m].
        h, b: distances of the bases, Eq. (3) [m].
        time_law: time law of the path.
        duration: duration of the path [s]; a step is a 400th of it.
    """
    cell = three_rx90l(h=h, b=b)
    path = lift_path(0.90, 0.10, duration, time_law)
    return plate_lift("paper_lift", cell, path, _NEAR_START_DEG, alpha=alpha, beta=beta)


def plate_lift(
    name: str,
    cell: RobotCell,
    path: LinePath,
    near: Sequence[Sequence[float]],
    *,
    alpha: Metres = ALPHA,
    beta: Metres = BETA,
) -> Scenario:
    """The plate held by a triangle grasp; ``near``: joint positions of each arm near the start [deg]."""
    grasp = Grasp.triangle(alpha, beta)
    guess = cell.configuration(np.deg2rad(np.concatenate(near)))
    return Scenario(
        name=name,
        cell=cell,
        grasp=grasp,
        path=path,
        q_start=inverse_kinematics(cell, grasp, path.pose(0.0), guess),
        dt=path.duration / 400,
        # The length of the plate is along y of A, an edge is at A; 1.80 x 0.80 m with the default grasp.
        object_size=(max(PLATE_SIZE[1], 2.0 * beta), 3.0 * alpha, PLATE_SIZE[2]),
        T_object_body=pin.SE3(np.eye(3), np.array([0.0, 1.5 * alpha, 0.0])),
    )


def wide_grasp(*, time_law: TimeLaw | str = TimeLaw.LINEAR, duration: Seconds = DURATION) -> Scenario:
    """The paper's lift with a wide grasp (β = 0.6 m, 3α = 0.8 m). B and C are 1 m nearer to A, and so are the slaves.

    The baseline drifts by 1.5 mm at N = 400, against 0.9 mm with the narrow grasp.
    """
    return replace(
        paper_lift(alpha=0.8 / 3.0, beta=0.60, h=2.60, time_law=time_law, duration=duration), name="wide_grasp"
    )


def fast_lift(*, joint_speed: RadiansPerSecond = 1.0, duration: Seconds = 0.5) -> Scenario:
    """The paper's lift at 0.6 m/s with joint speeds limited to 1 rad/s. The arms cannot follow at full rate.

    Args:
        joint_speed: speed limit of every joint [rad/s].
        duration: duration of the path at full rate [s].
    """
    lift = paper_lift(duration=duration)
    return replace(lift, name="fast_lift", cell=lift.cell.with_limits(velocity=joint_speed), dt=0.002)


class _Stand(NamedTuple):
    """Where an arm stands, as seen from the plate.

    Attributes:
        reach, height: of a master: distance of A ahead of its base, and height of A above it, at the start [m].
        away, b: of a slave: distance of its base beyond the far edge of the plate, and to the side [m].
        near: joint positions near the start [deg], as master, as slave 1 and as slave 2.
    """

    reach: float
    height: float
    away: float
    b: float
    near: tuple[tuple[float, ...], ...]


_STANDS = {
    "rx90l": _Stand(
        0.90, 0.10, 0.85, 0.70, ((0.0, 65.4, 76.0, 180.0, 51.3, -90.0),
        (27.6, 69.6, 67.6, -144.5, 53.0, -113.2), (-27.6, 69.6, 67.6, 144.5, 53.0, -66.8)),
    ),
    "kr16_2": _Stand(
        1.40, 0.60, 1.20, 0.90, ((0.0, -38.5, 83.4, 0.0, -44.9, -90.0),
        (-29.9, -40.6, 88.2, -38.0, -54.2, -65.5), (29.9, -40.6, 88.2, 38.0, -54.2, -114.5)),
    ),
    "irb1600": _Stand(
        1.00, 0.30, 0.90, 0.70, ((0.0, 55.7, -6.6, 0.0, -49.2, 90.0),
        (25.6, 55.0, -5.1, 32.1, -54.5, 70.0), (-25.6, 55.0, -5.1, -32.1, -54.5, 110.0)),
    ),
}  # fmt: skip


def _lift(name: str, robots: tuple[str, str, str], duration: float, time_law: TimeLaw | str) -> Scenario:
    """The paper's lift: master, slave 1 and slave 2 by the names of their robots."""
    first, length = _STANDS[robots[0]], PLATE_SIZE[0]
    arms = [robot_arm(robots[0], name="master")]
    for k, robot in enumerate(robots[1:], start=1):
        stand = _STANDS[robot]
        base = slave_base(stand.b if k == 1 else -stand.b, first.reach + length + stand.away)
        base.translation = base.translation + np.array([0.0, 0.0, first.height - stand.height])
        arms.append(robot_arm(robot, name=f"slave_{k}", T_world_base=base))
    path = lift_path(first.reach, first.height, duration, time_law)
    return plate_lift(name, RobotCell(arms), path, [_STANDS[robot].near[k] for k, robot in enumerate(robots)])


def kuka_lift(*, duration: Seconds = DURATION, time_law: TimeLaw | str = TimeLaw.LINEAR) -> Scenario:
    """The paper's lift by three KUKA KR 16-2.

    Args:
        duration: duration of the path [s]; a step is a 400th of it.
        time_law: time law of the path.
    """
    return _lift("kuka_lift", ("kr16_2",) * 3, duration, time_law)


def abb_lift(*, duration: Seconds = DURATION, time_law: TimeLaw | str = TimeLaw.LINEAR) -> Scenario:
    """The paper's lift by three ABB IRB 1600-6/1.2.

    Args:
        duration: duration of the path [s]; a step is a 400th of it.
        time_law: time law of the path.
    """
    return _lift("abb_lift", ("irb1600",) * 3, duration, time_law)


def mixed_lift(*, duration: Seconds = DURATION, time_law: TimeLaw | str = TimeLaw.LINEAR) -> Scenario:
    """The paper's lift by a KUKA KR 16-2 as master, a Stäubli RX-90L and an ABB IRB 1600-6/1.2 on pedestals.

    Args:
        duration: duration of the path [s]; a step is a 400th of it.
        time_law: time law of the path.
    """
    return _lift("mixed_lift", ("kr16_2", "rx90l", "irb1600"), duration, time_law)
