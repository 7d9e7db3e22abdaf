"""Further constraints on a step and on the path ahead: the user's own, collisions, torques. All are rows or lines.

A row ``lower ≤ G v ≤ upper`` on the joint velocities enters every answer of a step: the nominal test, the fastest rate
on the path, the QP. A line ``a z + b σ̇ ≤ c`` with z = σ² bounds the path speed at a grid point of the look-ahead.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, NamedTuple, Protocol, final, runtime_checkable

import numpy as np

from coopqp.constraints.cause import Cause
from coopqp.constraints.rate import Knot
from coopqp.model.limits import BindingLimit
from coopqp.model.shapes import NearPair
from coopqp.model.state import CellState
from coopqp.spatial import Array

#: Further rows that a step may have.
MOST_ROWS = 64


class Rank(enum.IntEnum):
    """Order of precedence: a rank gives way only to the ranks before it."""

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

        Asked at every step, and at every grid point of the look-ahead: keep it free of side effects.

        Args:
            state: kinematics at the commanded configuration, or at the grid point's.
            dt: length of the step [s].
        """
        ...


class LabelledRows(NamedTuple):
    """Rows ``lower ≤ G v ≤ upper`` of a :class:`CertifiedConstraint`, and the label of each (m,)."""

    G: Array
    lower: Array
    upper: Array
    which: Any


class Quiet(NamedTuple):
    """Where a constraint is known to be quiet: joint positions x with ``Σ reach |x − centre| ≤ slack``.

    The sum is over the joints of the two arms where it is largest: no row may depend on more arms.

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

    def clear(self, blind: bool, shorter: bool = False, /) -> bool:
        """Whether it is shown, by few distances, that no row can bind the command; ``shorter``: by those alone."""
        ...

    def tightened(self) -> bool:
        """Raise lower bounds that the command breaks; whether it does."""
        ...

    def stopping(self, place: int, span: float, /) -> int:
        """Label that stops the object on the way to the grid point at a place, -2 for none; -1 if that is not known.

        The way takes ``span`` [s of the clock].
        """
        ...

    def prepare(self) -> None:
        """Look at everything once, where the joints start."""
        ...

    def evade(self) -> bool:
        """Add self-motion to the slope in the memory, at the positions there; whether it succeeded."""
        ...

    def surveys(self, shorter: bool = False, /) -> bool:
        """Do a piece of work that need not be done in one step, or half of one; whether there was any."""
        ...


@runtime_checkable
class CertifiedConstraint(VelocityConstraint, Protocol):
    """A velocity constraint with many rows of which few bind: it names each, and says where none does.

    Attributes:
        labels: name of the limit that each row stands for, one for each row that there may ever be.
        quiet: the inactive region of the last ``rows_by_label``. A step of velocities v and length dt from joint
            positions x breaks no row if ``Σ reach |v| dt ≤ min(approach dt, 1) (slack − Σ reach |x − centre|)``.
        quiet_ahead: the same for grid points and the way between them.
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

    def in_memory(self, memory: Mapping[str, Array], *, ahead: bool = False) -> RowsInMemory | None:
        """The same rows, or those of the look-ahead, in the memory of a compiled step; None without a native form."""
        ...

    def stopping_pair(self, knot: Knot) -> int:
        """Number of the label that stops the object before a grid point; −1 if none does."""
        ...

    def evaded(self, q: Array, slope: Array) -> Array:
        """Slopes q′ (nv,) at ``q`` (nq,) with the self-motion by which redundant arms keep clear of bodies ahead."""
        ...

    def measured(self, limit: BindingLimit, q: Array) -> BindingLimit:
        """One of the labels with its distance at ``q`` (nq,)."""
        ...

    def nearest(self, q: Array) -> NearPair | None:
        """The pair nearest to binding at ``q`` (nq,)."""
        ...

    def inside(self, q: Array) -> tuple[BindingLimit, ...]:
        """Labels of what is already violated at ``q`` (nq,), with its distance, the worst first."""
        ...


@final
@dataclass(frozen=True, eq=False)
class Rows:
    """Rows ``lower ≤ G v ≤ upper`` of one step.

    Attributes:
        G: (m, nv).
        lower, upper: (m,).
        soft: how far a row gives way before the arms part, over what a row of the rank CLEARANCE does at the same cost
            (m,); 0 for rows that never do.
        owner: number of each row's name in :attr:`Constraints.labels` (m,); of a row that brakes all arms together −1
            less its number in :attr:`coopqp.control.step.braking_rows.BrakingRows.labels`.
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
    """The rate that constraints allow at a grid point.

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
    """Zero rows, for nv joints."""
    nothing = np.zeros(0)
    return Rows(np.zeros((0, nv)), nothing, nothing, nothing, nothing.astype(int))


class ConstraintTrouble(Exception):  # noqa: N818
    """A constraint raised, or returned something else than rows; the step holds.

    Attributes:
        rows: those that constraints could still give; the step that holds keeps them.
        cause: of the step that holds.
    """

    def __init__(self, message: str, rows: Any = None, cause: Cause = Cause.INPUT) -> None:
        super().__init__(message)
        self.rows, self.cause = rows, cause
