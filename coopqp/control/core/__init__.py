"""The compiled core of a step, and the choice between it and the plain definition."""

from __future__ import annotations

from typing import TYPE_CHECKING

from coopqp.control.options import QPOptions
from coopqp.control.step.constraint_set import Constraints
from coopqp.errors import UnknownNameError
from coopqp.model.cell import RobotCell
from coopqp.model.grasp import Grasp
from coopqp.native import available_kernels

if TYPE_CHECKING:
    from coopqp.control.core.compiled import CompiledLoop
    from coopqp.control.step.plain import PlainLoop


def make_loop(
    cell: RobotCell, grasp: Grasp, *, dt: float, options: QPOptions, constraints: Constraints
) -> CompiledLoop | PlainLoop:
    """The loop that ``options.kernel`` names; the plain one where the core does not know the robot.

    Raises:
        UnknownNameError: this installation has no such kernel.
    """
    # Both loops use the layout of this package: they are imported here, so that either may be imported first.
    from coopqp.control.step.plain import PlainLoop

    kernels = available_kernels()
    if options.kernel != "auto" and options.kernel not in kernels:
        raise UnknownNameError("kernel", options.kernel, kernels)
    if "compiled" in kernels and options.kernel != "plain":
        from coopqp.control.core.compiled import CompiledLoop
        from coopqp.control.core.memory import NotForTheCore

        try:
            return CompiledLoop(cell, grasp, dt=dt, options=options, constraints=constraints)
        except NotForTheCore:
            pass
    return PlainLoop(cell, grasp, dt=dt, options=options, constraints=constraints)


__all__ = ["make_loop"]
