"""The geometry of the library's own paths: straight lines about one axis each, as functions of the share of the way.

Along a segment the object's twist about its own origin, per share of the segment and in world axes, is constant. A
proof in shares holds for every time law.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from coopqp.spatial import Array, rotations
from coopqp.task.geometry import Straight
from coopqp.task.path import ObjectPath

_NUMBERS = 29
_X = np.arange(1, 12) / 12.0
#: Shares of a quintic segment at clocks that are spread evenly.
_SLOW = _X**3 * (10.0 - 15.0 * _X + 6.0 * _X**2)

Indices = npt.NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Segments:
    """S segments of a path.

    Attributes:
        R: rotation of the object at the start of each segment (S, 3, 3).
        p: its origin there (S, 3) [m].
        turn: rotation vector of each segment in the object's frame (S, 3) [rad].
        way: displacement of the origin in the world (S, 3) [m].
        start, duration: first clock and duration of each (S,) [s].
        quintic: True where the time law is quintic, else linear (S,).
        lengths, when: of a path with a speed profile of its own, the length of each segment (S,) [m] and its
            ``clocks``; None for time laws.
    """

    R: Array
    p: Array
    turn: Array
    way: Array
    start: Array
    duration: Array
    quintic: npt.NDArray[np.bool_]
    lengths: Array | None = None
    when: Callable[[Array], Array] | None = None

    def __len__(self) -> int:
        return len(self.start)

    @property
    def twists(self) -> Array:
        """Twist of the object about its own origin in world axes, per share of each segment (S, 6) [m, rad]."""
        turned: Array = (self.R @ self.turn[:, :, None])[:, :, 0]
        return np.concatenate([self.way, turned], axis=1)

    def poses(self, segment: Indices, share: Array) -> Array:
        """T_world_object (M, 4, 4) at shares (M,) of segments (M,)."""
        w = self.turn[segment] * share[:, None]
        T = np.zeros((len(share), 4, 4))
        T[:, :3, :3] = self.R[segment] @ rotations(w)
        T[:, :3, 3] = self.p[segment] + self.way[segment] * share[:, None]
        T[:, 3, 3] = 1.0
        return T

    def clocks(self, segment: Indices, share: Array) -> Array:
        """Clocks [s] at which the object is at shares (M,) of segments (M,)."""
        if self.when is not None and self.lengths is not None:
            starts = np.cumsum(self.lengths) - self.lengths
            return self.when(starts[segment] + share * self.lengths[segment])
        from scipy.special import betaincinv

        # 10x³ − 15x⁴ + 6x⁵ is the regularised incomplete beta function of (3, 3).
        x = np.where(self.quintic[segment], betaincinv(3.0, 3.0, share), share)
        out: Array = self.start[segment] + x * self.duration[segment]
        return out

    def knots(self, T_object_tool: pin.SE3, *, distance: float, angle: float, pieces: int) -> tuple[Indices, Array]:
        """Segments and shares of knots between which a tool moves by little, and not much time goes by.

        The ends of segments are among them.

        Args:
            T_object_tool: placement of the tool on the object.
            distance, angle: largest motion of the tool between knots [m, rad].
            pieces: least number of pieces of a segment.
        """
        turned = np.linalg.norm(self.turn, axis=1)
        moved = np.linalg.norm(self.way, axis=1) + turned * float(np.linalg.norm(T_object_tool.translation))
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
    numbers = path.packed()
    if numbers is None:
        return _timed(path)
    breakpoints, count = int(numbers[1]), int(numbers[2])
    rows = np.asarray(numbers[3 + breakpoints :]).reshape(count, _NUMBERS)
    return Segments(
        R=rows[:, :9].reshape(-1, 3, 3),
        p=rows[:, 9:12],
        turn=rows[:, 12:15],
        way=rows[:, 15:18],
        start=rows[:, 18],
        duration=rows[:, 19],
        quintic=rows[:, 20] != 0.0,
    )


def _timed(path: ObjectPath) -> Segments | None:
    """The segments of a path with a geometry; None where it has none, or rounded corners."""
    geometry = path.geometry()
    if geometry is None:
        return None
    lines = [piece for piece in geometry.pieces if isinstance(piece, Straight)]
    if len(lines) < len(geometry.pieces):
        return None
    lengths = np.array([line.length for line in lines])
    clocks = path.clocks(np.cumsum(np.concatenate([[0.0], lengths])))
    return Segments(
        R=np.array([line.R for line in lines]),
        p=np.array([line.p for line in lines]),
        turn=np.array([line.turn for line in lines]),
        way=np.array([line.way for line in lines]),
        start=clocks[:-1],
        duration=np.diff(clocks),
        quintic=np.ones(len(lines), dtype=bool),  # it rests at both ends, so knots are spread as for this law
        lengths=lengths,
        when=path.clocks,
    )
