"""The further constraints of one controller: all rows of a step, and the rate that they allow at a grid point."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from functools import partial
from typing import Any, final

import numpy as np

from coopqp.checks import as_floats, as_tuple
from coopqp.constraints.rate import BoundTrouble, Knot, RateBound, lines_of
from coopqp.constraints.velocity import (
    MOST_ROWS,
    Bound,
    CertifiedConstraint,
    ConstraintTrouble,
    LabelledRows,
    Rank,
    Rows,
    VelocityConstraint,
    no_rows,
)
from coopqp.core._core import STILL_SLOPE
from coopqp.errors import InvalidInputError, said, shown
from coopqp.model.cell import RobotCell
from coopqp.model.limits import BindingLimit, LimitKind
from coopqp.model.shapes import NearPair
from coopqp.model.state import CellState
from coopqp.spatial import Array

#: Entries of rows this large are nonsense.
_LARGEST = 1e9
#: Rows whose largest entry is smaller are scaled to 1, for steps keep all rows with the same absolute tolerance; where
#: it is smaller than the least, their numbers have lost digits.
_SMALL, _LEAST = 1e-3, 1e-290


@final
class Constraints:
    """The further constraints of one controller, in their order.

    Args:
        cell: the arms.
        constraints: objects with ``rows`` or ``lines``.

    Attributes:
        given: the constraints.

    Raises:
        InvalidInputError: no list, or an object that is neither, or has no name or no rank.
    """

    def __init__(self, cell: RobotCell, constraints: Sequence[Any]) -> None:
        self.cell = cell
        self.velocity: list[tuple[int, VelocityConstraint]] = []
        self.rate: list[tuple[int, RateBound]] = []
        names: list[str] = []
        self.given = as_tuple(constraints, "constraints", "Give a list of them.")
        for i, item in enumerate(self.given):
            where = f"constraints[{i}]"
            name = getattr(item, "name", None)
            if not isinstance(name, str) or not name or name in names:
                raise InvalidInputError(
                    f"its name is {shown(name)}", where, "Give it an attribute name: a string of its own, not empty."
                )
            if callable(getattr(item, "rows", None)):
                rank = getattr(item, "rank", None)
                if rank not in (Rank.LIMITS, Rank.CLEARANCE):
                    raise InvalidInputError(f"its rank is {shown(rank)}", where, "Give Rank.LIMITS or Rank.CLEARANCE.")
                self.velocity.append((i, item))
            elif callable(getattr(item, "lines", None)):
                self.rate.append((i, item))
            else:
                raise InvalidInputError(
                    f"a {type(item).__name__} has neither rows(state, dt) nor lines(knot)",
                    where,
                    "See the how-to on constraints.",
                )
            names.append(name)
        self.names = tuple(names)
        #: Names of all limits that may bind, and the index of each constraint's first name.
        self.labels, self._first = _labels(names, dict(self.velocity))
        self._certified = [(i, c) for i, c in self.velocity if isinstance(c, CertifiedConstraint)]
        self._uncertified = [(i, c) for i, c in self.velocity if not isinstance(c, CertifiedConstraint)]
        self._soft = {i: item.rank == Rank.CLEARANCE for i, item in self.velocity}

    def __bool__(self) -> bool:
        return bool(self.names)

    @property
    def gives_way(self) -> bool:
        """Whether one of them may lead the object off its path."""
        return any(getattr(c, "give_way", False) for _, c in self.velocity)

    @property
    def evades(self) -> bool:
        """Whether redundant arms may be asked to evade."""
        return bool(self._certified)

    def evaded(self, q: Array, slope: Array) -> Array:
        """Slopes (nv,) at ``q`` (nq,) with the self-motion that certified constraints ask for.

        Raises:
            ConstraintTrouble: it is not finite.
        """
        for i, constraint in self._certified:
            slope = constraint.evaded(q, slope)
            if not np.isfinite(slope).all():
                raise ConstraintTrouble(f"constraint {self.names[i]}: its self-motion is not finite")
        return slope

    @property
    def certified(self) -> CertifiedConstraint | None:
        """The only constraint, if it is certified: it says in which region none of its rows binds."""
        only = len(self.names) == len(self._certified) == 1
        return self._certified[0][1] if only else None

    def check(self, q: Array, dt: float) -> None:
        """Ask every constraint at a configuration (nq,), before anything moves.

        Raises:
            InvalidInputError: one raises, or returns something else than rows or lines.
        """
        state, still = CellState(self.cell, q), np.zeros(self.cell.nv)
        for _, constraint in self._certified:
            constraint.check(q)
        try:
            self.rows(q, dt)
            self._lines(Knot(0.0, state, still, still))
        except ConstraintTrouble as trouble:
            raise InvalidInputError(str(trouble), "reset", "See the how-to on constraints.") from trouble

    def rows(self, q: Array, dt: float, *, blind: bool = False) -> Rows:
        """All rows at a configuration (nq,); ``blind`` where no look-ahead brakes for them.

        Raises:
            ConstraintTrouble: a constraint raised, or its rows are not finite or have other shapes; with the rows of
                the others.
        """
        parts: list[Rows] = []
        trouble: ConstraintTrouble | None = None
        for i, constraint in self._certified:
            try:
                own = constraint.rows_by_label(q, dt, blind=blind)
            except ConstraintTrouble as raised:
                trouble = trouble or raised
                if raised.rows is None:
                    continue
                own = raised.rows
            soft = np.full(len(own.which), float(self._soft[i]))
            parts.append(Rows(own.G, own.lower, own.upper, soft, self._first[i] + own.which))
        try:
            parts += self._uncertified_rows(CellState(self.cell, q), dt)
        except ConstraintTrouble as raised:
            trouble = trouble or raised
        rows = self._joined(parts)
        if trouble is not None:
            raise ConstraintTrouble(str(trouble), rows, trouble.cause)
        return rows

    def _uncertified_rows(self, state: CellState, dt: float) -> list[Rows]:
        nv, parts = self.cell.nv, []
        for i, constraint in self._uncertified:
            name = self.names[i]
            G, lower, upper = _three_arrays(name, partial(constraint.rows, state, dt))
            G, lower, upper = np.atleast_2d(G), np.atleast_1d(lower), np.atleast_1d(upper)
            if not G.size and not lower.size:
                G = G.reshape(0, nv)
            m = len(G)
            fits = G.shape == (m, nv) and lower.shape == upper.shape == (m,)
            if not fits or not (np.abs(G) < _LARGEST).all() or not (lower <= upper).all():
                raise ConstraintTrouble(
                    f"constraint {name}: G {G.shape}, lower {lower.shape} and upper {upper.shape} are no rows "
                    f"for {nv} joints (finite G, lower ≤ upper)"
                )
            G, lower, upper = _scaled(name, G, lower, upper)
            parts.append(Rows(G, lower, upper, np.full(m, float(self._soft[i])), np.full(m, self._first[i])))
        return parts

    def _joined(self, parts: list[Rows]) -> Rows:
        parts = [no_rows(self.cell.nv), *parts]
        rows = Rows(*(np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(Rows)))
        if len(rows) > MOST_ROWS:
            raise ConstraintTrouble(f"the constraints have {len(rows)} rows, at most {MOST_ROWS} are possible")
        return rows

    def measured(self, binding: tuple[BindingLimit, ...], q: Array) -> tuple[BindingLimit, ...]:
        """Limits with the distances of their bodies at ``q`` (nq,)."""
        if not self._certified:
            return binding
        owners = [next((c for _, c in self._certified if limit in c.labels), None) for limit in binding]
        measured = [x if owner is None else owner.measured(x, q) for x, owner in zip(binding, owners, strict=True)]
        return tuple(dict.fromkeys(measured))

    def nearest(self, q: Array) -> NearPair | None:
        """The bodies that are nearest to their margin at ``q`` (nq,); None without certified constraints."""
        pairs = [pair for _, c in self._certified if (pair := c.nearest(q)) is not None]
        return min(pairs, key=lambda pair: pair.distance, default=None)

    def inside(self, q: Array) -> tuple[BindingLimit, ...]:
        """Pairs of bodies that are inside their margin at ``q`` (nq,), each with its distance, the worst first."""
        limits = [limit for _, c in self._certified for limit in c.inside(q)]
        return tuple(sorted(dict.fromkeys(limits), key=lambda limit: limit.distance or 0.0))

    def tightened(self, rows: Rows, q_next: Array, v: Array, dt: float) -> Rows | None:
        """Tighter rows if a command keeps the rows but breaks their constraint; None if it breaks none."""
        tightened = None
        for i, constraint in self._certified:
            first = self._first[i]
            own = (rows.owner >= first) & (rows.owner < first + len(constraint.labels))
            given = LabelledRows(rows.G[own], rows.lower[own], rows.upper[own], rows.owner[own] - first)
            lower = constraint.tightened(given, q_next, v, dt)
            if lower is not None:
                all_lower = rows.lower.copy()
                all_lower[own] = lower
                tightened = rows = replace(rows, lower=all_lower)
        return tightened

    def _lines(self, knot: Knot) -> list[tuple[Array, Array, Array, int]]:
        """a, b, c of every rate bound, and its number."""
        lines = []
        for i, bound in self.rate:
            try:
                lines.append((*lines_of(bound, knot), i))
            except BoundTrouble as trouble:
                raise ConstraintTrouble(f"constraint {self.names[i]}{trouble}") from trouble
        return lines

    def bound(self, knot: Knot, dt: float, curvature_share: float) -> Bound:
        """The rate that the constraints allow at a knot.

        Args:
            knot: the knot.
            dt: nominal length of a step [s].
            curvature_share: share of a bound that curvature may take.

        Raises:
            ConstraintTrouble: as for :meth:`rows`.
        """
        cap, decrease, rise, which = np.inf, np.inf, np.inf, -1
        for i, constraint in self._certified:
            label = constraint.stopping_pair(knot)
            if label >= 0:
                return Bound(-1.0, np.inf, np.inf, self._first[i] + label)
        rows = self._joined(self._uncertified_rows(knot.state, dt))
        if len(rows):
            along = rows.G @ knot.slope
            most = np.where(along > 0.0, rows.upper, -rows.lower)
            with np.errstate(divide="ignore", invalid="ignore"):
                rate = np.where(np.abs(along) > STILL_SLOPE, most / np.abs(along), np.inf)
            worst = int(rate.argmin())
            if rate[worst] < 1.0:
                cap, which = float(rate[worst] * abs(rate[worst])), int(rows.owner[worst])
        for a, b, c, i in self._lines(knot):
            # A line that bounds σ̇ as well leaves a share of itself for it.
            share = np.where((b == 0.0) | (c < 0.0), c, curvature_share * c)
            with np.errstate(divide="ignore", over="ignore"):
                z = np.where(c < 0.0, -1.0, np.where(a > 0.0, share / np.where(a > 0.0, a, 1.0), np.inf))
                if z.size and z.min() < min(cap, 1.0):
                    cap, which = float(z.min()), self._first[i]
                left = c - np.maximum(a, 0.0) * min(max(cap, 0.0), 1.0)
                decrease = min([decrease, *(left[b < 0.0] / -b[b < 0.0]).tolist()])
                rise = min([rise, *(left[b > 0.0] / b[b > 0.0]).tolist()])
        return Bound(cap, max(decrease, 0.0), max(rise, 0.0), which)


def _labels(
    names: Sequence[str], velocity: dict[int, VelocityConstraint]
) -> tuple[tuple[BindingLimit, ...], list[int]]:
    """Names of all limits that may bind, and the index of each constraint's first name."""
    labels: list[BindingLimit] = []
    first = []
    for i, name in enumerate(names):
        first.append(len(labels))
        item = velocity.get(i)
        own = item.labels if isinstance(item, CertifiedConstraint) else ()
        labels += own or [BindingLimit("", "", LimitKind.CONSTRAINT, name)]
    return tuple(labels), first


def _scaled(name: str, G: Array, lower: Array, upper: Array) -> tuple[Array, Array, Array]:
    """The same rows, G (m, nv) with lower and upper (m,), those with small entries in units in which the largest is 1.

    Raises:
        ConstraintTrouble: entries of a row are too small to be told from rounding.
    """
    size = np.abs(G).max(axis=1, initial=0.0)
    small = (size < _SMALL) & (size > 0.0)
    if not small.any():
        return G, lower, upper
    if size[small].min() < _LEAST:
        raise ConstraintTrouble(
            f"constraint {name}: the largest entry of row {int(np.argmax(small & (size < _LEAST)))} of G is "
            f"{size[small].min():.3g}: scale the row, and its bounds with it"
        )
    units = np.where(small, size, 1.0)
    with np.errstate(over="ignore"):  # a bound that becomes infinite cannot be reached
        return G / units[:, None], lower / units, upper / units


def _three_arrays(name: str, call: Callable[[], Any]) -> tuple[Array, Array, Array]:
    """The three arrays that a user's constraint returns.

    Raises:
        ConstraintTrouble: it raised, or returned something else.
    """
    try:
        first, second, third = call()
        return as_floats(first), as_floats(second), as_floats(third)
    except Exception as error:
        raise ConstraintTrouble(f"constraint {name} raised {said(error)}") from error
