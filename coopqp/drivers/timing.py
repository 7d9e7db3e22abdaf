"""Time of the loop: its clock, stamps of the robots' own clocks, and how late its periods are."""

from __future__ import annotations

import time
from collections import deque
from typing import Protocol, final


class LoopTime(Protocol):
    """The clock of the loop."""

    def now(self) -> float:
        """Present time [s]; it never goes back."""
        ...

    def sleep_until(self, moment: float) -> None:
        """Wait until a time [s]; at once if it is over."""
        ...


@final
class MonotonicTime:
    """The machine's monotonic clock."""

    def now(self) -> float:
        """Present time [s]."""
        return time.monotonic()

    def sleep_until(self, moment: float) -> None:
        """Wait until a time [s]."""
        rest = moment - time.monotonic()
        if rest > 0.0:
            time.sleep(rest)


@final
class ManualTime:
    """Time that goes on only when it is waited for: runs in simulation are the same each time, and need no sleep."""

    def __init__(self, start: float = 0.0) -> None:
        self._now = start

    def now(self) -> float:
        """Present time [s]."""
        return self._now

    def sleep_until(self, moment: float) -> None:
        """Go on to a time [s]."""
        self._now = max(self._now, moment)


@final
class ClockOffset:
    """Offset of a robot's clock: the least time by which states arrived after their stamps, seen in a window.

    Args:
        window: number of states that are looked back at.
    """

    def __init__(self, window: int = 500) -> None:
        self._least: deque[tuple[int, float]] = deque()  # rising; the first is the least of the window
        self._count, self._window = 0, window

    def take(self, stamp: float, arrival: float) -> float:
        """Take a state's stamp on the robot's clock and its arrival on the loop's; return the offset [s]."""
        late = arrival - stamp
        while self._least and self._least[-1][1] >= late:
            self._least.pop()
        self._least.append((self._count, late))
        self._count += 1
        while self._least[0][0] <= self._count - 1 - self._window:
            self._least.popleft()
        return self._least[0][1]

    @property
    def offset(self) -> float:
        """The loop's time minus the robot's [s]; 0 before the first state."""
        return self._least[0][1] if self._least else 0.0
