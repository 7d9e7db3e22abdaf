"""The newest state of every robot, on the loop's time, and where it is along the way."""

from __future__ import annotations

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
    """

    def __init__(self, robot: Robot, patience: float | None) -> None:
        self.robot = robot
        self.patience = max(2.0 * robot.driver.period, 0.005) if patience is None else patience
        self._clock = ClockOffset()
        self.state: RobotState | None = None
        self.moment, self.fresh = -np.inf, False
        self.received = self.lost = self.refused = 0
        self.refusal = ""

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
        if state is None:
            return
        self.refusal = self._refusal_of(state)
        if self.refusal:
            self.refused += 1
            return
        self._clock.take(state.stamp, now)
        if self.state is not None:
            missed = round((state.stamp - self.state.stamp) / self.robot.driver.period) - 1
            # A robot that is read more seldom than it tells has lost nothing.
            self.lost += max(0, missed) if now - self._read_at < 1.5 * self.robot.driver.period else 0
        self._read_at = now
        self.state, self.fresh = state, True
        self.moment = state.stamp + self._clock.offset
        self.received += 1

    _read_at = -np.inf

    def _refusal_of(self, state: RobotState) -> str:
        """Why a state is of no use; empty if it is of use."""
        n = len(self.robot.joints)
        for name, value in (("positions", state.q), ("velocities", state.velocity), ("a target", state.target)):
            if value is not None and np.shape(value) != (n,):
                return f"{name} of shape {np.shape(value)} for {n} joints"
        if not (np.isfinite(state.q).all() and np.isfinite(state.stamp)):
            return "positions or a stamp that are no numbers"
        if self.state is not None and not state.stamp > self.state.stamp:
            return f"a stamp of {state.stamp:g} s after {self.state.stamp:g} s"
        return ""

    def age(self, now: float) -> float:
        """Age of the newest state [s]."""
        return now - self.moment

    def missing(self, now: float) -> bool:
        """Whether the newest state is too old to be used."""
        return not now - self.moment <= self.patience

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
