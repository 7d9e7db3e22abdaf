"""A user's own path behind checks: it may raise or return anything, and a step gets a pose or a reason."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator
from typing import Any, final

import numpy as np
import pinocchio as pin

from coopqp.checks import as_scalar, as_vector
from coopqp.core._core import (
    FASTEST_PATH,
    JUMP_WIDTH,
    KINK_SHARE,
    KINK_WIDTH,
    LEAST_JUMP,
    LEAST_KINK,
    STEEP_SHARE,
    STEEP_WIDTH,
    TURN_LENGTH,
)
from coopqp.errors import InvalidInputError, said
from coopqp.paths.elbows import Elbows
from coopqp.paths.grasp_motion import GraspMotion
from coopqp.paths.path import HoldPath, LinePath, ObjectPath, SegmentedPath, WaypointPath
from coopqp.paths.section import Section
from coopqp.paths.servo import ServoPath
from coopqp.paths.shifted import ShiftedPath
from coopqp.paths.timed import TimedPath
from coopqp.spatial import Array, as_placement

#: Entries this large make a pose invalid [m].
FARTHEST = 1e9
#: Entries this large make a twist invalid [m/s, rad/s].
FASTEST = 1e9
#: Breakpoints that are asked for, at most.
_MOST_BREAKPOINTS = 10_000
#: Length of the part of an endless path that is asked before anything moves [s].
_LOOKED_AT = 1.0
#: Clocks at which a path is asked, and the share of the distance between them over which its poses are compared.
_PROBES, _SPAN_SHARE = 9, 1e-2
#: A twist may differ from the poses' change by this share of both, and by this much besides [m/s, rad/s].
_TWIST_SHARE, _TWIST_TOLERANCE = 0.1, 1e-3


def is_known(path: ObjectPath) -> bool:
    """Whether the path is one of the library's own, which neither raise nor return nonsense."""
    while type(path) in (Section, ShiftedPath):
        path = path.path  # type: ignore[attr-defined]
    known = isinstance(path, SegmentedPath) and path.of_segments
    return known or type(path) in (LinePath, WaypointPath, HoldPath, ServoPath, TimedPath)


def pose_distance(a: pin.SE3, b: pin.SE3) -> float:
    """Distance of two poses [m], turns included."""
    cosine = 0.5 * (float((a.rotation * b.rotation).sum()) - 1.0)
    return float(np.linalg.norm(b.translation - a.translation)) + TURN_LENGTH * math.acos(min(max(cosine, -1.0), 1.0))


def twist_distance(a: Array, b: Array) -> float:
    """Distance of two twists [m/s], angular parts included."""
    d = b - a
    return float(np.linalg.norm(d[:3])) + TURN_LENGTH * float(np.linalg.norm(d[3:]))


def jump(far: float, clock: float) -> str:
    """A sentence: the path jumps, by a distance [m], at a clock [s]; or where that is negative, it is too steep."""
    if far < 0.0:
        return f"the path is too steep at its clock {clock:.3f} s: it moves by {-1e3 * far:.3g} mm within 1 µs"
    distance = f"{1e3 * far:.3g} mm" if far < 1.0 else f"{far:.3g} m"
    return f"the path jumps by {distance} at its clock {clock:.3f} s (a turn of 1 rad counts as {TURN_LENGTH:g} m)"


def _halved(
    ask: Callable[[float], Any], distance: Callable[[Any, Any], float], before: Any, after: Any, width: float
) -> Generator[None, None, tuple[float, float, tuple[Any, Any]] | None]:
    """Halve an interval, keep the half in which the value changes more, until it is short; pauses before every call.

    Args:
        ask, distance: the function of the clock that is searched, and the distance of two of its values.
        before, after: clocks and values at both ends.
        width: what is short [s].

    Returns:
        The clock of its end [s], the change in it, and clocks and values at both ends; None if the path fails.
    """
    (start, low), (end, high) = before, after
    while end - start > width:
        yield
        clock = 0.5 * (start + end)
        middle = ask(clock)
        if middle is None or not start < clock < end:
            return None
        if distance(low, middle) >= distance(middle, high):
            end, high = clock, middle
        else:
            start, low = clock, middle
    return end, distance(low, high), ((start, low), (end, high))


@final
class GuardedPath:
    """Poses and twists of a path; of a user's own path checked, with a fault in :attr:`problem`.

    Attributes:
        duration: the path's duration when it was taken [s]; 0 if it has none.
        known_ahead: whether poses ahead of the clock are known.
        planned_share: share of the limits that the path was planned with; None if it was not.
        keeps_clear: whether its planned motion is proved to keep clear of bodies.
        elbows: a motion of redundant arms on it; None if it has none.
        grasps: how the tools move on the object along it; None where all grasps are fixed.
        problem: what was wrong with the last pose or twist; empty if nothing was.
        own: whether the path is a user's.
        asked: number of calls of a user's path.
    """

    def __init__(self, path: ObjectPath) -> None:
        self.path, self.own = path, not is_known(path)
        self.problem, self.asked = "", 0
        self.duration, self.known_ahead = 0.0, False
        self.planned_share: float | None = None
        self.keeps_clear = False
        self.elbows: Elbows | None = None
        self.grasps: GraspMotion | None = None
        try:
            self.duration, self.known_ahead = float(path.duration), bool(path.known_ahead)
            share = path.planned_share
            self.planned_share = None if share is None else as_scalar(share, "planned_share", high=1.0)
            self.keeps_clear = bool(path.keeps_clear)
            self.elbows = path.elbows
            if self.elbows is not None and not isinstance(self.elbows, Elbows):
                raise TypeError("elbows is no Elbows")
            self.grasps = path.grasps
            if self.grasps is not None and not isinstance(self.grasps, GraspMotion):
                raise TypeError("grasps is no GraspMotion")
        except Exception as error:
            self.problem = (
                f"the path's duration, known_ahead, planned_share, elbows or grasps cannot be read: {said(error)}"
            )

    def pose(self, clock: float) -> pin.SE3 | None:
        """T_world_object at ``clock`` [s]; None if the path fails, :attr:`problem` says how."""
        return self._ask(self.path.pose, clock, "pose") if self.own else self.path.pose(clock)

    def twist(self, clock: float) -> Array | None:
        """Body twist at ``clock`` [m/s, rad/s]; None if the path fails."""
        return self._ask(self.path.twist, clock, "twist") if self.own else self.path.twist(clock)

    def motion(self, clock: float) -> Array | None:
        """The twist of the object (6,), with those of the tools on it (1 + N, 6); None if the path fails."""
        twist = self.twist(clock)
        if twist is None or self.grasps is None:
            return twist
        return np.vstack([twist, self.grasps.twists(clock)])

    def _ask(self, ask: Callable[[float], Any], clock: float, kind: str) -> Any:
        """What a user's path returns at ``clock`` [s], checked; None if it fails."""
        self.problem, at = "", f"at its clock {clock:.6g} s"
        self.asked += 1
        try:
            value = ask(clock)
            if kind == "twist":
                value = as_vector(value, 6, kind)
                size, most, unit = np.abs(value).max(), FASTEST, ""
            elif isinstance(value, pin.SE3):
                value = as_placement(value, kind)
                size, most, unit = np.abs(value.translation).max(), FARTHEST, " m away"
            else:
                self.problem = f"the path's pose {at} is a {type(value).__name__}, no pinocchio.SE3"
                return None
        except InvalidInputError as error:
            self.problem = f"the path's {kind} {at} is no {'twist' if kind == 'twist' else 'placement'}: {error.what}"
        except Exception as error:
            self.problem = f"the path raised {said(error)} {at}"
        else:
            if size < most:
                return value
            self.problem = f"the path's {kind} {at} is {size:.3g}{unit}"
        return None

    def kink(self, before: float, after: float) -> float | None:
        """A clock between two others at which the twist of a user's path jumps [s]; None if it does not."""
        search = self.kinks(before, after)
        while True:
            try:
                next(search)
            except StopIteration as done:
                return done.value

    def kinks(self, before: float, after: float) -> Generator[None, None, float | None]:
        """As :meth:`kink`; it pauses before every further twist that it asks for."""
        if not self.own:
            return None
        low, high = self.twist(before), self.twist(after)
        whole = 0.0 if low is None or high is None else twist_distance(low, high)
        if not whole > LEAST_KINK:
            return None
        found = yield from _halved(self.twist, twist_distance, (before, low), (after, high), KINK_WIDTH)
        return found[0] if found is not None and found[1] > max(KINK_SHARE * whole, LEAST_KINK) else None

    def jumps(self, before: float, after: float) -> Generator[None, None, tuple[float, float] | None]:
        """The clock between two others at which a user's path jumps [s], and by how far [m]; None if it does not.

        Where it is only too steep the distance is negative: how far it moves within :data:`JUMP_WIDTH`. The search
        pauses before every further pose that it asks for.
        """
        low, high = self.pose(before), self.pose(after)
        whole = 0.0 if low is None or high is None else pose_distance(low, high)
        if not whole > max(FASTEST_PATH * (after - before), LEAST_JUMP):
            return None
        wide = yield from _halved(self.pose, pose_distance, (before, low), (after, high), JUMP_WIDTH)
        if wide is None or not wide[1] > KINK_SHARE * whole:
            return None
        (start, low), (end, high), far = *wide[2], wide[1]
        narrow = max(STEEP_WIDTH, STEEP_SHARE * end)
        found = yield from _halved(self.pose, pose_distance, (start, low), (end, high), narrow)
        if found is None:
            return None
        return found[0], found[1] if found[1] > KINK_SHARE * far else -far

    def breakpoints(self) -> list[float]:
        """Clocks before the end at which the path says that its twist jumps [s], up to the first that it cannot say."""
        found: list[float] = []
        clock = 0.0
        while len(found) < _MOST_BREAKPOINTS:
            try:
                ahead = float(self.path.next_breakpoint(clock))
            except Exception:
                break
            if not clock < ahead < self.duration:
                break
            found.append(ahead)
            clock = ahead
        return found

    def trouble(self, clock: float, h: float, held: pin.SE3, away: float) -> tuple[str, float]:
        """The fault of the path's poses at ``clock`` and ``h`` later [s], or empty; and the new ``away``.

        Args:
            clock, h: the object's clock, and the length of the step [s].
            held: pose of the object as an arm holds it.
            away: its distance from the path in the last step [m]; infinite where the path begins.
        """
        if not self.own:
            return "", away
        here = self.pose(clock)
        ahead = None if here is None else self.pose(clock + h)
        if here is None or ahead is None:
            return self.problem, away
        now = pose_distance(here, held)
        far = max(pose_distance(here, ahead), now - away)
        return ("", now) if far <= FASTEST_PATH * h else (jump(far, clock), away)

    def check(self, where: str) -> None:
        """Ask a user's path along its duration, before anything moves.

        Raises:
            InvalidInputError: it raises, or returns something else than poses and the twists that belong to them.
        """
        if not isinstance(self.path, ObjectPath):
            raise InvalidInputError(f"the path is a {type(self.path).__name__}", where, "Give an ObjectPath.")
        if not self.own:
            return
        if self.problem or not self.duration > 0.0:
            what = self.problem or f"the path's duration is {self.duration:g} s"
            raise InvalidInputError(what, where, "Give it a duration > 0 [s], as a number.")
        span = self.duration if math.isfinite(self.duration) else _LOOKED_AT
        clocks = np.linspace(0.0, span, _PROBES).tolist() if self.known_ahead else [0.0]
        for clock in clocks:
            if self.pose(clock) is None or self.twist(clock) is None:
                raise InvalidInputError(
                    self.problem, where, "pose(clock) returns T_world_object, twist(clock) six numbers."
                )
        if self.known_ahead:
            self._check_twists(clocks, where)

    def _check_twists(self, clocks: list[float], where: str) -> None:
        """Twists against the change of poses. A path may jump here and there: most of its twists have to be right."""
        h = _SPAN_SHARE * (clocks[1] - clocks[0])
        moving, wrong, example = 0, 0, ""
        for clock in clocks[:-1]:
            first, middle, last = self.pose(clock), self.twist(clock + 0.5 * h), self.pose(clock + h)
            if first is None or middle is None or last is None:
                raise InvalidInputError(self.problem, where, "Give poses and twists at any clock.")
            change = np.asarray(pin.log6(first.actInv(last)).vector) / h
            off = [np.linalg.norm((middle - change)[part]) for part in (slice(0, 3), slice(3, 6))]
            size = [np.linalg.norm(middle[p]) + np.linalg.norm(change[p]) for p in (slice(0, 3), slice(3, 6))]
            moving += int(max(size) > _TWIST_TOLERANCE)
            if any(o > 0.5 * _TWIST_SHARE * s + _TWIST_TOLERANCE for o, s in zip(off, size, strict=True)):
                wrong += 1
                told, found = (np.array2string(x, precision=3, suppress_small=True) for x in (middle, change))
                example = (
                    f"at its clock {clock + 0.5 * h:.4g} s the path's twist is {told}, but its poses change by {found}"
                )
        if wrong > 1 and 2 * wrong > moving:
            raise InvalidInputError(
                f"{example} a second", where, "twist(clock) is in the object's own frame: dT/dτ = T · [twist]."
            )
