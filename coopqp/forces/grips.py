"""How an arm holds the object: the wrenches that a grip transmits, and their bounds.

A grip bounds the wrench ``[f; m]`` of its arm on the object, at the origin and in the axes of the tool [N, N·m]. All
bounds are norms of linear forms, ``|A c| ≤ b·c + d`` in the components c that the grip transmits.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, final

import numpy as np

from coopqp.checks import NOT_NUMBERS, as_floats, as_scalar, as_vector, read_only
from coopqp.errors import InvalidInputError, UnknownNameError
from coopqp.model.limits import LimitKind
from coopqp.spatial import Array

GripKind = Literal["rigid", "torque-free", "palm"]
_KINDS = ("rigid", "torque-free", "palm")
#: Uniform pressure on a disc of radius r turns against μ f with a lever of ⅔ r.
_TURNING = 2.0 / 3.0


class GripBound(NamedTuple):
    """``|A c| ≤ b·c + d`` in the components c of one grip."""

    kind: LimitKind
    A: Array
    b: Array
    d: float


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Grip:
    """The wrenches that one arm's grip transmits, and its limits.

    A palm presses on the object along ``normal`` and holds it by friction: its pad is a disc with uniform pressure at
    the tool's origin. Friction and turning share one limit surface, the ellipsoid ``|(f_t, m_n / ⅔r)| ≤ μ f_n``
    (Howe and Cutkosky, 1996); the pressure stays on the pad, ``|m_t| ≤ r f_n``.

    Attributes:
        kind: ``"rigid"`` transmits all six components, ``"torque-free"`` a force at the tool's origin, ``"palm"`` a
            force inside the friction cone and the torques that its pad holds.
        force: largest norm of the force [N].
        torque: largest norm of the torque about the tool's origin [N·m].
        wrench: largest components (6,) [N, N·m] in the tool's axes, such as the range of a wrist sensor; inf for none.
        friction: μ of a palm.
        radius: radius r of a palm's pad [m]; 0 for a point, which transmits no torque.
        squeeze: least normal force of a palm [N].
        normal: direction in which a palm presses, in the tool's axes (3,); normalised.

    Raises:
        InvalidInputError, UnknownNameError: bad settings, or settings of another kind.
    """

    kind: GripKind = "rigid"
    force: float = np.inf
    torque: float = np.inf
    wrench: Any = None
    friction: float | None = None
    radius: float = 0.0
    squeeze: float = 0.0
    normal: Any = (0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        if self.kind not in _KINDS:
            raise UnknownNameError("kind of grip", str(self.kind), _KINDS, "Grip")
        for name in ("force", "torque"):
            if getattr(self, name) != np.inf:
                object.__setattr__(self, name, as_scalar(getattr(self, name), f"Grip: {name}"))
        if self.wrench is not None:
            object.__setattr__(self, "wrench", _components(self.wrench))
        for name in ("radius", "squeeze"):
            object.__setattr__(self, name, as_scalar(getattr(self, name), f"Grip: {name}", open_low=False))
        direction = as_vector(self.normal, 3, "Grip: normal")
        if not np.linalg.norm(direction) > 1e-9:
            raise InvalidInputError("normal is zero", "Grip", "Give a direction in the tool's axes.")
        object.__setattr__(self, "normal", read_only(direction / np.linalg.norm(direction)))
        if self.kind == "palm":
            if self.friction is None:
                raise InvalidInputError("a palm without friction", "Grip", "Give friction, the coefficient μ.")
            object.__setattr__(self, "friction", as_scalar(self.friction, "Grip: friction", high=10.0))
        elif self.friction is not None or self.radius or self.squeeze:
            raise InvalidInputError(
                f"friction, radius or squeeze of a {self.kind} grip", "Grip", 'They belong to kind="palm".'
            )

    @property
    def components(self) -> int:
        """Number of components that the grip transmits: the force, and unless it is a point, the torque."""
        return 3 if self.kind == "torque-free" or (self.kind == "palm" and self.radius == 0.0) else 6

    def bounds(self) -> list[GripBound]:
        """The limits, in the components [f] or [f; m] in the tool's axes."""
        n = self.components
        unit, none, found = np.eye(n), np.zeros(n), []
        if np.isfinite(self.force):
            found.append(GripBound(LimitKind.GRIP_FORCE, unit[:3], none, self.force))
        if np.isfinite(self.torque) and n == 6:
            found.append(GripBound(LimitKind.GRIP_TORQUE, unit[3:], none, self.torque))
        if self.wrench is not None:
            found += [
                GripBound(LimitKind.WRIST, unit[i : i + 1], none, float(self.wrench[i]))
                for i in range(n)
                if np.isfinite(self.wrench[i])
            ]
        if self.kind == "palm":
            found += self._palm(n)
        return found

    def _palm(self, n: int) -> list[GripBound]:
        assert self.friction is not None
        along = _tangents(self.normal)  # two tangents, then the normal
        force, torque = np.zeros((3, n)), np.zeros((3, n))
        force[:, :3] = along
        pressing = force[2]
        slip = force[:2]
        found = [GripBound(LimitKind.SQUEEZE, np.zeros((1, n)), pressing, -self.squeeze)]
        if n == 6:
            torque[:, 3:] = along
            slip = np.vstack([slip, torque[2] / (_TURNING * self.radius)])
            found.append(GripBound(LimitKind.TILT, torque[:2] / self.radius, pressing, 0.0))
        return [GripBound(LimitKind.FRICTION, slip, self.friction * pressing, 0.0), *found]


def _components(value: Any) -> Array:
    """Largest components (6,), inf where there is no limit."""
    try:
        given = as_floats(value)
    except NOT_NUMBERS as error:
        raise InvalidInputError("wrench cannot be read as numbers", "Grip", "Give six.") from error
    if given.shape != (6,) or not (given > 0.0).all():
        raise InvalidInputError("wrench has a bad shape or entries ≤ 0", "Grip", "Give six, inf for no limit.")
    return read_only(given)


def _tangents(normal: Array) -> Array:
    """An orthonormal right-handed frame (3, 3) by rows: two tangents, then the normal."""
    least = np.eye(3)[int(np.abs(normal).argmin())]
    first = np.cross(normal, least)
    first /= np.linalg.norm(first)
    return np.array([first, np.cross(normal, first), normal])
