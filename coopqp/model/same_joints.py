"""Joints of one robot that is given as several arms.

A description with two arms holds every joint of the robot. Given twice, as an arm with the left tool and as one with
the right tool, each of its joints is there twice, and would get two commands. A joint is the same one if its name, its
kind and its place in the world are the same, with all joints at zero. Arms of one :class:`coopqp.Robot` may share
joints: a cell has each of them once.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from coopqp.errors import InvalidInputError
from coopqp.model.arm import Arm
from coopqp.model.joint_limits import LIMIT_FIELDS, JointLimits
from coopqp.model.links import joint_axes
from coopqp.spatial import Array

#: Joints whose places differ by no more than this are at the same place [m, and rotation matrix entries].
_SAME = 1e-6
#: Most joints that a message names.
_NAMED = 6
#: Fewest joints of its own of an arm that shares others: the object's motion leaves it no choice of the shared ones.
_LEAST_OWN = 6


@dataclass(frozen=True, eq=False)
class _Joint:
    """A joint that moves.

    Attributes:
        arm, number: index of its arm, and of the joint in the arm's model.
        name: its name in the arm.
        slides: True for a prismatic joint.
        place: its frame in the world (4, 4), with all joints at zero.
        axis: its twist in that frame (6,).
        carries: True if it moves the tool.
        behind: number of joints before it that move the tool.
    """

    arm: int
    number: int
    name: str
    slides: bool
    place: Array
    axis: Array
    carries: bool
    behind: int

    def is_same(self, other: _Joint) -> bool:
        """Same name, kind, place and axis."""
        return (
            self.name == other.name
            and self.slides == other.slides
            and bool(np.abs(self.place - other.place).max() <= _SAME)
            and bool(np.abs(self.axis - other.axis).max() <= _SAME)
        )

    def gives_way_to(self, other: _Joint) -> bool:
        """Whether this joint, which moves no tool, is left to another arm: to that on whose chain it stands."""
        return other.carries or (other.behind, -other.arm) > (self.behind, -self.arm)

    def is_locked_as(self, fixed: _Fixed) -> bool:
        """The fixed frame is where this joint moves its own frame to at some position."""
        if fixed.name.removesuffix(" (joint)") != self.name:
            return False
        away = np.linalg.solve(self.place, fixed.place)
        if self.slides:
            off = away[:3, 3] - self.axis[:3] * (self.axis[:3] @ away[:3, 3])
            return bool(max(np.abs(off).max(), np.abs(away[:3, :3] - np.eye(3)).max()) <= _SAME)
        turned = away[:3, :3] @ self.axis[3:] - self.axis[3:]
        return bool(max(np.abs(away[:3, 3]).max(), np.abs(turned).max()) <= _SAME)


@dataclass(frozen=True, eq=False)
class _Fixed:
    """A fixed or locked joint on the way to a tool: its name, and its frame and the frame before it (4, 4)."""

    name: str
    place: Array
    before: Array


def without_copies(arms: Sequence[Arm]) -> tuple[tuple[Arm, ...], tuple[str, ...]]:
    """The arms with no joint twice.

    A joint that does not move the tool of its arm, and is a joint of another arm as well, is locked at zero, or at
    the nearest position inside its limits. Its links are shown, weighed and kept clear of in the other arm alone.

    Returns:
        The arms, and the names ``arm/joint`` of joints that were locked, but for those that move with another arm of
        one robot.

    Raises:
        InvalidInputError: a joint moves the tools of two arms, or is locked in one of them only, or elsewhere.
    """
    if len(arms) < 2:
        return tuple(replace(arm, shared=()) if arm.shared else arm for arm in arms), ()
    joints = [_joints(k, arm) for k, arm in enumerate(arms)]
    fixed = [_fixed(arm) for arm in arms]
    shared: list[set[str]] = [set() for _ in arms]
    for a, b in itertools.combinations(range(len(arms)), 2):
        if arms[a].robot and arms[a].robot == arms[b].robot:
            both = _shared_by((arms[a], arms[b]), (joints[a], joints[b]))
            shared[a] |= both
            shared[b] |= both
        else:
            _refuse_shared((arms[a], arms[b]), (joints[a], joints[b]), (fixed[a], fixed[b]))
    out: list[Arm] = []
    locked: list[str] = []
    for k, arm in enumerate(arms):
        others = [joint for own in joints for joint in own if joint.arm != k]
        twice = [j for j in joints[k] if not j.carries and any(j.gives_way_to(o) and j.is_same(o) for o in others)]
        alone = _reduced(arm, twice) if twice else arm
        names = tuple(joint.name for joint in joints[k] if joint.name in shared[k])
        out.append(alone if alone.shared == names else replace(alone, shared=names))
        moved = [o for o in others if o.carries and arm.robot and arms[o.arm].robot == arm.robot]  # by its other arms
        locked += [f"{arm.name}/{joint.name}" for joint in twice if not any(joint.is_same(o) for o in moved)]
    return tuple(out), tuple(locked)


def _shared_by(arms: tuple[Arm, Arm], joints: tuple[list[_Joint], list[_Joint]]) -> set[str]:
    """Names of the joints that move the tools of two arms of one robot.

    Raises:
        InvalidInputError: the arms stand on two bases, or one of them has no joint of its own.
    """
    if np.abs(arms[0].T_world_base.homogeneous - arms[1].T_world_base.homogeneous).max() > _SAME:
        raise InvalidInputError(
            f"arms '{arms[0].name}' and '{arms[1].name}' of robot '{arms[0].robot}' stand on two bases",
            "RobotCell",
            "Move the whole robot: give it another T_world_base.",
        )
    first, second = ([joint for joint in own if joint.carries] for own in joints)
    both = {a.name for a in first if any(a.is_same(b) for b in second)}
    for arm, own in zip(arms, (first, second), strict=True):
        left = len(own) - len(both)
        if both and left < _LEAST_OWN:
            locks = _locks(arm, [joint for joint in own if joint.name in both])
            raise InvalidInputError(
                f"arm '{arm.name}' of robot '{arm.robot}' has {left} joints that move no other arm's tool; an arm that "
                f"shares joints needs {_LEAST_OWN} of its own",
                "RobotCell",
                f"Choose another tool frame, or lock what it shares: {locks}.",
            )
    return both


def _joints(k: int, arm: Arm) -> list[_Joint]:
    model, data = arm.model, arm.model.createData()
    pin.forwardKinematics(model, data, pin.neutral(model))
    carrying = set(model.supports[model.frames[model.getFrameId(arm.tool_frame)].parentJoint])
    out = []
    for i, axis in enumerate(joint_axes(model), start=1):
        place = (arm.T_world_base * data.oMi[i]).homogeneous
        slides = bool(np.linalg.norm(axis[3:]) < 0.5)
        behind = len(carrying & set(model.supports[i]))
        out.append(_Joint(k, i, model.names[i], slides, place, axis, i in carrying, behind))
    return out


def _fixed(arm: Arm) -> list[_Fixed]:
    """The fixed joints from the base to the tool."""
    model, data = arm.model, arm.model.createData()
    pin.framesForwardKinematics(model, data, pin.neutral(model))
    place = [(arm.T_world_base * T).homogeneous for T in data.oMf]
    out = []
    i = model.getFrameId(arm.tool_frame)
    while i > 0:
        frame = model.frames[i]
        if frame.type == pin.FrameType.FIXED_JOINT:
            out.append(_Fixed(frame.name, place[i], place[frame.parentFrame]))
        i = frame.parentFrame if frame.parentFrame != i else 0
    return out


def _refuse_shared(
    arms: tuple[Arm, Arm], joints: tuple[list[_Joint], list[_Joint]], fixed: tuple[list[_Fixed], list[_Fixed]]
) -> None:
    """Raise for joints on the ways to both tools, unless both arms have them locked at one position."""
    first, second = ([joint for joint in own if joint.carries] for own in joints)
    both = [a for a in first if any(a.is_same(b) for b in second)]
    names = f"arms '{arms[0].name}' and '{arms[1].name}'"
    if both:
        said, remedy = _named([joint.name for joint in both]), _locks(arms[0], both)
        one = len(both) == 1
        raise InvalidInputError(
            f"{said} {'moves' if one else 'move'} the tools of {names}: same name, kind and place in the world, so "
            f"{'it is one joint' if one else 'they are joints'} of one robot and would get two commands",
            "RobotCell",
            f"Lock {'it' if one else 'them'} in both arms: {remedy}. Or give both as arms of one robot: coopqp.Robot.",
        )
    for (free, held), own, other in (((0, 1), first, fixed[1]), ((1, 0), second, fixed[0])):
        for joint in own:
            if any(joint.is_locked_as(frame) for frame in other):
                raise InvalidInputError(
                    f"joint '{joint.name}' moves the tool of arm '{arms[free].name}' and is locked in arm "
                    f"'{arms[held].name}', at the same place in the world: it is one joint of one robot",
                    "RobotCell",
                    f"Lock it in both arms at one position: {_locks(arms[free], [joint])}.",
                )
    for a, b in itertools.product(*fixed):
        if a.name == b.name and np.abs(a.before - b.before).max() <= _SAME < np.abs(a.place - b.place).max():
            raise InvalidInputError(
                f"joint '{a.name}' is at the same place in the world in {names}, and is locked at two positions",
                "RobotCell",
                "Lock it in both arms at one position.",
            )


def _named(names: list[str]) -> str:
    """Joints of a message."""
    first = ", ".join(f"'{name}'" for name in names[:_NAMED])
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return f"{'joint' if len(names) == 1 else 'joints'} {first}{more}"


def _locks(arm: Arm, joints: list[_Joint]) -> str:
    """The argument that locks joints, at zero where their limits allow it."""
    return f"locked_joints={ {joint.name: _rest(arm, joint) for joint in joints[:_NAMED]} }"


def _rest(arm: Arm, joint: _Joint) -> float:
    """Zero, or the nearest position inside the limits [rad or m]."""
    v = arm.model.joints[joint.number].idx_v
    return float(np.clip(0.0, arm.limits.lower[v], arm.limits.upper[v]))


def _reduced(arm: Arm, joints: list[_Joint]) -> Arm:
    """The arm with joints locked, without the shapes and the masses that they carry: the other arm has them."""
    model = pin.Model(arm.model)
    ids = {joint.number for joint in joints}
    for i in range(1, model.njoints):
        if ids & set(model.supports[i]):
            model.inertias[i] = pin.Inertia.Zero()
    q = pin.neutral(model)
    for joint in joints:
        at, own = _rest(arm, joint), model.joints[joint.number]
        q[own.idx_q : own.idx_q + own.nq] = [at] if own.nq == 1 else [np.cos(at), np.sin(at)]
    shapes = []
    for kept in (arm.visual, arm.collision):
        geometry = pin.GeometryModel() if kept is None else kept.copy()
        carried = [shape.name for shape in geometry.geometryObjects if ids & set(model.supports[shape.parentJoint])]
        for name in carried:  # each removal moves the others
            geometry.removeGeometryObject(name)
        shapes.append(geometry)
    stay = np.array([v for i in range(1, model.njoints) if i not in ids for v in [model.joints[i].idx_v]], dtype=int)
    limits = JointLimits(*(getattr(arm.limits, field)[stay] for field in LIMIT_FIELDS))
    reduced, (visual, collision) = pin.buildReducedModel(model, shapes, sorted(ids), q)
    return replace(
        arm,
        model=reduced,
        limits=limits,
        visual=None if arm.visual is None else visual,
        collision=None if arm.collision is None else collision,
    )
