"""Self-motion of redundant arms where a joint nears its position limit."""

from __future__ import annotations

from typing import final

import numpy as np
import numpy.typing as npt

from coopqp.model.chain import Chain
from coopqp.native.constants import LEADS, LIMIT_MARGIN, TURNING_WAY
from coopqp.spatial import Array


@final
class LimitAvoidance:
    """Self-motion that keeps the joints of redundant arms off their limits on a path.

    Near a limit at distance d the slope of a joint towards it is at most ``S (d − m) / w``, with the margin m, the way
    w, and the arm's largest slope S in units of the joints' speeds. The least self-motion that keeps these bounds is
    taken. If none does, all bounds give way by the same, in units of the joints' speeds. An arm with more than one
    joint beyond six uses the self-motion that moves the joint that is worst off. Arms that share joints are one arm
    here.

    Args:
        chain: evaluated and inverted where it is asked.
    """

    def __init__(self, chain: Chain) -> None:
        self._chain = chain
        limits = chain.cell.limits
        self._low, self._high = limits.lower + LIMIT_MARGIN, limits.upper - LIMIT_MARGIN
        parts = zip(chain.parts, chain.part_columns, strict=True)
        self._arms: list[npt.NDArray[np.intp]] = [c for part, c in parts if len(c) > 6 * len(part)]

    def led_away(self, positions: Array, slope: Array) -> Array:
        """Slopes (nv,) at positions (nv,), those of redundant arms changed where a joint nears a limit."""
        slope = slope.copy()
        for columns in self._arms:
            slope[columns] = self._arm_led_away(columns, positions[columns], slope[columns])
        return slope

    def _arm_led_away(self, columns: npt.NDArray[np.intp], x: Array, own: Array) -> Array:
        scale = self._chain.scale[columns]
        largest = float((np.abs(own) / scale).max()) / TURNING_WAY
        if not largest > 0.0:
            return own
        up, down = largest * scale * (self._high[columns] - x), largest * scale * (self._low[columns] - x)
        beyond = np.maximum(own - up, down - own) / scale
        for worst in np.argsort(-beyond, kind="stable").tolist():
            if not beyond[worst] > 0.0:
                return own
            push = np.zeros(self._chain.nv)
            push[columns[worst]] = 1.0
            way = self._chain.null_part(push)[columns]
            if way[worst] > LEADS:
                break
        else:
            return own
        moves = np.abs(way) > LEADS * way[worst]
        a, b = (down[moves] - own[moves]) / way[moves], (up[moves] - own[moves]) / way[moves]
        lows, highs, gives = np.minimum(a, b), np.maximum(a, b), scale[moves] / np.abs(way[moves])
        z = min(max(0.0, float(lows.max())), float(highs.min()))
        if lows.max() > highs.min():
            give = (lows[:, None] - highs) / (gives[:, None] + gives)
            i = int(give.argmax()) // len(highs)
            z = float(lows[i] - give.max() * gives[i])
        led: Array = own + z * way
        return led
