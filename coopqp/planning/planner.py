"""A plan: a start, and the fastest way along a path or through waypoints."""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np

from coopqp.checks import ArrayLike, as_count, as_scalar
from coopqp.core._core import TURN_LENGTH
from coopqp.errors import InvalidInputError, UndecidedError, UnreachableError
from coopqp.model.cell import RobotCell
from coopqp.model.chain import moving_columns
from coopqp.model.grasp import Grasp
from coopqp.paths.certificate import PathVerdict, follows
from coopqp.paths.geometry import PathGeometry, Straight, blended
from coopqp.paths.path import LinePath, ObjectPath
from coopqp.paths.timed import SpeedProfile, TimedPath
from coopqp.planning.check import PathCheck, check_motion, check_path, places_along
from coopqp.planning.clear_elbows import clear_plan, smooth
from coopqp.planning.fastest_start import faster_start
from coopqp.planning.knots import Lead
from coopqp.planning.payload import Payload
from coopqp.planning.starts import Start, check_scene, find_start
from coopqp.planning.timing import SHARE, geometry_of, timed_motion
from coopqp.shown import Brief
from coopqp.spatial import Array, Placement, as_placements

if TYPE_CHECKING:
    from coopqp.collision.scene import CollisionScene

#: Limits that bind for less than this share of the duration are not listed.
_WORTH_SAYING = 0.01
#: Halvings of the search for the largest clear tolerance of blends: to 1 % of what was asked.
_SHARE_HALVINGS = 7
#: Samples of the motion of shared joints along the whole path, and the deviation of the mean that smooths it.
_LED_SAMPLES, _LED_WIDTH = 240, 0.02


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Plan(Brief):
    """A start and a timed path from it.

    Attributes:
        q_start: configuration at the start (nq,).
        grasp: the grasp; with rolled tools where allowed.
        path: the path, for a controller or a simulation.
        start: result for each arm; None where ``q_start`` was given.
        check: the verdict on the timed path; None without a scene.
    """

    q_start: Array
    grasp: Grasp
    path: TimedPath
    start: Start | None
    check: PathCheck | None = None

    def binding_times(self) -> dict[str, float]:
        """How long each limit binds [s], the longest first; keys are ``arm left joint joint_2: acceleration``."""
        times: dict[str, float] = {}
        profile = self.path.profile
        for limit, span in zip(profile.binding, np.diff(profile.clocks).tolist(), strict=True):
            if limit is not None:
                times[str(limit)] = times.get(str(limit), 0.0) + span
        return dict(sorted(times.items(), key=lambda item: -item[1]))

    def explain(self) -> str:
        """The duration, and what binds for how long, a line each; limits that bind for less than 1 % are left out."""
        total = self.path.duration
        lines = [f"{total:.3f} s from rest to rest"]
        for name, span in self.binding_times().items():
            if span >= _WORTH_SAYING * total:
                lines.append(f"{name} binds for {span:.3f} s ({100.0 * span / total:.0f} %)")
        return "\n".join(lines)


def plan(
    cell: RobotCell,
    grasp: Grasp,
    path: ObjectPath | PathGeometry | Sequence[Placement],
    *,
    q_start: ArrayLike | None = None,
    blend: float = 0.0,
    blend_angle: float | None = None,
    free_roll: Mapping[str, Sequence[float]] | None = None,
    payload: Payload | None = None,
    bounds: Sequence[Any] = (),
    jerk: ArrayLike | None = None,
    share: float = SHARE,
    knots: int | None = None,
    starts: int = 1,
    scene: CollisionScene | None = None,
) -> Plan:
    """Find a start, and the fastest way along a path from rest to rest.

    Args:
        cell, grasp: the arms, and how they hold the object.
        path: a path, or placements of the object (waypoints) with straight lines between them.
        q_start: start configuration (nq,); found by default.
        blend: corners are rounded off: the object stays within this distance of them [m]. 0: it rests at each corner.
        blend_angle: and within this angle [rad]; by default ``blend`` over 0.3 m.
        free_roll: as for :func:`find_start`.
        payload, bounds, jerk, share, knots: as for :func:`time_path`.
        starts: number of starts of each arm to compare by time; the fastest is taken. By default the one with the
            largest margins and singular values. Arms with more than six joints gain most: their starts differ in the
            elbow. Not with ``q_start``.
        scene: the bodies that keep distances, a :class:`coopqp.CollisionScene` of the same cell: the plan is
            checked by :func:`check_path`, and is given only if proved or followed at samples. Not with ``starts``.

    Raises:
        NoStartError: an arm has no start from which it follows the path.
        UnreachableError: as for :func:`time_path`; or the bodies come too close. For corners that are rounded off the
            message has the largest tolerance that keeps clear, if there is one.
        UndecidedError: as for :func:`time_path`; or it is not decided whether the bodies keep clear.
        InvalidInputError, MissingExtraError: as for :func:`time_path`.
    """
    where = "plan"
    blend = as_scalar(blend, f"{where}: blend", open_low=False)
    angle = (
        blend / TURN_LENGTH if blend_angle is None else as_scalar(blend_angle, f"{where}: blend_angle", open_low=False)
    )
    check_scene(cell, scene, f"{where}: scene")
    geometry = _through(path) if not isinstance(path, (ObjectPath, PathGeometry)) else geometry_of(path, where)
    lines: list[Straight] = []
    if blend > 0.0 or angle > 0.0:
        lines = [piece for piece in geometry.pieces if isinstance(piece, Straight)]
        if len(lines) < len(geometry.pieces):
            raise InvalidInputError("the path is no chain of straight lines", where, "Give one, or no blend.")
        geometry = blended(lines, distance=blend, angle=angle)
    start, starts = None, as_count(starts, f"{where}: starts")
    if starts > 1:
        cell.refuse_shared(f"{where}: starts")
    if q_start is not None and starts > 1:
        raise InvalidInputError("starts to compare beside a start", where, "Give one of both.")
    if scene is not None and starts > 1:
        raise InvalidInputError("starts to compare beside a scene", where, "Give one of both.")
    if q_start is None:
        # On a path of the user's the clocks of a message are the user's.
        start = find_start(cell, grasp, _route(path, geometry, blend), free_roll=free_roll, scene=scene)
        if starts > 1:
            start = faster_start(cell, geometry, start, starts)
        q_start, grasp = start.q, start.grasp
    q = cell.check_configuration(q_start, f"{where}: q_start")
    shared = _shared_lead(cell, grasp, _route(path, geometry, blend), geometry, q)
    timing = functools.partial(
        timed_motion, cell, grasp, geometry, q_start=q, payload=payload, bounds=bounds, jerk=jerk, share=share,
        knots=knots,
    )  # fmt: skip
    motion = timing(lead=shared)
    timed = motion.path
    if scene is None:
        return Plan(q_start=q, grasp=grasp, path=timed, start=start)
    redundant = any(len(columns) > 6 for columns in moving_columns(cell))
    if redundant:
        own = check_motion(cell, grasp, timed, motion.x, scene)  # the elbows as they are planned
        if own is not None and own.verdict is PathVerdict.CERTIFIED:
            timed = timed.kept_clear()
            return Plan(q_start=q, grasp=grasp, path=timed, start=start, check=own.on(timed))
    check = check_path(cell, grasp, timed, q_start=q, scene=scene)
    if redundant and not cell.groups and check.verdict is not PathVerdict.INFEASIBLE:
        clear = clear_plan(check, motion, scene, lambda lead: timing(lead=lead))
        if clear is not None:
            return Plan(q_start=q, grasp=grasp, path=clear[0], start=start, check=clear[1])
    if not check.feasible:
        _refuse(check, lines, blend, angle)
    return Plan(q_start=q, grasp=grasp, path=timed, start=start, check=check)


def _route(path: Any, geometry: PathGeometry, blend: float) -> ObjectPath:
    """The path with its own clocks where it has some."""
    return path if isinstance(path, ObjectPath) and blend == 0.0 else some_timing(geometry)


def _shared_lead(cell: RobotCell, grasp: Grasp, route: ObjectPath, geometry: PathGeometry, q: Array) -> Lead | None:
    """Where joints that arms share are along the path, as its check proves it; None where no arms share joints.

    Raises:
        UnreachableError, UndecidedError: the arms do not follow the path, or it is not decided.
    """
    if not cell.groups:
        return None
    check = check_path(cell, grasp, route, q_start=q)
    proved = check.proved_trajectory()
    if proved is None:
        kind = UnreachableError if check.verdict is PathVerdict.INFEASIBLE else UndecidedError
        raise kind(check.explain().replace("\n", " "))
    s = np.linspace(0.0, geometry.length, _LED_SAMPLES)
    return smooth(s, proved.positions(places_along(geometry, s))[0], _LED_WIDTH)


def _refuse(check: PathCheck, lines: Sequence[Straight], blend: float, angle: float) -> NoReturn:
    """Raise for a plan that does not keep clear, with the largest tolerance of its blends that does."""
    troubles = [arm.explain() for arm in check.arms if not follows(arm.verdict)]
    if check.clearance is not None and not follows(check.clearance.verdict):
        troubles.append(check.clearance.explain())
    message = f"the plan is {check.verdict.value.lower()}: {' '.join(troubles)}"
    if lines:
        share = _clear_share(check, lines, blend, angle)
        turned = np.rad2deg(share * angle)
        message += (
            f" With blends of at most {1e3 * share * blend:.1f} mm and {turned:.2f}° it keeps clear."
            if share > 0.0
            else " Without rounding its corners off it does not keep clear, either."
        )
    raise (UnreachableError if check.verdict is PathVerdict.INFEASIBLE else UndecidedError)(message)


def _clear_share(check: PathCheck, lines: Sequence[Straight], blend: float, angle: float) -> float:
    """The largest share of the tolerances of blends with which a path keeps clear, by halving; 0 without any."""

    def keeps_clear(share: float) -> bool:
        path = some_timing(blended(lines, distance=share * blend, angle=share * angle))
        return check_path(check.cell, check.grasp, path, q_start=check.q_start, scene=check.scene).feasible

    if check.q_start is None or not keeps_clear(0.0):
        return 0.0
    low, high = 0.0, 1.0
    for _ in range(_SHARE_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if keeps_clear(middle) else (low, middle)
    return math.floor(low * blend * 1e4) / (blend * 1e4) if blend > 0.0 else low  # tenths of a millimetre are said


def some_timing(geometry: PathGeometry) -> TimedPath:
    """A path along a geometry in some time: at most at 1 m/s, from rest to rest between its corners."""
    s, squares = [0.0], [0.0]
    for stretch in geometry.stretches():
        s += [s[-1] + 0.5 * stretch.length, s[-1] + stretch.length]
        squares += [1.0, 0.0]
    return TimedPath(geometry, SpeedProfile(np.array(s), np.array(squares)))


def _through(placements: Sequence[Placement]) -> PathGeometry:
    """Straight lines through placements; placements that are the same count once."""
    poses = as_placements(placements, "plan: path")
    if len(poses) < 2:
        raise InvalidInputError(f"{len(poses)} placements", "plan: path", "Give at least two.")
    lines = [LinePath(a, b, duration=1.0).straight() for a, b in itertools.pairwise(poses)]
    pieces = tuple(line for line in lines if line is not None)
    if not pieces:
        raise InvalidInputError("all placements are the same", "plan: path", "Give at least two that differ.")
    return PathGeometry(pieces)
