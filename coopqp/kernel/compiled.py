"""The fused step in C, over the same workspace as the NumPy one."""

from __future__ import annotations

from typing import final

from coopqp.kernel._native import Kernel
from coopqp.kernel.workspace import Workspace

#: Order of the buffers, as the enumeration in _native.c.
_BUFFERS = (
    "placements", "jacobian_T", "Y_transposed", "tool_joints", "starts", "sizes", "scale", "shares", "low", "high",
    "speed", "acceleration", "lower", "upper", "R", "p", "along", "path", "measured", "positions", "v_prev",
    "null_along", "null_offset", "scalars", "result", "errors", "grasp", "offsets", "predicted", "velocity",
    "along_velocity", "midpoint", "line", "per_acceleration",
)  # fmt: skip


@final
class CompiledKernel:
    """See :class:`StepKernel`."""

    name = "compiled"
    follows_lines = True

    def __init__(self, workspace: Workspace) -> None:
        self._arrays = tuple(getattr(workspace, name) for name in _BUFFERS)  # keeps their memory alive
        for name, array in zip(_BUFFERS, self._arrays, strict=True):
            if not (array.flags.c_contiguous and array.dtype.itemsize == 8):
                raise ValueError(f"the workspace's '{name}' is not a contiguous array of 8-byte items")
        self._workspace = workspace  # and Pinocchio's
        self.step = Kernel(tuple((array.ctypes.data, array.nbytes) for array in self._arrays)).step
