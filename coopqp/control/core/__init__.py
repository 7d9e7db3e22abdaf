"""The compiled core of a step, and the choice between it and the plain definition."""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable
from importlib import import_module
from typing import TYPE_CHECKING

from coopqp.control.constraint_set import Constraints
from coopqp.control.core import allow_plain, relax_plain
from coopqp.control.core.memory import NotForTheCore
from coopqp.control.options import QPOptions
from coopqp.control.plain import PlainLoop
from coopqp.errors import KernelWarning, UnknownNameError
from coopqp.model.cell import RobotCell
from coopqp.model.grasp import Grasp
from coopqp.spatial import Array

if TYPE_CHECKING:
    from coopqp.control.core.compiled import CompiledLoop

#: Memory, arms, wrenches (N, 6) or None, dt; and memory, arms, dt.
Relax = Callable[[Array, int, Array | None, float], int]
Allow = Callable[[Array, int, float], None]

_MISSING = ""
try:
    import_module("coopqp.control.core._native")
except ModuleNotFoundError:
    _MISSING = "it was not built: there was no C compiler, or it failed"
except ImportError as error:
    _MISSING = f"it cannot be loaded ({error})"
_KERNELS = ("plain",) if _MISSING else ("compiled", "plain")


def available_kernels() -> tuple[str, ...]:
    """Names of what runs a step in this installation, the fastest first."""
    return _KERNELS


def kernel_text() -> str:
    """The kernel that steps run by default, and why it is not the compiled one."""
    return _KERNELS[0] + (f" ({_MISSING})" if _MISSING else "")


@functools.cache
def _warn_once() -> None:
    remedy = (
        "Install a C compiler, then: COOPQP_REQUIRE_KERNEL=1 pip install --force-reinstall --no-binary coopqp coopqp"
    )
    warnings.warn(
        f"coopqp runs without its compiled kernel, about a hundred times slower: {_MISSING}. {remedy}",
        KernelWarning,
        stacklevel=4,
    )


def make_loop(
    cell: RobotCell, grasp: Grasp, *, dt: float, options: QPOptions, constraints: Constraints
) -> CompiledLoop | PlainLoop:
    """The loop that ``options.kernel`` names; the plain one where the core does not know the robot.

    Raises:
        UnknownNameError: this installation has no such kernel.

    Warns:
        KernelWarning: there is no compiled kernel, and none was asked for by name.
    """
    if options.kernel != "auto" and options.kernel not in _KERNELS:
        raise UnknownNameError("kernel", options.kernel, _KERNELS)
    if "compiled" in _KERNELS and options.kernel != "plain":
        from coopqp.control.core.compiled import CompiledLoop

        try:
            return CompiledLoop(cell, grasp, dt=dt, options=options, constraints=constraints)
        except NotForTheCore:
            pass
    elif options.kernel == "auto":
        _warn_once()
    return PlainLoop(cell, grasp, dt=dt, options=options, constraints=constraints)


def minding_of(kernel: str) -> tuple[Relax, Allow]:
    """Functions of a kernel for forces: the relaxation (``relax.c``), and the allowed rate (``allow.c``)."""
    if kernel == "plain":
        return relax_plain.relax, allow_plain.allow
    from coopqp.control.core import _native

    return _native.relax, _native.allow


__all__ = ["available_kernels", "kernel_text", "make_loop", "minding_of"]
