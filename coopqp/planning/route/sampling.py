"""Straight lines with corners rounded off, between poses that a search has found."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

from coopqp.core._core import TURN_LENGTH
from coopqp.paths.geometry import PathGeometry, Straight, blended
from coopqp.planning.route.tree import Pose, between, length_of
from coopqp.spatial import Array


def rounded(poses: Sequence[Pose], deviations: Array) -> PathGeometry:
    """Straight lines from each pose to the next, with corners rounded off.

    Args:
        poses: both ends, and the corners.
        deviations: at most this far from each corner [m]; an angle of it over 0.3 m.
    """
    lines = []
    for a, b in itertools.pairwise(poses):
        way, turn = between(a, b)
        lines.append(Straight(a.R, a.p, turn, way, length_of(way, turn)))
    return blended(lines, distance=deviations, angle=deviations / TURN_LENGTH)
