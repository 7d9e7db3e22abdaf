"""How wrist sensors read: whose wrenches, in which axes, with which gains, bias and delay."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from coopqp.checks import ArrayLike, as_floats, as_scalar, as_vector, read_only
from coopqp.errors import InvalidInputError, UnknownNameError
from coopqp.model.cell import RobotCell
from coopqp.spatial import Array

#: How far the rows of a rotation may be from orthonormal.
_ORTHONORMAL = 1e-6


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class WristSensor:
    """How one wrist sensor reads a wrench ``[f; τ]`` at its tool: ``[g_f R f; g_t R τ] + b``.

    Attributes:
        reads: name of the arm whose wrenches it reads; None for the arm that it belongs to.
        rotation: R, the proper rotation from the tool's axes to those of the sensor (3, 3).
        force_gain, torque_gain: g of forces and of torques; negative for a wrong sign. 0 is a dead sensor: it can be
            simulated, and not be corrected.
        bias: b (6,) [N, N·m].
        delay: age of a reading when it arrives [s].

    Raises:
        InvalidInputError: numbers that are not finite, or no rotation.
    """

    reads: str | None = None
    rotation: Any = None
    force_gain: float = 1.0
    torque_gain: float = 1.0
    bias: Any = None
    delay: float = 0.0

    def __post_init__(self) -> None:
        R = np.eye(3) if self.rotation is None else as_floats(self.rotation)
        if R.shape != (3, 3) or not np.abs(R @ R.T - np.eye(3)).max() < _ORTHONORMAL or np.linalg.det(R) < 0.0:
            raise InvalidInputError("no proper rotation (3, 3)", "WristSensor: rotation", "Give rows of unit length.")
        object.__setattr__(self, "rotation", read_only(R))
        b = np.zeros(6) if self.bias is None else as_vector(self.bias, 6, "WristSensor: bias")
        object.__setattr__(self, "bias", read_only(b))
        for name in ("force_gain", "torque_gain"):
            object.__setattr__(self, name, as_scalar(getattr(self, name), f"WristSensor: {name}", low=-np.inf))
        object.__setattr__(self, "delay", as_scalar(self.delay, "WristSensor: delay", open_low=False))

    @property
    def map(self) -> Array:
        """The matrix from a wrench to its reading without bias (6, 6)."""
        out = np.zeros((6, 6))
        out[:3, :3], out[3:, 3:] = self.force_gain * self.rotation, self.torque_gain * self.rotation
        return out


@final
class SensorMaps:
    """The sensors of a cell together: wrenches to readings, and back.

    Args:
        cell: the arms.
        sensors: by the arm that each belongs to; the others read as they should.

    Raises:
        UnknownNameError: no such arm.
        InvalidInputError: two sensors read the same arm.
    """

    def __init__(self, cell: RobotCell, sensors: Mapping[str, WristSensor]) -> None:
        n = len(cell)
        for name in sensors:
            if name not in cell.arm_names:
                raise UnknownNameError("arm", name, cell.arm_names, "sensors")
        own = [sensors.get(name, WristSensor()) for name in cell.arm_names]
        self._reads = np.array([k if s.reads is None else cell.index(s.reads) for k, s in enumerate(own)])
        if len(set(self._reads.tolist())) < n:
            raise InvalidInputError("two sensors read the same arm", "sensors", "Give each arm one sensor.")
        self._maps, self._bias = np.array([s.map for s in own]), np.array([s.bias for s in own])
        self._gains = np.array([[s.force_gain, s.torque_gain] for s in own])
        self._names = cell.arm_names

    def readings(self, wrenches: Array) -> Array:
        """What the sensors read of wrenches at the tools (N, 6) [N, N·m]."""
        return (self._maps @ wrenches[self._reads][:, :, None])[:, :, 0] + self._bias

    def check(self) -> None:
        """Refuse dead sensors, whose readings cannot be corrected.

        Raises:
            InvalidInputError: a gain is 0.
        """
        dead = [name for name, gains in zip(self._names, self._gains, strict=True) if not gains.all()]
        if dead:
            raise InvalidInputError(f"the sensor of arm {dead[0]} is dead", "sensors", "Replace it.")

    def wrenches(self, readings: ArrayLike) -> Array:
        """The wrenches at the tools (N, 6) [N, N·m] that readings (N, 6) tell; NaN for lost ones."""
        y = np.asarray(readings, dtype=float)
        out = np.empty_like(self._bias)
        out[self._reads] = np.linalg.solve(self._maps, (y - self._bias)[:, :, None])[:, :, 0]
        return out
