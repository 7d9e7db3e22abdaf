"""About how long a motion takes under the joints' limits, to tell a fast way from a slow one."""

from __future__ import annotations

import numpy as np

from coopqp.model.joint_limits import JointLimits
from coopqp.spatial import Array

#: Differences of the joints' positions that count as none [rad or m].
_STILL = 1e-9
#: Share of an acceleration limit that bends of the joints' way use up, at most: the rest speeds up and slows down.
_BEND_SHARE = 0.8


def estimated_duration(limits: JointLimits, s: Array, x: Array) -> float:
    """Duration from rest to rest [s], by differences of the joints' positions; a few per cent off.

    Args:
        limits: of the joints.
        s: increasing parameter of the samples (K,).
        x: joint positions there (K, nv) [rad or m].
    """
    ds = np.diff(s)
    slope = np.abs(np.diff(x, axis=0)) / ds[:, None]
    bend = np.zeros_like(x)
    bend[1:-1] = np.abs(np.diff(np.diff(x, axis=0) / ds[:, None], axis=0)) / (0.5 * (ds[1:] + ds[:-1]))[:, None]
    steep = np.maximum(slope, _STILL)
    # Squares of the speed that the joints' speeds and bends allow at the samples.
    fastest = (limits.velocity / steep).min(axis=1) ** 2
    square = np.minimum(np.append(fastest, 0.0), np.append(0.0, fastest))
    square = np.minimum(square, (_BEND_SHARE * limits.acceleration / np.maximum(bend, _STILL)).min(axis=1))
    square[0] = square[-1] = 0.0
    for order in (range(len(ds)), range(len(ds) - 1, -1, -1)):
        forwards = order.step > 0
        for i in order:
            at, to = (i, i + 1) if forwards else (i + 1, i)
            left = (limits.acceleration - bend[at] * square[at]) / steep[i]
            square[to] = min(square[to], square[at] + 2.0 * ds[i] * max(float(left.min()), 0.0))
    speed = np.sqrt(square)
    return float((2.0 * ds / np.maximum(speed[1:] + speed[:-1], _STILL)).sum())
