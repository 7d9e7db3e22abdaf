"""Commands that hold at a time, for a robot that takes them without one: the driver interpolates."""

from __future__ import annotations

from collections import deque
from typing import final

import numpy as np

from coopqp.spatial import Array

#: The first command is led over to from where the robot stands, in this time at most [s].
_FIRST = 0.01


@final
class StampedCommands:
    """Commands in straight lines between the times at which they hold.

    Args:
        q: positions before the first command (n,) [rad or m].
    """

    def __init__(self, q: Array) -> None:
        self._commands: deque[tuple[float, Array]] = deque([(-np.inf, np.array(q, dtype=float))])

    def push(self, at: float, q: Array) -> None:
        """Take positions (n,) that hold at a time [s]; those that are not later than the last are ignored."""
        commands = self._commands
        if at > commands[-1][0]:
            if commands[-1][0] == -np.inf:
                commands.append((at - _FIRST, commands[-1][1]))
            commands.append((at, np.array(q, dtype=float)))

    def at(self, moment: float) -> Array:
        """The positions at a time [s] (n,). What is older than that is forgotten."""
        commands = self._commands
        while len(commands) > 2 and commands[1][0] <= moment:
            commands.popleft()
        if len(commands) < 2 or not np.isfinite(commands[0][0]):
            return commands[0][1]
        (t0, a), (t1, b) = commands[0], commands[1]
        return a + min(max((moment - t0) / (t1 - t0), 0.0), 1.0) * (b - a)
