"""The motion of all arms: the way, the shared clock along it, what is sent, and where each robot is behind it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import final

import numpy as np

from coopqp.core._core import LONGEST_LAG
from coopqp.drivers.command_spline import CommandSpline
from coopqp.drivers.driver import RobotState
from coopqp.drivers.follow_slowest import FollowSlowest
from coopqp.drivers.limited_clock import LimitedClock
from coopqp.drivers.options import LoopOptions
from coopqp.drivers.play_out import PlayOut
from coopqp.drivers.robots import Robot, turned
from coopqp.model.cell import RobotCell
from coopqp.spatial import Array

#: Lags are learnt where a robot moves at this share of its speed limits at least.
_LEARNS_FROM = 1e-3
#: Below this share of its speed limits a robot's place says little of how late it is.
_SLOW = 5e-3
#: A robot that is no further off its place along the way than its joints together travel in this time at their largest
#: speeds is not late [s].
RESOLUTION = 1e-4
#: Leaps between states are averaged over this time [s], and one counts as this share of the speed limits at most.
_LEAPS, _ONE_LEAP = 0.5, 10.0
#: How far robots and their commands went is forgotten in this time [s].
_OF_LATE = 0.5
#: Off what it hangs at rest is taken in this time [s].
_SAG_TIME = 0.03
#: Periods of the history of the shared clock.
_HISTORY = 1024


@final
class SharedMotion:
    """Commands of all joints along the controller's way, at the rate of the slowest robot.

    Args:
        cell: the arms.
        robots: the robots, with what their drivers tell of lag and delay.
        x: where they begin, at rest (nv,) [rad or m].
        clock: the controller's clock there [s].
        command_period: the controller's dt [s].
        period, lead: of the loop [s].
        options: of the loop.

    Attributes:
        way: the controller's commands as a curve.
        shared: the clock along it.
        play_out: what is sent.
        law: the rate.
        lag: lag of each robot, as told or learnt so far (robots,) [s].
        sent, before: the commands of the last period and of the one before (nv,) [rad or m].
        lateness: of each robot along the way (robots,) [s]; NaN while it is not known.
        sag: how far joints hang off their commands at rest, as servos do under load (nv,) [rad or m]: no lateness.
        away: how far joints are from where they should be (nv,) [rad or m].
        leaps: by how much faster each robot's joints go from state to state than it says, as a share of their speed
            limits: the mean of the last half second (robots,).
    """

    def __init__(
        self,
        cell: RobotCell,
        robots: Sequence[Robot],
        x: Array,
        *,
        clock: float,
        command_period: float,
        period: float,
        lead: float,
        options: LoopOptions,
    ) -> None:
        self._cell, self._robots, self._options, self._h = cell, tuple(robots), options, period
        limits = {"velocity": cell.limits.velocity, "acceleration": cell.limits.acceleration}
        self.way = CommandSpline(x, clock=clock, period=command_period)
        self.shared = LimitedClock(self.way, period=period, **limits)
        n = len(self._robots)
        self.lag = np.array([robot.driver.lag or 0.0 for robot in self._robots])
        delay = np.array([robot.driver.delay for robot in self._robots])
        self._delay = delay
        self._unknown = np.array([robot.driver.lag is None for robot in self._robots])
        #: Sums of (u − y) ẏ and ẏ² of what each robot measures, and of its target: their ratio is the lag.
        self._sums = np.zeros((n, 2, 2))
        self._targets: dict[int, tuple[float, Array]] = {}
        self._learning = np.full(n, options.learning_time)
        #: By how much what a robot tells as its target is behind what it is sent, where that is learnt [s].
        self.target_lag = np.zeros(n)
        self.play_out = PlayOut(
            x, lag=self.joints(self.lag), delay=self.joints(delay), period=period, lower=cell.limits.lower,
            upper=cell.limits.upper, shared=np.isin(np.arange(cell.nv), cell.shared), **limits,
        )  # fmt: skip
        self.law = FollowSlowest(n, period=period)
        self._lead = lead
        self._wait = lead + float(delay.max(initial=0.0))
        self.lateness = np.full(n, np.nan)
        self.sag, self.away = np.zeros(cell.nv), np.zeros(cell.nv)
        #: The lateness that RESOLUTION makes of each robot.
        self._allowed = np.zeros(n)
        #: The rate at which each robot goes along the way, how far it and its commands went of late [s], and where both
        #: were seen last, at what time.
        self._own, self._went = np.zeros(n), np.zeros((2, n))
        self._seen: list[tuple[float, Array, Array] | None] = [None] * n
        self.leaps = np.zeros(n)
        self._told: list[RobotState | None] = [None] * n
        self._learnt = False
        self._times = np.full(_HISTORY, -np.inf)
        self._past = np.zeros((_HISTORY, 2))
        #: What was sent, and where joints and targets should be with their lags behind it (…, 3, nv).
        self._sent_past = np.tile(x, (_HISTORY, 3, 1))
        self._followed = np.tile(x, (3, 1))
        self._at = -1
        self.velocity_share = self.acceleration_share = 0.0
        self.sent = self.before = x.copy()

    def joints(self, values: Array) -> Array:
        """A value of each robot for each of its joints (nv,)."""
        full = np.zeros(self._cell.nv)
        for value, robot in zip(values, self._robots, strict=True):
            full[robot.joints] = value
        return full

    # -- where a robot is ------------------------------------------------------------------------------------------

    def _between(self, wanted: float) -> tuple[int, int, float]:
        """The rows of the history before and after a time, and the share of the second."""
        if self._at < 0:
            return 0, 0, 0.0
        first = self._at + 1
        low, high = 0, _HISTORY - 1  # bisection: the times of the ring rise from its oldest row
        if not wanted < self._times[(first + high) % _HISTORY]:
            return self._at, self._at, 0.0
        while high - low > 1:
            middle = (low + high) // 2
            if self._times[(first + middle) % _HISTORY] <= wanted:
                low = middle
            else:
                high = middle
        i, j = (first + low) % _HISTORY, (first + high) % _HISTORY
        before = self._times[i]
        if not (np.isfinite(before) and before <= wanted):
            return j, j, 0.0
        return i, j, float((wanted - before) / (self._times[j] - before))

    def expected(self, moment: float) -> tuple[float, float]:
        """The curve's parameter p that all robots should be at at a time, and its rate there."""
        i, j, u = self._between(moment - self._wait)
        value = (1.0 - u) * self._past[i] + u * self._past[j]
        return float(value[0]), float(value[1])

    def _commanded(self, k: int, which: int, moment: float) -> Array:
        """What robot k was to follow at a time (n,): 0 as sent, 1 its joints with their lag, 2 its target with its."""
        i, j, u = self._between(moment - self._lead - self._delay[k])
        joints = self._robots[k].joints
        value: Array = (1.0 - u) * self._sent_past[i, which, joints] + u * self._sent_past[j, which, joints]
        return value

    def watch(self, k: int, state: RobotState, moment: float, q: Array, aligned: float) -> Array:
        """Take where robot k is; return how far it is from where it should be (n,), what is along the way aside.

        Args:
            k: index of the robot.
            state: its newest state, of the loop's time ``moment`` [s].
            q: its positions (n,) [rad or m], carried on to the time ``aligned`` [s].
        """
        joints = self._robots[k].joints
        scale = 1.0 / self._cell.limits.velocity[joints] ** 2
        p, rate = self.expected(aligned)
        slope = self.way.slope(p)[joints]
        away = turned(self._cell, q - self._commanded(k, 1, aligned), joints)
        off: Array = away + _behind(away, slope, scale, 1e-2 * _SLOW) * slope
        learns = self._learning[k] > 0.0
        if learns:
            self._learn(k, state, moment, scale)
        place, wanted = np.asarray(state.q, dtype=float), self._commanded(k, 1, moment)
        if state.target is not None:
            place, wanted = np.asarray(state.target, dtype=float), self._commanded(k, 2, moment)
            away = turned(self._cell, place - wanted, joints)
        self.away[joints] = away
        seen = _behind(away - self.sag[joints], slope, scale, _SLOW)
        if learns and seen > 0.0:
            # What may be lag is no lateness yet; an arm that stops is soon behind more than that.
            unknown = LONGEST_LAG if self._unknown[k] else self.lag[k]
            left = self._learning[k] / self._options.learning_time
            seen = max(seen - unknown * left * max(rate, 0.0), 0.0)
        self.lateness[k] = seen
        speed = math.sqrt(float(slope @ (scale * slope)))
        self._allowed[k] = RESOLUTION * speed / (speed * speed + _SLOW**2)
        last = self._seen[k]
        if last is not None and moment > last[0]:
            time, moved = moment - last[0], turned(self._cell, place - last[1], joints)
            own = -_behind(moved, slope, scale, _SLOW)
            asked = -_behind(wanted - last[2], slope, scale, _SLOW)
            self._own[k] = own / time
            self._went[:, k] *= max(1.0 - time / _OF_LATE, 0.0)
            self._went[:, k] += own, asked
        self._seen[k] = moment, place.copy(), wanted
        self._find_leaps(k, state)
        return off

    def _find_leaps(self, k: int, state: RobotState) -> None:
        joints, last = self._robots[k].joints, self._told[k]
        self._told[k] = state
        if last is None or not state.stamp > last.stamp:
            return
        time, most = state.stamp - last.stamp, self._cell.limits.velocity[joints]
        came = np.abs(turned(self._cell, state.q - last.q, joints)) / (most * time)
        says = np.maximum(np.abs(state.velocity), np.abs(last.velocity)) / most
        leap = min(max(float((came - np.where(np.isfinite(says), says, 0.0)).max()), 0.0), _ONE_LEAP)
        self.leaps[k] += min(time / _LEAPS, 1.0) * (leap - self.leaps[k])

    def _learn(self, k: int, state: RobotState, moment: float, scale: Array) -> None:
        """Learn the lag of a robot, L ẏ = u − y for a first-order one, and that of its target."""
        joints = self._robots[k].joints
        wanted = self._commanded(k, 0, moment)
        speed = np.asarray(state.velocity, dtype=float)
        size = float(speed @ (scale * speed))
        if not size > _LEARNS_FROM**2:
            return
        self._learning[k] -= self._h
        if self._unknown[k]:
            away = turned(self._cell, wanted - state.q + self.sag[joints], joints)
            self.lag[k] = self._take(k, 0, away, speed, scale)
            self._learnt = True
        if state.target is not None:
            last = self._targets.get(k)
            if last is not None and state.stamp > last[0]:
                moves = turned(self._cell, state.target - last[1], joints) / (state.stamp - last[0])
                self.target_lag[k] = self._take(k, 1, turned(self._cell, wanted - state.target, joints), moves, scale)
            self._targets[k] = state.stamp, np.array(state.target)

    def _take(self, k: int, which: int, away: Array, speed: Array, scale: Array) -> float:
        sums = self._sums[k, which]
        sums += float(away @ (scale * speed)), float(speed @ (scale * speed))
        return min(max(float(sums[0] / sums[1]), 0.0), LONGEST_LAG) if sums[1] > 0.0 else 0.0

    def lose(self, k: int) -> None:
        """It is not known where robot k is."""
        self.lateness[k] = np.nan

    # -- one period ------------------------------------------------------------------------------------------------

    def needs_command(self) -> bool:
        """Whether the controller has to go on before :meth:`step`."""
        return self.way.head < self.shared.sigma + self._h * (1.0 + 1e-9)

    def step(self, moment: float, *, most: float, said: Array, stand: bool) -> Array:
        """The commands of a period (nv,).

        Args:
            moment: beginning of the period [s].
            most: largest rate of the shared clock, 0 to 1.
            said: which robots say that they have stopped (robots,).
            stand: brake, and stay where the brake ends.
        """
        # What moves away from its commands where they stand did not fall behind.
        fell = np.minimum(self._went[1] - self._went[0], self._went[1])
        rate = self.law.step(self.lateness, self._allowed, self._own, fell, said)
        if self.law.hangs:
            known = self.joints(np.isfinite(self.lateness))
            self.sag += self._h / (_SAG_TIME + self._h) * known * (self.away - self.sag)
        play_out, shared = self.play_out, self.shared
        if stand:
            wanted = 0.0
        else:
            self.law.rate = rate = min(rate, most)
            wanted = self.law.clock_rate(play_out.parameter, play_out.time_constant, shared.sigma)
            wanted = min(wanted, most)
        if wanted < 0.0:  # the way is kept for a while only
            wanted = max(wanted, -(shared.sigma - max(self.way.tail, -1.0) - 1.0) / 0.5, -1.0)
        c = shared.step(wanted)
        if self._learnt and play_out.rests():
            play_out.retune(self.joints(self.lag))
            self._learnt = False
        share = self._options.learning_addition if self._learnt else self._options.addition
        before = self.sent
        self.sent = play_out.step(c, shared.sigma, self.way, self.joints(self.lag), share)
        self._at = (self._at + 1) % _HISTORY
        self._times[self._at] = moment
        self._past[self._at] = play_out.parameter, play_out.rate
        self._follow(before)
        self._account(before)
        return self.sent

    def _follow(self, before: Array) -> None:
        """Where joints and targets should be: L ẏ = u − y, for what is sent in straight lines between two periods."""
        h, u, slope = self._h, self.sent, (self.sent - before) / self._h
        rows = self._sent_past[self._at]
        rows[0] = u
        for which, lags in ((1, self.lag), (2, self.target_lag)):
            L = self.joints(lags)
            with np.errstate(divide="ignore"):
                left = np.exp(-h / L)  # 0 without a lag
            rows[which] = u - L * slope + left * (self._followed[which] - before + L * slope)
        self._followed = rows.copy()

    def _account(self, before: Array) -> None:
        step, last = self.sent - before, before - self.before
        self.before = before
        limits = self._cell.limits
        self.velocity_share = max(self.velocity_share, float((np.abs(step) / (limits.velocity * self._h)).max()))
        change = np.abs(step - last) / (limits.acceleration * self._h**2)
        self.acceleration_share = max(self.acceleration_share, float(change.max()))

    # -- rest ------------------------------------------------------------------------------------------------------

    @property
    def settling(self) -> float:
        """How long robots take to come to rest after what is sent does [s]."""
        return self._wait + 3.0 * float(self.lag.max(initial=0.0))

    def speed(self) -> float:
        """Largest speed of what is sent [rad/s or m/s]."""
        return float(np.abs(self.sent - self.before).max() / self._h)

    def rests(self) -> bool:
        """Whether nothing moves: the clock stands, and low pass and addition have come to its point."""
        return self.speed() < 1e-5 and float(np.abs(self.sent - self.shared.point).max()) < 1e-5

    def clock(self) -> float:
        """The controller's clock at the point of the shared one [s]."""
        return self.way.clock(self.shared.sigma)

    def halt(self) -> None:
        """Go on from rest at the last commands: they ran out, and all robots stand where these left them."""
        self.shared.halt()
        self.play_out.halt(self.sent, self.shared.sigma)
        self.before = self.sent
        self._followed[:] = self.sent
        self.law.restart()

    def restart(self) -> None:
        """Begin a new way at the shared clock's point, at rest."""
        x, clock, sigma = self.shared.point.copy(), self.clock(), self.shared.sigma
        self.way.restart(x, clock)
        self.shared.restart()
        self.play_out.parameter -= sigma
        self._past[:, 0] -= sigma
        self._went[:] = 0.0
        self.law.restart()


def _behind(away: Array, slope: Array, scale: Array, least: float) -> float:
    """By how much positions that are ``away`` (n,) from where they should be are late on their way [s].

    Where the way's slope, as a share of the speed limits, comes near to ``least``, less and less is said.
    """
    weighted = scale * slope
    return -float(away @ weighted) / (float(slope @ weighted) + least**2)
