"""The geometry of paths as functions of the share of each segment: a proof in shares holds for every time law.

A segment is a piece that tells bounds of its motion (:meth:`coopqp.paths.geometry.Piece.bounds`): straight lines about
one axis each, blends, and pieces of a user's geometry that have them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from coopqp.paths.geometry import MotionBounds, Piece, Straight
from coopqp.paths.path import ObjectPath
from coopqp.paths.section import Section
from coopqp.paths.time_law import TimeLaw
from coopqp.paths.timed import TimedPath
from coopqp.spatial import Array, Flags

_NUMBERS = 29
_X = np.arange(1, 12) / 12.0
#: Shares of a quintic segment at clocks that are spread evenly.
_SLOW = _X**3 * (10.0 - 15.0 * _X + 6.0 * _X**2)

Indices = npt.NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Segments:
    """S segments of a path: pieces of a geometry, over the share of each.

    Attributes:
        pieces: S pieces whose bounds are known.
        start, duration: first clock and duration of each (S,) [s].
        quintic: True where the time law is quintic, else linear (S,).
        when: of a path with a speed profile of its own, its ``clocks`` of the motion [m]; None for time laws.
        where: its reverse: numbers of segments, and shares of them, at clocks [s]; None where nobody asks.
    """

    pieces: tuple[Piece, ...]
    start: Array
    duration: Array
    quintic: Flags
    when: Callable[[Array], Array] | None = None
    where: Callable[[Array], Array] | None = None

    def __len__(self) -> int:
        return len(self.pieces)

    @cached_property
    def lengths(self) -> Array:
        """Length of each piece (S,) [m]."""
        return np.array([piece.length for piece in self.pieces])

    def split(self, places: Array) -> tuple[Indices, Array]:
        """Numbers of segments (M,), and shares of them (M,), at places (M,): their sums."""
        segment = np.clip(np.floor(places).astype(np.intp), 0, len(self) - 1)
        return segment, places - segment

    def poses(self, segment: Indices, share: Array) -> Array:
        """T_world_object (M, 4, 4) at shares (M,) of segments (M,)."""
        T = np.zeros((len(share), 4, 4))
        T[:, 3, 3] = 1.0
        for piece, here in self._of_pieces(segment):
            T[here, :3, :3], T[here, :3, 3] = piece.poses(share[here] * piece.length)
        return T

    def twists(self, segment: Indices, share: Array) -> tuple[Array, Array]:
        """Twists of the object about its own origin in world axes (M, 6), and their derivatives, per share [m, rad]."""
        V, dV = np.empty((len(share), 6)), np.empty((len(share), 6))
        for piece, here in self._of_pieces(segment):
            V[here], dV[here] = piece.twists(share[here] * piece.length)
        size = self.lengths[segment][:, None]
        return V * size, dV * size**2

    def bounds(self, segment: Indices, low: Array, high: Array) -> MotionBounds:
        """Bounds of the motion between two shares (M,) of segments (M,), per share."""
        way, turn, way_change, turn_change = (np.empty(len(low)) for _ in range(4))
        for piece, here in self._of_pieces(segment):
            size = piece.length
            found = piece.bounds(low[here] * size, high[here] * size)
            assert found is not None
            way[here], turn[here] = found.way * size, found.turn * size
            way_change[here], turn_change[here] = found.way_change * size**3, found.turn_change * size**3
        return MotionBounds(way, turn, way_change, turn_change)

    def _of_pieces(self, segment: Indices) -> Iterator[tuple[Piece, Indices]]:
        """Pieces with the rows of ``segment`` (M,) that are on each."""
        order = np.argsort(segment, kind="stable")
        cuts = np.flatnonzero(np.diff(segment[order])) + 1
        for here in np.split(order, cuts) if len(order) else ():
            yield self.pieces[segment[here[0]]], here

    def clocks(self, segment: Indices, share: Array) -> Array:
        """Clocks [s] at which the object is at shares (M,) of segments (M,)."""
        if self.when is not None:
            starts = np.cumsum(self.lengths) - self.lengths
            return self.when(starts[segment] + share * self.lengths[segment])
        x = np.where(self.quintic[segment], TimeLaw.QUINTIC.inverse(share), share)
        return self.start[segment] + x * self.duration[segment]

    def knots(self, T_object_tool: pin.SE3, *, distance: float, angle: float, pieces: int) -> tuple[Indices, Array]:
        """Segments and shares of knots between which a tool moves by little, and not much time goes by.

        The ends of segments are among them.

        Args:
            T_object_tool: placement of the tool on the object.
            distance, angle: largest motion of the tool between knots [m, rad].
            pieces: least number of pieces of a segment.
        """
        every = np.arange(len(self))
        whole = self.bounds(every, np.zeros(len(self)), np.ones(len(self)))
        turned = whole.turn
        moved = whole.way + turned * float(np.linalg.norm(T_object_tool.translation))
        counts = np.maximum(np.ceil(np.maximum(moved / distance, turned / angle)), pieces).astype(int)
        segment, share = [0], [0.0]
        for s, count in enumerate(counts.tolist()):
            knots = np.arange(1, count + 1) / count
            if self.quintic[s]:  # the object stays long near both ends
                slow = _SLOW[np.minimum(_SLOW, 1.0 - _SLOW) * count < 1.0]
                knots = np.union1d(knots, slow)
            segment += [s] * len(knots)
            share += knots.tolist()
        return np.array(segment, dtype=np.intp), np.array(share)


def segments_of(path: ObjectPath) -> Segments | None:
    """The segments of a path; None where only its poses are known, its corners are rounded, or it does not end."""
    if not (np.isfinite(path.duration) and path.known_ahead):
        return None
    numbers = None if isinstance(path, (TimedPath, Section)) else path.packed()
    if numbers is None:
        return _timed(path)
    breakpoints, count = int(numbers[1]), int(numbers[2])
    rows = np.asarray(numbers[3 + breakpoints :]).reshape(count, _NUMBERS)
    return Segments(
        pieces=tuple(
            # The length only scales s: shares are the same for any.
            Straight(row[:9].reshape(3, 3), row[9:12], row[12:15], row[15:18], 1.0)
            for row in rows
        ),
        start=rows[:, 18],
        duration=rows[:, 19],
        quintic=rows[:, 20] != 0.0,
    )


def _timed(path: ObjectPath) -> Segments | None:
    """The segments of a path with a geometry; None where it has none, or a piece tells no bounds of its motion."""
    geometry = path.geometry()
    if geometry is None:
        return None
    end = np.zeros(1)
    if any(piece.bounds(end, end + piece.length) is None for piece in geometry.pieces):
        return None
    clocks = path.clocks(np.cumsum(np.array([0.0, *(piece.length for piece in geometry.pieces)])))
    return Segments(
        pieces=geometry.pieces,
        start=clocks[:-1],
        duration=np.diff(clocks),
        quintic=np.ones(len(geometry.pieces), dtype=bool),  # it rests at both ends: knots are spread as for this law
        when=path.clocks,
    )
