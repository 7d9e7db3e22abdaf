"""The fused step: compiled where a compiler was there when the package was built, NumPy elsewhere."""

from __future__ import annotations

from coopqp.control.core.border import Border, BorderArrays, NumpyBorder
from coopqp.control.core.reference import NumpyKernel
from coopqp.control.core.workspace import Outcome, StepKernel, Workspace
from coopqp.errors import UnknownNameError

try:
    from coopqp.control.core.compiled import CompiledBorder, CompiledKernel
except ImportError:  # built without a compiler
    _KERNELS: dict[str, type[StepKernel]] = {"numpy": NumpyKernel}
    _BORDERS: dict[str, type[Border]] = {"numpy": NumpyBorder}
else:
    _KERNELS = {"compiled": CompiledKernel, "numpy": NumpyKernel}
    _BORDERS = {"compiled": CompiledBorder, "numpy": NumpyBorder}

__all__ = [
    "BorderArrays",
    "NumpyKernel",
    "Outcome",
    "StepKernel",
    "Workspace",
    "available_kernels",
    "make_border",
    "make_kernel",
]


def available_kernels() -> tuple[str, ...]:
    """Names of the kernels that this installation has, the fastest first."""
    return tuple(_KERNELS)


def make_kernel(workspace: Workspace, name: str = "auto") -> StepKernel | None:
    """The kernel of that name; ``"auto"`` for the fastest, ``"none"`` for None.

    Raises:
        UnknownNameError: this installation has no such kernel.
    """
    if name == "none":
        return None
    if name != "auto" and name not in _KERNELS:
        raise UnknownNameError("kernel", name, _KERNELS)
    return _KERNELS[available_kernels()[0] if name == "auto" else name](workspace)


def make_border(arrays: BorderArrays, name: str) -> Border:
    """The border of the kernel of that name."""
    return _BORDERS[name](arrays)
