"""The paper's lift by other triads: KUKA KR 16-2, ABB IRB 1600-6/1.2, and one arm of each maker.

The plate, the grasp and the motion are the paper's. Places of bases were found with :mod:`coopqp.studies`, and rounded.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from coopqp.model.cell import RobotCell
from coopqp.paths.path import TimeLaw
from coopqp.paths.scenario import Scenario
from coopqp.scenarios.arms import robot_arm
from coopqp.scenarios.paper import DURATION, PLATE_SIZE, lift_path, plate_lift, slave_base
from coopqp.scenarios.units import Seconds


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
