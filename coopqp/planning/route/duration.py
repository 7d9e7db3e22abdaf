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
#: Durations of a speed at the start that is too high altogether [s].
_PENALTY = 100.0


def estimated_squares(limits: JointLimits, s: Array, x: Array, *, speed: float = 0.0) -> Array:
    """Squares of the fastest speed ds/dt at samples (K,), by differences of the joints' positions; a few per cent off.

    Args:
        limits: of the joints.
        s: increasing parameter of the samples (K,).
        x: joint positions there (K, nv) [rad or m].
        speed: ds/dt at the first sample. Where the joints cannot slow down from it the first square is less than its.
    """
    ds = np.diff(s)
    slope = np.abs(np.diff(x, axis=0)) / ds[:, None]
    bend = np.zeros_like(x)
    bend[1:-1] = np.abs(np.diff(np.diff(x, axis=0) / ds[:, None], axis=0)) / (0.5 * (ds[1:] + ds[:-1]))[:, None]
    steep = np.maximum(slope, _STILL)
    # Squares of the speed that the joints' speeds and bends allow at the samples.
    fastest = (limits.velocity / steep).min(axis=1) ** 2
    caps = np.minimum(np.append(fastest, 0.0), np.append(fastest[0], fastest))
    caps = np.minimum(caps, (_BEND_SHARE * limits.acceleration / np.maximum(bend, _STILL)).min(axis=1))
    caps[0], caps[-1] = min(caps[0], speed * speed), 0.0
    square = caps
    for _ in range(_PASSES):  # what bends leave for speeding up depends on the speed of the pass before
        left = limits.acceleration - bend * square[:, None]
        ahead, back = ((part / steep).min(axis=1).clip(0.0) for part in (left[:-1], left[1:]))
        square = _slowed(_slowed(caps, 2.0 * ds * ahead)[::-1], (2.0 * ds * back)[::-1])[::-1]
    return square


def estimated_duration(limits: JointLimits, s: Array, x: Array, *, speed: float = 0.0) -> float:
    """Duration from a speed to rest [s]; arguments as for :func:`estimated_squares`.

    A speed from which the joints cannot slow down counts as a second for each of its hundredths that is too much.
    """
    square = estimated_squares(limits, s, x, speed=speed)
    speeds = np.sqrt(square)
    duration = float((2.0 * np.diff(s) / np.maximum(speeds[1:] + speeds[:-1], _STILL)).sum())
    return duration + _PENALTY * (1.0 - float(speeds[0]) / speed) if speed > 0.0 else duration


def _slowed(caps: Array, rises: Array) -> Array:
    """Squares (K,) up to the caps that rise from one to the next by no more than ``rises`` (K − 1,)."""
    out = [float(caps[0])]
    for cap, rise in zip(caps[1:].tolist(), rises.tolist(), strict=True):
        out.append(min(cap, out[-1] + rise))
    return np.array(out)
