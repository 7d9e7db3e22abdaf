"""Ways of one arm's joints in a program: where they lead its tool on the object, and what is refused."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin

from coopqp.errors import InvalidInputError
from coopqp.model.arm import Arm
from coopqp.model.batch import ArmKinematics
from coopqp.model.branches import amount
from coopqp.paths.joint_path import JointPath, JointPiece
from coopqp.paths.path import ObjectPath
from coopqp.spatial import Array

#: A way may begin this far from where the tool is [m, rad]; it is led there exactly.
_NEAR = 1e-3
#: Positions this far outside their limits count as inside [rad or m].
_AT_LIMIT = 1e-9


def joint_piece(
    program: ObjectPath, arm: Arm, path: JointPath, X: pin.SE3, before: pin.SE3, start: float, where: str
) -> JointPiece:
    """The part of a program on which an arm follows its joints.

    Args:
        program: its object's path gives where the object is.
        arm, path: the arm, and the way.
        X, before: T_object_tool of the grasp, and M where the phase begins.
        start: the program's clock there [s].
        where: of messages.

    Raises:
        InvalidInputError: another number of joints, positions outside their limits, or a way that begins elsewhere.
    """
    kinematics = ArmKinematics(arm)
    if path.rows.shape[1] != kinematics.n:
        raise InvalidInputError(
            f"a way of {path.rows.shape[1]} joints, and the arm has {kinematics.n}", where, "Give one position a joint."
        )
    margins = kinematics.margins(path.farthest)
    row, j = np.unravel_index(int(margins.argmin()), margins.shape)
    if margins[row, j] < -_AT_LIMIT:
        place = f"(row {row})" if row < len(path.rows) else "between its rows"
        outside = amount(-margins[row, j], slides=bool(kinematics.slides[j]))
        raise InvalidInputError(
            f"its way leads {kinematics.joints[j]} out of its limits by {outside} {place}",
            where,
            "Give positions inside the joint's limits.",
        )
    tool = program.pose(start) * before * X
    away = pin.log6(tool.actInv(pin.SE3(kinematics.tool_poses(path.rows[:1])[0]))).vector
    far, turned = float(np.linalg.norm(away[:3])), float(np.linalg.norm(away[3:]))
    if max(far, turned) > _NEAR:
        raise InvalidInputError(
            f"its way begins {1e3 * far:.3g} mm and {np.rad2deg(turned):.3g}° from where its tool is",
            where,
            "Begin it at the arm's configuration when the phase begins.",
        )
    exact = kinematics.solve(tool.homogeneous[None], path.rows[:1], tolerance=1e-11, steps=8)
    way = path.begun(exact.q[0]) if exact.reached[0] else path
    moved = _Moved(program, arm, way, X.inverse(), start)
    return JointPiece(start, start + way.duration, way, moved, start)


@dataclass(frozen=True, eq=False)
class _Moved:
    """M of a tool that joints lead, at a clock of the program."""

    program: ObjectPath
    arm: Arm
    way: JointPath
    back: pin.SE3
    begins: float

    @cached_property
    def _kinematics(self) -> ArmKinematics:
        return ArmKinematics(self.arm)

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "_kinematics"}

    def __call__(self, clock: float) -> pin.SE3:
        x: Array = self.way.at(clock - self.begins)[0]
        tool = pin.SE3(self._kinematics.tool_poses(x[None])[0])
        return self.program.pose(clock).inverse() * tool * self.back
