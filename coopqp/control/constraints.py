"""Further constraints on a step and on the path ahead: the user's own, collisions, torques. All are rows or lines.

A row ``lower ≤ G v ≤ upper`` on the joint velocities enters every answer of a step: the nominal test, the fastest rate
on the path, the QP. A line ``a z + b σ̇ ≤ c`` with z = σ² bounds the rate of the object at a knot of the look-ahead.
"""

from __future__ import annotations

import enum
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Any, NamedTuple, Protocol, final, runtime_checkable

import numpy as np

from coopqp.checks import as_floats
from coopqp.errors import InvalidInputError, said, shown
from coopqp.model.cell import RobotCell
from coopqp.model.limits import BindingLimit, LimitKind
from coopqp.model.shapes import NearPair
from coopqp.model.state import CellState
from coopqp.spatial import Array

#: Further rows that a step may have.
MOST_ROWS = 64


class Rank(enum.IntEnum):
    """What gives way to what: a rank gives way only to those before it."""

    LIMITS = 0  #: never exceeded
    CHAIN = 1  #: the arms agree on where the object is
    CLEARANCE = 2  #: distances, and whatever may give way before the arms part
    PATH = 3  #: the object stays on its path
    RATE = 4  #: the object follows its path at full rate
    COMFORT = 5  #: what redundant arms wish for


@runtime_checkable
class VelocityConstraint(Protocol):
    """Rows that joint velocities have to keep.

    Attributes:
        name: how ``ControlStep.binding`` calls it.
        rank: ``Rank.LIMITS``: never exceeded; ``Rank.CLEARANCE``: gives way before the arms part.
    """

    name: str
    rank: Rank

    def rows(self, state: CellState, dt: float) -> tuple[Array, Array, Array]:
        """G (m, nv), lower (m,) and upper (m,) with ``lower ≤ G v ≤ upper`` for joint velocities v [rad/s or m/s].

        Asked at every step, and at every knot of the look-ahead: keep it free of side effects.

        Args:
            state: kinematics at the commanded configuration, or at the knot's.
            dt: length of the step [s].
        """
        ...


@dataclass(frozen=True, eq=False)
class Knot:
    """The chain at one clock of the path ahead: joints move at ``q′ σ`` and accelerate at ``q′ σ̇ + q″ σ²``.

    Attributes:
        clock: the object's clock [s].
        state: kinematics there.
        slope: q′ (nv,) [rad or m per clock second].
        curvature: q″ (nv,), its mean since the knot before.
        span: since the knot before [s]; 0 at the first one.
    """

    clock: float
    state: CellState
    slope: Array
    curvature: Array
    span: float = 0.0


@runtime_checkable
class RateBound(Protocol):
    """Lines that the object's rate σ, and its change σ̇, have to keep at every knot of the look-ahead.

    They hold on paths that are looked ahead on, and while the object follows its path: a hold brakes as hard as the
    joints' own limits allow.

    Attributes:
        name: how ``ControlStep.binding`` calls it.
    """

    name: str

    def lines(self, knot: Knot) -> tuple[Array, Array, Array]:
        """a, b and c (m,) with ``a z + b σ̇ ≤ c``, z = σ². At z = 0 and σ̇ = 0 they have to hold: c ≥ 0."""
        ...


class LabelledRows(NamedTuple):
    """Rows ``lower ≤ G v ≤ upper`` of a :class:`CertifiedConstraint`, and the label of each (m,)."""

    G: Array
    lower: Array
    upper: Array
    which: Any


class Quiet(NamedTuple):
    """Where a constraint is known to be quiet: joint positions x with ``Σ reach |x − centre| ≤ slack``.

    Attributes:
        centre: joint positions (nv,).
        reach: (nv,), 0 or more.
        slack: negative where nothing is known.
        approach: 1/s, at which the slack may be used up in a step; infinite for all of it.
    """

    centre: Array
    reach: Array
    slack: float
    approach: float = np.inf


class RowsInMemory(Protocol):
    """``rows_by_label`` and ``tightened`` of a :class:`CertifiedConstraint` over the memory of a compiled step."""

    def rows(self, blind: bool, /) -> int:
        """Put the rows of this step, and where it is quiet, into the memory; how many."""
        ...

    def tightened(self) -> bool:
        """Raise lower bounds that the command breaks; whether it does."""
        ...


@runtime_checkable
class CertifiedConstraint(VelocityConstraint, Protocol):
    """A velocity constraint with many rows of which few bind: it names each, and says where none does.

    Attributes:
        labels: what binds, one for each row that there may ever be.
        quiet: joint positions at whose neighbours no row binds: with the certificate of the last ``rows_by_label`` a
            step of velocities v and length dt is admissible where ``Σ reach |v| dt`` is at most a share of
            ``slack − Σ reach |x − centre|``: min(approach dt, 1).
        quiet_ahead: the same for knots, and for what is between two of them.
    """

    labels: tuple[BindingLimit, ...]

    @property
    def quiet(self) -> Quiet:
        """See above."""
        ...

    @property
    def quiet_ahead(self) -> Quiet:
        """See above."""
        ...

    def check(self, q: Array) -> None:
        """Raise InvalidInputError if no motion can start at ``q`` (nq,)."""
        ...

    def rows_by_label(self, q: Array, dt: float, *, blind: bool) -> LabelledRows:
        """The rows at ``q`` (nq,); ``blind`` where nothing brakes ahead of them."""
        ...

    def tightened(self, rows: LabelledRows, q_next: Array, v: Array, dt: float) -> Array | None:
        """Other lower bounds (m,) if ``q_next`` (nq,) breaks what rows stand for; else None."""
        ...

    def in_memory(self, memory: Mapping[str, Array]) -> RowsInMemory | None:
        """What says the same over the memory of a compiled step; None where nothing does."""
        ...

    def room(self, knot: Knot) -> int:
        """Number of the label that stops the object before a knot; −1 if none does."""
        ...

    def evaded(self, q: Array, slope: Array) -> Array:
        """Slopes q′ (nv,) at ``q`` (nq,) with the self-motion of redundant arms that keeps off what is ahead."""
        ...

    def measured(self, limit: BindingLimit, q: Array) -> BindingLimit:
        """One of the labels with its distance at ``q`` (nq,)."""
        ...

    def nearest(self, q: Array) -> NearPair | None:
        """What is nearest to binding at ``q`` (nq,)."""
        ...


@final
@dataclass(frozen=True, eq=False)
class Rows:
    """Rows ``lower ≤ G v ≤ upper`` of one step.

    Attributes:
        G: (m, nv).
        lower, upper: (m,).
        soft: which rows may give way before the arms part (m,).
        owner: number of each row's name in :attr:`Constraints.labels` (m,).
    """

    G: Array
    lower: Array
    upper: Array
    soft: Array
    owner: Array

    def __len__(self) -> int:
        return len(self.lower)

    def only(self, chosen: Any) -> Rows:
        """Those of a mask (m,)."""
        return Rows(*(getattr(self, f.name)[chosen] for f in fields(Rows)))


class Bound(NamedTuple):
    """What constraints leave of the rate at a knot.

    Attributes:
        cap: largest z = σ²; negative where not even rest is admissible.
        decrease, rise: largest changes of σ [1/s], downwards and upwards.
        which: number of the name in :attr:`Constraints.labels` that makes the cap; −1 if none does.
    """

    cap: float
    decrease: float
    rise: float
    which: int


def no_rows(nv: int) -> Rows:
    """No rows for so many joints."""
    nothing = np.zeros(0)
    return Rows(np.zeros((0, nv)), nothing, nothing, nothing.astype(bool), nothing.astype(int))


class ConstraintTrouble(Exception):  # noqa: N818
    """A constraint raised, or returned something else than rows; the step holds.

    Attributes:
        rows: what it, or the other constraints, could still say; the step that holds keeps them.
    """

    def __init__(self, message: str, rows: Any = None) -> None:
        super().__init__(message)
        self.rows = rows


def listed(constraints: Any) -> tuple[Any, ...]:
    """The constraints as a tuple.

    Raises:
        InvalidInputError: they are no sequence.
    """
    try:
        return tuple(constraints)
    except TypeError as error:
        raise InvalidInputError(f"a {type(constraints).__name__}", "constraints", "Give a list of them.") from error


@final
class Constraints:
    """The further constraints of one controller, in their order.

    Args:
        cell: whose joints they constrain.
        constraints: objects with ``rows`` or ``lines``.

    Raises:
        InvalidInputError: an object that is neither, or has no name or no rank.
    """

    def __init__(self, cell: RobotCell, constraints: Sequence[Any]) -> None:
        self.cell = cell
        self.velocity: list[tuple[int, VelocityConstraint]] = []
        self.rate: list[tuple[int, RateBound]] = []
        names: list[str] = []
        for i, item in enumerate(listed(constraints)):
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
        #: Names of all that may bind, and where those of each constraint begin.
        self.labels, self._first = _labels(names, dict(self.velocity))
        self._certified = [(i, c) for i, c in self.velocity if isinstance(c, CertifiedConstraint)]
        self._uncertified = [(i, c) for i, c in self.velocity if not isinstance(c, CertifiedConstraint)]
        self._soft = {i: item.rank == Rank.CLEARANCE for i, item in self.velocity}
        self._nothing = no_rows(cell.nv)
        self._all_soft, self._none_soft = np.ones(MOST_ROWS, dtype=bool), np.zeros(MOST_ROWS, dtype=bool)

    def __bool__(self) -> bool:
        return bool(self.names)

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
        """The only constraint, if it says where it is quiet."""
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
        """All rows at a configuration (nq,); ``blind`` where nothing brakes ahead of them.

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
            soft = self._all_soft if self._soft[i] else self._none_soft
            parts.append(Rows(own.G, own.lower, own.upper, soft[: len(own.which)], self._first[i] + own.which))
        if self._uncertified:
            try:
                parts += self._uncertified_rows(CellState(self.cell, q), dt)
            except ConstraintTrouble as raised:
                trouble = trouble or raised
        rows = self._joined(parts)
        if trouble is not None:
            raise ConstraintTrouble(str(trouble), rows)
        return rows

    def _uncertified_rows(self, state: CellState, dt: float) -> list[Rows]:
        nv, parts = self.cell.nv, []
        for i, constraint in self._uncertified:
            name = self.names[i]
            G, lower, upper = _asked(name, partial(constraint.rows, state, dt))
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
            parts.append(Rows(G, lower, upper, np.full(m, self._soft[i]), np.full(m, self._first[i])))
        return parts

    def _joined(self, parts: list[Rows]) -> Rows:
        if len(parts) < 2:
            found = parts[0] if parts else self._nothing
        else:
            found = Rows(*(np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(Rows)))
        if len(found) > MOST_ROWS:
            raise ConstraintTrouble(f"the constraints have {len(found)} rows, at most {MOST_ROWS} are possible")
        return found

    def measured(self, binding: tuple[BindingLimit, ...], q: Array) -> tuple[BindingLimit, ...]:
        """Limits with the distances of their bodies at ``q`` (nq,)."""
        if not self._certified or all(limit.kind is not LimitKind.COLLISION for limit in binding):
            return binding
        found = []
        for limit in binding:
            owner = next((c for _, c in self._certified if limit in c.labels), None)
            found.append(limit if owner is None else owner.measured(limit, q))
        return tuple(dict.fromkeys(found))

    def nearest(self, q: Array) -> NearPair | None:
        """The bodies that are nearest to their margin at ``q`` (nq,); None where nothing says so."""
        if not self._certified:
            return None
        found = [pair for _, c in self._certified if (pair := c.nearest(q)) is not None]
        return min(found, key=lambda pair: pair.distance, default=None)

    def tightened(self, rows: Rows, q_next: Array, v: Array, dt: float) -> Rows | None:
        """Rows that make up for what a step's command breaks although it keeps its rows; None if it breaks nothing."""
        found = None
        for i, constraint in self._certified:
            first, own = self._first[i], _EVERY
            if len(self.velocity) > 1:
                own = (rows.owner >= first) & (rows.owner < first + len(constraint.labels))
            given = LabelledRows(rows.G[own], rows.lower[own], rows.upper[own], rows.owner[own] - first)
            lower = constraint.tightened(given, q_next, v, dt)
            if lower is not None:
                all_lower = rows.lower.copy()
                all_lower[own] = lower
                found = rows = replace(rows, lower=all_lower)
        return found

    def _lines(self, knot: Knot) -> list[tuple[Array, Array, Array, int]]:
        """a, b, c of every rate bound, and its number."""
        found = []
        for i, bound in self.rate:
            a, b, c = (np.atleast_1d(x) for x in _asked(self.names[i], partial(bound.lines, knot)))
            if not (a.shape == b.shape == c.shape == (a.size,) and np.isfinite([a, b, c]).all()):
                raise ConstraintTrouble(f"constraint {self.names[i]}: a, b and c are not finite vectors of one length")
            found.append((a, b, c, i))
        return found

    def bound(self, knot: Knot, dt: float, curvature_share: float) -> Bound:
        """What the constraints leave of the rate at a knot.

        Raises:
            ConstraintTrouble: as of :meth:`rows`.
        """
        cap, decrease, rise, which = np.inf, np.inf, np.inf, -1
        for i, constraint in self._certified:
            label = constraint.room(knot)
            if label >= 0:
                return Bound(-1.0, np.inf, np.inf, self._first[i] + label)
        rows = self._joined(self._uncertified_rows(knot.state, dt))
        if len(rows):
            along = rows.G @ knot.slope
            room = np.where(along > 0.0, rows.upper, -rows.lower)
            with np.errstate(divide="ignore", invalid="ignore"):
                rate = np.where(np.abs(along) > _STILL, room / np.abs(along), np.inf)
            worst = int(rate.argmin())
            if rate[worst] < 1.0:
                cap, which = float(rate[worst] * abs(rate[worst])), int(rows.owner[worst])
        for a, b, c, i in self._lines(knot):
            # A line that bounds σ̇ as well leaves a share of itself for it.
            room = np.where((b == 0.0) | (c < 0.0), c, curvature_share * c)
            with np.errstate(divide="ignore", over="ignore"):
                z = np.where(c < 0.0, -1.0, np.where(a > 0.0, room / np.where(a > 0.0, a, 1.0), np.inf))
                if z.size and z.min() < min(cap, 1.0):
                    cap, which = float(z.min()), self._first[i]
                left = c - np.maximum(a, 0.0) * min(max(cap, 0.0), 1.0)
                decrease = min([decrease, *(left[b < 0.0] / -b[b < 0.0]).tolist()])
                rise = min([rise, *(left[b > 0.0] / b[b > 0.0]).tolist()])
        return Bound(cap, max(decrease, 0.0), max(rise, 0.0), which)


def _labels(
    names: Sequence[str], velocity: dict[int, VelocityConstraint]
) -> tuple[tuple[BindingLimit, ...], list[int]]:
    """The names of all that may bind, and where those of each constraint begin."""
    labels: list[BindingLimit] = []
    first = []
    for i, name in enumerate(names):
        first.append(len(labels))
        item = velocity.get(i)
        own = item.labels if isinstance(item, CertifiedConstraint) else ()
        labels += own or [BindingLimit("", "", LimitKind.CONSTRAINT, name)]
    return tuple(labels), first


def _asked(name: str, call: Callable[[], Any]) -> tuple[Array, Array, Array]:
    """The three arrays that a user's constraint returns.

    Raises:
        ConstraintTrouble: it raised, or returned something else.
    """
    try:
        first, second, third = call()
        return as_floats(first), as_floats(second), as_floats(third)
    except Exception as error:
        raise ConstraintTrouble(f"constraint {name} raised {said(error)}") from error


_EVERY: Any = slice(None)
#: Per unit of rate, a row that changes by less does not bound the rate.
_STILL = 1e-12
#: Entries of rows this large are nonsense.
_LARGEST = 1e9
