"""A controller whose every step is checked by a monitor."""

from __future__ import annotations

from typing import Any, final

import numpy as np

from coopqp.checks import ArrayLike
from coopqp.control.interface import Controller, ControlStep
from coopqp.paths.path import ObjectPath
from coopqp.simulation.evaluation.monitor import Monitor
from coopqp.simulation.evaluation.violations import Verdict, ViolationKind
from coopqp.spatial import Array


@final
class Monitored:
    """A controller with a monitor. The monitor checks every step, and detects changes of the caller's arrays.

    A controller that needs wrenches gets them. The monitor sees them, too, and by how much the grasps give way.

    Args:
        controller: the checked controller; use its other methods directly.
        monitor: the monitor; by default a new one for the controller's cell and grasp.
    """

    def __init__(self, controller: Controller, monitor: Monitor | None = None) -> None:
        self.controller = controller
        self.cell, self.grasp, self.dt = controller.cell, controller.grasp, controller.dt
        self.monitor = monitor or Monitor(controller.cell, controller.grasp)
        self._inner: Any = controller
        self.needs_wrenches = bool(getattr(controller, "needs_wrenches", False))
        self.needs_servos = bool(getattr(controller, "needs_servos", False))
        self._last: ControlStep | None = None
        self._kept: tuple[Array, ...] = ()

    @property
    def path(self) -> ObjectPath:
        """The controller's path."""
        return self.controller.path

    @property
    def shift(self) -> Array:
        """Motion by which each grasp has given way (N, 6) [m, rad], for a controller with such a motion."""
        return self._inner.shift

    def reset(self, q: ArrayLike) -> None:
        """Reset the controller. The monitor keeps its violations."""
        kept = _copy(q)
        self.controller.reset(q)
        self._unchanged(q, kept, "q of reset")
        self.monitor.restart()
        self._last = None

    def step(
        self, q_measured: ArrayLike | None = None, *, wrenches: ArrayLike | None = None, dt: float | None = None
    ) -> ControlStep:
        """Compute and check the controller's step."""
        kept, felt = _copy(q_measured), _copy(wrenches)
        more = {"wrenches": wrenches} if self.needs_wrenches else {}
        step: ControlStep = self._inner.step(q_measured, dt=dt, **more)
        self._unchanged(q_measured, kept, "q_measured")
        self._unchanged(wrenches, felt, "wrenches")
        self.monitor.observe(step, wrenches=wrenches, shift=getattr(self, "shift", None))
        last = self._last
        if last is not None:
            for name, value in zip(("q", "velocity", "q_next"), self._kept, strict=True):
                self._unchanged(getattr(last, name), value, f"{name} of the step before")
        self._last, self._kept = step, (_copy(step.q), _copy(step.velocity), _copy(step.q_next))
        return step

    def verdict(self) -> Verdict:
        """The verdict so far."""
        return self.monitor.verdict()

    def _unchanged(self, now: Any, before: Any, what: str) -> None:
        if isinstance(before, np.ndarray) and not np.array_equal(now, before, equal_nan=before.dtype.kind == "f"):
            self.monitor.report(ViolationKind.MUTATED, detail=what)


def _copy(value: Any) -> Any:
    return value.copy() if isinstance(value, np.ndarray) else value
