"""Tasks that cannot be finished: one path meets a position limit, another leads an arm into a singularity."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated, Literal

import numpy as np
import pinocchio as pin

from coopqp.checks import Array, Doc, as_scalar, as_vector
from coopqp.errors import InvalidInputError, UnknownNameError
from coopqp.model.state import CellState
from coopqp.paths.path import LinePath
from coopqp.paths.scenario import Scenario
from coopqp.paths.time_law import TimeLaw
from coopqp.scenarios.paper import paper_lift
from coopqp.scenarios.stations import Stance, Station, put_together
from coopqp.scenarios.units import MetresPerSecond, Radians, RadiansPerSquareSecond

#: Kinds of singularity of :func:`at_singularity`.
SINGULARITIES = ("wrist", "elbow", "reach")


def at_limit(
    *,
    direction: Sequence[float] = (0.0, 0.0, 1.0),
    rotation: Sequence[float] = (0.0, 0.0, 0.0),
    margin: Annotated[float | Array, Doc("[rad]")] = 0.25,
    speed: MetresPerSecond = 0.25,
    acceleration: RadiansPerSquareSecond = 5.0,
) -> Scenario:
    """The paper's three arms with narrow position limits around the start, and a path of 1 m beyond these limits.

    Args:
        direction: direction of the path in the world, of any length.
        rotation: rotation of the plate along the path, a rotation vector in world axes [rad].
        margin: distance from the start to the position limits, one number or (nv,) [rad].
        speed: speed of the object [m/s].
        acceleration: acceleration limit of every joint [rad/s²]; inf for no limit.
    """
    lift = paper_lift()
    way = as_vector(direction, 3, "at_limit: direction")
    length = float(np.linalg.norm(way))
    if length < 1e-9:
        raise InvalidInputError("direction is zero", "at_limit", "Give a direction.")
    path = LinePath.displaced(
        lift.path.pose(0.0),
        translation=way / length,
        rotation=rotation,
        duration=1.0 / as_scalar(speed, "at_limit: speed"),
        time_law=TimeLaw.LINEAR,
    )
    limits = lift.cell.limits
    cell = lift.cell.with_limits(
        lower=np.maximum(limits.lower, lift.q_start - margin),
        upper=np.minimum(limits.upper, lift.q_start + margin),
        acceleration=acceleration,
    )
    return replace(lift, name="at_limit", cell=cell, path=path, dt=0.002)


def at_singularity(
    kind: Literal["wrist", "elbow", "reach"] = "wrist",
    arm: int = 0,
    *,
    miss: Radians = 0.0,
    speed: MetresPerSecond = 0.25,
    acceleration: RadiansPerSquareSecond = np.inf,
) -> Scenario:
    """Three RX-90L around a plate, and a path that leads one of them through a singularity.

    The path passes straight through a pose with a stretched wrist or elbow and continues for a third of its length, or
    it leaves the reach of the arm. A stretched elbow and the end of the reach stop the object. A path exactly through
    the pole of a wrist can continue. A path that narrowly misses the pole must slow down while the wrist turns.

    Args:
        kind: ``"wrist"``, ``"elbow"`` or ``"reach"``.
        arm: index of the arm, 0 to 2.
        miss: distance of the path from the wrist's pole, as an angle of joint 5 [rad]; 0 passes through the pole.
        speed: speed of the object [m/s]; a turn of 1 rad counts as 0.3 m.
        acceleration: acceleration limit of every joint [rad/s²]; inf for no limit.

    Raises:
        UnknownNameError: no such kind or arm.
    """
    if kind not in SINGULARITIES:
        raise UnknownNameError("singularity", str(kind), SINGULARITIES, "at_singularity")
    if arm not in (0, 1, 2):
        raise UnknownNameError("arm", str(arm), ("0", "1", "2"), "at_singularity")
    start = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.60]))
    still = LinePath(start, start, duration=1.0)
    near = (0.0, 45.0, 70.0, 0.0, -25.0, 0.0)
    led = Stance(0.80, 0.60, near) if kind == "wrist" else Stance(1.0, 0.30, near)
    others = Stance(0.80, 0.30, (0.0, 38.0, 100.0, 0.0, -47.0, 0.0))
    stations = []
    for k, angle in enumerate((180.0, -60.0, 60.0)):
        point = 0.45 * math.cos(math.radians(angle)), 0.45 * math.sin(math.radians(angle))
        stations.append(Station("rx90l", f"arm_{k + 1}", point, angle + 180.0, led if k == arm else others))
    rest = put_together("at_singularity", stations, still, object_size=(0.90, 0.90, 0.03), object_mass=9.0)
    goal = _singular_goal(rest, kind, arm, start, as_scalar(miss, "at_singularity: miss", open_low=False))
    way, turn = goal.translation - start.translation, pin.log3(start.rotation.T @ goal.rotation)
    beyond = 4.0 / 3.0
    path = LinePath.displaced(
        start,
        translation=beyond * way,
        rotation=beyond * turn,
        duration=beyond
        * float(np.linalg.norm(way) + 0.3 * np.linalg.norm(turn))
        / as_scalar(speed, "at_singularity: speed"),
        time_law=TimeLaw.LINEAR,
    )
    return replace(rest, cell=rest.cell.with_limits(acceleration=acceleration), path=path)


def _singular_goal(rest: Scenario, kind: str, arm: int, start: pin.SE3, miss: float) -> pin.SE3:
    """Object pose at which the arm is singular, or a pose out of its reach."""
    if kind == "reach":
        away = rest.cell.arms[arm].T_world_base.rotation[:, 0]
        return pin.SE3(start.rotation, start.translation + 0.40 * away)
    q = rest.q_start.copy()
    joints = q[rest.cell.q_slices[arm]]  # a view
    joints += np.deg2rad([4.0, 2.0, -3.0, 12.0, 0.0, -8.0])
    if kind == "elbow":
        joints[1] += np.deg2rad(40.0)
        joints[2] = 0.0
    else:
        joints[4] = -miss
        if miss:
            joints[[3, 5]] += 0.5 * np.pi, -0.5 * np.pi  # a quarter turn of the wrist: it passes sideways
    return CellState(rest.cell, q).T_world_tool[arm] * rest.grasp.T_object_tool[arm].inverse()
