"""The compiled core of a step, and the choice between it and the plain definition."""

from __future__ import annotations

from typing import TYPE_CHECKING

from coopqp.control.constraints import Constraints
from coopqp.control.core.memory import NotForTheCore
from coopqp.control.options import QPOptions
from coopqp.control.plain import PlainLoop
from coopqp.errors import UnknownNameError
from coopqp.model.cell import RobotCell
from coopqp.model.grasp import Grasp

if TYPE_CHECKING:
    from coopqp.control.core.compiled import CompiledLoop

try:
    from coopqp.control.core import _native  # noqa: F401
except ImportError:  # built without a compiler
    _KERNELS: tuple[str, ...] = ("plain",)
else:
    _KERNELS = ("compiled", "plain")


def available_kernels() -> tuple[str, ...]:
    """Names of what runs a step in this installation, the fastest first."""
    return _KERNELS


def make_loop(
    cell: RobotCell, grasp: Grasp, *, dt: float, options: QPOptions, constraints: Constraints
) -> CompiledLoop | PlainLoop:
    """The loop that ``options.kernel`` names; the plain one where the core does not know the robot.

    Raises:
        UnknownNameError: this installation has no such kernel.
    """
    if options.kernel != "auto" and options.kernel not in _KERNELS:
        raise UnknownNameError("kernel", options.kernel, _KERNELS)
    if "compiled" in _KERNELS and options.kernel != "plain":
        from coopqp.control.core.compiled import CompiledLoop

        try:
            return CompiledLoop(cell, grasp, dt=dt, options=options, constraints=constraints)
        except NotForTheCore:
            pass
    return PlainLoop(cell, grasp, dt=dt, options=options, constraints=constraints)


__all__ = ["NotForTheCore", "available_kernels", "make_loop"]
