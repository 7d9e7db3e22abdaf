"""The trail: what redundant arms travelled, so that they can go back through the same configurations."""

from __future__ import annotations

from typing import final

import numpy as np
import pinocchio as pin

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
        self._cell, self._turns_on = cell, not cell.euclidean
        self._first_stride = self.stride = max(1, round(_BETWEEN / dt))
        self._left = self.stride
        #: Clock [s], positions (nv,) and their change per second of the clock (nv,), None where it is not known.
        self._knots: list[tuple[float, Array, Array | None]] = []
        self._last_q: Array | None = None

    def __len__(self) -> int:
        return len(self._knots)

    def begin(self, clock: float, q: Array) -> None:
        """Start anew at a configuration (nq,)."""
        self.stride = self._left = self._first_stride
        self._knots = [(clock, self._cell.positions(q), None)]
        self._last_q = np.array(q)

    def due(self, steps: int = 1) -> bool:
        """Count steps; whether the end of the last one is a knot."""
        self._left -= steps
        return self._left <= 0

    def note(self, clock: float, q: Array, velocity: Array, rate: float) -> None:
        """A knot at the end of a step: where the arms are (nq,), with what velocities (nv,), at a path speed σ."""
        self._left = self.stride
        if self._last_q is None:
            return self.begin(clock, q)
        if self._turns_on:  # over whole turns
            x = self._knots[-1][1] + pin.difference(self._cell.model, self._last_q, q)
            self._last_q = np.array(q)
        else:
            x = self._last_q = np.array(q)
        slope = velocity / rate if rate >= _SLOWEST else None
        if clock - self._knots[-1][0] < _NEAREST:
            clock = self._knots.pop()[0]
        self._knots.append((clock, x, slope))
        if len(self._knots) > MOST_KEPT:
            self._knots = [*self._knots[:-1:2], self._knots[-1]]
            self.stride *= 2
        return None

    def cut(self, clock: float, q: Array) -> None:
        """Forget what was travelled beyond a clock, where the arms are at ``q`` (nq,) now."""
        before = [knot for knot in self._knots if knot[0] < clock - _NEAREST]
        if not before:
            return self.begin(clock, q)
        last = self._cell.configuration_of(before[-1][1])
        x = before[-1][1] + pin.difference(self._cell.model, last, q)
        self._knots, self._last_q, self._left = [*before, (clock, x, None)], np.array(q), self.stride
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
        for i, (_, _, slope) in enumerate(knots):
            if slope is not None:
                slopes[i] = -slope
        return Elbows(clocks, x, slopes)

    def copy(self) -> Trail:
        """A copy that shares nothing that changes."""
        other: Trail = object.__new__(Trail)
        vars(other).update(vars(self) | {"_knots": list(self._knots)})
        return other
