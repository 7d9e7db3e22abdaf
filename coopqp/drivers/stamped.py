"""Commands that hold at a time, for a robot that takes them without one: the driver interpolates."""

from __future__ import annotations

import itertools
from collections import deque
from typing import final

import numpy as np

from coopqp.spatial import Array

#: The first command is led over to from where the robot stands, in this time at most [s].
_FIRST = 0.01
#: For so many periods after the last command it goes on evenly, and then stands.
_EVENLY = 2.0


@final
class StampedCommands:
    """Commands as a curve over the times at which they hold.

    :meth:`line` is in straight lines between them. :meth:`at` is their mean with the weights of a triangle, a period to
    either side: for even times a uniform cubic B-spline, with a continuous second derivative that is nowhere larger
    than the largest second difference of commands over the square of their period. It needs the commands up to a period
    ahead; where they have not come it takes them for even.

    Args:
        q: positions before the first command (n,) [rad or m].
    """

    def __init__(self, q: Array) -> None:
        self._commands: deque[tuple[float, Array]] = deque([(-np.inf, np.array(q, dtype=float))])
        self._period = np.inf

    def push(self, at: float, q: Array) -> None:
        """Take positions (n,) that hold at a time [s]; those that are not later than the last are ignored."""
        commands = self._commands
        if at > commands[-1][0]:
            if commands[-1][0] == -np.inf:
                commands.append((at - _FIRST, commands[-1][1]))
            self._period = min(self._period, at - commands[-1][0])
            commands.append((at, np.array(q, dtype=float)))

    def line(self, moment: float) -> Array:
        """The positions at a time [s] (n,), in straight lines. What is older than that is forgotten."""
        self._forget(moment)
        (t0, a), *later = self._commands
        for t1, b in later:
            if moment < t1:
                return a + max((moment - t0) / (t1 - t0), 0.0) * (b - a) if np.isfinite(t0) else a
            t0, a = t1, b
        return a

    def at(self, moment: float) -> Array:
        """The positions at a time [s] (n,) on the smooth curve. What is older than two periods is forgotten."""
        h = self._period
        if not np.isfinite(h):
            return self._commands[0][1]
        self._forget(moment - h)
        (t0, a), (t1, b) = self._commands[-2], self._commands[-1]
        even = (b - a) / (t1 - t0)
        goal = b + _EVENLY * h * even
        knots = [*self._commands, (t1 + _EVENLY * h, goal), (np.inf, goal)]
        value, before = np.zeros(len(b)), np.zeros(len(b))
        for (t0, a), (t1, b) in itertools.pairwise(knots):
            slope = (b - a) / (t1 - t0)
            if t0 <= moment < t1:
                value += a if t0 == -np.inf else a + (moment - t0) * slope
            away = abs(moment - t0)
            if away < h:  # what a bend adds to the mean
                value += (slope - before) * ((h - away) ** 3 / (6.0 * h * h))
            before = slope
        return value

    def _forget(self, moment: float) -> None:
        while len(self._commands) > 3 and self._commands[2][0] <= moment:
            self._commands.popleft()
