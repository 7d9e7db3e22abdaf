"""How far the commands lead the arms apart: the definition of the core's ``apart.cpp``.

The arms' views O_k of the object should be one. Their errors without the mean are lengths at the grasps, turns
included, as in the supervision. Two parts of them were asked for, and do not count as long as they are corrected: the
mismatch of a start, and shifts of the grasps. Both are followed as a step corrects them: it makes up for what grasps
were shifted by since the step before, and takes a share of all other errors away. What is left is then compared with
the errors themselves: it is the share of it that they still show, and never grows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import final

import numpy as np

from coopqp.control.monitoring.supervision import grasp_lengths
from coopqp.model.grasp import Grasp
from coopqp.native.constants import ALIKE, NO_MISMATCH, SAID_APART, TOGETHER_AGAIN
from coopqp.spatial import Array

#: An arm that is not where its joints are led.
OFF_WAY = "arm {arm} is not on the way of its joints: {joint} is {far:.3g} rad (or m) off"
#: Two arms that their commands part.
PARTED = "arms {arm} and {other} are commanded {mm:.2g} mm apart"


@dataclass(eq=False)
class Apart:
    """Distances of the arms in one sample.

    Attributes:
        distance: the largest distance of an arm's view of the object from the others' [m].
        arms: the arm that is furthest from the others, and the one that is furthest from it, in the cell's order.
        holds: it is so large that the arms hold.
        mismatch: what is left of the expected mismatch (N, 6); None if nothing is.
    """

    distance: float = 0.0
    arms: tuple[int, int] = (0, 0)
    holds: bool = False
    mismatch: Array | None = None


@final
class ChainWatch:
    """The watch of one controller.

    Args:
        grasp: how the arms hold the object.
        hold_from: distance at which the arms hold [m]; None for no such distance.
    """

    def __init__(self, grasp: Grasp, hold_from: float | None) -> None:
        self._at_grasps, self._hold_from = grasp_lengths(grasp), math.inf if hold_from is None else hold_from

    def look(self, errors: Array, mismatch: Array | None, *, started: bool, held: bool) -> Apart:
        """Compare the errors of the arms (N, 6) with each other.

        Args:
            errors: e_k.
            mismatch: the expected mismatch so far.
            started: False in the first step: whatever the errors show is then the mismatch of the start.
            held: the arms are held already.
        """
        n = len(errors)
        if n < 2:
            return Apart()
        away = among_arms(errors)
        if not started:
            mismatch = away
        if mismatch is not None:
            square = float((mismatch * mismatch).sum())
            left = min(max(float((away * mismatch).sum()) / square, 0.0), 1.0) if square > 0.0 else 0.0
            away = away - left * mismatch
            mismatch = left * mismatch if left * left * square > NO_MISMATCH**2 else None
        away = away @ self._at_grasps
        distances = np.linalg.norm(away, axis=1)
        arm = int((distances * ALIKE >= distances.max()).argmax())
        distance = float(distances[arm]) * n / (n - 1.0)
        holds = not distance <= self._hold_from * (TOGETHER_AGAIN if held else 1.0)
        arms = (0, 0)
        if distance > SAID_APART:
            between = np.linalg.norm(away - away[arm], axis=1)
            between[arm] = -1.0
            other = int(between.argmax())
            arms = min(arm, other), max(arm, other)
        return Apart(distance, arms, holds, mismatch)


def expected(mismatch: Array | None, asked: Array | None, closes: float) -> Array | None:
    """The mismatch (N, 6) that is left after a step; None for none.

    Args:
        mismatch: the mismatch in the step; None for none.
        asked: shift of the grasps before it, without the mean of all (N, 6); None for none.
        closes: share that the step takes away of all other errors.
    """
    if mismatch is None and asked is None:
        return None
    left: Array = sum((part for part in (mismatch, asked) if part is not None), start=np.zeros(1))
    return (1.0 - closes) * left


def among_arms(errors: Array) -> Array:
    """Errors (N, 6) without their mean."""
    out: Array = errors - errors.sum(axis=0) / len(errors)
    return out
