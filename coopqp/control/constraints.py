"""Further constraints on a step and on the path ahead: the user's own, collisions, torques. All are rows or lines.

A row ``lower ≤ G v ≤ upper`` on the joint velocities enters every answer of a step: the nominal test, the fastest rate
on the path, the QP. A line ``a z + b σ̇ ≤ c`` with z = σ² bounds the rate of the object at a knot of the look-ahead.
"""

from __future__ import annotations

import enum
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol, final, runtime_checkable

import numpy as np

from coopqp.checks import NOT_NUMBERS, as_floats
from coopqp.errors import InvalidInputError
from coopqp.model.cell import RobotCell
from coopqp.model.state import CellState
from coopqp.spatial import Array


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
        curvature: q″ (nv,).
    """

    clock: float
    state: CellState
    slope: Array
    curvature: Array


@runtime_checkable
class RateBound(Protocol):
    """Lines that the object's rate has to keep at every knot of the look-ahead.

    Attributes:
        name: how ``ControlStep.binding`` calls it.
    """

    name: str

    def lines(self, knot: Knot) -> tuple[Array, Array, Array]:
        """a, b and c (m,) with ``a z + b σ̇ ≤ c``, z = σ². At z = 0 and σ̇ = 0 they have to hold: c ≥ 0."""
        ...


Constraint = VelocityConstraint | RateBound


@final
@dataclass(frozen=True, eq=False)
class Rows:
    """Rows ``lower ≤ G v ≤ upper`` of one step.

    Attributes:
        G: (m, nv).
        lower, upper: (m,).
        soft: which rows may give way before the arms part (m,).
        owner: index of the constraint that each row belongs to (m,).
    """

    G: Array
    lower: Array
    upper: Array
    soft: Array
    owner: Array

    def __len__(self) -> int:
        return len(self.lower)


def no_rows(nv: int) -> Rows:
    """No rows for so many joints."""
    nothing = np.zeros(0)
    return Rows(np.zeros((0, nv)), nothing, nothing, nothing.astype(bool), nothing.astype(int))


class ConstraintTrouble(Exception):  # noqa: N818
    """A constraint raised, or returned something else than rows; the step holds."""


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
        names = []
        for i, item in enumerate(listed(constraints)):
            where = f"constraints[{i}]"
            if not isinstance(getattr(item, "name", None), str):
                raise InvalidInputError("it has no name", where, "Give it an attribute name (a string).")
            if callable(getattr(item, "rows", None)):
                if getattr(item, "rank", None) not in (Rank.LIMITS, Rank.CLEARANCE):
                    raise InvalidInputError(
                        f"its rank is {getattr(item, 'rank', None)!r}", where, "Give Rank.LIMITS or Rank.CLEARANCE."
                    )
                self.velocity.append((i, item))
            elif callable(getattr(item, "lines", None)):
                self.rate.append((i, item))
            else:
                raise InvalidInputError(
                    f"a {type(item).__name__} has neither rows(state, dt) nor lines(knot)",
                    where,
                    "See the how-to on constraints.",
                )
            names.append(item.name)
        self.names = tuple(names)
        self._nothing = no_rows(cell.nv)

    def __bool__(self) -> bool:
        return bool(self.names)

    def rows(self, state: CellState, dt: float) -> Rows:
        """All rows at a state.

        Raises:
            ConstraintTrouble: a constraint raised, or its rows are not finite or have other shapes.
        """
        if not self.velocity:
            return self._nothing
        parts = []
        for i, constraint in self.velocity:
            G, lower, upper = self._asked(constraint.name, lambda c=constraint: c.rows(state, dt))
            G = G.reshape(-1, self.cell.nv) if G.size else np.zeros((0, self.cell.nv))
            lower, upper = np.atleast_1d(lower), np.atleast_1d(upper)
            fits = len(G) == len(lower) == len(upper) and np.isfinite(G).all() and (lower <= upper).all()
            if not fits:
                raise ConstraintTrouble(
                    f"{constraint.name}: G {G.shape}, lower {lower.shape} and upper {upper.shape} are no rows "
                    f"for {self.cell.nv} joints (finite G, lower ≤ upper)"
                )
            parts.append((G, lower, upper, np.full(len(G), constraint.rank is Rank.CLEARANCE), np.full(len(G), i)))
        return Rows(*(np.concatenate(column) for column in zip(*parts, strict=True)))

    def bound(self, knot: Knot, dt: float, curvature_share: float) -> tuple[float, float, int]:
        """What the constraints leave of the rate at a knot.

        Returns:
            The largest z = σ², the largest decrease of σ per clock second at it, and the index of the constraint that
            makes z (−1 if none does). z is negative where not even rest is admissible.
        """
        cap, decrease, which = np.inf, np.inf, -1
        rows = self.rows(knot.state, dt)
        if len(rows):
            along = rows.G @ knot.slope
            room = np.where(along > 0.0, rows.upper, -rows.lower)
            with np.errstate(divide="ignore", invalid="ignore"):
                rate = np.where(np.abs(along) > _STILL, room / np.abs(along), np.inf)
            worst = int(rate.argmin())
            if rate[worst] < 1.0:
                cap, which = float(rate[worst] * abs(rate[worst])), int(rows.owner[worst])
        for i, bound in self.rate:
            a, b, c = (np.atleast_1d(x) for x in self._asked(bound.name, lambda r=bound: r.lines(knot)))
            if not (a.shape == b.shape == c.shape and np.isfinite([a, b, c]).all()):
                raise ConstraintTrouble(f"rate bound {bound.name}: a, b and c are not finite arrays of one length")
            rising = a > 0.0
            if rising.any():
                z = (np.where(c < 0.0, 1.0, curvature_share) * c)[rising] / a[rising]
                if z.min() < cap:
                    cap, which = float(z.min()), i
            braking = b < 0.0  # σ̇ = −D: b σ̇ = |b| D
            if braking.any():
                left = c[braking] - a[braking] * min(max(cap, 0.0), 1.0)
                decrease = min(decrease, float((left / -b[braking]).min()))
        return cap, max(decrease, 0.0), which

    def bound_or_stop(self, knot: Knot, dt: float, curvature_share: float) -> tuple[float, float, int]:
        """The same; the object stops at a knot where a constraint raises or returns nonsense."""
        try:
            return self.bound(knot, dt, curvature_share)
        except ConstraintTrouble:
            return 0.0, 0.0, 0

    def _asked(self, name: str, call: Any) -> tuple[Array, Array, Array]:
        try:
            first, second, third = call()
            return as_floats(first), as_floats(second), as_floats(third)
        except NOT_NUMBERS as error:
            raise ConstraintTrouble(f"constraint {name}: {error}") from error
        except (ArithmeticError, AttributeError, LookupError, RuntimeError, NotImplementedError) as error:
            raise ConstraintTrouble(f"constraint {name} raised {type(error).__name__}: {error}") from error


_STILL = 1e-12
