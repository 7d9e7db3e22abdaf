"""Two seven-joint arms reach into shelves: the problem of Cohn, Shaw, Simchowitz and Tedrake (arXiv 2309.08770).

Rebuilt from the numbers that they publish: two LBR iiwa 14 side by side 0.765 m apart on a table, grippers that face
each other, flange to flange 0.6 m, two shelves with a back. The arms are described by the project: rods of 60 mm radius
between their joints, a box for the gripper's body and one for each finger, and a cube between the fingers. Bodies keep
10 mm. A query starts at one of their key configurations and leads to the object's pose at another.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import common  # first: it limits BLAS to one thread
import numpy as np
import pinocchio as pin
from route_cases import ACCELERATION, Problem, at
from written_urdfs import urdf

from coopqp import Arm, CollisionScene, Grasp, RobotCell, inverse_kinematics
from coopqp.collision import Body, Box
from coopqp.spatial import Array

assert common

#: Joints at the key configurations, the left arm's and the right one's, to six digits [rad].
_CONFIGURATIONS = {
    "top": [
        -0.199499, 0.914074, -2.236618, 0.523888, 0.799844, -1.357540, -1.015309,
        0.241608, 0.902267, 2.289741, 0.528685, -0.863682, -1.412313, -1.345403,
    ],
    "middle": [
        -0.599731, 1.489781, -1.473968, 1.290537, -0.044211, -0.879371, -1.160346,
        0.647809, 1.542018, 1.401203, 1.293143, 0.146914, -0.934873, -1.276887,
    ],
    "bottom": [
        -0.643091, 1.915612, -1.796825, 1.294545, -0.023835, -0.876967, -1.704164,
        0.713706, 1.967510, 1.728621, 1.297296, 0.163509, -0.933994, -0.755539,
    ],
}  # fmt: skip
#: The queries in the order of their paper.
QUERIES = (("top", "middle"), ("middle", "bottom"), ("bottom", "top"))
#: The shortest way that they publish for each, without contact, measured in their coordinates [rad]; see
#: :func:`length_in_their_coordinates`.
PUBLISHED = {("top", "middle"): 2.09, ("middle", "bottom"): 3.00, ("bottom", "top"): 4.75}
_BETWEEN_BASES, _BETWEEN_TOOLS, _RADIUS = 0.765, 0.6, 0.06
#: The gripper's turn about its flange [rad], and how far the last link's frame is from the tool's [m].
_GRIPPER_TURN, _TO_TOOL = np.deg2rad(68.0), 0.045


def name_of(query: tuple[str, str]) -> str:
    """Name of the rows of a query."""
    return "shelves, {} to {}".format(*query)


def problem(query: tuple[str, str]) -> Problem:
    """A query."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "iiwa14.urdf"
        file.write_text(urdf("iiwa14", radius=_RADIUS), encoding="utf-8")
        arms = [
            Arm.from_urdf(
                name, file, tool_frame="iiwa_link_ee", T_world_base=at((0.0, y, 0.0)), acceleration_limits=ACCELERATION
            )
            for name, y in (("left", 0.0), ("right", _BETWEEN_BASES))
        ]
    cell = RobotCell(arms)
    # The right tool faces the left one; the object's frame is in the middle, with the left tool's axes.
    R = np.diag([-1.0, 1.0, -1.0]) @ pin.utils.rotate("z", np.pi - 2.0 * _GRIPPER_TURN)
    half = 0.5 * _BETWEEN_TOOLS - _TO_TOOL
    grasp = Grasp((at((0.0, 0.0, -half)), at((0.0, 0.0, half), R)))
    start, goal = (_object_at(cell, grasp, _CONFIGURATIONS[name]) for name in query)
    q_start = inverse_kinematics(cell, grasp, start, np.array(_CONFIGURATIONS[query[0]]))
    scene = CollisionScene(
        cell=cell,
        grasp=grasp,
        carried=[Body("cube", Box((0.04, 0.04, 0.04)), at((0.0, 0.0, 0.0)))],
        obstacles=_furniture(),
        on_links={f"{arm.name}/link_7": _gripper(arm.name) for arm in arms},
    )
    return Problem(cell, grasp, start, goal, scene, q_start)


def _object_at(cell: RobotCell, grasp: Grasp, q: list[float]) -> pin.SE3:
    """Where the left arm holds the object."""
    model = cell.model
    data = model.createData()
    pin.framesForwardKinematics(model, data, np.array(q))
    tool = data.oMf[model.getFrameId("left/iiwa_link_ee")]
    return pin.SE3(tool * grasp.T_object_tool[0].inverse())


def _gripper(arm: str) -> list[Body]:
    """A parallel gripper with long fingers, in the frame of the last link."""
    turn: Array = pin.utils.rotate("z", _GRIPPER_TURN) @ pin.utils.rotate("x", 0.5 * np.pi)
    T = at((0.0, 0.0, 0.09), turn)
    body = Body(f"{arm} gripper", Box((0.146, 0.0725, 0.05)), T)
    fingers = [
        Body(f"{arm} finger {k}", Box((0.04, 0.163, 0.038)), T * at((0.07 * side, 0.1045, 0.0)))
        for k, side in ((1, -1.0), (2, 1.0))
    ]
    return [body, *fingers]


def _furniture() -> list[Body]:
    """The table, both boards and their back."""
    y = 0.5 * _BETWEEN_BASES
    board = Box((0.4, 1.0, 0.014))
    return [
        Body("table", Box((5.0, 5.0, 0.2)), at((0.4, y, -0.1))),
        Body("lower board", board, at((0.8, y, 0.3))),
        Body("upper board", board, at((0.8, y, 0.6))),
        Body("back", Box((0.03, 1.0, 0.9)), at((1.0, y, 0.45))),
    ]


def joint_length(joints: Array) -> float:
    """Length of the way of all joints [rad]."""
    return float(np.linalg.norm(np.diff(joints, axis=0), axis=1).sum())


def length_in_their_coordinates(cell: RobotCell, joints: Array) -> float:
    """Length of a way in the coordinates of their planner [rad]: the joints of one arm, the elbow angle of the other.

    The joints of both arms cannot be meant: between the ends of the first query they differ by 2.41 rad, and the length
    that is published is 2.09 rad. In these coordinates the ends differ by 1.88 or 1.97 rad, and by elbow angles of
    0.8200 and 0.9600 rad: round numbers, as one chooses them. Either arm may lead; the longer length is given.
    """
    lengths = []
    for leader, follower in (("left", "right"), ("right", "left")):
        leading = joints[:, [cell.model.joints[k].idx_q for k in _joints_of(cell, leader)]]
        elbow = np.unwrap([_elbow_angle(cell, q, follower) for q in joints])
        lengths.append(joint_length(np.column_stack((leading, elbow))))
    return max(lengths)


def _joints_of(cell: RobotCell, arm: str) -> list[int]:
    return [k for k, name in enumerate(cell.model.names) if name.startswith(f"{arm}/")]


def _elbow_angle(cell: RobotCell, q: Array, arm: str) -> float:
    """Angle about the line from shoulder to wrist between the elbow and the vertical plane of that line [rad]."""
    data = cell.model.createData()
    pin.forwardKinematics(cell.model, data, q)
    shoulder, elbow, wrist = (data.oMi[_joints_of(cell, arm)[k]].translation for k in (1, 3, 5))
    axis = (wrist - shoulder) / np.linalg.norm(wrist - shoulder)
    vertical, plane = np.cross([0.0, 0.0, 1.0], axis), np.cross(elbow - shoulder, axis)
    return float(np.arctan2(axis @ np.cross(vertical, plane), vertical @ plane))
