"""The plant protocol, and the ideal plant."""

from __future__ import annotations

from typing import Protocol, final

from coopqp.checks import ArrayLike, require
from coopqp.control.interface import ControlStep
from coopqp.model.cell import RobotCell
from coopqp.spatial import Array


class Plant(Protocol):
    """The protocol of the plants of :func:`coopqp.simulate`."""

    def reset(self, q: ArrayLike) -> Array:
        """Put the cell at rest at ``q`` (nq,). Returns the measured configuration (nq,)."""
        ...

    def apply(self, step: ControlStep) -> Array:
        """Execute a command for its ``dt``. Returns the measured configuration (nq,) at the end."""
        ...


@final
class KinematicPlant:
    """Joints that follow their commands exactly. They hold nothing: ``gripped`` is False."""

    gripped = False

    def __init__(self, cell: RobotCell) -> None:
        require(cell, RobotCell, "KinematicPlant: cell", "Give a RobotCell.")
        self.cell = cell
        self.q: Array = cell.configuration([0.0] * cell.nv)

    def reset(self, q: ArrayLike) -> Array:
        """Put the cell at ``q`` (nq,)."""
        self.q = self.cell.check_configuration(q, "KinematicPlant.reset")
        return self.q

    def apply(self, step: ControlStep) -> Array:
        """Move the joints to ``step.q_next``."""
        self.q = step.q_next
        return self.q
