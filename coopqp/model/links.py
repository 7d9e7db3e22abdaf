"""The axes of joints, and the joints of one arm as a product of frames whose z axes are their axes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
import pinocchio as pin

from coopqp.checks import read_only
from coopqp.core._core import MOST_JOINTS
from coopqp.errors import ModelError
from coopqp.spatial import Array, skew


def joint_axes(model: pin.Model) -> Array:
    """Unit twist of each joint in its own frame (nv, 6), for joints of one degree of freedom.

    It is [axis; 0] of a joint that slides, [0; axis] of one that turns, and NaN where the model has no valid origin.
    """
    data, axes = model.createData(), np.empty((model.nv, 6))
    pin.computeJointJacobians(model, data, pin.neutral(model))
    for i, joint in enumerate(list(model.joints)[1:], start=1):
        # Pinocchio drops the second axis of a model with one joint.
        columns = np.asarray(pin.getJointJacobian(model, data, i, pin.LOCAL)).reshape(6, -1)
        axes[joint.idx_v] = columns[:, joint.idx_v]
    return axes


def joint_links(model: pin.Model, joints: Sequence[int]) -> tuple[Array, Array, Array, Array]:
    """Links of joints (indices in ``model``) that follow each other, the first one on the base.

    Returns:
        (R, p, pitch, aligned): rotation (n, 3, 3) and origin (n, 3) [m] of each joint in the one before, both with the
        z axis along the joint's axis; how far it goes along that axis as it turns (n,) [m/rad]: 0 for a joint that only
        turns, inf for one that only slides; rotation (3, 3) from the last joint's own frame.

    Raises:
        ModelError: a joint does not follow the one before, or neither turns about an axis nor slides along one.
    """
    R, p, pitch = np.empty((len(joints), 3, 3)), np.empty((len(joints), 3)), np.zeros(len(joints))
    parent, aligned = 0, np.eye(3)
    data, neutral = model.createData(), pin.neutral(model)
    for i, j in enumerate(joints):
        if model.joints[j].nv != 1 or model.parents[j] != parent:
            raise ModelError(f"joint {model.names[j]} does not follow the one before")
        axis, pitch[i] = _axis(model, j, pin.computeJointJacobian(model, data, neutral, j).reshape(6, -1))
        placement, turned = data.liMi[j], _z_to(*axis.tolist())
        R[i], p[i] = aligned.T @ placement.rotation @ turned, aligned.T @ placement.translation
        parent, aligned = j, turned
    return R, p, pitch, aligned


def check_count(arm: str, joints: int) -> None:
    """Raise where more joints move the tool of an arm than the compiled functions take.

    Raises:
        ModelError: there are more.
    """
    if joints > MOST_JOINTS:
        raise ModelError(
            f"arm '{arm}': {joints} joints move its tool; coopqp takes up to {MOST_JOINTS}. Lock some: locked_joints."
        )


def _axis(model: pin.Model, joint: int, jacobian: Array) -> tuple[Array, float]:
    """The joint's axis in its own frame, and its pitch, from the joint's Jacobian in its frame."""
    own = jacobian[:, int(model.joints[joint].idx_v)]
    linear, angular = own[:3], own[3:]
    along = float(angular @ linear)
    if abs(np.linalg.norm(angular) - 1.0) < 1e-9 and np.abs(linear - along * angular).max() < 1e-9:
        return angular, along if abs(along) > 1e-9 else 0.0
    if abs(np.linalg.norm(linear) - 1.0) < 1e-9 and np.abs(angular).max() < 1e-9:
        return linear, math.inf
    raise ModelError(f"joint {model.names[joint]} neither turns about an axis nor slides along one")


@lru_cache(maxsize=256)
def _z_to(*axis: float) -> Array:
    """A rotation that takes z to an axis; most axes are axes of a frame."""
    z = np.array(axis) / np.linalg.norm(axis)
    x = skew(np.eye(3)[int(np.abs(z).argmin())]) @ z
    x /= np.linalg.norm(x)
    return read_only(np.column_stack([x, skew(z) @ x, z]))
