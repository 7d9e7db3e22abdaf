"""How fast the object may be at a grid point: linear programs of two variables, z = σ² and u = σ̇.

Between two knots the joints move at ``q′σ`` and accelerate at ``q′u + q″z``; z changes by 2u per second of clock. From
a knot with z the object has to be able to reach the next one with at most K there, within the accelerations. Unknown
changes of q″ between the knots count as a share e of its known changes. The largest such z is K here: a backward pass,
as in TOPP-RA [Pham & Pham, 2018], over the known horizon. The core's counterpart is ``sharing.cpp``.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from coopqp.native.constants import CROSSED, MOST_PIVOTS, STILL_SLOPE
from coopqp.spatial import Array


class Interval(NamedTuple):
    """Two knots in a row.

    Attributes:
        span: between them [s].
        slope, arrival: q′ after the first knot and before the second (nv,).
        chord: mean of q″ (nv,).
        bend, bend_ahead: q″ at the first and at the second knot (nv,).
        fall, rise: largest changes of the rate downwards and upwards [1/s].
    """

    span: float
    slope: Array
    arrival: Array
    chord: Array
    bend: Array
    bend_ahead: Array
    fall: float
    rise: float


class Share(NamedTuple):
    """The largest z at a knot, its slope over K at the next knot, and the joint that limits it.

    Attributes:
        square: z.
        gain: slope of z over K at the next knot; 0 where K there does not limit z.
        until: K at the next knot up to which this is the slope.
        joint: index of the joint whose acceleration limits z, alone or together with K ahead; −1 if none does.
    """

    square: float
    gain: float
    until: float
    joint: int

    @property
    def ahead(self) -> bool:
        """Whether K at the next knot limits z."""
        return self.gain > 0.0


def largest_square(interval: Interval, acceleration: Array, cap: float, ahead: float, *, doubt: float) -> Share:
    """Largest z ≤ ``cap`` at the first knot from which z at the second one can be in [0, ``ahead``].

    The lines are ``α u + β z ≤ γ``. The largest lower bound of u is convex in z, the least upper one concave; where
    they cross Newton's method finds from above, one pair of lines after the other. ``doubt`` is the share of the
    differences of q″ that stands for what the path does between the knots.

    As a function of ``ahead`` the largest z is concave, rises, and is linear in pieces: while ``ahead`` makes it, it
    moves along one lower bound of u, until that meets another line.
    """
    span, slope, arrival, chord, bend, bend_ahead, fall, rise = interval
    two = 2.0 * span
    unknown = doubt * (np.abs(bend - chord) + np.abs(bend_ahead - chord))
    # Four lines of each joint, upwards and downwards at either knot, and then those of the rate.
    a, b, c = np.empty((3, len(slope) + 1, 4))
    a[-1], b[-1], c[-1] = (1.0, -1.0, -two, two), (0.0, 0.0, -1.0, 1.0), (rise, fall, 0.0, ahead)
    # Of the bend and the chord the worse counts: z is not negative at either knot.
    b[:-1, 0], b[:-1, 1] = np.maximum(bend, chord), -np.minimum(bend, chord)
    b[:-1, 2], b[:-1, 3] = np.maximum(bend_ahead, chord), -np.minimum(bend_ahead, chord)
    b[:-1] += unknown[:, None]
    a[:-1, 0], a[:-1, 1] = slope, -slope
    a[:-1, 2], a[:-1, 3] = two * b[:-1, 2] + arrival, two * b[:-1, 3] - arrival
    c[:-1] = acceleration[:, None]
    return _largest(a.ravel(), b.ravel(), c.ravel(), cap, each=4)


def largest_alone(slope: Array, bend: Array, acceleration: Array, most: float, cap: float) -> float:
    """Largest z ≤ ``cap`` that some |u| ≤ ``most`` allows at one knot."""
    a = np.concatenate([slope, -slope, [1.0, -1.0]])  # whose line it is does not matter here
    b = np.concatenate([bend, -bend, [0.0, 0.0]])
    c = np.concatenate([acceleration, acceleration, [most, most]])
    return _largest(a, b, c, cap, each=2).square


def _largest(a: Array, b: Array, c: Array, cap: float, *, each: int) -> Share:
    """Largest z for lines ``a u + b z ≤ c``: ``each`` of them per joint, then four others, the last one of K ahead."""
    top, which, by_ahead = cap, -1, False
    (up,), (down,) = (a > STILL_SLOPE).nonzero(), (a < -STILL_SLOPE).nonzero()
    if len(up) + len(down) < len(a):
        (still,) = ((np.abs(a) <= STILL_SLOPE) & (b > 0.0)).nonzero()
        z = c[still] / b[still]
        if z.min(initial=np.inf) < top:
            top, which = float(z.min()), int(still[z.argmin()]) // each
    rising, falling = a[up], a[down]
    high_c, high_b, low_c, low_b = c[up] / rising, b[up] / rising, c[down] / falling, b[down] / falling
    square, lower = top, 0
    for _ in range(MOST_PIVOTS):
        high, low = high_c - high_b * square, low_c - low_b * square
        i, j = int(high.argmin()), int(low.argmax())
        over = float(low[j] - high[i])
        if over <= CROSSED * (1.0 + abs(float(low[j]))):  # at rest at the latest: every c is 0 or more
            break
        square, lower = max(square - over / float(high_b[i] - low_b[j]), 0.0), j
        rows = (int(up[i]), int(down[j]))
        by_ahead = rows[0] == len(a) - 1
        named = [row // each for row in rows if row < len(a) - 4]
        which = named[0] if named else -1
    if not by_ahead:
        return Share(square, 0.0, np.inf, which)
    least_c, least_b = float(low_c[lower]), float(low_b[lower])  # u = least_c − least_b z on that lower bound
    two = float(a[-1])
    leaves = np.concatenate([high_b - least_b, least_b - low_b])
    slack = np.concatenate([high_c - least_c, least_c - low_c])
    leaves[len(up) - 1] = 0.0  # the line of K ahead moves along
    limits = leaves > 0.0
    end = max(min(top, float((slack[limits] / leaves[limits]).min(initial=np.inf))), square)
    return Share(square, 1.0 / (1.0 - two * least_b), end + two * (least_c - least_b * end), which)
