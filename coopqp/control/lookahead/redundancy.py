"""Self-motion of redundant arms where a joint nears its position limit."""

from __future__ import annotations

from typing import final

import numpy as np

from coopqp.model.chain import Chain
from coopqp.native.constants import IN_PLANE, LEADS, LIMIT_MARGIN, TURNING_WAY, TURNS_WELL
from coopqp.spatial import Array


@final
class LimitAvoidance:
    """Self-motion that keeps the joints of redundant arms off their limits on a path.

    Near a limit at distance d the slope of a joint towards it is at most ``S (d − m) / w``, with the margin m, the way
    w, and the arm's largest slope S in units of the joints' speeds. The least self-motion that keeps these bounds is
    taken. If none does, all bounds give way by the same, in units of the joints' speeds. An arm with more than one
    joint beyond six uses the self-motion that moves the joint that is worst off. Arms that share joints are one arm
    here.

    On the way the slope n of that joint along the self-motion changes by its bend κ. Away from the limit at the
    distance D it bends by itself where κ > 0, as with the elbow in the arm's plane, where n is 0: it wins back D where
    its slope has become ``√(2 κ D)``, which is counted with where n is smaller. Where κ < 0 it can win
    ``G = n² / 2|κ|`` and no more: ``n (1 + D / G)`` is counted with, so an elbow is not turned ever faster for nothing.

    Args:
        chain: evaluated and inverted where it is asked.
    """

    def __init__(self, chain: Chain) -> None:
        self._chain = chain
        limits = chain.cell.limits
        self._low, self._high = limits.lower + LIMIT_MARGIN, limits.upper - LIMIT_MARGIN
        parts = zip(chain.parts, chain.part_columns, strict=True)
        self._arms = [i for i, (part, c) in enumerate(parts) if len(c) > 6 * len(part)]

    def led_away(self, positions: Array, slope: Array) -> Array:
        """Slopes (nv,) at positions (nv,), those of redundant arms changed where a joint nears a limit."""
        slope = slope.copy()
        for i in self._arms:
            columns = self._chain.part_columns[i]
            slope[columns] = self._arm_led_away(i, positions[columns], slope[columns])
        return slope

    def _arm_led_away(self, i: int, x: Array, own: Array) -> Array:
        columns = self._chain.part_columns[i]
        scale = self._chain.scale[columns]
        largest = float((np.abs(own) / scale).max()) / TURNING_WAY
        if not largest > 0.0:
            return own
        up, down = largest * scale * (self._high[columns] - x), largest * scale * (self._low[columns] - x)
        beyond = np.maximum(own - up, down - own) / scale
        for worst in np.argsort(-beyond, kind="stable").tolist():
            if not beyond[worst] > 0.0:
                return own
            way, lever = self._lever(i, worst, x[worst], own[worst] > up[worst])
            if lever > 0.0:
                break
        else:
            return own
        moves = np.abs(way) > LEADS * lever
        moves[worst], moved = True, way.copy()
        moved[worst] = lever
        moved = moved[moves]
        a, b = (down[moves] - own[moves]) / moved, (up[moves] - own[moves]) / moved
        lows, highs, gives = np.minimum(a, b), np.maximum(a, b), scale[moves] / np.abs(moved)
        z = min(max(0.0, float(lows.max())), float(highs.min()))
        if lows.max() > highs.min():
            give = (lows[:, None] - highs) / (gives[:, None] + gives)
            row = int(give.argmax()) // len(highs)
            z = float(lows[row] - give.max() * gives[row])
        led: Array = own + z * way
        return led

    def _lever(self, i: int, worst: int, x: float, downwards: bool) -> tuple[Array, float]:
        """The self-motion (n,) of part ``i``, at unit speed, that leads a joint away from its limit.

        With its slope along it that is counted with; 0 if it cannot be led.
        """
        columns, limits, side = self._chain.part_columns[i], self._chain.cell.limits, -1.0 if downwards else 1.0
        scale = self._chain.scale[columns]
        way, share = self._self_motion(i, worst)
        if share > IN_PLANE:
            bend = side * self._bend(i, worst, way)
        else:  # that which bends it most; its first joint that turns well goes upwards
            bend = 0.0
            for j in range(len(columns)):
                motion, own_share = self._self_motion(i, j)
                if own_share > LEADS and (bends := side * self._bend(i, worst, motion)) > bend:
                    way, bend = motion, bends
            if way[int(np.argmax(np.abs(way) > TURNS_WELL * scale))] < 0.0:
                way = -way
        left = x - limits.lower[columns[worst]] if side > 0.0 else limits.upper[columns[worst]] - x
        slope, won = scale[worst] * float(np.sqrt(max(share, 0.0))), 2.0 * bend * max(left, 0.0)
        if won > 0.0:
            lever = max(slope, float(np.sqrt(won)))
            return way, lever if lever > LEADS * scale[worst] else 0.0
        lever = slope - won / slope if slope > 0.0 else 0.0
        return way, lever if lever > np.sqrt(LEADS) * scale[worst] else 0.0

    def _self_motion(self, i: int, j: int) -> tuple[Array, float]:
        """The self-motion (n,) of part ``i`` of its joint ``j``, at unit speed, and that joint's share of it."""
        columns = self._chain.part_columns[i]
        push = np.zeros(self._chain.nv)
        push[columns[j]] = 1.0
        motion = self._chain.null_part(push)[columns]
        share = float(motion[j])
        return motion * (self._chain.scale[columns[j]] / np.sqrt(share) if share > IN_PLANE else 0.0), share

    def _bend(self, i: int, j: int, way: Array) -> float:
        """How joint ``j`` of part ``i`` bends along a self-motion w (n,): ``−A⁺ A′(w) w``."""
        return -float(self._chain.inverses[i][j] @ (self._chain.part_slope(i, way) @ way))
