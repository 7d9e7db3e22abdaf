"""About how long a motion takes under the joints' limits, to tell a fast way from a slow one."""

from __future__ import annotations

import numpy as np

from coopqp.model.joint_limits import JointLimits
from coopqp.spatial import Array

#: Differences of the joints' positions that count as none [rad or m].
_STILL = 1e-9
#: Share of an acceleration limit that bends of the joints' way use up, at most: the rest speeds up and slows down.
_BEND_SHARE = 0.8
#: Passes forwards and backwards.
_PASSES = 2


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
    caps = np.minimum(np.append(fastest, 0.0), np.append(0.0, fastest))
    caps = np.minimum(caps, (_BEND_SHARE * limits.acceleration / np.maximum(bend, _STILL)).min(axis=1))
    caps[0] = caps[-1] = 0.0
    square = caps
    for _ in range(_PASSES):  # what bends leave for speeding up depends on the speed of the pass before
        left = limits.acceleration - bend * square[:, None]
        ahead, back = ((part / steep).min(axis=1).clip(0.0) for part in (left[:-1], left[1:]))
        square = _slowed(_slowed(caps, 2.0 * ds * ahead)[::-1], (2.0 * ds * back)[::-1])[::-1]
    speed = np.sqrt(square)
    return float((2.0 * ds / np.maximum(speed[1:] + speed[:-1], _STILL)).sum())


def _slowed(caps: Array, rises: Array) -> Array:
    """Squares (K,) up to the caps that rise from one to the next by no more than ``rises`` (K − 1,)."""
    out = [float(caps[0])]
    for cap, rise in zip(caps[1:].tolist(), rises.tolist(), strict=True):
        out.append(min(cap, out[-1] + rise))
    return np.array(out)
