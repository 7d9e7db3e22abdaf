"""Limits of joints: of an arm's model, and those given in their place."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from coopqp.checks import NOT_NUMBERS, ArrayLike, as_floats, one_each, read_only
from coopqp.errors import InvalidInputError, UnknownNameError
from coopqp.spatial import Array

#: A position limit beyond this [rad or m] means "no limit" (parsers write the largest double for it).
UNLIMITED = 1e6
#: Smallest accepted velocity or acceleration limit [rad/s or m/s, rad/s² or m/s²]. Below it the joint could not move.
SMALLEST_LIMIT = 1e-6
#: Largest accepted finite limit. The square of a larger one loses its meaning in floating point.
LARGEST_LIMIT = 1e9
#: Names of the fields of :class:`JointLimits`, in order.
LIMIT_FIELDS = ("lower", "upper", "velocity", "acceleration")


@dataclass(frozen=True, eq=False)
class JointLimits:
    """Limits of joints, one entry per velocity coordinate; ±inf means no limit.

    Attributes:
        lower, upper: position limits [rad or m], shape (nv,).
        velocity: largest speeds [rad/s or m/s], shape (nv,), > 0.
        acceleration: largest accelerations [rad/s² or m/s²], shape (nv,), > 0.
    """

    lower: Array
    upper: Array
    velocity: Array
    acceleration: Array

    def __post_init__(self) -> None:
        n = None
        for name in LIMIT_FIELDS:
            try:
                value = as_floats(getattr(self, name))
            except NOT_NUMBERS as error:
                raise InvalidInputError(f"{name} is not a vector of numbers", "JointLimits", "Give floats.") from error
            n = value.size if n is None else n
            if value.shape != (n,) or n == 0 or np.isnan(value).any():
                raise InvalidInputError(
                    f"{name} has shape {value.shape} or NaN, expected ({n},)", "JointLimits", "One number per joint."
                )
            object.__setattr__(self, name, read_only(value))
            if (np.isfinite(value) & (np.abs(value) > LARGEST_LIMIT)).any():
                raise InvalidInputError(
                    f"{name} has entries beyond {LARGEST_LIMIT:g}", "JointLimits", "Give inf where there is no limit."
                )
        _check_room(self.lower, self.upper, self.velocity, self.acceleration, lambda j: f"JointLimits: joint {j}")

    def replace(self, **changes: ArrayLike) -> JointLimits:
        """Return a copy with some limits replaced. A scalar applies to every joint."""
        n = len(self.lower)
        full = {}
        for key, value in changes.items():
            if key not in LIMIT_FIELDS:
                raise UnknownNameError("limit", key, LIMIT_FIELDS, "JointLimits")
            full[key] = one_each(value, n, f"JointLimits: {key}", finite=False)
        return replace(self, **full)


def model_limits(
    where: str, model: pin.Model, velocity: Any, acceleration: Any, lower: Any, upper: Any, *, by_name: bool = False
) -> JointLimits:
    """Limits of the model of an arm or robot, ``where`` in messages, or those given in their place.

    Each is None, or one number or one per joint; ``by_name`` one number or numbers by the joints' names.
    """
    n = model.nv
    joints = list(model.joints)[1:]  # joint 0 is the universe
    continuous = np.array([j.nq != j.nv for j in joints])
    index = np.array([j.idx_q for j in joints])
    joint_names = [x for x in model.names if x != "universe"]

    def override(value: Any, default: Array, what: str) -> Array:
        if value is None:
            return default
        if not by_name:
            remedy = f"Give one number or {n}: {joint_names}."
            return one_each(value, n, f"{where}: {what}", finite=False, remedy=remedy)
        if not isinstance(value, Mapping):
            return np.full(n, one_each(value, 1, f"{where}: {what}", finite=False)[0])
        out = default.copy()
        for joint, own in value.items():
            if joint not in joint_names:
                raise UnknownNameError("joint", str(joint), joint_names, f"{where}, {what}")
            out[joint_names.index(joint)] = one_each(own, 1, f"{where}: {what}['{joint}']", finite=False)[0]
        return out

    low = np.asarray(model.lowerPositionLimit)[index].copy()
    high = np.asarray(model.upperPositionLimit)[index].copy()
    # A continuous joint has the limits ±1.01 on its cosine: it has none. Huge numbers also mean no limit.
    low[continuous | (low <= -UNLIMITED)] = -np.inf
    high[continuous | (high >= UNLIMITED)] = np.inf
    speed = np.array(model.velocityLimit)  # Pinocchio 4 has other names for it, too
    speed[speed >= UNLIMITED] = np.inf
    low, high = override(lower, low, "lower_limits"), override(upper, high, "upper_limits")
    speed = override(velocity, speed, "velocity_limits")
    accel = override(acceleration, np.full(n, np.inf), "acceleration_limits")
    _check_room(low, high, speed, accel, lambda j: f"{where}, joint '{joint_names[j]}'")
    return JointLimits(low, high, speed, accel)


def narrow_to_soft_limits(model: pin.Model, root: ElementTree.Element) -> None:
    """Put the soft position limits of a URDF, which its parser took, into its model where they are narrower.

    Soft limits that leave a joint no room, as some files have them, are none.
    """
    low, high = np.array(model.lowerPositionLimit), np.array(model.upperPositionLimit)
    for joint in root.findall("joint"):
        safety, name = joint.find("safety_controller"), joint.get("name", "")
        if safety is None or not model.existJointName(name):
            continue
        own = model.joints[model.getJointId(name)]
        if own.nq != 1:
            continue
        lower = max(float(safety.get("soft_lower_limit", "-inf")), low[own.idx_q])
        upper = min(float(safety.get("soft_upper_limit", "inf")), high[own.idx_q])
        if lower < upper:
            low[own.idx_q], high[own.idx_q] = lower, upper
    model.lowerPositionLimit, model.upperPositionLimit = low, high


def _check_room(lower: Array, upper: Array, velocity: Array, acceleration: Array, where: Callable[[int], str]) -> None:
    """Every joint can move."""
    for j in range(len(lower)):
        if not lower[j] < upper[j]:
            raise InvalidInputError(
                f"position limits [{lower[j]:g}, {upper[j]:g}] are empty or reversed",
                where(j),
                "Correct the model, or give lower_limits and upper_limits, or lock the joint.",
            )
        if not (velocity[j] >= SMALLEST_LIMIT and acceleration[j] >= SMALLEST_LIMIT):
            raise InvalidInputError(
                f"velocity limit {velocity[j]:g}, acceleration limit {acceleration[j]:g}: both must be > 0 "
                f"(at least {SMALLEST_LIMIT:g})",
                where(j),
                "Give velocity_limits [rad/s or m/s] and acceleration_limits, inf for none.",
            )
