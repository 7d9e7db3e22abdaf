"""Object paths: functions from the object's clock [s] to its pose and twist.

The clock τ runs from 0 to the duration of the path. Before and after, the object rests at the ends. When a controller
slows the object, the clock advances slower than real time: the path never runs ahead of the object.
"""

from __future__ import annotations

import abc
import math
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import final

import numpy as np
import pinocchio as pin

from coopqp.checks import ArrayLike, as_scalar, as_vector, read_only
from coopqp.errors import InvalidInputError
from coopqp.paths.elbows import Elbows
from coopqp.paths.geometry import PathGeometry, Straight, motion_length
from coopqp.paths.grasp_motion import GraspMotion
from coopqp.paths.time_law import TimeLaw, as_time_law
from coopqp.spatial import Array, Placement, as_placement, as_placements, axis_angle

#: A larger turn is an angle in another unit, or no number of turns that rounding leaves [rad].
_LARGEST_TURN = 1e4


class ObjectPath(abc.ABC):
    """A path of the object: pose and twist as functions of the object's clock τ [s]."""

    duration: float  #: [s]
    known_ahead: bool = True  #: True if poses ahead of the clock are known (the preview needs them)
    #: Share of the joints' limits that the path was planned with; None if it was not planned. A controller lets a
    #: planned path use that share, and moves redundant arms by least motion, as they were planned, without posture.
    planned_share: float | None = None
    #: Whether the planned motion is proved to keep clear of bodies: redundant arms then do not evade on it. Margins are
    #: kept all the same: where a body is elsewhere than it was when the path was planned, the object stops.
    keeps_clear: bool = False
    #: A motion of redundant arms that a controller which looks ahead follows in their null-space, in place of its own
    #: rules; None for these.
    elbows: Elbows | None = None
    #: How the tools move on the object along this path, and which arms hold it; None where all grasps are fixed.
    grasps: GraspMotion | None = None
    #: Clocks [s] of gates, at which the object rests until a signal of this name comes.
    gates: tuple[tuple[float, str], ...] = ()
    #: Seconds after the start of a run at which signals come by themselves.
    signals: Mapping[str, float] = MappingProxyType({})
    #: Whether :meth:`packed` gives segments in the order of their clocks, of which a part is a path, too.
    of_segments: bool = False

    def __repr__(self) -> str:
        duration = getattr(self, "duration", None)
        if duration is None:
            return f"{type(self).__name__}()"
        return f"{type(self).__name__}({'no end' if duration == math.inf else f'{duration:.4g} s'})"

    @abc.abstractmethod
    def pose(self, clock: float) -> pin.SE3:
        """T_world_object at ``clock`` [s]. It is constant before 0 and after :attr:`duration`."""

    @abc.abstractmethod
    def twist(self, clock: float) -> Array:
        """Twist of the object in its own frame, shape (6,) [m/s, rad/s]: ``dT/dτ = T · [twist]``."""

    def next_breakpoint(self, clock: float) -> float:
        """First clock [s] after ``clock`` at which the twist jumps, at the latest the end."""
        return self.duration

    def packed(self) -> Array | None:
        """The path as numbers, for the library's own paths; None where only :meth:`pose` knows it.

        ``[duration, number of breakpoints, number of segments, breakpoints …, segments …]``; a segment has 29 numbers:
        ``R(0)`` row by row (9), p(0) (3), φ* r (3), displacement in the world (3), start [s], duration [s], time law
        (0 linear, 1 quintic, 2 ramps, 3 even acceleration), and of ramps the motion that dies away (6) and the times of
        both ramps (2) [s], of even acceleration the speed at the start over the mean speed (1).
        """
        return None

    def geometry(self) -> PathGeometry | None:
        """Where the path goes, without when; None where only :meth:`pose` knows it, or the object stays."""
        return None

    def clocks(self, s: Array) -> Array:
        """Clocks [s] at which the path is at s (K,) [m] of its :meth:`geometry`."""
        raise NotImplementedError(f"{type(self).__name__} has no geometry")

    def increment(self, clock: float, dt: float) -> Array:
        """``log(T(τ)⁻¹ T(τ + dt)) / dt``, shape (6,): the constant twist whose step of ``dt`` [s] is exact.

        Raises:
            InvalidInputError: ``dt`` is 0, NaN or infinite.
        """
        if dt == 0.0 or not math.isfinite(dt):
            raise InvalidInputError(f"dt is {dt}", "ObjectPath.increment", "Give a step [s] other than 0.")
        return np.asarray(pin.log6(self.pose(clock).actInv(self.pose(clock + dt))).vector) / dt


class SegmentedPath(ObjectPath, abc.ABC):
    """A path of the library's own beside those of this package; users derive from :class:`ObjectPath`.

    Where :attr:`of_segments` is true it neither raises nor returns nonsense.
    """


@dataclass(frozen=True, eq=False)
class ScrewParameters:
    """p, r, φ* of Eq. (10): the motion from the initial to the final placement.

    Attributes:
        p: displacement in the initial frame [m], shape (3,).
        r: unit axis in the initial frame, shape (3,); zero when φ* = 0.
        angle: φ* ≥ 0 [rad]; at most π between two placements.
    """

    p: Array
    r: Array
    angle: float

    @staticmethod
    def between(start: Placement, goal: Placement) -> ScrewParameters:
        """Eq. (10) with two corrections: r is normalised (10c has norm 2 sin φ*) and φ* comes from atan2."""
        T0, T1 = as_placement(start, "ScrewParameters: start"), as_placement(goal, "ScrewParameters: goal")
        r, angle = axis_angle(T0.rotation.T @ T1.rotation)
        return ScrewParameters(T0.rotation.T @ (T1.translation - T0.translation), r, angle)


@final
class LinePath(ObjectPath):
    """The paper's motion, Eqs. (7)–(9): the origin moves on a straight line while the object turns about a fixed axis.

    ``T(τ) = T(0) M(τ)`` with ``M = [Rot(r, u φ*), u p]`` and the time law u. Between two placements it turns by the
    shorter way; :meth:`displaced` turns as told.

    Args:
        start, goal: placements of the object in the world.
        duration: t_f, the duration [s].
        time_law: ``"linear"`` (the paper's) or ``"quintic"``.
    """

    def __init__(
        self, start: Placement, goal: Placement, *, duration: float, time_law: TimeLaw | str = TimeLaw.QUINTIC
    ) -> None:
        T0, T1 = as_placement(start, "LinePath: start"), as_placement(goal, "LinePath: goal")
        self._set(T0, T1, ScrewParameters.between(T0, T1), duration, time_law)

    def _set(
        self, start: pin.SE3, goal: pin.SE3, screw: ScrewParameters, duration: float, time_law: TimeLaw | str
    ) -> None:
        self.duration = as_scalar(duration, "LinePath: duration")
        self.time_law = as_time_law(time_law)
        self.start, self.goal, self.screw = start, goal, screw
        self._R0, self._p0 = self.start.rotation.copy(), self.start.translation.copy()
        self._line = self._R0 @ self.screw.p
        self._rotation_vector = self.screw.angle * self.screw.r
        law = 0.0 if self.time_law is TimeLaw.LINEAR else 1.0
        self._segment = np.concatenate(
            [self._R0.ravel(), self._p0, self._rotation_vector, self._line, [0.0, self.duration, law], np.zeros(8)]
        )

    @staticmethod
    def displaced(
        start: Placement,
        *,
        translation: ArrayLike = (0.0, 0.0, 0.0),
        rotation: ArrayLike = (0.0, 0.0, 0.0),
        duration: float,
        time_law: TimeLaw | str = TimeLaw.QUINTIC,
    ) -> LinePath:
        """Path from ``start`` by a translation [m] and a rotation vector [rad] about the origin, in world axes.

        The object turns as told, also by more than half a turn, for which no goal could ask.

        Raises:
            InvalidInputError: not placements and vectors of finite numbers, or a turn of more than 1e4 rad.
        """
        T = as_placement(start, "LinePath.displaced: start")
        shift = as_vector(translation, 3, "LinePath.displaced: translation")
        turn = as_vector(rotation, 3, "LinePath.displaced: rotation")
        if np.abs(turn).max() > _LARGEST_TURN:
            what = f"a turn by {np.abs(turn).max():.3g} rad"
            raise InvalidInputError(what, "LinePath.displaced: rotation", f"Give {_LARGEST_TURN:g} rad at most.")
        goal = pin.SE3(pin.exp3(turn) @ T.rotation, T.translation + shift)
        path = LinePath.__new__(LinePath)
        angle = float(np.linalg.norm(turn))
        r = T.rotation.T @ turn / angle if angle > 0.0 else np.zeros(3)
        path._set(T, goal, ScrewParameters(T.rotation.T @ shift, r, angle), duration, time_law)
        return path

    def segment(self, start: float) -> Array:
        """The numbers of :meth:`packed` for this line, begun at ``start`` [s] (29,)."""
        numbers = self._segment.copy()
        numbers[18] = start
        return numbers

    def straight(self) -> Straight | None:
        """The line without its time law; None if it stays."""
        length = motion_length(self._line, self.screw.angle)
        return Straight(self._R0, self._p0, self._rotation_vector, self._line, length) if length > 0.0 else None

    def geometry(self) -> PathGeometry | None:
        """One straight piece."""
        line = self.straight()
        return None if line is None else PathGeometry((line,))

    def clocks(self, s: Array) -> Array:
        """See :meth:`ObjectPath.clocks`."""
        line = self.straight()
        return self.duration * self.time_law.inverse(s / line.length) if line else super().clocks(s)

    def packed(self) -> Array:
        """One segment."""
        return np.concatenate([[self.duration, 0.0, 1.0], self._segment])

    def pose(self, clock: float) -> pin.SE3:
        """T_world_object at ``clock`` [s], Eq. (8)."""
        u = self.time_law.value_at(clock / self.duration)
        return pin.SE3(self._R0.dot(pin.exp3(u * self._rotation_vector)), self._p0 + u * self._line)

    def twist(self, clock: float) -> Array:
        """Body twist [m/s, rad/s]. The axis is also fixed in the body, so the angular part is ``r φ* u′``."""
        x = clock / self.duration
        rate = self.time_law.slope_at(x) / self.duration
        u = self.time_law.value_at(x)
        R = pin.exp3(u * self._rotation_vector)
        return np.concatenate([R.T @ self.screw.p, self._rotation_vector]) * rate


@final
class WaypointPath(ObjectPath):
    """Straight segments through placements, one time law per segment.

    With ``"quintic"`` the object rests at every waypoint. With ``"linear"`` its velocity jumps at every waypoint.

    Args:
        placements: at least two placements of the object in the world.
        durations: duration of each segment [s], one fewer than placements.
        time_law: time law of every segment.
    """

    def __init__(
        self,
        placements: Sequence[Placement],
        *,
        durations: Sequence[float],
        time_law: TimeLaw | str = TimeLaw.QUINTIC,
    ) -> None:
        poses = as_placements(placements, "WaypointPath: placements")
        if not np.iterable(durations):
            raise InvalidInputError(f"durations is {durations!r}", "WaypointPath", "Give one number per segment [s].")
        times = tuple(as_scalar(d, f"WaypointPath: durations[{i}]") for i, d in enumerate(durations))
        if len(poses) < 2 or len(times) != len(poses) - 1:
            raise InvalidInputError(
                f"{len(poses)} placements and {len(times)} durations",
                "WaypointPath",
                "Give at least two placements and one duration per segment.",
            )
        self.segments = tuple(
            LinePath(a, b, duration=d, time_law=time_law) for a, b, d in zip(poses[:-1], poses[1:], times, strict=True)
        )
        self._starts = [0.0, *np.cumsum(times)[:-1].tolist()]
        self.duration = float(np.sum(times))

    def geometry(self) -> PathGeometry | None:
        """A straight piece for each pair of waypoints that differ."""
        lines = [line for segment in self.segments if (line := segment.straight())]
        return PathGeometry(tuple(lines)) if lines else None

    def clocks(self, s: Array) -> Array:
        """See :meth:`ObjectPath.clocks`."""
        found, mark = np.full(len(s), self.duration), 0.0
        for segment, start in zip(self.segments, self._starts, strict=True):
            line = segment.straight()
            if line is not None:
                here = (s >= mark) & (s <= mark + line.length)
                found[here] = start + segment.clocks(s[here] - mark)
                mark += line.length
        return found

    def packed(self) -> Array:
        """A segment for each pair of waypoints; the twist jumps between them."""
        return self._numbers

    @cached_property
    def _numbers(self) -> Array:
        inner, segments = self._starts[1:], [s.segment(t) for s, t in zip(self.segments, self._starts, strict=True)]
        return read_only(np.concatenate([[self.duration, len(inner), len(segments)], inner, *segments]))

    def _segment(self, clock: float) -> tuple[LinePath, float]:
        i = max(bisect_right(self._starts, clock) - 1, 0)
        return self.segments[i], clock - self._starts[i]

    def next_breakpoint(self, clock: float) -> float:
        """Start of the next segment [s]."""
        i = bisect_right(self._starts, clock + 1e-9)
        return self._starts[i] if i < len(self._starts) else self.duration

    def pose(self, clock: float) -> pin.SE3:
        """T_world_object at ``clock`` [s]."""
        segment, local = self._segment(clock)
        return segment.pose(local)

    def twist(self, clock: float) -> Array:
        """Body twist at ``clock`` [m/s, rad/s]."""
        segment, local = self._segment(clock)
        return segment.twist(local)


@final
class HoldPath(ObjectPath):
    """The object rests at one pose.

    Args:
        T_world_object: the pose.
        duration: length of the rest [s].
    """

    def __init__(self, T_world_object: Placement, *, duration: float = 1.0) -> None:
        self._pose = as_placement(T_world_object, "HoldPath")
        self.duration = as_scalar(duration, "HoldPath: duration")

    def packed(self) -> Array:
        """A segment that stays where it begins."""
        still = LinePath(self._pose, self._pose, duration=self.duration)
        return still.packed()

    def pose(self, clock: float) -> pin.SE3:
        """The constant pose."""
        return self._pose

    def twist(self, clock: float) -> Array:
        """Zero."""
        return np.zeros(6)
