"""Targets that move at run time: from its present motion the object goes over to the way to each new target."""

from __future__ import annotations

from typing import Any, final

import numpy as np
import pinocchio as pin

from coopqp.checks import as_scalar, as_vector
from coopqp.core._core import NOWHERE, SHORTEST_CHANGE, SPEEDS, STILL_OBJECT
from coopqp.errors import InvalidInputError
from coopqp.paths.path import ObjectPath
from coopqp.spatial import Array, Placement, as_placement, axis_angle, for_twists

#: Time in which the object reaches its full speed if the joints' accelerations are unknown [s].
_RAMP = 0.2
_SHARES = np.arange(1, SPEEDS + 1) / SPEEDS


class _Way:
    """From a pose in motion to rest at another pose.

    The present motion dies away while the straight way to the goal begins; both are linear in time, so the speed
    stays between the two. In world axes, with the present velocity v and angular velocity ω of the object:

        p(τ) = p₀ + b v + u d,   R(τ) = exp(b ω) R₀ exp(u φ),   b′ = 1 − τ/B,   u′ = ramp up in B, hold, ramp down in E

    From rest the way begins at its full speed, as a path with a linear time law: the rate of the object's clock rises
    from 0 instead, and falls before the end. Only where joints without acceleration limits have to stop does the way
    end as above. So the joints' slopes show how near a singularity is, however short the way.

    Args:
        start: T_world_object, the pose in motion.
        twist: its velocity and angular velocity, in world axes (6,) [m/s, rad/s].
        goal: T_world_object, the pose to rest at.
        speed, spin: largest speed and angular speed of the straight way [m/s, rad/s].
        ramp_times: seconds that each joint takes for a change of the object's motion by one unit, in world axes (m, 6).
        stops: time that each joint takes to stop from its full speed (m,) [s], where the way itself brings it to rest
            at its end; 0 where the rate does.
    """

    def __init__(
        self, start: pin.SE3, twist: Array, goal: pin.SE3, *, speed: float, spin: float, ramp_times: Array, stops: Array
    ) -> None:
        rests = bool(np.abs(twist).max() <= STILL_OBJECT)
        self.start, self.goal, self.twist = start, goal, np.zeros(6) if rests else twist
        self.begin = self.end = 0.0
        if rests:
            nominal, full = self._straight(speed, spin)
            self.end = float(np.fmin(np.abs(ramp_times @ full), stops).max(initial=0.0))
            self.duration = max(nominal + 0.5 * self.end, self.end, SHORTEST_CHANGE)
            return
        before = ramp_times @ self.twist
        self.begin = max(float(np.abs(before).max()), SHORTEST_CHANGE)
        share = 1.0
        for _ in range(4):  # the way begins where the present motion has died away
            nominal, full = self._straight(speed, spin)
            after = ramp_times @ full
            changes = np.abs(np.outer(_SHARES, after) - before).max(axis=1)
            fits = 0.5 * _SHARES * (changes + _SHARES * np.abs(after).max()) <= nominal
            i = int(np.flatnonzero(fits).max(initial=0))
            share, self.begin = float(_SHARES[i]), max(float(changes[i]), SHORTEST_CHANGE)
        nominal, full = self._straight(speed, spin)
        self.end = max(share * float(np.abs(ramp_times @ full).max()), SHORTEST_CHANGE)
        ramps = self.begin + self.end
        self.duration = max(nominal / share + 0.5 * ramps, ramps)

    @staticmethod
    def at_rest(pose: pin.SE3) -> _Way:
        """No way: it begins and ends at a pose."""
        way: _Way = object.__new__(_Way)
        way.start = way.goal = pose
        way.twist, way.line, way.turn = np.zeros(6), np.zeros(3), np.zeros(3)
        way.begin, way.end, way.duration = 0.0, 0.0, SHORTEST_CHANGE
        return way

    @staticmethod
    def of_segment(numbers: Array, goal: pin.SE3) -> _Way:
        """The way that :meth:`segment` describes."""
        way: _Way = object.__new__(_Way)
        way.start, way.goal = pin.SE3(numbers[:9].reshape(3, 3), numbers[9:12]), goal
        way.turn, way.line, way.twist = numbers[12:15], numbers[15:18], numbers[21:27]
        way.duration, way.begin, way.end = numbers.item(19), numbers.item(27), numbers.item(28)
        return way

    def _straight(self, speed: float, spin: float) -> tuple[float, Array]:
        """Set the straight way from where the present motion ends; its time at full speed [s], and its twist then."""
        b = 0.5 * self.begin
        R = pin.exp3(b * self.twist[3:]) @ self.start.rotation
        self.line = self.goal.translation - self.start.translation - b * self.twist[:3]
        axis, angle = axis_angle(R.T @ self.goal.rotation)
        self.turn = angle * axis
        nominal = max(float(np.linalg.norm(self.line)) / speed, float(np.linalg.norm(self.turn)) / spin)
        if nominal < NOWHERE:
            return 0.0, np.zeros(6)
        return nominal, np.concatenate([self.line, R @ self.turn]) / nominal

    def _shares(self, time: float) -> tuple[float, float, float, float]:
        """b, b′, u and u′ at a time since the start [s]."""
        if time != time:
            raise InvalidInputError("the clock is NaN", "ObjectPath", "Give a finite time [s].")
        T, B, E = self.duration, self.begin, self.end
        peak = 1.0 / (T - 0.5 * (B + E))
        if time >= T:
            return 0.5 * B, 0.0, 1.0, 0.0
        if time < 0.0:
            return 0.0, 0.0, 0.0, 0.0
        b, slope = (time - 0.5 * time * time / B, 1.0 - time / B) if time < B else (0.5 * B, 0.0)
        left = T - time
        if left < E:
            return b, slope, 1.0 - 0.5 * peak * left * left / E, peak * left / E
        if time < B:
            return b, slope, 0.5 * peak * time * time / B, peak * time / B
        return b, slope, peak * (time - 0.5 * B), peak

    def pose(self, time: float) -> pin.SE3:
        """T_world_object at a time since the start [s]."""
        b, _, u, _ = self._shares(time)
        R = pin.exp3(b * self.twist[3:]) @ self.start.rotation @ pin.exp3(u * self.turn)
        return pin.SE3(R, self.start.translation + b * self.twist[:3] + u * self.line)

    def body_twist(self, time: float) -> Array:
        """Twist of the object in its own frame at a time since the start (6,) [m/s, rad/s]."""
        _, fading, _, rate = self._shares(time)
        Rt = self.pose(time).rotation.T
        linear = fading * self.twist[:3] + rate * self.line
        return np.concatenate([Rt @ linear, fading * (Rt @ self.twist[3:]) + rate * self.turn])

    def segment(self, start: float) -> Array:
        """The numbers of :meth:`ObjectPath.packed`, begun at ``start`` [s]."""
        R, p = self.start.rotation, self.start.translation
        numbers = [R.ravel(), p, self.turn, self.line, [start, self.duration, 2.0], self.twist, [self.begin, self.end]]
        return np.concatenate(numbers)


@final
class ServoPath(ObjectPath):
    """A path to a target that the user moves at run time, on straight ways at bounded speed.

    The object goes over from its present motion to the way to a new target without a jump of its velocity. It rests at
    the target. With :meth:`coopqp.QPController.retarget` the change takes as long as the joints need; the object never
    leaves its path, and it stops ahead of limits, singularities and the end of the arms' reach.

    Args:
        T_world_object: start pose.
        speed, spin: speed and angular speed of the object on its way to the target [m/s, rad/s]; attributes, too.
    """

    def __init__(self, T_world_object: Placement, *, speed: float = 0.25, spin: float = 0.5) -> None:
        self.duration = np.inf
        self.speed, self.spin = as_scalar(speed, "ServoPath: speed"), as_scalar(spin, "ServoPath: spin")
        self._rest(as_placement(T_world_object, "ServoPath"))

    def _rest(self, pose: pin.SE3) -> None:
        self._since = 0.0
        self._way = _Way.at_rest(pose)

    def _to(self, start: pin.SE3, twist: Array, goal: pin.SE3, ramp_times: Array | None, stops: Array | None) -> _Way:
        if ramp_times is None:
            ramp_times = _RAMP * np.diag([1.0 / self.speed] * 3 + [1.0 / self.spin] * 3)
        if stops is None:
            stops = np.zeros(len(ramp_times))
        return _Way(start, twist, goal, speed=self.speed, spin=self.spin, ramp_times=ramp_times, stops=stops)

    @property
    def target(self) -> pin.SE3:
        """T_world_object where the object rests in the end."""
        return self._way.goal

    def restart(self, T_world_object: Placement) -> None:
        """Rest at ``T_world_object`` at clock 0. The target is the same pose.

        Raises:
            InvalidInputError: not a pose. The path is then unchanged.
        """
        self._rest(as_placement(T_world_object, "ServoPath.restart"))

    def set_target(
        self,
        T_world_object: Placement,
        *,
        clock: float,
        rate: float = 1.0,
        ramp_times: Array | None = None,
        stops: Array | None = None,
    ) -> None:
        """Move to ``T_world_object`` from the object's pose and motion at ``clock``.

        Args:
            T_world_object: where to.
            clock: the object's clock [s].
            rate: σ, share of the path's twist at which the object moves there.
            ramp_times: seconds that each joint takes for a change of the object's motion by one unit, in world axes
                (m, 6).
            stops: time that each joint takes to stop from its full speed (m,) [s], where the way itself brings it to
                rest at its end; 0, the default, where the rate of the clock does.

        Raises:
            InvalidInputError: not a pose, or invalid other numbers. The target is then unchanged.
        """
        where = "ServoPath.set_target"
        goal, here = as_placement(T_world_object, where), self.pose(clock)
        rate = as_scalar(rate, f"{where}: rate", open_low=False)
        turned = for_twists(here.rotation)
        if ramp_times is not None:
            rows = np.shape(ramp_times)[0] if np.ndim(ramp_times) == 2 else 0
            ramp_times = as_vector(np.ravel(ramp_times), 6 * rows, f"{where}: ramp_times").reshape(rows, 6)
        self._way = self._to(here, rate * turned @ self.twist(clock), goal, ramp_times, stops)
        self._since = clock

    def take(self, goal: pin.SE3, segment: Array) -> None:
        """Take a way to a goal as the numbers of a segment, see :meth:`ObjectPath.packed`."""
        self._way, self._since = _Way.of_segment(segment, goal), segment.item(18)

    def packed(self) -> Array:
        """The way to the present target; the object rests at its end."""
        end = self._since + self._way.duration
        return np.concatenate([[self.duration, 1.0, 1.0, end], self._way.segment(self._since)])

    def next_breakpoint(self, clock: float) -> float:
        """Clock at the end of the way [s]."""
        end = self._since + self._way.duration
        return end if clock < end - 1e-9 else self.duration

    def straight_for(self, clock: float) -> float:
        """How much longer the way is straight before its speed falls towards its end [s]."""
        return self._since + self._way.duration - self._way.end - clock

    def pose(self, clock: float) -> pin.SE3:
        """T_world_object at ``clock`` [s]."""
        return self._way.pose(clock - self._since)

    def twist(self, clock: float) -> Array:
        """Body twist at ``clock`` [m/s, rad/s]."""
        return self._way.body_twist(clock - self._since)

    def state(self) -> Any:
        """The present way, for :meth:`restore`."""
        return self._way, self._since

    def restore(self, state: Any) -> None:
        """Go back to a way that :meth:`state` returned."""
        self._way, self._since = state
