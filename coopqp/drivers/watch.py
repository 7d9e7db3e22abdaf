"""The newest state of every robot, on the loop's time, and where it is along the way."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import final

import numpy as np

from coopqp.drivers.driver import Condition, RobotState
from coopqp.drivers.robots import Robot
from coopqp.drivers.timing import ClockOffset, LoopTime
from coopqp.errors import said
from coopqp.spatial import Array

#: A state is carried on by its velocity for this time at most [s].
_FURTHEST = 0.003
#: So many of the last states say how often a robot tells them, and so many have to.
_GAPS, _ENOUGH = 50, 4


@final
class RobotWatch:
    """Reads one robot.

    Args:
        robot: the robot.
        patience: age at which a state counts as missing [s].

    Attributes:
        state: the newest state; None before the first.
        moment: when it was on the loop's time [s].
        fresh: it came with the last reading.
        received, lost, refused: how many states came, are missing by their stamps, and were no use: old, or no numbers.
        refusal: why the last state was refused; empty where it was not.
        offset: the loop's time minus the robot's [s].
        lack: for how long the states were missing, forgotten at a tenth of the time without a gap [s].
    """

    def __init__(self, robot: Robot, patience: float | None) -> None:
        self.robot = robot
        self.patience = max(2.0 * robot.driver.period, 0.005) if patience is None else patience
        self._clock = ClockOffset()
        self.state: RobotState | None = None
        self.moment, self.fresh = -np.inf, False
        self.received = self.lost = self.refused = 0
        self.refusal = ""
        self.lack, self._set_back = 0.0, 0.0
        #: Times between two states, on the robot's clock and on the loop's, and between two readings [s].
        self._gaps: deque[tuple[float, float]] = deque(maxlen=_GAPS)
        self._readings: deque[float] = deque(maxlen=_GAPS)
        self._read_at = self._came_at = -np.inf

    @property
    def offset(self) -> float:
        """The loop's time minus the robot's [s]."""
        return self._clock.offset

    def read(self, time: LoopTime) -> None:
        """Take the newest state, if there is one. Where the driver raises there is none; :attr:`refusal` says so."""
        self.fresh = False
        try:
            state = self.robot.driver.read()
        except Exception as error:
            self.refused, self.refusal = self.refused + 1, f"its driver raised {said(error)}"
            return
        now = time.now()  # after the reading: a stall between would make the state older than it is
        self._readings.append(now - self._read_at)
        self._read_at = now
        if state is None:
            return
        self.refusal = self._refusal_of(state)
        if self.refusal:
            self.refused += 1
            return
        self._clock.take(state.stamp, now)
        if self.state is not None:
            self._gaps.append((state.stamp - self.state.stamp, now - self._came_at))
            missed = round((state.stamp - self.state.stamp) / self.robot.driver.period) - 1
            # A robot that is read more seldom than it tells has lost nothing.
            self.lost += max(0, missed) if self._gaps[-1][1] < 1.5 * self.robot.driver.period else 0
        self._came_at = now
        self.state, self.fresh = state, True
        self.moment = state.stamp + self._clock.offset
        self.received += 1

    def _refusal_of(self, state: RobotState) -> str:
        """Why a state is of no use; empty if it is of use."""
        n = len(self.robot.joints)
        for name, value in (("positions", state.q), ("velocities", state.velocity), ("a target", state.target)):
            if value is not None and np.shape(value) != (n,):
                return f"{name} of shape {np.shape(value)} for {n} joints"
        if not (np.isfinite(state.q).all() and np.isfinite(state.stamp)):
            return "positions or a stamp that are no numbers"
        if self.state is not None and not state.stamp > self.state.stamp:
            self._set_back = max(self._set_back, self.state.stamp - state.stamp)
            return f"a stamp of {state.stamp:g} s after {self.state.stamp:g} s"
        return ""

    def age(self, now: float) -> float:
        """Age of the newest state [s]."""
        return now - self.moment

    def missing(self, now: float) -> bool:
        """Whether the newest state is too old to be used."""
        return not now - self.moment <= self.patience

    def account(self, now: float, period: float) -> bool:
        """Count a period of the loop [s] in which the state is missing or not; say whether it is missing."""
        missing = self.missing(now)
        self.lack = max(self.lack + (period if missing else -0.1 * period), 0.0)
        return missing

    def unlike_told(self) -> str:
        """What the times of the last states say against what the driver tells, a sentence; empty if nothing does."""
        robot, told = self.robot, self.robot.driver.period
        if not self._gaps:
            use = f" of use ({self.refusal})" if self.refusal else ""
            return f"robot '{robot.name}' told one state, and then none{use}. Look at its network and its program."
        if len(self._gaps) < _ENOUGH:
            return ""
        stamps, arrivals = np.median(np.array(self._gaps), axis=0)
        if not 0.5 * arrivals < stamps < 2.0 * arrivals:
            return (
                f"robot '{robot.name}' stamps its states {1e3 * stamps:.3g} ms apart, and they come every "
                f"{1e3 * arrivals:.3g} ms. "
                "Let its driver give stamps in seconds."
            )
        if stamps > 1.5 * max(told, float(np.median(np.array(self._readings)))):
            return (
                f"robot '{robot.name}' tells its state every {1e3 * stamps:.3g} ms, and its driver says "
                f"{1e3 * told:.3g} ms. Let the driver tell the true period."
            )
        return ""

    def trouble(self, now: float, gone_after: float) -> str:
        """Why a robot without states is given up, a sentence; empty if it is not."""
        age, name = self.age(now), self.robot.name
        use = f" of use ({self.refusal})" if self.refusal else ""
        if age > gone_after:
            return f"robot '{name}' told no state{use} for {1e3 * age:.0f} ms, and where it stands is not known"
        if self.lack > gone_after:
            if self._set_back > self.patience:
                why = f"its clock was set back by {1e3 * self._set_back:.0f} ms"
            else:
                why = self.unlike_told().rstrip(".") or "they come late or too seldom"
            return (
                f"robot '{name}' told no state younger than {1e3 * self.patience:.3g} ms for {1e3 * self.lack:.0f} ms "
                f"in sum: {why}"
            )
        return ""

    def condition(self) -> Condition:
        """What the robot says of itself."""
        return Condition.RUNNING if self.state is None else self.state.condition

    def wrench(self, arm: str) -> Array | None:
        """The newest state's wrench of an arm of this robot (6,); None where it tells none."""
        wrench = None if self.state is None else self.state.wrench
        if isinstance(wrench, Mapping):
            return wrench.get(arm)
        return wrench if self.robot.arms == (arm,) else None

    def positions(self) -> Array:
        """Positions (n,) of the newest state [rad or m]; NaN before the first."""
        return np.full(len(self.robot.joints), np.nan) if self.state is None else np.asarray(self.state.q)

    def aligned(self, now: float) -> tuple[Array, float]:
        """Positions (n,) carried on by their velocity, for 3 ms at most, and the time that they hold for [s]."""
        state = self.state
        assert state is not None
        ahead = min(max(now - self.moment, 0.0), _FURTHEST)
        v = np.asarray(state.velocity, dtype=float)
        return state.q + np.where(np.isfinite(v), v, 0.0) * ahead, self.moment + ahead
