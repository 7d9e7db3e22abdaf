"""One Pinocchio model of a cell in which arms share joints.

Joint by joint and frame by frame, in the order of the arms: the joints that arms of a robot share come before the own
joints of its first arm, under the robot's name. The links that these joints move, and the robot's fixed links, are
there once.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from coopqp.model.arm import Arm

_JOINT_LIMITS = ("lowerPositionLimit", "upperPositionLimit")
_SPEED_LIMITS = ("velocityLimit", "effortLimit", "friction", "damping", "rotorInertia", "rotorGearRatio", "armature")


def assemble_shared(arms: Sequence[Arm], kind: str | None = None) -> tuple[pin.Model, pin.GeometryModel]:
    """The model of all arms, and with ``kind`` ("visual" or "collision") their shapes."""
    model, geometry = pin.Model(), pin.GeometryModel()
    begun: set[str] = set()
    for arm in arms:
        first = not arm.shared or arm.robot not in begun
        if arm.shared and first:
            begun.add(arm.robot)
            # Joints that only later arms share among each other come before the own joints, too.
            for other in arms:
                if other.robot == arm.robot and other.shared:
                    _add_joints(model, other, shared=True)
        _add_joints(model, arm, shared=False)
        _add_links(model, geometry, arm, kind, everything=first)
    return model, geometry


def _prefix(arm: Arm, joint: int) -> str:
    """The name before that of a joint, and of what is fixed to it: the robot's for what arms share."""
    own = not arm.shared or (joint != 0 and arm.model.names[joint] not in arm.shared)
    return arm.name if own else arm.robot


def _joint_id(model: pin.Model, arm: Arm, joint: int) -> int:
    return int(model.getJointId(f"{_prefix(arm, joint)}/{arm.model.names[joint]}")) if joint else 0


def _add_joints(model: pin.Model, arm: Arm, *, shared: bool) -> None:
    """The joints of an arm that it shares, or its own; those that are there already are left out."""
    own = arm.model
    for i in range(1, own.njoints):
        name = f"{_prefix(arm, i)}/{own.names[i]}"
        if (own.names[i] in arm.shared) is not shared or model.existJointName(name):
            continue
        parent, placement = int(own.parents[i]), own.jointPlacements[i]
        placed = arm.T_world_base * placement if parent == 0 else placement
        at = model.addJoint(_joint_id(model, arm, parent), _free(own.joints[i]), placed, name)
        model.inertias[at] = own.inertias[i]
        new, old = model.joints[at], own.joints[i]
        for field in _JOINT_LIMITS:
            _copied(model, own, field, slice(new.idx_q, new.idx_q + new.nq), slice(old.idx_q, old.idx_q + old.nq))
        for field in _SPEED_LIMITS:
            _copied(model, own, field, slice(new.idx_v, new.idx_v + new.nv), slice(old.idx_v, old.idx_v + old.nv))
        if hasattr(model, "lowerVelocityLimit"):  # Pinocchio 4
            limits = np.array(model.lowerVelocityLimit)
            limits[new.idx_v] = -float(model.velocityLimit[new.idx_v])
            model.lowerVelocityLimit = limits


def _free(joint: pin.JointModel) -> pin.JointModel:
    """A joint of the same kind that belongs to no model."""
    return pin.JointModel(joint.extract()) if hasattr(joint, "extract") else pin.JointModel(joint)


def _copied(model: pin.Model, own: pin.Model, field: str, to: slice, since: slice) -> None:
    if not hasattr(own, field):
        return
    values = np.array(getattr(model, field))
    values[to] = np.asarray(getattr(own, field))[since]
    setattr(model, field, values)


def _add_links(model: pin.Model, geometry: pin.GeometryModel, arm: Arm, kind: str | None, *, everything: bool) -> None:
    """The frames and shapes of an arm; without those of the base and of what it shares where they are there already."""
    own = arm.model
    frames, added = {0: 0}, []
    for i in range(1, own.nframes):
        frame = own.frames[i]
        joint = int(frame.parentJoint)
        name, at = f"{_prefix(arm, joint)}/{frame.name}", _joint_id(model, arm, joint)
        if not everything and _prefix(arm, joint) != arm.name:
            frames[i] = int(model.getFrameId(name)) if model.existFrame(name) else 0
            continue
        placement = arm.T_world_base * frame.placement if joint == 0 else frame.placement
        frames[i] = int(model.addFrame(pin.Frame(name, at, 0, placement, frame.type, frame.inertia), False))
        added.append(i)
    for i in added:  # the frame of a locked joint may come after those that are fixed to it
        model.frames[frames[i]].parentFrame = frames[int(own.frames[i].parentFrame)]
    shapes = getattr(arm, kind) if kind else None
    for shape in [] if shapes is None else shapes.geometryObjects:
        joint = int(shape.parentJoint)
        if not everything and _prefix(arm, joint) != arm.name:
            continue
        copied = shape.copy()
        copied.name = f"{_prefix(arm, joint)}/{shape.name}"
        if joint == 0:
            copied.placement = arm.T_world_base * shape.placement
        copied.parentJoint = _joint_id(model, arm, joint)
        copied.parentFrame = frames[int(shape.parentFrame)]
        geometry.addGeometryObject(copied)
