"""The trail: what redundant arms travelled, so that they can go back through the same configurations."""

from __future__ import annotations

from typing import final

import numpy as np

from coopqp.model.cell import RobotCell
from coopqp.paths.elbows import Elbows
from coopqp.spatial import Array

#: Knots that are kept at most: then every second one is dropped, and fewer are noted.
MOST_KEPT = 1024
#: Time between two knots at first [s].
_BETWEEN = 0.032
#: Knots are at least so far from each other on the clock [s].
_NEAREST = 1e-4
#: At a path speed below this σ, joint velocities say little about how positions depend on the clock.
_SLOWEST = 0.02


@final
class Trail:
    """Joint positions over the program's clock, from where the run began to where it is: cubics through knots.

    Going back takes knots away, going on adds some.

    Args:
        cell: the arms.
        dt: nominal length of a step [s].
    """

    def __init__(self, cell: RobotCell, *, dt: float) -> None:
        self._turning = np.flatnonzero(cell.continuous)
        #: Steps between two knots.
        self._first_stride = self.stride = max(1, round(_BETWEEN / dt))
        #: Clock [s], positions and velocities (nv,), path speed σ; no velocities where they are not known.
        self._knots: list[tuple[float, Array, Array | None, float]] = []
        self._last: Array | None = None  # positions as they were given

    def __len__(self) -> int:
        return len(self._knots)

    def begin(self, clock: float, x: Array) -> None:
        """Start anew at joint positions (nv,)."""
        self.stride = self._first_stride
        self._last = x.copy()
        self._knots = [(clock, self._last, None, 0.0)]

    def note(self, clock: float, x: Array, velocity: Array, rate: float) -> None:
        """A knot at the end of a step: where the joints are (nv,), with what velocities (nv,), at a path speed σ."""
        if self._last is None:
            return self.begin(clock, x)
        x = self._gone_on(self._knots[-1][1], self._last, x)
        if clock - self._knots[-1][0] < _NEAREST:
            clock = self._knots.pop()[0]
        self._knots.append((clock, x, velocity, rate))
        if len(self._knots) > MOST_KEPT:
            kept = [*self._knots[:-1:2], self._knots[-1]]  # copies, so that what held the others is free
            self._knots = [(at, q.copy(), None if v is None else v.copy(), sigma) for at, q, v, sigma in kept]
            self.stride *= 2
        return None

    def _gone_on(self, before: Array, last: Array, x: Array) -> Array:
        """Positions x that were ``last``, over whole turns from those ``before``."""
        self._last = x
        if not self._turning.size:
            return x
        way, turns = x - last, self._turning
        way[turns] -= 2.0 * np.pi * np.round(way[turns] / (2.0 * np.pi))
        return before + way

    def cut(self, clock: float, x: Array) -> None:
        """Forget what was travelled beyond a clock, where the joints are at x (nv,) now."""
        before = [knot for knot in self._knots if knot[0] < clock - _NEAREST]
        if not before:
            return self.begin(clock, x)
        last = before[-1][1]
        self._knots = [*before, (clock, self._gone_on(last, last, x.copy()), None, 0.0)]
        return None

    def back(self, begin: float) -> Elbows | None:
        """The motion back from a clock over the clock of the way back; None where nothing was travelled.

        Beyond where the run began the arms stay as near as they can to how it began.
        """
        knots = [knot for knot in self._knots if knot[0] <= begin + _NEAREST][::-1]
        if len(knots) < 2:
            return None
        clocks, x = begin - np.array([knot[0] for knot in knots]), np.array([knot[1] for knot in knots])
        elbows = Elbows.through(clocks, x)
        slopes = elbows.slopes.copy()
        for i, (_, _, velocity, rate) in enumerate(knots):
            if velocity is not None and rate >= _SLOWEST:
                slopes[i] = -velocity / rate
        return Elbows(clocks, x, slopes)

    def copy(self) -> Trail:
        """A copy that shares nothing that changes."""
        other: Trail = object.__new__(Trail)
        vars(other).update(vars(self) | {"_knots": list(self._knots)})
        return other
