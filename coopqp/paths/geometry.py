"""The geometry of a path: where the object goes, without when.

A geometry is a chain of pieces over a parameter s, the motion of the object [m], where a turn of 1 rad counts as
:data:`TURN_LENGTH`. Twists per unit of s are given at the object's origin, in world axes: with ``T(s) = (R, p)`` the
twist is ``[p′; ω]``, ``R′ = [ω]× R``. They and their derivatives are exact; no spline passes through samples.
"""

from __future__ import annotations

import abc
import itertools
import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar, final

import numpy as np
import pinocchio as pin

from coopqp.core._core import NO_CORNER, RAMP_AT_MIDDLE, SHORTEST_LINE, TURN_LENGTH
from coopqp.errors import InvalidInputError
from coopqp.spatial import Array, as_placement, cross, rotations

_Number = TypeVar("_Number", float, Array)


@dataclass(frozen=True, eq=False)
class MotionBounds:
    """Bounds over M stretches of a piece, per unit of its parameter (M,).

    With ``p`` the object's origin and ``ω`` its turning in world axes:

    Attributes:
        way: of ‖p′‖ [m].
        turn: of ‖ω‖ [rad].
        way_change: of ‖p‴‖ [m].
        turn_change: of ‖ω″‖ [rad].
    """

    way: Array
    turn: Array
    way_change: Array
    turn_change: Array


class Piece(abc.ABC):
    """A smooth piece of a geometry, over its own s from 0 to :attr:`length` [m]."""

    length: float

    @abc.abstractmethod
    def poses(self, s: Array) -> tuple[Array, Array]:
        """Rotations (K, 3, 3) and origins (K, 3) [m] at s (K,)."""

    @abc.abstractmethod
    def twists(self, s: Array) -> tuple[Array, Array]:
        """Twists (K, 6) per unit of s, and their derivatives (K, 6)."""

    def pose(self, s: float) -> pin.SE3:
        """The pose at one s."""
        R, p = self.poses(np.array([s]))
        return pin.SE3(R[0], p[0])

    def twist(self, s: float) -> Array:
        """The twist (6,) at one s."""
        return self.twists(np.array([s]))[0][0]

    def bounds(self, low: Array, high: Array) -> MotionBounds | None:
        """Bounds of the motion between s of ``low`` and ``high`` (M,); None by default: nothing is known.

        With them :func:`coopqp.check_path` proves the piece, also one of your own.
        """
        return None

    @abc.abstractmethod
    def numbers(self) -> Array:
        """The piece as numbers, from which :func:`piece_of` makes it again, bit for bit."""


def motion_length(displacement: Array, angle: float) -> float:
    """Length of a motion [m], turns included."""
    return math.hypot(float(np.linalg.norm(displacement)), TURN_LENGTH * angle)


@final
@dataclass(frozen=True, eq=False)
class Straight(Piece):
    """The origin moves on a line while the object turns about an axis that is fixed in it.

    Attributes:
        R, p: pose at the start, (3, 3) and (3,) [m].
        turn: rotation vector in the object's frame (3,) [rad].
        way: displacement in the world (3,) [m].
        length: length of s [m].
    """

    R: Array
    p: Array
    turn: Array
    way: Array
    length: float

    def poses(self, s: Array) -> tuple[Array, Array]:
        """See :class:`Piece`."""
        share = s / self.length
        return self.R @ rotations(share[:, None] * self.turn), self.p + share[:, None] * self.way

    def twists(self, s: Array) -> tuple[Array, Array]:
        """See :class:`Piece`. The axis is fixed in the world, too: the twist is constant."""
        return np.tile(self._twist, (len(s), 1)), np.zeros((len(s), 6))

    def bounds(self, low: Array, high: Array) -> MotionBounds:
        """See :class:`Piece`. The twist is constant."""
        ones = np.ones(len(low))
        way, turn = (float(np.linalg.norm(part)) / self.length for part in (self.way, self.turn))
        return MotionBounds(way * ones, turn * ones, 0.0 * ones, 0.0 * ones)

    def pose(self, s: float) -> pin.SE3:
        """See :class:`Piece`; a tenth of the time."""
        share = s / self.length
        return pin.SE3(self.R.dot(pin.exp3(share * self.turn)), self.p + share * self.way)

    def twist(self, s: float) -> Array:
        """See :class:`Piece`."""
        return self._twist

    @cached_property
    def _twist(self) -> Array:
        return np.concatenate([self.way, self.R @ self.turn]) / self.length

    def numbers(self) -> Array:
        """R row by row, p, turn, way, length: 19 numbers."""
        return np.concatenate([self.R.ravel(), self.p, self.turn, self.way, [self.length]])

    def part(self, start: float, end: float) -> Straight:
        """The piece from ``start`` to ``end`` [m]."""
        T = self.pose(start)
        share = (end - start) / self.length
        return Straight(*_rows(T), share * self.turn, share * self.way, end - start)


def _rows(T: pin.SE3) -> tuple[Array, Array]:
    """R and p of a pose, R row by row: Pinocchio's own is column by column, and its products round otherwise."""
    return np.array(T.rotation, order="C"), np.array(T.translation)


def ramp(x: _Number) -> tuple[_Number, _Number, _Number]:
    """A ramp β from 0 at x = −1 to x = 1 at x = 1 with its first two derivatives; α = x − β is its mirror.

    β′ is the cubic smooth step, so β joins its lines with continuous second derivative.
    """
    return (
        3.0 / 16.0 + x * (0.5 + x * (3.0 / 8.0 - x * x / 16.0)),
        0.5 + x * (0.75 - 0.25 * x * x),
        0.75 * (1.0 - x * x),
    )


@final
@dataclass(frozen=True, eq=False)
class Blend(Piece):
    """A smooth way past a corner C: ``p = p_C + α e_0 + β e_1``, ``R = R_C exp(α w_0) exp(β w_1)``.

    It begins and ends on the two lines of the corner with their twists, and with continuous second derivative.
    Its distance from the lines is at most 3/16 ‖e_1 − e_0‖, its angle at most 3/16 ‖w_1 − w_0‖: with β ≤ 3/16 before
    the middle the distance from the first line is β ‖e_1 − e_0‖; rotations are no further apart than their vectors.

    Attributes:
        R, p: pose of the corner.
        turns: w_0, w_1 (2, 3) [rad], of the incoming and outgoing line over half of the blend.
        ways: e_0, e_1 (2, 3) [m].
        length: length of s [m].
    """

    R: Array
    p: Array
    turns: Array
    ways: Array
    length: float

    def poses(self, s: Array) -> tuple[Array, Array]:
        """See :class:`Piece`."""
        x = 2.0 * s / self.length - 1.0
        b = ramp(x)[0]
        a, b = (y[:, None] for y in (x - b, b))
        R = self.R @ rotations(a * self.turns[0]) @ rotations(b * self.turns[1])
        return R, self.p + a * self.ways[0] + b * self.ways[1]

    def twists(self, s: Array) -> tuple[Array, Array]:
        """See :class:`Piece`. In world axes ω = R_C (α′ w_0 + β′ exp(α w_0) w_1)."""
        half = 0.5 * self.length
        x = s / half - 1.0
        b, db, ddb = (y[:, None] for y in ramp(x))
        a, da = x[:, None] - b, 1.0 - db
        (e0, e1), w0 = self.ways, self.turns[0]
        w1 = rotations(a * w0) @ self.turns[1]
        V = np.hstack([da * e0 + db * e1, (da * w0 + db * w1) @ self.R.T]) / half
        bend = cross(np.tile(w0, (len(s), 1)), w1)
        dV = np.hstack([ddb * (e1 - e0), (ddb * (w1 - w0) + da * db * bend) @ self.R.T]) / (half * half)
        return V, dV

    def bounds(self, low: Array, high: Array) -> MotionBounds:
        """See :class:`Piece`.

        In x, ``p‴ = β‴ (e_1 − e_0)``, and with ``w = exp(α w_0) w_1``

            ω″ = R_C [β‴ (w − w_0) + β″ (2α′ − β′) w_0 × w + α′² β′ w_0 × (w_0 × w)]

        where ``‖w − w_0‖ ≤ ‖w_1 − w_0‖ + |α| c`` and ``‖w_0 × w‖ = ‖w_0 × w_1‖ = c``. β′ grows from 0 to 1, ``α′ =
        1 − β′`` and ``|α|`` fall, β″ is largest next to the middle, and ``β‴ = −3x/2``.
        """
        half = 0.5 * self.length
        x, y = low / half - 1.0, high / half - 1.0
        a = np.abs(x - ramp(x)[0])
        da, db = 1.0 - ramp(x)[1], ramp(y)[1]
        ddb = ramp(np.clip(0.0, x, y))[2]
        dddb = 1.5 * np.maximum(np.abs(x), np.abs(y))
        (e0, e1), (w0, w1) = self.ways, self.turns
        size_e0, size_e1, size_w0, size_w1 = (float(np.linalg.norm(v)) for v in (e0, e1, w0, w1))
        bent, turned = float(np.linalg.norm(e1 - e0)), float(np.linalg.norm(w1 - w0))
        c = float(np.linalg.norm(cross(w0[None], w1[None])))
        turn_change = dddb * (turned + a * c) + ddb * np.maximum(2.0 * da, db) * c + da * da * db * size_w0 * c
        return MotionBounds(
            (da * size_e0 + db * size_e1) / half,
            (da * size_w0 + db * size_w1) / half,
            dddb * bent / half**3,
            turn_change / half**3,
        )

    def pose(self, s: float) -> pin.SE3:
        """See :class:`Piece`; a fifth of the time."""
        x = 2.0 * s / self.length - 1.0
        b = ramp(x)[0]
        R = self.R.dot(pin.exp3((x - b) * self.turns[0])).dot(pin.exp3(b * self.turns[1]))
        return pin.SE3(R, self.p + (x - b) * self.ways[0] + b * self.ways[1])

    def numbers(self) -> Array:
        """R row by row, p, both turns, both ways, length: 25 numbers."""
        return np.concatenate([self.R.ravel(), self.p, self.turns.ravel(), self.ways.ravel(), [self.length]])


def piece_of(numbers: Array) -> Straight | Blend:
    """The piece whose :meth:`Piece.numbers` are given.

    Raises:
        InvalidInputError: they do not describe a piece.
    """
    where = "piece of a geometry"
    x = np.asarray(numbers, dtype=float)
    if x.shape not in ((19,), (25,)) or not np.isfinite(x).all() or not x[-1] > 0.0:
        raise InvalidInputError("not 19 or 25 finite numbers with a length > 0", where, "Give those of numbers().")
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = x[:9].reshape(3, 3), x[9:12]
    as_placement(T, where)
    if x.size == 19:
        return Straight(x[:9].reshape(3, 3), x[9:12], x[12:15], x[15:18], float(x[-1]))
    return Blend(x[:9].reshape(3, 3), x[9:12], x[12:18].reshape(2, 3), x[18:24].reshape(2, 3), float(x[-1]))


@final
@dataclass(frozen=True, eq=False)
class PathGeometry:
    """Pieces in a row.

    Attributes:
        pieces: at least one; each begins where the one before ends.
    """

    pieces: tuple[Piece, ...]

    @cached_property
    def marks(self) -> Array:
        """s at the ends of the pieces (P + 1,) [m]; the first is 0."""
        return np.cumsum([0.0, *(piece.length for piece in self.pieces)])

    @property
    def length(self) -> float:
        """Length of s [m]."""
        return float(self.marks[-1])

    @cached_property
    def corners(self) -> tuple[int, ...]:
        """Indices of the marks at which the twist jumps: an object on this path has to rest there."""
        found = []
        for i, (before, after) in enumerate(itertools.pairwise(self.pieces)):
            ends = before.twists(np.array([before.length]))[0], after.twists(np.zeros(1))[0]
            if np.abs(ends[1] - ends[0]).max() > NO_CORNER:
                found.append(i + 1)
        return tuple(found)

    def stretches(self) -> tuple[PathGeometry, ...]:
        """The geometries between corners."""
        cuts = [0, *self.corners, len(self.pieces)]
        return tuple(PathGeometry(self.pieces[a:b]) for a, b in itertools.pairwise(cuts))

    def poses(self, s: Array) -> tuple[Array, Array]:
        """Rotations (K, 3, 3) and origins (K, 3) [m] at s (K,), increasing; s is clipped to the geometry."""
        R, p = np.empty((len(s), 3, 3)), np.empty((len(s), 3))
        for piece, here, local in self._split(s):
            R[here], p[here] = piece.poses(local)
        return R, p

    def twists(self, s: Array) -> tuple[Array, Array]:
        """Twists (K, 6) per unit of s and their derivatives (K, 6); at a mark those after it."""
        V, dV = np.empty((len(s), 6)), np.empty((len(s), 6))
        for piece, here, local in self._split(s):
            V[here], dV[here] = piece.twists(local)
        return V, dV

    def pose(self, s: float) -> pin.SE3:
        """The pose at one s [m]."""
        piece, local = self._piece(s)
        return piece.pose(local)

    def twist(self, s: float) -> Array:
        """Twist per unit of s at one s, shape (6,)."""
        piece, local = self._piece(s)
        return piece.twist(local)

    def _piece(self, s: float) -> tuple[Piece, float]:
        """The piece on which s lies, and s on it."""
        i = min(max(bisect_right(self._starts, s) - 1, 0), len(self.pieces) - 1)
        piece = self.pieces[i]
        return piece, min(max(s - self._starts[i], 0.0), piece.length)

    @cached_property
    def _starts(self) -> list[float]:
        return self.marks[:-1].tolist()

    def _split(self, s: Array) -> list[tuple[Piece, slice, Array]]:
        """Pieces with the part of s that lies on each, in the piece's own s."""
        cuts = [0, *np.searchsorted(s, self.marks[1:-1]).tolist(), len(s)]
        return [
            (piece, slice(a, b), np.clip(s[a:b] - mark, 0.0, piece.length))
            for piece, mark, a, b in zip(self.pieces, self.marks[:-1], cuts[:-1], cuts[1:], strict=True)
            if b > a
        ]


def blended(lines: Sequence[Straight], *, distance: float | Array, angle: float | Array) -> PathGeometry:
    """Lines whose corners are rounded off by blends that stay within a distance [m] and an angle [rad] of them.

    A blend takes at most half of each line. Corners stay where ``distance`` or ``angle`` is 0. Both are one number for
    all corners, or one each.
    """
    cuts: list[float] = [0.0]  # length of s that the blend at each end of a line takes
    corners = max(len(lines) - 1, 0)
    tolerances = np.broadcast_to(distance, corners).tolist(), np.broadcast_to(angle, corners).tolist()
    for a, b, widest, most in zip(lines, lines[1:], *tolerances, strict=False):
        apart = float(np.linalg.norm(b.way / b.length - a.way / a.length)) * RAMP_AT_MIDDLE
        turned = float(np.linalg.norm(b.turn / b.length - a.turn / a.length)) * RAMP_AT_MIDDLE
        longest = [0.5 * min(a.length, b.length)]
        longest += [limit / size for limit, size in ((widest, apart), (most, turned)) if size > NO_CORNER]
        cuts.append(min(longest) if len(longest) > 1 else 0.0)
    cuts.append(0.0)
    pieces: list[Piece] = []
    for i, line in enumerate(lines):
        if line.length - cuts[i] - cuts[i + 1] > SHORTEST_LINE:
            pieces.append(line.part(cuts[i], line.length - cuts[i + 1]))
        half = cuts[i + 1]
        if half > 0.0:
            T = line.pose(line.length)
            both = line, lines[i + 1]
            turns = np.array([half / x.length * x.turn for x in both])
            ways = np.array([half / x.length * x.way for x in both])
            pieces.append(Blend(*_rows(T), turns, ways, 2.0 * half))
    return PathGeometry(tuple(pieces))
