"""Bodies that move: their places, the rows that keep arms clear of them, and rows of joints that give way."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, final

import numpy as np
import pinocchio as pin

from coopqp.checks import as_vector
from coopqp.collision.built_scene import BuiltScene
from coopqp.collision.distances import Gradient
from coopqp.constraints.velocity import MOST_ROWS, LabelledRows
from coopqp.core._core import BRAKING_SHARE
from coopqp.errors import UnknownNameError
from coopqp.model.limits import BindingLimit, LimitKind
from coopqp.spatial import Array, as_placement

#: Speed at which a body that gives way is asked to retreat, at most [m/s].
_FASTEST_RETREAT = 0.5
#: Joints that come to rest in less time stand still [s].
_STANDS = 1e-9
#: Least number of rows for pairs, beside the rows of joints.
_LEAST_PAIRS = 8


@dataclass(eq=False)
class _Place:
    """Where a moving body is, how it moves, and how long ago that was told [s]."""

    T_world_body: pin.SE3
    twist: Array
    age: float = 0.0


@final
class MovingBodies:
    """The moving bodies of a scene; false without any.

    Args:
        built: what may touch what.
        approach, give_way, stopping: as in :class:`coopqp.Clearance`.

    Attributes:
        pairs: numbers of the pairs with a moving body (m,).
        moves: True for these pairs (P,).
        labels: labels of the rows of :meth:`smooth`, which follow the rows of the pairs.
        most_rows: largest number of these rows.
    """

    def __init__(self, built: BuiltScene, *, approach: float, give_way: bool, stopping: float) -> None:
        cell = built.cell
        self._cell, self._approach, self._give_way, self._stopping = cell, approach, give_way, stopping
        self._places = {b.name: _Place(as_placement(b.placement, b.name), np.zeros(6)) for b in built.moving_bodies}
        self._shapes = {b.name: i for b, i in zip(built.moving_bodies, built.moving, strict=True)}
        self._second, self.moves = built.second, built.moves
        self.pairs = np.flatnonzero(self.moves)
        speed, self._acceleration = cell.limits.velocity, cell.limits.acceleration
        joints = np.flatnonzero(np.isfinite(speed) & ~np.isfinite(self._acceleration))
        if not (give_way and self._places) or len(joints) > MOST_ROWS - _LEAST_PAIRS:
            joints = joints[:0]
        names = [cell.joint_names[j].partition("/") for j in joints]
        self.labels = tuple(BindingLimit(arm, joint, LimitKind.ACCELERATION) for arm, _, joint in names)
        self.most_rows = len(joints)
        self._joints, self._hardest, self._joint_rows = joints, speed[joints] / stopping, np.eye(cell.nv)[joints]
        self._x: Array | None = None  # joint positions at the step before
        self._v = np.zeros(cell.nv)

    def __bool__(self) -> bool:
        return bool(self._places)

    def tell(self, name: str, T_world_body: pin.SE3, twist: Any, where: str) -> int:
        """Take the present place and motion of a body. Returns the number of its shape.

        Raises:
            UnknownNameError, InvalidInputError: no such body, or a twist that is not six numbers.
        """
        if name not in self._shapes:
            raise UnknownNameError("moving body", str(name), tuple(self._shapes), where)
        self._places[name] = _Place(T_world_body, as_vector(twist, 6, f"{where} '{name}': twist"))
        return self._shapes[name]

    def placements(self) -> Iterator[tuple[int, pin.SE3]]:
        """Shapes, and where they are."""
        for name, place in self._places.items():
            yield self._shapes[name], place.T_world_body

    def grow_old(self, dt: float, patience: float) -> str:
        """Let time pass. Returns the body whose last reported place is too old."""
        late = ""
        for name, place in self._places.items():
            place.age += dt
            if place.age > patience + dt and not late:
                late = name
        return late

    def forget(self) -> None:
        """The arms are elsewhere."""
        self._x = None

    def follow(self, x: Array, dt: float) -> None:
        """The joints are at positions x (nv,) now; they stood still before the first time."""
        way = np.zeros(len(x)) if self._x is None else x - self._x
        turns = self._cell.continuous
        way[turns] = np.remainder(way[turns] + np.pi, 2.0 * np.pi) - np.pi
        self._v, self._x = way / dt, x

    def bound(self, near: Any, clearances: Array, gradient: Gradient, lower: Array, dt: float) -> None:
        """Put lower bounds of near pairs with their clearances (m,)."""
        for name, place in self._places.items():
            own = self._second[near] == self._shapes[name]
            if own.any():
                some = Gradient(*(part[own] for part in gradient))
                lower[own] = self._lower(place, clearances[own], some, dt)

    def _lower(self, place: _Place, clearance: Array, gradient: Gradient, dt: float) -> Array:
        """Bounds (m,) where a body comes closer at u = −n · v, the arms coming closer at s = −ḋ.

        While the arms stop, in the time T and half of it at their present speed, the body goes on:
        ``s (h + T/2) + u (h + T) ≤ d − m``. This may ask for more braking than the joints have, (s + u) / (T/2): they
        brake by no more than a, their accelerations', as long as that suffices,
        ``s²/2a + u s/a + (s + u) h ≤ d − m``. Distances of convex bodies that go straight on are convex in time, so
        neither bound overestimates them. Where the arms give way they keep ``ḋ ≥ −ξ (d − m)``, the body's motion
        included.
        """
        velocity = place.twist[:3] + np.cross(place.twist[3:], gradient.points - place.T_world_body.translation)
        closing, T = -np.einsum("ij,ij->i", gradient.normals, velocity), self._stopping
        if self._give_way:
            return np.minimum(closing - self._approach * clearance, _FASTEST_RETREAT)
        u, (s, a) = np.maximum(closing, 0.0), self._braking(gradient.rows)
        in_time, b = (clearance - u * (dt + T)) / (dt + 0.5 * T), u + a * dt
        in_reach = np.sqrt(np.maximum(b**2 + 2.0 * a * (clearance - u * dt), 0.0)) - b
        return -np.maximum(np.maximum(in_time, np.minimum(s - a * dt, in_reach)), 0.0)

    def _braking(self, G: Array) -> tuple[Array, Array]:
        """Approaches s = −G v (m,) [m/s], and how hard joints that brake together slow them down [m/s²].

        Both are 0 where accelerations have no limits, or nothing moves.
        """
        slowest = float((np.abs(self._v) / self._acceleration).max())
        s = np.maximum(-(G @ self._v), 0.0) * (slowest > _STANDS)
        return s, s * BRAKING_SHARE / max(slowest, _STANDS)

    def smooth(self, rows: LabelledRows, dt: float) -> LabelledRows:
        """Add rows of joints without acceleration limits where arms give way, so that their velocities do not jump.

        Where an arm is stretched they would turn round at full speed from step to step, and no linearisation of a step
        sees that ahead: the arms would part. They take the time ``stopping`` to full speed.
        """
        if not len(self._joints):
            return rows
        v, jump = self._v[self._joints], self._hardest * dt
        slowest = rows.G @ self._v - np.abs(rows.G[:, self._joints]) @ jump
        if not (self.moves[rows.which] & (slowest < rows.lower)).any():
            return rows
        return LabelledRows(
            np.concatenate([rows.G, self._joint_rows]),
            np.concatenate([rows.lower, v - jump]),
            np.concatenate([rows.upper, v + jump]),
            np.concatenate([rows.which, len(self._second) + np.arange(len(self._joints))]),
        )
