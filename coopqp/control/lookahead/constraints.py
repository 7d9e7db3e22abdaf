"""Further constraints at knots ahead."""

from __future__ import annotations

from typing import final

from coopqp.constraints.rate import Knot
from coopqp.constraints.velocity import ConstraintTrouble
from coopqp.control.lookahead.closed_chain import KnotRoom, LookAheadTrouble
from coopqp.control.step.constraint_set import Constraints
from coopqp.model.cell import RobotCell
from coopqp.model.state import CellState
from coopqp.spatial import Array


@final
class ConstraintsAhead:
    """Further constraints in the words of the look-ahead.

    Args:
        cell: the arms.
        constraints: the constraints.
        curvature_share: share of a bound that curvature may take, see :class:`coopqp.PreviewOptions`.
        dt: nominal length of a step [s].
    """

    def __init__(self, cell: RobotCell, constraints: Constraints, curvature_share: float, *, dt: float) -> None:
        self._cell, self._constraints, self._curvature_share, self._dt = cell, constraints, curvature_share, dt

    def bound(self, clock: float, q: Array, slope: Array, curvature: Array, span: float) -> KnotRoom:
        """The rate that the constraints allow at a knot.

        Raises:
            LookAheadTrouble: one fails.
        """
        knot = Knot(clock, CellState(self._cell, q), slope, curvature, span)
        try:
            found = self._constraints.bound(knot, self._dt, self._curvature_share)
        except ConstraintTrouble as trouble:
            raise LookAheadTrouble(str(trouble)) from trouble
        binding = self._constraints.labels[found.which] if found.which >= 0 else None
        return KnotRoom(found.cap, found.decrease, found.rise, binding)

    def evade(self, q: Array, slope: Array) -> Array:
        """Slopes (nv,) at ``q`` (nq,) with the self-motion that the constraints ask for.

        Raises:
            LookAheadTrouble: one fails.
        """
        try:
            return self._constraints.evaded(q, slope)
        except ConstraintTrouble as trouble:
            raise LookAheadTrouble(str(trouble)) from trouble
