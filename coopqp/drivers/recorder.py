"""A run on robots as a :class:`coopqp.Recording`, for ``coopqp view``, ``report`` and ``export``."""

from __future__ import annotations

from typing import Any, final

import numpy as np

from coopqp.control.interface import ControlStep
from coopqp.simulation.recording.recording import Recording
from coopqp.simulation.simulate import RunRecorder
from coopqp.spatial import Array


@final
class MemoryRecorder:
    """Keeps every period of a run in memory (a few hundred bytes each), and makes a recording of it afterwards.

    Args:
        controller: the loop's controller.
    """

    def __init__(self, controller: Any) -> None:
        self._controller = controller
        self._periods: list[tuple[float, Array, Array, ControlStep, float]] = []

    @property
    def steps(self) -> int:
        """How many steps the recording would have: one less than periods."""
        return max(0, len(self._periods) - 1)

    def take(self, moment: float, measured: Array, sent: Array, step: ControlStep, clock: float) -> None:
        """One period."""
        self._periods.append((moment, measured.copy(), sent.copy(), step, clock))

    def recording(self, metadata: dict[str, Any]) -> Recording:
        """The run so far; where a robot's state was missing, its last one.

        Args:
            metadata: entries of the recording; must be JSON.
        """
        cell = self._controller.cell
        known = np.zeros(cell.nv) if not self._periods else self._periods[0][2]
        rows: RunRecorder | None = None
        last: tuple[float, Array, float] | None = None
        for moment, measured, sent, step, clock in self._periods:
            known = np.where(np.isfinite(measured), measured, known)
            q = cell.configuration_of(known)
            if rows is None or last is None:
                rows = RunRecorder(self._controller, q)
            else:
                dt = moment - last[0]
                rows.take(
                    step.replaced(
                        q=cell.configuration_of(last[1]), q_next=cell.configuration_of(sent), dt=dt,
                        velocity=(sent - last[1]) / dt, clock=last[2], clock_next=clock,
                    ),
                    q,
                )  # fmt: skip
            last = moment, sent, clock
        if rows is None:
            rows = RunRecorder(self._controller, cell.configuration_of(known))
        return rows.recording({"plant": "robots", "gripped": None, "turns": self._turns(), **metadata})

    def _turns(self) -> dict[str, int]:
        """Whole turns from (−π, π] at which continuous joints began, by name: configurations do not have them."""
        cell = self._controller.cell
        if not self._periods:
            return {}
        x = self._periods[0][2]
        turns = np.rint((x - cell.positions(cell.configuration_of(x))) / (2.0 * np.pi)).astype(int)
        return {cell.joint_names[j]: int(turns[j]) for j in np.flatnonzero(turns)}
