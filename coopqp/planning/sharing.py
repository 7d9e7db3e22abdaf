"""How fast the object may be at a knot: linear programs of two variables, z = σ² and u = σ̇.

Between two knots the joints move at ``q′σ`` and accelerate at ``q′u + q″z``; z changes by 2u per second of clock. From
a knot with z the object has to be able to reach the next one with at most K there, within the accelerations. What is
not known of q″ between the knots counts as a share e of them. The largest such z is K here: a backward pass, as of
TOPP-RA [Pham & Pham, 2018], over the known horizon.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from coopqp.spatial import Array

#: A bound of u counts from this slope on [rad/s or m/s, per unit of rate].
STILL_SLOPE = 1e-12
#: Newton steps of one program. Each takes another pair of lines.
MOST_PIVOTS = 50
#: The lower bound of u is above the upper one by more than rounding.
CROSSED = 1e-13


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
    """Largest z, how it follows K at the next knot, and what makes it.

    Attributes:
        square: z.
        gain: slope of z over K at the next knot; 0 where K there does not make z.
        until: K at the next knot up to which this is the slope.
        joint: whose acceleration makes z, or helps to; −1 if none does.
    """

    square: float
    gain: float
    until: float
    joint: int

    @property
    def ahead(self) -> bool:
        """Whether K at the next knot makes z."""
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
    # Of the bend and the chord the worse counts: z is not negative at either knot.
    up, down = unknown + np.maximum(bend, chord), unknown - np.minimum(bend, chord)
    up_ahead, down_ahead = unknown + np.maximum(bend_ahead, chord), unknown - np.minimum(bend_ahead, chord)
    alpha = (slope, -slope, two * up_ahead + arrival, two * down_ahead - arrival)
    return _largest(
        np.concatenate([np.array(alpha).T.ravel(), [1.0, -1.0, -two, two]]),
        np.concatenate([np.array((up, down, up_ahead, down_ahead)).T.ravel(), [0.0, 0.0, -1.0, 1.0]]),
        np.concatenate([np.repeat(acceleration, 4), [rise, fall, 0.0, ahead]]),
        cap,
        each=4,
    )


def largest_alone(slope: Array, bend: Array, acceleration: Array, most: float, cap: float) -> float:
    """Largest z ≤ ``cap`` that some |u| ≤ ``most`` allows at one knot."""
    a = np.concatenate([slope, -slope, [1.0, -1.0]])  # whose line it is does not matter here
    b = np.concatenate([bend, -bend, [0.0, 0.0]])
    c = np.concatenate([acceleration, acceleration, [most, most]])
    return _largest(a, b, c, cap, each=2).square


def _largest(a: Array, b: Array, c: Array, cap: float, *, each: int) -> Share:
    """The same for lines ``a u + b z ≤ c``: ``each`` of them per joint, then four others, the last one of K ahead."""
    top, which, by_ahead = cap, -1, False
    (still,) = ((np.abs(a) <= STILL_SLOPE) & (b > 0.0)).nonzero()
    if still.size:
        z = c[still] / b[still]
        if z.min() < top:
            top, which = float(z.min()), int(still[z.argmin()]) // each
    (up,), (down,) = (a > STILL_SLOPE).nonzero(), (a < -STILL_SLOPE).nonzero()
    high_c, high_b, low_c, low_b = c[up] / a[up], b[up] / a[up], c[down] / a[down], b[down] / a[down]
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
    room = np.concatenate([high_c - least_c, least_c - low_c])
    leaves[len(up) - 1] = 0.0  # the line of K ahead moves along
    limits = leaves > 0.0
    end = max(min(top, float((room[limits] / leaves[limits]).min(initial=np.inf))), square)
    return Share(square, 1.0 / (1.0 - two * least_b), end + two * (least_c - least_b * end), which)
