"""The fused step in C, over the same workspace as the NumPy one."""

from __future__ import annotations

from typing import Any, final

import coopqp.control.core._native as native
from coopqp.control.core.border import BorderArrays
from coopqp.control.core.workspace import Workspace

#: Order of the buffers, as the enumeration in arithmetic.h.
_BUFFERS = (
    "placements", "jacobian_T", "Y_transposed", "tool_joints", "starts", "sizes", "scale", "shares", "low", "high",
    "speed", "acceleration", "lower", "upper", "R", "p", "along", "path", "measured", "positions", "v_prev",
    "null_along", "null_offset", "scalars", "result", "errors", "grasp", "offsets", "predicted", "velocity",
    "along_velocity", "midpoint", "line", "per_acceleration", "unit", "base", "columns", "rows", "norms", "row_lower",
    "row_upper", "recovery", "outside", "common",
)  # fmt: skip


#: The same of a border.
_BORDER_BUFFERS = (
    "slope", "before", "positions", "low", "high", "per_speed", "per_bend", "acceleration", "slope_change", "curvature",
    "result",
)  # fmt: skip


def _buffers(owner: Any, names: tuple[str, ...]) -> tuple[tuple[Any, ...], tuple[tuple[int, int], ...]]:
    """The arrays, to keep their memory alive, and their addresses and lengths."""
    arrays = tuple(getattr(owner, name) for name in names)
    for name, array in zip(names, arrays, strict=True):
        if not (array.flags.c_contiguous and array.dtype.itemsize == 8):
            raise ValueError(f"'{name}' is not a contiguous array of 8-byte items")
    return arrays, tuple((array.ctypes.data, array.nbytes) for array in arrays)


@final
class CompiledKernel:
    """See :class:`StepKernel`; ``plain`` for the arithmetic that any processor can do."""

    name = "compiled"
    follows_lines = True

    def __init__(self, workspace: Workspace, *, plain: bool = False) -> None:
        self._arrays, addresses = _buffers(workspace, _BUFFERS)
        self._workspace = workspace  # and Pinocchio's memory
        kernel = native.Kernel(addresses, plain)
        self.step, self.observe, self.rows = kernel.step, kernel.observe, kernel.rows


@final
class CompiledBorder:
    """See :class:`Border`; ``plain`` as for the kernel."""

    def __init__(self, arrays: BorderArrays, *, plain: bool = False) -> None:
        self._arrays, addresses = _buffers(arrays, _BORDER_BUFFERS)
        self.evaluate = native.Border(addresses, arrays.caps_speed, plain).evaluate
