"""Geometry of a user's path, from its poses and twists at clocks."""

from __future__ import annotations

import itertools
from typing import Any, final

import numpy as np

from coopqp.core._core import TURN_LENGTH
from coopqp.errors import InvalidInputError
from coopqp.paths.geometry import PathGeometry, Piece
from coopqp.paths.guarded import GuardedPath, twist_distance
from coopqp.paths.path import ObjectPath
from coopqp.spatial import Array

#: Clocks at which a piece is measured, and nodes of its clock over s.
_MEASURED, _NODES = 1001, 161
#: A twist may jump where it changes by this many times as much as before and after.
_SUDDEN = 3.0
#: Within this share of the length from an end the twist per unit of s is the one there: at rest it is 0/0.
_AT_END = 1e-4
#: A piece rests where it moves at less than this share of its largest speed.
_RESTS = 1e-3
#: Ends of a piece are evaluated this far inside its breakpoints, as a share of the duration.
_INSET = 1e-9
#: Step of the differences of twists, as a share of the piece's duration.
_DIFFERENCE = 1e-4
#: Motion below this counts as rest [m].
_STILL = 1e-9


def sampled_geometry(path: ObjectPath) -> PathGeometry | None:
    """Pieces between the breakpoints of a path, declared or found; None where it stays.

    Poses and twists are those of the path; derivatives of twists are differences.

    Raises:
        InvalidInputError: the path fails, or jumps.
    """
    guarded = GuardedPath(path)
    guarded.check("the path")
    marks = [0.0, *guarded.breakpoints(), guarded.duration]
    marks += [kink for span in itertools.pairwise(marks) for kink in _kinks(guarded, *span)]
    marks.sort()
    pieces = [ClockPiece(guarded, a, b) for a, b in itertools.pairwise(marks)]
    moving = tuple(piece for piece in pieces if piece.length > _STILL)
    return PathGeometry(moving) if moving else None


def _kinks(path: GuardedPath, start: float, end: float) -> list[float]:
    """Clocks between two breakpoints at which the twist jumps, undeclared [s]."""
    clocks = np.linspace(start, end, _MEASURED)
    clocks[[0, -1]] += np.array([_INSET, -_INSET]) * (end - start)
    found = [path.twist(clock) for clock in clocks.tolist()]
    twists = [twist for twist in found if twist is not None]
    if len(twists) < len(found):
        raise InvalidInputError(path.problem, "the path", "Give twists at any clock.")
    change = np.array([twist_distance(a, b) for a, b in itertools.pairwise(twists)])
    beside = np.maximum(np.append(change[1:], 0.0), np.insert(change[:-1], 0, 0.0))
    kinks = [path.kink(*clocks[i : i + 2].tolist()) for i in np.flatnonzero(change > _SUDDEN * beside)]
    return [kink for kink in kinks if kink is not None]


@final
class ClockPiece(Piece):
    """A piece of a path between two clocks [s]. Its clock over s is a smooth, increasing function.

    Which function does not matter, as long as its derivatives are its own: ``V = ν τ′``, ``V′ = ν̇ τ′² + ν τ″``.
    """

    def __init__(self, path: GuardedPath, start: float, end: float) -> None:
        from scipy.interpolate import CubicSpline, PchipInterpolator

        self._path, self._start, self._end = path, start, end
        clocks = np.linspace(start, end, _MEASURED)
        V = self._world_twists(clocks)
        speeds = np.hypot(np.linalg.norm(V[:, :3], axis=1), TURN_LENGTH * np.linalg.norm(V[:, 3:], axis=1))
        done = np.concatenate([[0.0], np.cumsum(0.5 * (speeds[1:] + speeds[:-1]) * np.diff(clocks))])
        self.length = float(done[-1])
        if self.length <= _STILL:
            return
        keep = np.concatenate([[True], np.diff(done) > 1e-12 * done[-1]])
        keep[-1] = True
        self._rests = bool((speeds[[0, -1]] < _RESTS * speeds.max()).any())
        x = np.linspace(0.0, 1.0, _NODES)
        times = PchipInterpolator(done[keep], clocks[keep])(self.length * self._share(x)[0])
        times[0], times[-1] = start, end
        self._clock: Any = CubicSpline(x, times)
        if (np.diff(self._clock(np.linspace(0.0, 1.0, 8 * _NODES))) <= 0.0).any():
            self._clock = PchipInterpolator(x, times)

    def _clocks(self, s: Array) -> tuple[Array, Array, Array]:
        """Clocks of the path at s (K,) [s], with first and second derivatives."""
        share = s / self.length
        x = share
        if self._rests:
            near, far = np.cbrt(np.clip(share, 0.0, 1.0)), np.cbrt(np.clip(1.0 - share, 0.0, 1.0))
            x = near / (near + far)
        _, w, dw = self._share(x)
        w = np.maximum(w, 1e-12)
        slope, bend = 1.0 / (self.length * w), -dw / (self.length**2 * w**3)  # of x
        first, second = self._clock(x, 1), self._clock(x, 2)
        return np.clip(self._clock(x), self._start, self._end), first * slope, second * slope**2 + first * bend

    def _share(self, x: Array) -> tuple[Array, Array, Array]:
        """s over the length as a function of x in [0, 1], about the path's own time, with its derivatives.

        ``x³/(x³ + (1 − x)³)`` where the path rests at an end: from rest s often grows as the cube of time.
        """
        if not self._rests:
            return x, np.ones_like(x), np.zeros_like(x)
        D, dD = 1.0 - 3.0 * x + 3.0 * x * x, 6.0 * x - 3.0
        g, dg = (x * (1.0 - x)) ** 2, 2.0 * x * (1.0 - x) * (1.0 - 2.0 * x)
        return x**3 / D, 3.0 * g / D**2, 3.0 * (dg * D - 2.0 * g * dD) / D**3

    def poses(self, s: Array) -> tuple[Array, Array]:
        """See :class:`Piece`."""
        found = [self._path.pose(clock) for clock in self._clocks(s)[0].tolist()]
        poses = [pose for pose in found if pose is not None]
        if len(poses) < len(found):
            raise InvalidInputError(self._path.problem, "the path", "Give poses at any clock.")
        return np.array([T.rotation for T in poses]), np.array([T.translation for T in poses])

    def twists(self, s: Array) -> tuple[Array, Array]:
        """See :class:`Piece`."""
        clocks, slope, bend = self._clocks(np.clip(s, _AT_END * self.length, (1.0 - _AT_END) * self.length))
        h = _DIFFERENCE * (self._end - self._start)
        inside = np.clip(clocks, self._start + 3.0 * h, self._end - 3.0 * h)
        at = {k: self._world_twists(inside + k * h) for k in (-2, -1, 1, 2)}
        change = (8.0 * (at[1] - at[-1]) - (at[2] - at[-2])) / (12.0 * h)
        V = self._world_twists(clocks)
        return V * slope[:, None], change * slope[:, None] ** 2 + V * bend[:, None]

    def numbers(self) -> Array:
        """A user's path has none."""
        raise InvalidInputError("a path of your own cannot be written", "TimedPath.record", "Give lines or placements.")

    def _world_twists(self, clocks: Array) -> Array:
        """Twists (K, 6) per second at the object's origin, in world axes."""
        inset = _INSET * (self._end - self._start)
        V = np.empty((len(clocks), 6))
        for i, clock in enumerate(np.clip(clocks, self._start + inset, self._end - inset).tolist()):
            pose, twist = self._path.pose(clock), self._path.twist(clock)
            if pose is None or twist is None:
                raise InvalidInputError(self._path.problem, "the path", "Give poses and twists at any clock.")
            V[i, :3], V[i, 3:] = pose.rotation @ twist[:3], pose.rotation @ twist[3:]
        return V
