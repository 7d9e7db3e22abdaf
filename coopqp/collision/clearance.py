"""The constraint that keeps distances: rows in every step, a stop in the look-ahead, and a certificate for all others.

A pair at distance d with margin m keeps ``ḋ ≥ −ξ (d − m)``. Where the look-ahead brakes in time, ξ = 1/dt: the margin
is reached within one step, at the earliest. Where nothing is known ahead, ξ is small enough for the joints to brake.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, final

import numpy as np
import pinocchio as pin

from coopqp.checks import as_scalar, as_vector, require
from coopqp.collision.distances import KERNEL, Distances, Gradient, LowerBounds
from coopqp.collision.evasion import Evasion
from coopqp.collision.scene import CollisionScene
from coopqp.control.constraints import MOST_ROWS, ConstraintTrouble, Knot, LabelledRows, Quiet, Rank
from coopqp.control.limits import BRAKING_SHARE
from coopqp.errors import InvalidInputError, UnknownNameError
from coopqp.model.limits import BindingLimit, LimitKind
from coopqp.model.shapes import NearPair
from coopqp.model.state import CellState
from coopqp.spatial import Array, Placement, as_placement

#: A start this far inside a margin is outside it but for rounding [m].
_ROUNDING = 1e-6
#: Pairs are watched within this of their margin: in a step at most, and where nothing is known ahead [m].
_WATCH, _BLIND_WATCH = 0.1, 0.3
#: Between knots a pair is asked until its bodies move by less than this from one sample to the next [m].
_SAMPLE = 5e-4
#: Pairs are looked at this far beyond the comfort, so that evasion begins gently [m].
_EVADES_EARLY = 0.05
#: A distance that would fall faster than it should by this, per second of the path's clock, is asked for in full [m/s].
_GENTLE = 0.1
#: Room that the bend between two knots may take, where they are certified together [m].
_BEND = 2e-3
#: The joints' way between knots is no longer than this many times the straight one.
_BENT = 1.02
#: A distance that falls by less stands still [m].
_STANDS = 1e-9
#: Speed at which a body that gives way is asked to retreat, at most [m/s].
_FASTEST_RETREAT = 0.5
#: Rows of one step at most; the nearest pairs.
_MOST_PAIRS = MOST_ROWS // 2


@dataclass(eq=False)
class _Place:
    """Where a moving body is, how it moves, and how long ago that was told [s]."""

    T_world_body: pin.SE3
    twist: Array
    age: float = 0.0


@final
class Clearance:
    """Distances that a controller keeps: ``QPController(..., constraints=[Clearance(scene)])``.

    It ranks below the chain and above the path: the object slows down and stops on its path, as far from the others as
    the margins say. ``step.binding`` names both bodies.

    Args:
        scene: what may touch what.
        approach: ξ where the path is not known ahead [1/s].
        comfort: redundant arms keep this far from their margins where their self-motion can [m]; 0: they do not evade.
        give_way: what stands in the way of a moving body leaves the path for it; else it slows down and stops there.
        stopping: time in which the arms come to rest where a moving body comes closer [s]; braking later where
            acceleration limits say that it suffices.
        patience: a moving body whose place is not told for longer leads to HOLDING [s].
        name: how messages call it.

    Attributes:
        labels: a limit for each pair.
    """

    rank = Rank.CLEARANCE

    def __init__(
        self,
        scene: CollisionScene,
        *,
        approach: float = 5.0,
        comfort: float = 0.03,
        give_way: bool = False,
        stopping: float = 0.4,
        patience: float = 0.1,
        name: str = "clearance",
    ) -> None:
        require(scene, CollisionScene, "Clearance: scene", "Give a CollisionScene.")
        self.scene, self.name = scene, name
        self.approach = as_scalar(approach, "Clearance: approach", high=1e3)
        self.comfort = as_scalar(comfort, "Clearance: comfort", open_low=False, high=1.0)
        self.give_way = bool(give_way)
        self.stopping = as_scalar(stopping, "Clearance: stopping", high=60.0)
        self.patience = as_scalar(patience, "Clearance: patience", high=60.0)
        self.labels = tuple(BindingLimit("", "", LimitKind.COLLISION, between=label) for label in scene.built.labels)
        self._x: Array | None = None  # joint positions at the step before, where bodies move
        self._places = {b.name: _Place(as_placement(b.placement, b.name), np.zeros(6)) for b in scene.moving}
        self._prepare()

    def _prepare(self) -> None:
        built, cell = self.scene.built, self.scene.cell
        self._distances, self._probe = Distances(self.scene), Distances(self.scene)
        self._step, self._ahead = (LowerBounds(self.scene, self._distances) for _ in range(2))
        self._margins, self._inside, self._reach = built.margins, built.inside, built.reach
        self._speed, self._acceleration = cell.limits.velocity, cell.limits.acceleration
        self._v = np.zeros(cell.nv)
        self._evasion = Evasion(cell)
        evades = bool(self._evasion) and self.comfort > 0.0
        self._evading_from = self.comfort + _EVADES_EARLY if evades else 0.0
        self._fastest = built.reach @ np.where(np.isfinite(self._speed), self._speed, 0.0)
        self._fastest[(built.reach[:, ~np.isfinite(self._speed)] > 0.0).any(axis=1)] = np.inf
        self._approach = np.inf
        self._shapes = {b.name: i for b, i in zip(self.scene.moving, built.moving, strict=True)}
        second = np.array([int(pair.second) for pair in built.geometry.collisionPairs], dtype=int)
        self._moves = np.isin(second, list(self._shapes.values()))
        self._runs = np.flatnonzero(self._moves)  # pairs with a body that moves
        self._second = second
        self._most = np.where(np.isfinite(self._speed), self._speed, 1e9)
        self._in_view = np.full(len(second), self._evading_from)
        self._watch_of, self._watch = (0.0, False), self._fastest
        self._endless = np.full(_MOST_PAIRS, np.inf)
        nothing = np.zeros(0)
        self._no_rows = LabelledRows(np.zeros((0, cell.nv)), nothing, nothing, nothing.astype(int))

    # -- state -----------------------------------------------------------------------------------------------------

    def __getstate__(self) -> dict[str, Any]:
        names = ("scene", "name", "approach", "comfort", "give_way", "stopping", "patience", "labels", "_places", "_x")
        return {name: self.__dict__[name] for name in names}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._prepare()
        for name, place in self._places.items():
            self._put(name, place.T_world_body)

    @property
    def quiet(self) -> Quiet:
        """Where no row binds, from the last :meth:`rows_by_label` on."""
        return self._quiet(self._step, 0.0, self._approach)

    @property
    def quiet_ahead(self) -> Quiet:
        """Where no knot is stopped, from the last :meth:`room` on."""
        return self._quiet(self._ahead, max(_BEND, self._evading_from), np.inf)

    def _quiet(self, bounds: LowerBounds, spare: float, approach: float) -> Quiet:
        reach, slack = bounds.certificate(spare)
        return Quiet(bounds.positions, reach, -1.0 if self._shapes else slack, approach)

    def nearest(self, q: Array) -> NearPair | None:
        """The pair that is nearest to its margin at a configuration (nq,)."""
        if not self.labels:
            return None
        d = self._probe.all(q)
        k = int((d - self._margins).argmin())
        return self._pair(k, float(d[k]))

    def _pair(self, k: int, distance: float) -> NearPair:
        first, second = self.scene.built.labels[k]
        return NearPair(first, second, distance)

    def measured(self, limit: BindingLimit, q: Array) -> BindingLimit:
        """One of the labels with the distance of its bodies at a configuration (nq,)."""
        self._probe.place(q)
        pairs = [k for k, label in enumerate(self.labels) if label.between == limit.between]
        return replace(limit, distance=min(self._probe.one(k) for k in pairs))

    # -- starting --------------------------------------------------------------------------------------------------

    def check(self, q: Array) -> None:
        """Refuse a start at which a pair is inside its margin.

        Raises:
            InvalidInputError: one is, and the scene does not say that it may start there.
        """
        d = self._distances.all(q)
        near = np.flatnonzero((d < self._margins - _ROUNDING) & ~self._inside)
        self._step.forget()
        self._ahead.forget()
        self._x = None
        if not near.size:
            return
        k = int(near[(d - self._margins)[near].argmin()])
        pair = self._pair(k, float(d[k]))
        others = len({self.labels[i].between for i in near}) - 1
        more = f", and {others} other pair{'s' * (others > 1)}" if others else ""
        size = f"{1e3 * abs(pair.distance):.1f} mm"
        apart = f"overlap by {size}" if pair.distance < 0.0 else f"are {size} from each other"
        raise InvalidInputError(
            f"{pair.first} and {pair.second} {apart}, inside their margin of {1e3 * self._margins[k]:.4g} mm{more}",
            "reset: q",
            "Start elsewhere, lower the margin (margins), or allow the pair: inside=[…] where it may only part, "
            "ignored=[…] where it may touch.",
        )

    # -- the step --------------------------------------------------------------------------------------------------

    def rows(self, state: CellState, dt: float) -> tuple[Array, Array, Array]:
        """Rows where the look-ahead brakes in time; see :class:`coopqp.VelocityConstraint`."""
        found = self.rows_by_label(state.q, dt, blind=False)
        return found.G, found.lower, found.upper

    def rows_by_label(self, q: Array, dt: float, *, blind: bool) -> LabelledRows:
        """Rows of the pairs that are near, and their labels.

        Raises:
            ConstraintTrouble: nobody has told for too long where a moving body is; with the rows that hold where it was
                told last.
        """
        trouble = self._grow_old(dt)
        rows = self._rows(q, dt, blind=blind)
        if trouble:
            raise ConstraintTrouble(trouble, rows)
        return rows

    def _rows(self, q: Array, dt: float, *, blind: bool) -> LabelledRows:
        bounds = self._step
        xi = min(self.approach, 1.0 / dt) if blind else 1.0 / dt
        self._approach = self.approach if blind else np.inf
        x = self.scene.cell.positions(q)
        bounds.follow(x)
        if self._places:
            self._v, self._x = self._velocity(x, dt), x
            bounds.rooms[self._runs] = -np.inf
        self._distances.place(q)
        near = bounds.near(self._watched(xi, blind=blind))
        bounds.sharpen(near)
        if len(near) > _MOST_PAIRS:
            near = sorted(sorted(near, key=bounds.rooms.item)[:_MOST_PAIRS])
        if not near:
            return self._no_rows
        gradient, lower = self._distances.rows(near, bounds.rooms, xi)
        if self._places:
            which = np.array(near)
            for name, place in self._places.items():
                self._run(which, self._shapes[name], place, gradient, lower, dt)
        binds = KERNEL.binding(gradient.rows, lower, self._most)
        if len(binds) < len(near):
            return LabelledRows(
                gradient.rows[binds], lower[binds], self._endless[: len(binds)], np.array([near[i] for i in binds], int)
            )
        return LabelledRows(gradient.rows, lower, self._endless[: len(near)], np.array(near))

    def _velocity(self, x: Array, dt: float) -> Array:
        """Of the joints since the step before (nv,); 0 at the first one."""
        way = np.zeros(len(x)) if self._x is None else x - self._x
        turns = self.scene.cell.continuous
        way[turns] = np.remainder(way[turns] + np.pi, 2.0 * np.pi) - np.pi
        return way / dt

    def _watched(self, xi: float, *, blind: bool) -> Array:
        """Pairs are asked within this of their margin (P,) [m]: nothing else can reach it at full speed."""
        if self._watch_of != (xi, blind):
            watch = np.minimum(self._fastest / xi, _BLIND_WATCH if blind else _WATCH)
            watch[self._runs] = _BLIND_WATCH
            self._watch_of, self._watch = (xi, blind), watch
        return self._watch

    def tightened(self, rows: LabelledRows, q_next: Array, v: Array, dt: float) -> Array | None:
        """Lower bounds (m,) that make up for what rows are blind to, the bend of distances within a step.

        Args:
            rows: of this step.
            q_next: where its command leads to (nq,).
            v: the command (nv,).
            dt: its length [s].

        Returns:
            None where all pairs keep their margin, or come no closer inside it.
        """
        if not len(rows.which):
            return None
        rooms = self._step.rooms[rows.which]
        least = np.minimum(rooms, 0.0)
        close = np.flatnonzero(rooms + dt * (rows.G @ v) < least + _SAMPLE)
        if not close.size:
            return None
        self._distances.place(q_next)
        room = np.array([self._distances.one(int(rows.which[i])) for i in close]) - self._margins[rows.which[close]]
        missing = least[close] - room
        bent = (missing > 0.1 * _STANDS) & ~self._moves[rows.which[close]]
        if not bent.any():
            return None
        lower: Array = rows.lower.copy()
        lower[close[bent]] = np.maximum(lower[close[bent]], rows.G[close[bent]] @ v) + missing[bent] / dt
        return lower

    # -- the path ahead --------------------------------------------------------------------------------------------

    def room(self, knot: Knot) -> int:
        """Label of a pair that stops the object between the knot before and this one; −1 if none does.

        It stops where the distance is below the margin while it falls.
        """
        bounds, positions = self._ahead, self.scene.cell.positions
        bounds.follow(positions(knot.state.q))
        way = _BENT * (self._reach @ np.abs(self._back(knot, knot.span)))
        bounds.rooms[self._runs] = np.inf  # where they will be nobody knows
        close = np.maximum(way, self._evading_from)
        if not (bounds.rooms < close).any():
            return -1
        self._distances.place(knot.state.q)
        bounds.ask(np.flatnonzero(bounds.rooms < close).tolist())
        bounds.sharpen()
        for k in np.flatnonzero(bounds.rooms < way):
            if self._crosses(int(k), knot, float(way[k])):
                return int(k)
        return -1

    def evaded(self, q: Array, slope: Array) -> Array:
        """Slopes with the self-motion of redundant arms that keeps ``ḋ ≥ −ξ (d − m − comfort)``.

        It begins and ends gently, so that slopes bend and accelerations stay small: bounds are lower where a pair comes
        into view, and the first part of what misses is asked for in its square.
        """
        if not self._evading_from:
            return slope
        bounds = self._ahead
        bounds.follow(self.scene.cell.positions(q))
        bounds.rooms[self._runs] = np.inf
        self._distances.place(q)
        near = bounds.near(self._in_view)
        if not near:
            return slope
        G = self._distances.gradient(near).rows
        spare = bounds.rooms[near] - self.comfort
        lower = -self.approach * spare / np.maximum(1.0 - np.maximum(spare, 0.0) / _EVADES_EARLY, _ROUNDING)
        kept = G @ slope
        missing = lower - kept
        first = np.clip(missing, 0.0, _GENTLE)
        return self._evasion.slope(q, slope, G, lower - first + first**2 / (2.0 * _GENTLE))

    def _crosses(self, k: int, knot: Knot, way: float) -> bool:
        """Whether pair ``k`` comes inside its margin, or closer inside it, between the knot before and this one."""
        after, before = float(self._ahead.rooms[k]), self._room_at(k, knot, knot.span)
        if knot.span == 0.0:  # the first knot
            G = self._distances.gradient([k]).rows[0]
            return after < -_ROUNDING and float(G @ knot.slope) < -_STANDS
        least = min(before, 0.0) - _STANDS
        if after < least:
            return True
        pieces = [(0.0, after, knot.span, before, way)]
        while pieces:
            late, d_late, early, d_early, length = pieces.pop()
            if 0.5 * (d_late + d_early - length) >= least or length < _SAMPLE:
                continue
            middle = 0.5 * (late + early)
            d = self._room_at(k, knot, middle)
            if d < least:
                return True
            pieces += [(late, d_late, middle, d, 0.5 * length), (middle, d, early, d_early, 0.5 * length)]
        return False

    def _room_at(self, k: int, knot: Knot, back: float) -> float:
        """How far pair ``k`` is from its margin at a clock before the knot [m]."""
        self._distances.place(self.scene.cell.moved(knot.state.q, self._back(knot, back)))
        return self._distances.one(k) - float(self._margins[k])

    @staticmethod
    def _back(knot: Knot, back: float) -> Array:
        """The joints' way from the knot back to an earlier clock: q″ is constant between knots (nv,)."""
        way: Array = (0.5 * back * knot.curvature - knot.slope) * back
        return way

    # -- bodies that move --------------------------------------------------------------------------------------------

    def move(self, name: str, T_world_body: Placement, twist: Any = (0.0,) * 6) -> None:
        """Tell where a moving body is now, before the next step.

        Args:
            name: of a body of ``scene.moving``.
            T_world_body: placement of its shape in the world.
            twist: its velocity: that of the placement's origin and of its turning, in world axes (6,) [m/s, rad/s].

        Raises:
            UnknownNameError, InvalidInputError: no such body, or no numbers.
        """
        if name not in self._shapes:
            raise UnknownNameError("moving body", str(name), tuple(self._shapes), "Clearance.move")
        T = as_placement(T_world_body, f"Clearance.move '{name}'")
        self._places[name] = _Place(T, as_vector(twist, 6, f"Clearance.move '{name}': twist"))
        self._put(name, T)

    def _put(self, name: str, T_world_body: pin.SE3) -> None:
        for distances in (self._distances, self._probe):
            distances.put(self._shapes[name], T_world_body)

    def _grow_old(self, dt: float) -> str:
        """Time goes on for moving bodies; what is wrong where nobody has told for too long where one is."""
        late = ""
        for name, place in self._places.items():
            place.age += dt
            if place.age > self.patience + dt and not late:
                late = f"constraint {self.name}: nobody has said for {self.patience:g} s where {name} is (move)"
        return late

    def _run(self, near: Any, shape: int, place: _Place, gradient: Gradient, lower: Array, dt: float) -> None:
        """Lower bounds of pairs with a moving body that comes closer at u = −n · v, the arms coming closer at s = −ḋ.

        While the arms stop, in the time T and half of it at their present speed, the body goes on:
        ``s (h + T/2) + u (h + T) ≤ d − m``. This may ask for more braking than the joints have, (s + u) / (T/2): they
        brake by no more than a, their accelerations', as long as that suffices,
        ``s²/2a + u s/a + (s + u) h ≤ d − m``. Distances of convex bodies that go straight on are convex in time, so
        neither takes them for larger than they will be. Where they give way they keep ``ḋ ≥ −ξ (d − m)``, its motion
        included.
        """
        own = self._second[near] == shape
        if not own.any():
            return
        velocity = place.twist[:3] + np.cross(place.twist[3:], gradient.points[own] - place.T_world_body.translation)
        closing = -np.einsum("ij,ij->i", gradient.normals[own], velocity)
        room, T = self._step.rooms[near[own]], self.stopping
        if self.give_way:
            lower[own] = np.minimum(closing - self.approach * room, _FASTEST_RETREAT)
        else:
            u, (s, a) = np.maximum(closing, 0.0), self._braking(gradient.rows[own])
            in_time, b = (room - u * (dt + T)) / (dt + 0.5 * T), u + a * dt
            in_room = np.sqrt(np.maximum(b**2 + 2.0 * a * (room - u * dt), 0.0)) - b
            lower[own] = -np.maximum(np.maximum(in_time, np.minimum(s - a * dt, in_room)), 0.0)

    def _braking(self, G: Array) -> tuple[Array, Array]:
        """Approaches s = −G v (m,) [m/s], and how hard joints that brake together slow them down [m/s²].

        Both are 0 where accelerations have no limits, or nothing moves.
        """
        slowest = float((np.abs(self._v) / self._acceleration).max())
        s = np.maximum(-(G @ self._v), 0.0) * (slowest > _STANDS)
        return s, s * BRAKING_SHARE / max(slowest, _STANDS)
