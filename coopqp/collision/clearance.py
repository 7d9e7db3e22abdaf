"""The constraint that keeps distances: rows in every step, a stop in the look-ahead, and a certificate for all others.

A pair at distance d with margin m keeps ``ḋ ≥ −ξ (d − m)``. Where the look-ahead brakes in time, ξ = 1/dt: the margin
is reached within one step, at the earliest. Where nothing is known ahead, ξ is small enough for the joints to brake.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, final

import numpy as np
import pinocchio as pin

from coopqp.checks import as_scalar, require
from coopqp.collision.distances import Distances, LowerBounds
from coopqp.collision.evasion import APPROACH, COMFORT, EvadingSlopes
from coopqp.collision.moving_bodies import MovingBodies
from coopqp.collision.scene import CollisionScene
from coopqp.constraints.cause import Cause
from coopqp.constraints.rate import Knot
from coopqp.constraints.velocity import MOST_ROWS, ConstraintTrouble, LabelledRows, Quiet, Rank, RowsInMemory
from coopqp.core import _core
from coopqp.core._core import BEND_SAMPLE, BENT_WAY, SMALL_CLEARANCE, STANDING, WATCHED, WATCHED_BLIND
from coopqp.errors import TooCloseError
from coopqp.model.limits import BindingLimit, LimitKind
from coopqp.model.shapes import NearPair, by_depth, too_close
from coopqp.model.state import CellState
from coopqp.spatial import Array, Placement, as_placement

#: Clearance that the bend between two grid points may take, where they are certified together [m].
_BEND = 2e-3
#: Rows of one step at most; the nearest pairs.
_MOST_PAIRS = MOST_ROWS // 2


@final
class Clearance:
    """Distances that a controller keeps: ``QPController(..., constraints=[Clearance(scene)])``.

    It ranks below the chain and above the path: the object slows down and stops on its path, as far from the others as
    the margins say. ``step.binding`` names both bodies.

    Args:
        scene: what may touch what.
        approach: ξ where the path is not known ahead [1/s].
        comfort: redundant arms keep this far from their margins where their self-motion can [m]; 0: they do not evade.
        give_way: arms and object leave the path for a moving body; else they slow down and stop on it.
        stopping: time in which the arms come to rest where a moving body comes closer [s]. They brake later where
            acceleration limits show that this suffices. Joints without such limits need this time to full speed while
            they give way.
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
        approach: float = APPROACH,
        comfort: float = COMFORT,
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
        pairs = [BindingLimit("", "", LimitKind.COLLISION, between=label) for label in scene.built.labels]
        self._moving = MovingBodies(scene.built, approach=self.approach, give_way=self.give_way, stopping=self.stopping)
        self.labels = (*pairs, *self._moving.labels)
        self._prepare()

    def _prepare(self) -> None:
        built, cell = self.scene.built, self.scene.cell
        self._distances, self._probe = Distances(built), Distances(built)
        self._step, self._ahead = (LowerBounds(built, self._distances) for _ in range(2))
        self._bounds = [self._step, self._ahead]
        self._in_memory: LowerBounds | None = None
        self._native: list[RowsInMemory] = []
        self._margins, self._inside, self._reach = built.margins, built.inside, built.reach
        speed = cell.limits.velocity
        self._evading = EvadingSlopes(built, self._ahead, approach=self.approach, comfort=self.comfort)
        self._fastest = built.reach @ np.where(np.isfinite(speed), speed, 0.0)
        self._fastest[(built.reach[:, ~np.isfinite(speed)] > 0.0).any(axis=1)] = np.inf
        self._approach = np.inf
        self._most = np.where(np.isfinite(speed), speed, 1e9)
        self._watch_of, self._watch = (0.0, False), self._fastest
        self._counts = np.zeros(2)
        self._most_pairs = min(_MOST_PAIRS, MOST_ROWS - self._moving.most_rows)
        self._endless = np.full(_MOST_PAIRS, np.inf)
        nothing = np.zeros(0)
        self._no_rows = LabelledRows(np.zeros((0, cell.nv)), nothing, nothing, nothing.astype(int))

    # -- state -----------------------------------------------------------------------------------------------------

    def __getstate__(self) -> dict[str, Any]:
        names = ("scene", "name", "approach", "comfort", "give_way", "stopping", "patience", "labels", "_moving")
        return {name: self.__dict__[name] for name in names}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._prepare()
        for shape, T_world_body in self._moving.placements():
            self._put(shape, T_world_body)

    @property
    def passes(self) -> int:
        """Number of steps that asked for rows; in the others all bodies were known to be far apart."""
        return int(self._counts[0])

    @property
    def binding(self) -> int:
        """Rows of the last time."""
        return int(self._counts[1])

    @property
    def quiet(self) -> Quiet:
        """Where no row binds, from the last :meth:`rows_by_label` on."""
        return self._quiet(self._step, 0.0, self._approach)

    @property
    def quiet_ahead(self) -> Quiet:
        """Where no grid point is stopped, from the last :meth:`stopping_pair` on."""
        return self._quiet(self._ahead, max(_BEND, self._evading.begins), np.inf)

    def _quiet(self, bounds: LowerBounds, spare: float, approach: float) -> Quiet:
        reach, slack = bounds.certificate(spare)
        return Quiet(bounds.positions, reach, -1.0 if self._moving else slack, approach)

    def nearest(self, q: Array) -> NearPair | None:
        """The pair that is nearest to its margin at a configuration (nq,)."""
        if not self.scene.built.labels:
            return None
        d = self._probe.all(q)
        k = int((d - self._margins).argmin())
        return self._pair(k, float(d[k]))

    def inside(self, q: Array) -> tuple[BindingLimit, ...]:
        """Pairs inside their margin at a configuration (nq,), with their distances; a pair that may be is no such pair.

        Pairs are asked whose lower bound of the last step does not exclude it.
        """
        clearances = self._step.clearances
        if self._in_memory is not None:
            clearances = np.minimum(clearances, self._in_memory.clearances)
        near = np.flatnonzero((clearances < -SMALL_CLEARANCE) & ~self._inside)
        if not near.size:
            return ()
        self._probe.place(q)
        found = [(self._probe.one(int(k)), int(k)) for k in near]
        least = self._margins - SMALL_CLEARANCE
        return tuple(replace(self.labels[k], distance=d) for d, k in sorted(found) if d < least[k])

    def _overlaps(self) -> tuple[BindingLimit, ...]:
        """Pairs that overlap where rows were asked, the deepest first; those that may start inside left out."""
        distances = self._step.clearances + self._margins
        found = np.flatnonzero((distances < -SMALL_CLEARANCE) & ~self._inside)
        return tuple(replace(self.labels[k], distance=distances[k]) for k in found[distances[found].argsort()])

    def _pair(self, k: int, distance: float) -> NearPair:
        first, second = self.scene.built.labels[k]
        return NearPair(first, second, distance)

    def measured(self, limit: BindingLimit, q: Array) -> BindingLimit:
        """One of the labels with the distance of its bodies at a configuration (nq,)."""
        if not limit.between:
            return limit
        self._probe.place(q)
        pairs = [k for k, label in enumerate(self.labels) if label.between == limit.between]
        return replace(limit, distance=min(self._probe.one(k) for k in pairs))

    # -- starting --------------------------------------------------------------------------------------------------

    def check(self, q: Array) -> None:
        """Refuse a start at which a pair is inside its margin.

        Raises:
            TooCloseError: one is, and the scene does not say that it may start there.
        """
        d = self._distances.all(q)
        near = np.flatnonzero((d < self._margins - SMALL_CLEARANCE) & ~self._inside)
        for bounds in self._bounds:
            bounds.start(d, self.scene.cell.positions(q))
        for native in self._native:
            native.prepare()
        self._moving.forget()
        if not near.size:
            return
        k = int(near[(d - self._margins)[near].argmin()])
        pair = self._pair(k, float(d[k]))
        names = list(dict.fromkeys(self.labels[i].between for i in near))
        others = len(names) - 1
        more = f", and {others} other pair{'s' * (others > 1)}" if others else ""
        away, notes = pair.distance, self.scene.built.notes
        apart = f"overlap{by_depth(away)}" if away < 0.0 else f"are {1e3 * away:.1f} mm from each other"
        hulls = "".join(f"; {notes[name]}" for name in (pair.first, pair.second) if name in notes)
        raise TooCloseError(
            f"{pair.first} and {pair.second} {apart}, inside their margin of {1e3 * self._margins[k]:.4g} mm{more}"
            f"{hulls}",
            "reset: q",
            "Start elsewhere, lower the margin (margins), or allow the pairs: inside=[…] where they may only part, "
            f"where they may touch ignored={json.dumps(names, ensure_ascii=False)}.",
        )

    # -- the step --------------------------------------------------------------------------------------------------

    def rows(self, state: CellState, dt: float) -> tuple[Array, Array, Array]:
        """Rows where the look-ahead brakes in time; see :class:`coopqp.VelocityConstraint`."""
        found = self.rows_by_label(state.q, dt, blind=False)
        return found.G, found.lower, found.upper

    def rows_by_label(self, q: Array, dt: float, *, blind: bool) -> LabelledRows:
        """Rows of the pairs that are near, and their labels.

        Raises:
            ConstraintTrouble: the place of a moving body was not told for too long, or bodies overlap while there is
                one; with the rows for the last place that was told.
        """
        late = self._moving.grow_old(dt, self.patience)
        rows = self._rows(q, dt, blind=blind)
        self._counts[:] = self._counts[0] + 1.0, len(rows.which)
        if late:
            trouble = f"constraint {self.name}: nobody has said for {self.patience:g} s where {late} is (move)"
            raise ConstraintTrouble(trouble, rows)
        if self._moving and (overlaps := self._overlaps()):
            raise ConstraintTrouble(too_close(overlaps), rows, Cause.CLEARANCE)
        return rows

    def _rows(self, q: Array, dt: float, *, blind: bool) -> LabelledRows:
        bounds = self._step
        xi = min(self.approach, 1.0 / dt) if blind else 1.0 / dt
        self._approach = self.approach if blind else np.inf
        x = self.scene.cell.positions(q)
        bounds.follow(x)
        if self._moving:
            self._moving.follow(x, dt)
            bounds.clearances[self._moving.pairs] = -np.inf
        self._distances.place(q)
        near = bounds.near(self._watched(xi, blind=blind))
        bounds.sharpen(near)
        if len(near) > self._most_pairs:
            near = sorted(sorted(near, key=bounds.clearances.item)[: self._most_pairs])
        if not near:
            return self._no_rows
        gradient, lower = self._distances.rows(near, bounds.clearances, xi)
        if self._moving:
            which = np.array(near)
            self._moving.bound(which, bounds.clearances[which], gradient, lower, dt)
        binds = _core.binding(gradient.rows, lower, self._most)
        kept = LabelledRows(gradient.rows, lower, self._endless[: len(near)], np.array(near))
        if len(binds) < len(near):
            which = np.array([near[i] for i in binds], int)
            kept = LabelledRows(gradient.rows[binds], lower[binds], self._endless[: len(binds)], which)
        return self._moving.smooth(kept, dt)

    def _watched(self, xi: float, *, blind: bool) -> Array:
        """Pairs are asked within this of their margin (P,) [m]: nothing else can reach it at full speed."""
        if self._watch_of != (xi, blind):
            watch = np.minimum(self._fastest / xi, WATCHED_BLIND if blind else WATCHED)
            watch[self._moving.pairs] = WATCHED_BLIND
            self._watch_of, self._watch = (xi, blind), watch
        return self._watch

    def tightened(self, rows: LabelledRows, q_next: Array, v: Array, dt: float) -> Array | None:
        """Lower bounds (m,) that make up for what rows are blind to, the bend of distances within a step.

        Args:
            rows: rows of this step.
            q_next: where its command leads to (nq,).
            v: the command (nv,).
            dt: its length [s].

        Returns:
            None where all pairs keep their margin, or come no closer inside it.
        """
        pairs = rows.which < len(self._margins)
        if not pairs.all():
            own = self.tightened(LabelledRows(*(part[pairs] for part in rows)), q_next, v, dt)
            return None if own is None else np.concatenate([own, rows.lower[~pairs]])
        if not len(rows.which):
            return None
        clearances = self._step.clearances[rows.which]
        least = np.minimum(clearances, 0.0)
        close = np.flatnonzero(clearances + dt * (rows.G @ v) < least + BEND_SAMPLE)
        if not close.size:
            return None
        self._distances.place(q_next)
        clearance = (
            np.array([self._distances.one(int(rows.which[i])) for i in close]) - self._margins[rows.which[close]]
        )
        missing = least[close] - clearance
        bent = (missing > 0.1 * STANDING) & ~self._moving.moves[rows.which[close]]
        if not bent.any():
            return None
        lower: Array = rows.lower.copy()
        lower[close[bent]] = np.maximum(lower[close[bent]], rows.G[close[bent]] @ v) + missing[bent] / dt
        return lower

    def in_memory(self, memory: Mapping[str, Array], *, ahead: bool = False) -> RowsInMemory | None:
        """The same for standing bodies, in the core, over the memory of a step; None for bodies that move.

        Each step does a bounded share of what need not be known at once. Pairs that it did not look at keep a lower
        bound of their distance, which the joints' motion takes from.

        Args:
            memory: see :meth:`coopqp.control.core.memory.Memory.of_rows`.
            ahead: for grid points ahead, not for rows.
        """
        if self._moving:
            return None
        names = (
            "positions", "command", "dt", "G", "lower", "upper", "soft", "owner", "node_positions", "node_slope",
            "node_curvature", "evading_positions", "evading_slope",
        )  # fmt: skip
        quiet = "quiet_ahead" if ahead else "quiet"
        arrays = {name: memory[name] for name in names} | {
            "centre": memory[f"{quiet}_centre"], "weights": memory[f"{quiet}_reach"],
            "slack": memory[f"{quiet}_slack"], "approach": memory[f"{quiet}_approach"],
            "counts": np.zeros(2) if ahead else self._counts, "speeds": self._most, "fastest": self._fastest,
        }  # fmt: skip
        spare, evades = (max(_BEND, self._evading.begins), self._evading.begins) if ahead else (0.0, -1.0)
        settings = self.approach, spare, evades, float(self._most_pairs)
        bounds = LowerBounds(self.scene.built, self._distances)
        found: RowsInMemory | None = Distances(self.scene.built).nearby(bounds, arrays, settings)
        if found is not None:
            self._bounds.append(bounds)
            self._native.append(found)
            self._in_memory = self._in_memory if ahead else bounds
        return found

    # -- the path ahead --------------------------------------------------------------------------------------------

    def stopping_pair(self, knot: Knot) -> int:
        """Label of a pair that stops the object from the grid point before to this one, or −1.

        It stops where the distance is below the margin while it falls.
        """
        bounds, positions = self._ahead, self.scene.cell.positions
        bounds.follow(positions(knot.state.q))
        way = BENT_WAY * (self._reach @ np.abs(self._back(knot, knot.span)))
        bounds.clearances[self._moving.pairs] = np.inf  # where they will be nobody knows
        close = np.maximum(way, self._evading.begins)
        if not (bounds.clearances < close).any():
            return -1
        self._distances.place(knot.state.q)
        bounds.ask(np.flatnonzero(bounds.clearances < close).tolist())
        bounds.sharpen()
        for k in np.flatnonzero(bounds.clearances < way):
            if self._crosses(int(k), knot, float(way[k])):
                return int(k)
        return -1

    def evaded(self, q: Array, slope: Array) -> Array:
        """Slopes with the self-motion of redundant arms; see :class:`coopqp.collision.evasion.EvadingSlopes`."""
        return self._evading.at(q, slope)

    def _crosses(self, k: int, knot: Knot, way: float) -> bool:
        """Whether pair ``k`` comes inside its margin, or closer inside it, from the grid point before to this one."""
        after, before = float(self._ahead.clearances[k]), self._clearance_at(k, knot, knot.span)
        if knot.span == 0.0:  # the first knot
            G = self._distances.gradient([k]).rows[0]
            return after < -SMALL_CLEARANCE and float(G @ knot.slope) < -STANDING
        least = min(before, 0.0) - STANDING
        if after < least:
            return True
        pieces = [(0.0, after, knot.span, before, way)]
        while pieces:
            late, d_late, early, d_early, length = pieces.pop()
            if 0.5 * (d_late + d_early - length) >= least or length < BEND_SAMPLE:
                continue
            middle = 0.5 * (late + early)
            d = self._clearance_at(k, knot, middle)
            if d < least:
                return True
            pieces += [(late, d_late, middle, d, 0.5 * length), (middle, d, early, d_early, 0.5 * length)]
        return False

    def _clearance_at(self, k: int, knot: Knot, back: float) -> float:
        """How far pair ``k`` is from its margin at a clock before the grid point [m]."""
        self._distances.place(self.scene.cell.moved(knot.state.q, self._back(knot, back)))
        return self._distances.one(k) - float(self._margins[k])

    @staticmethod
    def _back(knot: Knot, back: float) -> Array:
        """The joints' way from the grid point back to an earlier clock: q″ is constant between grid points (nv,)."""
        return (0.5 * back * knot.curvature - knot.slope) * back

    # -- bodies that move --------------------------------------------------------------------------------------------

    def move(self, name: str, T_world_body: Placement, twist: Any = (0.0,) * 6) -> None:
        """Tell where a moving body is now, before the next step.

        Args:
            name: name of a body of ``scene.moving``.
            T_world_body: placement of its shape in the world.
            twist: velocity of the placement's origin, and angular velocity, in world axes (6,) [m/s, rad/s].

        Raises:
            UnknownNameError, InvalidInputError: no such body, or no numbers.
        """
        T = as_placement(T_world_body, f"Clearance.move '{name}'")
        self._put(self._moving.tell(name, T, twist, "Clearance.move"), T)

    def _put(self, shape: int, T_world_body: pin.SE3) -> None:
        for distances in (self._distances, self._probe):
            distances.put(shape, T_world_body)
