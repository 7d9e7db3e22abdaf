"""The ideal plant, with the imperfections of a real one as options."""

from __future__ import annotations

from typing import Any, Protocol, final

from coopqp.control.command import ControlStep
from coopqp.model.cell import RobotCell
from coopqp.spatial import Array


class Plant(Protocol):
    """What :func:`coopqp.simulation.simulate.simulate` moves."""

    def reset(self, q: Any) -> Array:
        """Put the cell at ``q`` (nq,), at rest; return the measured configuration."""
        ...

    def apply(self, step: ControlStep) -> Array:
        """Execute a command for its ``dt``; return the measured configuration (nq,) at its end."""
        ...


@final
class KinematicPlant:
    """Joints that go exactly where they are told."""

    def __init__(self, cell: RobotCell) -> None:
        self.cell = cell
        self.q: Array = cell.configuration([0.0] * cell.nv)

    def reset(self, q: Any) -> Array:
        """Put the cell at ``q``."""
        self.q = self.cell.check_configuration(q, "KinematicPlant.reset")
        return self.q

    def apply(self, step: ControlStep) -> Array:
        """The joints reach ``step.q_next``."""
        self.q = step.q_next
        return self.q
