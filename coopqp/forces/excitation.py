"""The motion that a calibration needs: tilts about two or three axes, as large as the arms can follow."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from coopqp.checks import as_options, as_scalar
from coopqp.errors import UnreachableError
from coopqp.forces.calibration import CalibrationOptions, undetermined_by
from coopqp.model.cell import RobotCell
from coopqp.model.grasp import Grasp
from coopqp.model.inverse_kinematics import inverse_kinematics
from coopqp.model.state import CellState
from coopqp.paths.certificate import PathVerdict
from coopqp.paths.path import LinePath, WaypointPath
from coopqp.planning.check import PathCheck, check_path
from coopqp.spatial import Array

#: Shares of the largest tilt that are tried, the first that the arms can follow is taken.
_SHARES = (1.0, 0.5, 0.25, 0.125)
#: Poses of each tilt at which the motion is judged.
_POSES = 8
_FOLLOWED = (PathVerdict.CERTIFIED, PathVerdict.SAMPLED)


@dataclass(frozen=True, eq=False)
class DeterminingMotion:
    """A motion for a calibration, checked before it is made.

    Attributes:
        path: from the start to each tilt and back.
        tilts: angles about the x, y and z axes of the object [rad]; 0 where the arms can follow none.
        check: the check of the path from the start.
        undetermined: directions that even this motion leaves undetermined, in words.
    """

    path: WaypointPath
    tilts: tuple[float, float, float]
    check: PathCheck
    undetermined: tuple[str, ...]


def determining_motion(
    cell: RobotCell,
    grasp: Grasp,
    q_start: Any,
    *,
    largest: float = float(np.deg2rad(20.0)),
    duration: float = 3.0,
    options: CalibrationOptions | Mapping[str, Any] | None = None,
) -> DeterminingMotion:
    """Tilts about the object's axes through the middle of the grips, as large as the arms can follow from a start.

    Args:
        cell, grasp: the arms, and how they hold.
        q_start: configuration (nq,) at which they hold the object.
        largest: largest tilt [rad].
        duration: duration of each way to a tilt, and of each way back [s].
        options: as in :func:`coopqp.forces.calibrate`.

    Raises:
        InvalidInputError: bad arguments, or a start that does not hold the object.
        UnreachableError: the arms can follow no tilt.
    """
    grasp.check_arms(cell)
    cell.refuse_shared("determining_motion")
    settings = as_options(CalibrationOptions, options, "determining_motion: options")
    angle = as_scalar(largest, "determining_motion: largest", high=np.pi / 2)
    time = as_scalar(duration, "determining_motion: duration")
    state = CellState(cell, q_start)
    start = grasp.carried(state)[0]
    middle = np.mean([X.translation for X in grasp.T_object_tool], axis=0)
    tilts, goals = [0.0, 0.0, 0.0], []
    for axis in range(3):
        for size, sign in itertools.product(_SHARES, (1.0, -1.0)):
            turn = sign * size * angle
            R = pin.exp3(turn * np.eye(3)[axis])
            goal = start * pin.SE3(R, middle - R @ middle)
            if check_path(cell, grasp, LinePath(start, goal, duration=time), q_start=state.q).verdict in _FOLLOWED:
                tilts[axis] = turn
                goals.append(goal)
                break
    if not goals:
        raise UnreachableError("the arms can follow no tilt of the object from this start. Start from another pose.")
    poses = [start, *itertools.chain.from_iterable((goal, start) for goal in goals)]
    path = WaypointPath(poses, durations=[time] * (len(poses) - 1))
    found = check_path(cell, grasp, path, q_start=state.q)
    q = _configurations(cell, grasp, [start, *goals], state.q)
    return DeterminingMotion(
        path, (tilts[0], tilts[1], tilts[2]), found, undetermined_by(cell, grasp, q, options=settings)
    )


def _configurations(cell: RobotCell, grasp: Grasp, poses: list[pin.SE3], q_start: Array) -> Array:
    """Configurations (T, nq) on the ways from the first pose to each other."""
    rows = []
    for goal in poses[1:]:
        q = q_start
        for share in np.linspace(0.0, 1.0, _POSES):
            q = inverse_kinematics(cell, grasp, pin.SE3.Interpolate(poses[0], goal, float(share)), q, limits=False)
            rows.append(q)
    return np.array(rows)
