"""What a cell file and a recording come to, in numbers."""

from __future__ import annotations

from typing import Any

import numpy as np

from coopqp import Recording

ARRAYS = (
    "time", "q", "q_command", "velocity", "clock", "rate", "status", "reference", "wrenches", "torques", "shift",
)  # fmt: skip


def numbers_of(run: Any) -> dict[str, Any]:
    """What a cell file comes to."""
    s = run.scenario
    clocks = np.linspace(0.0, s.path.duration, 5)
    return {
        "dt": s.dt,
        "joints": list(s.cell.joint_names),
        "limits": [np.nan_to_num(getattr(s.cell.limits, n), posinf=1e9, neginf=-1e9).tolist()
                   for n in ("lower", "upper", "velocity", "acceleration")],
        "q_start": np.asarray(s.q_start).tolist(),
        "grasp": [np.asarray(X.homogeneous).tolist() for X in s.grasp.T_object_tool],
        "poses": [np.asarray(s.path.pose(float(t)).homogeneous).tolist() for t in clocks],
    }  # fmt: skip


def sums_of(run: Recording) -> dict[str, Any]:
    """What a recording comes to: shape and sum of each array, and what stands beside them."""
    arrays = {name: getattr(run, name) for name in ARRAYS}
    found: dict[str, Any] = {n: [*a.shape, float(np.abs(a).sum())] for n, a in arrays.items() if a is not None}
    cell = run.cell(shapes=False)
    return found | {"notes": list(run.notes), "finished": run.finished, "joint_names": list(cell.joint_names)}
