"""A way round: the object's path between two poses, for all arms at once, and its proof."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, final

import numpy as np
import pinocchio as pin

from coopqp.checks import NOT_NUMBERS, ArrayLike, as_count, as_floats, as_scalar
from coopqp.collision.clearance_check import remark
from coopqp.collision.edges import SPARE, EdgeLimits, Edges, Stop, columns_of, limits_with
from coopqp.core._core import SMALL_CLEARANCE
from coopqp.errors import InvalidInputError
from coopqp.model.batch import ArmKinematics
from coopqp.model.cell import RobotCell
from coopqp.model.chain import Chain
from coopqp.model.grasp import Grasp
from coopqp.paths.certificate import PathVerdict
from coopqp.paths.elbows import Elbows
from coopqp.paths.timed import SpeedProfile, TimedPath
from coopqp.planning.check import PathCheck, check_motion, check_path
from coopqp.planning.planner import some_timing
from coopqp.planning.route.duration import estimated_squares
from coopqp.planning.route.elbows import led_ways
from coopqp.planning.route.ends import Ends, ends_at
from coopqp.planning.route.goals import ArmGoal, GoalPose, TurnedGoal, goal_poses
from coopqp.planning.route.route import Route, RouteVerdict
from coopqp.planning.route.search import Search, Searched, SearchLimits, SearchResult
from coopqp.planning.route.shape import WIDEST, Shape, Shaper, corners_of
from coopqp.planning.route.shorten import shortened
from coopqp.planning.route.tree import Node, Pose, Tree, straight
from coopqp.planning.starts import check_scene, exact_start
from coopqp.spatial import Array, Placement, as_placement

if TYPE_CHECKING:
    from coopqp.collision.scene import CollisionScene

#: The object's origin keeps within this of the box of start and goal, below and above [m].
_BELOW, _ABOVE = 0.3, 0.4
#: Time to make a way shorter and faster [s], and the first part of it, in which other ways are searched: so many at
#: most, with so many nodes besides twice those of the first.
_BETTERING, _SEARCHING, _OTHERS, _OTHER_NODES = 0.6, 0.15, 6, 100
#: Of the shapes, so many are made faster by a few changes, and then the fastest by many.
_PROMISING, _FEW_CHANGES, _MANY_CHANGES = 3, 100, 2000
#: Poses of a goal, of those from which the arms hold the object, that the search leads to.
_MOST_GOALS = 3
#: Ways that are searched until one is proved.
_MOST_WAYS = 4
#: Poses in which the trees of redundant arms meet with other elbows until these are led over; the shortest are tried.
_FEW_MEETINGS, _TRIED_MEETINGS = 8, 3
#: A given start whose joints are further from ones that hold the object is refused [rad or m].
_OFF = 1e-2
#: Rooms and spares are known to within this [m].
_ROUNDING = 1e-7
#: Smaller deviations at corners that are tried until the way is proved [m].
_LESS = (0.02, 0.005, 0.0)


def find_path(
    cell: RobotCell,
    grasp: Grasp,
    start: Placement,
    goal: Placement | Sequence[Placement] | TurnedGoal | ArmGoal,
    scene: CollisionScene,
    *,
    q_start: ArrayLike | None = None,
    nodes: int | None = None,
    time_limit: float = 10.0,
    seed: int = 0,
    region: ArrayLike | None = None,
    clearance: float = 0.0,
    watch: Callable[[int], bool | None] | None = None,
) -> Route:
    """Find a way of the object from one pose to another that all arms can follow, clear of all bodies, and prove it.

    Two trees of poses grow from both ends; each edge is a straight line along which all arms walk. The way is
    shortened, its corners are rounded off, and :func:`check_path` proves it. What is not found may exist all the same.

    Args:
        cell, grasp: the arms, and how they hold the object.
        start: pose of the object.
        goal: pose of the object; several of them; one with free turns (:class:`coopqp.planning.TurnedGoal`); or joint
            positions of one arm, which give it (:class:`coopqp.planning.ArmGoal`).
        scene: the bodies that keep distances, a :class:`coopqp.CollisionScene` of the same cell.
        q_start: configuration at the start (nq,); found by default.
        nodes: number of poses in the trees that ends the search, samples that lead to none included. A search that
            ends by it gives the same way again, bit for bit, with the same seed, version and type of processor.
        time_limit: the longest search [s]; a way that is found by then is shortened, rounded and proved after it.
        seed: seed of the random numbers.
        region: lowest and highest origin of the object (2, 3) [m]; by default from 0.3 m below start and goal to 0.4 m
            above them, in every direction.
        clearance: distance that is kept beyond the scene's margins [m].
        watch: is told the number of poses in the trees now and then; a true answer ends the search. A way that was
            found by then is rounded and proved.

    Raises:
        InvalidInputError: bad arguments, or a start that does not hold the object at its pose.
    """
    began = time.perf_counter()
    where = "find_path"
    grasp.check_arms(cell)
    cell.refuse_shared("find_path")
    check_scene(cell, scene, f"{where}: scene")
    if scene is None:
        raise InvalidInputError("no scene", f"{where}: scene", "Give a CollisionScene; without bodies use check_path.")
    T_start = as_placement(start, f"{where}: start")
    arms = [ArmKinematics(arm) for arm in cell.arms]
    goals, all_of_them = goal_poses(goal, cell, grasp, arms, T_start)
    limits = _Limits(
        nodes=None if nodes is None else as_count(nodes, f"{where}: nodes"),
        until=began + as_scalar(time_limit, f"{where}: time_limit"),
        shortens=nodes is None,
        watch=watch,
    )
    bounds = _region(region, [T_start, *(pose.T for pose in goals)], f"{where}: region")
    clearance = as_scalar(clearance, f"{where}: clearance", open_low=False)
    scene = scene.widened(clearance) if clearance > 0.0 else scene
    given = None if q_start is None else cell.check_configuration(q_start, f"{where}: q_start")
    finding = _Finding(cell, grasp, arms, scene, began, limits, bounds, np.random.default_rng(seed))
    return finding.route(T_start, goals, given, all_of_them=all_of_them)


@dataclass(frozen=True, kw_only=True)
class _Limits:
    """What ends the search: a number of nodes, the clock or who watches; and whether the clock ends shortcuts, too."""

    nodes: int | None
    until: float
    shortens: bool
    watch: Callable[[int], bool | None] | None


def _region(region: ArrayLike | None, ends: Sequence[pin.SE3], where: str) -> Array:
    """Lowest and highest origin (2, 3) [m]."""
    p = np.array([T.translation for T in ends])
    if region is None:
        return np.array([p.min(axis=0) - _BELOW, p.max(axis=0) + _ABOVE])
    remedy = "Give the lowest and the highest origin [m], each (3,)."
    try:
        box = as_floats(region)
    except NOT_NUMBERS as error:
        raise InvalidInputError(f"not numbers ({error})", where, remedy) from error
    if box.shape != (2, 3) or not np.isfinite(box).all():
        raise InvalidInputError(f"shape {box.shape}, or not finite", where, remedy)
    if not (box[0] <= box[1]).all():
        raise InvalidInputError("its low corner is above its high one", where, "Give the lowest origin first [m].")
    if not ((p >= box[0] - 1e-9) & (p <= box[1] + 1e-9)).all():
        raise InvalidInputError("start or goal is outside", where, "Give a region that contains both.")
    return box


@final
class _Finding:
    """One search with all that it needs."""

    def __init__(
        self,
        cell: RobotCell,
        grasp: Grasp,
        arms: list[ArmKinematics],
        scene: CollisionScene,
        began: float,
        limits: _Limits,
        region: Array,
        rng: np.random.Generator,
    ) -> None:
        self._cell, self._grasp, self._scene = cell, grasp, scene
        self._began, self._limits, self._region, self._rng = began, limits, region, rng
        self._arms = arms
        required, _ = scene.required_at(np.empty((0, cell.nv)))
        anywhere = np.full(cell.nv, np.inf)
        self._kept = EdgeLimits(-anywhere, anywhere, required.copy(), np.full(len(required), SPARE))
        self._refused: list[str] = []
        self._edges: Edges = scene.edges(self._arms, grasp, self._kept)
        self._shaper = Shaper(edges=self._edges, limits=cell.limits)

    def route(self, start: pin.SE3, poses: Sequence[GoalPose], q_start: Array | None, *, all_of_them: bool) -> Route:
        """The answer; ``all_of_them``: no other pose is a goal."""
        starts = self._starts(start, q_start)
        if not len(starts.x):
            return self._no_end(starts, "start")
        goals: list[tuple[pin.SE3, Ends]] = []
        failed: list[Ends] = []
        for pose in poses:
            given = {} if pose.positions is None else {pose.arm: pose.positions}
            found = ends_at(
                self._cell, self._arms, self._grasp, pose.T, self._scene, self._edges, near=starts.x[0], given=given
            )
            if len(found.x):
                goals.append((pose.T, found))
            else:
                failed.append(found)
            if len(goals) == _MOST_GOALS:
                break
        if not goals:
            proved = all_of_them and all(found.proved for found in failed)
            return self._no_end(replace(failed[0], proved=proved), "goal")
        self._keep([starts, *(found for _, found in goals)])
        roots = [Node(Pose.of(start), *row) for row in zip(starts.x, starts.rooms, strict=True)]
        ends = [Node(Pose.of(T), *row) for T, found in goals for row in zip(found.x, found.rooms, strict=True)]
        return self._between(roots, ends)

    def _starts(self, start: pin.SE3, q_start: Array | None) -> Ends:
        if q_start is None:
            return self._found_starts(start)
        x = self._cell.positions(q_start)
        exact = self._cell.positions(self._exact(start, x))
        if np.abs(exact - x).max() > _OFF:
            raise InvalidInputError(
                "it does not hold the object at the start",
                "find_path: q_start",
                "Give a start that does (inverse_kinematics), or none.",
            )
        required, _ = self._scene.required_at(exact[None])
        self._kept.required[:] = required
        rooms = self._edges.rooms(exact)
        if rooms.min(initial=np.inf) < -SMALL_CLEARANCE:
            first, second = self._scene.labels[int(rooms.argmin())]
            return Ends(np.empty((0, self._cell.nv)), rooms[None][:0], f"{first} and {second} come inside their margin")
        return Ends(exact[None], rooms[None])

    def _found_starts(self, start: pin.SE3) -> Ends:
        """Starts at a pose, at which pairs that may start inside their margin are as near as they are."""
        free, required = self._scene.starts_inside, self._kept.required
        required[free] = -np.inf
        found = ends_at(self._cell, self._arms, self._grasp, start, self._scene, self._edges)
        required[:] = self._scene.required_at(found.x)[0]
        if not (free.any() and len(found.x)):
            return found
        return Ends(found.x, np.array([self._edges.rooms(x) for x in found.x]))

    def _keep(self, ends: Sequence[Ends]) -> None:
        """Limits of the edges: ends may be closer to a limit, or to a body, than the way between them gets."""
        kept = limits_with(self._cell, np.vstack([found.x for found in ends]), self._kept.required)
        rooms = np.vstack([found.rooms for found in ends]).min(axis=0)
        self._kept.lower[:], self._kept.upper[:] = kept.lower, kept.upper
        self._kept.spare[:] = np.clip(rooms - _ROUNDING, -_ROUNDING, SPARE)
        # No bound proves an edge that begins on a margin. Where an end has less room, bounds between the poses of edges
        # are looser by as much, the poses keep the same distance, and the check of the whole way decides.
        looser = np.minimum(rooms - SPARE, 0.0)
        self._kept.required[:] += looser
        self._kept.spare[:] -= looser
        for found in ends:
            found.rooms[:] -= looser

    def _no_end(self, ends: Ends, which: str) -> Route:
        spent = time.perf_counter() - self._began
        verdict = RouteVerdict.INFEASIBLE if ends.proved else RouteVerdict.NOT_FOUND
        reason = f"The {which} is impossible: {ends.why}."
        if not ends.proved:
            reason = f"No way was found; nothing is proved. At the {which} {ends.why}."
        reason += "".join(f" Note: {text}." for text in remark(self._scene.notes))  # a hull may be what is in the way
        return Route(verdict=verdict, reason=reason, first_s=spent, total_s=spent)

    def _between(self, starts: list[Node], goals: list[Node]) -> Route:
        """A way between roots."""
        edge = straight(self._edges, starts[0], goals[0].pose)
        if edge.complete:
            way = [starts[0], *edge.nodes]
            spent = time.perf_counter() - self._began
            route = self._proved([self._shape(way, WIDEST)], RouteVerdict.STRAIGHT, None, spent)
            if route is not None:
                return route
        task = Searched(
            arms=self._arms, grasp=self._grasp, columns=columns_of(self._cell, self._arms), scene=self._scene,
            edges=self._edges, kept=self._kept, region=self._region,
        )  # fmt: skip
        search = Search(task, starts, goals, self._rng)
        result = search.result
        redundant = any(arm.n > 6 for arm in self._arms)
        ways, meetings = 0, _FEW_MEETINGS
        while ways < _MOST_WAYS:
            own = self._limits
            most = meetings if redundant else None
            result = search.run(SearchLimits(nodes=own.nodes, until=own.until, meetings=most, watch=own.watch))
            first = time.perf_counter() - self._began
            if result.way:
                route = self._proved(self._shapes(task, starts, goals, result), RouteVerdict.FOUND, result, first)
                ways += 1
            elif most is not None and len(result.meetings) >= most:
                route = self._led(task, result, first)
                meetings *= 2
            else:
                break
            if route is not None:
                return route
            search.forget()
        return self._not_found(result)

    def _led(self, task: Searched, result: SearchResult, first: float) -> Route | None:
        """A way along which the trees met, whose elbows go over from one motion to another; None if none is proved."""
        limits = self._cell.limits
        until = time.perf_counter() + _BETTERING if self._limits.shortens else np.inf
        for before, behind in sorted(result.meetings, key=lambda met: len(met[0]) + len(met[1]))[:_TRIED_MEETINGS]:
            for led in led_ways(task, before, behind, self._rng, until):
                squares = estimated_squares(limits, led.s, led.positions)
                squares[np.isin(led.s, led.geometry.marks[list(led.geometry.corners)])] = 0.0
                path = TimedPath(led.geometry, SpeedProfile(led.s, squares))
                check = check_motion(self._cell, self._grasp, path, led.positions, self._scene)
                if check is None or check.verdict is not PathVerdict.CERTIFIED:
                    self._refused.append("UNDECIDED" if check is None else check.verdict.value)
                    continue
                path = TimedPath(
                    led.geometry,
                    path.profile,
                    keeps_clear=True,
                    elbows=Elbows.through(path.profile.clocks, led.positions),
                )
                return self._route(RouteVerdict.FOUND, path, check.on(path), result, first, led.positions, led.rows)
        return None

    def _shapes(
        self, task: Searched, starts: list[Node], goals: list[Node], result: SearchResult
    ) -> list[Shape | None]:
        """Shapes of the way and of some others, each shortened, the fastest first; that one is made faster still."""
        began = time.perf_counter()
        until = began + _BETTERING if self._limits.shortens else np.inf
        shapes = [self._shape(shortened(self._edges, result.way, self._rng, until), WIDEST)]
        for _ in range(_OTHERS):
            if self._limits.shortens and time.perf_counter() > began + _SEARCHING:
                break
            other = Search(task, starts, goals, self._rng)
            limits = SearchLimits(nodes=_OTHER_NODES + 2 * result.nodes, until=until, watch=self._limits.watch)
            if way := other.run(limits).way:
                shapes.append(self._shape(shortened(self._edges, way, self._rng, until), WIDEST))
        free = sorted((shape for shape in shapes if shape is not None), key=_duration)
        if not free:
            return []
        better = sorted((self._faster(shape, until, _FEW_CHANGES) for shape in free[:_PROMISING]), key=_duration)
        return [self._faster(better[0], until, _MANY_CHANGES), *better, *free]

    def _faster(self, shape: Shape, until: float, changes: int) -> Shape:
        return self._shaper.faster(shape, self._rng, until, changes=changes)

    def _shape(self, way: list[Node], widest: float) -> Shape | None:
        return self._shaper.shaped(way[0], corners_of(way), widest)

    def _proved(
        self, shapes: Sequence[Shape | None], verdict: RouteVerdict, result: SearchResult | None, first: float
    ) -> Route | None:
        """The first shape that is proved, with less rounded corners if need be; None if none is."""
        for given in shapes:
            for widest in (WIDEST, *_LESS) if given is not None else ():
                assert given is not None
                shape: Shape | None = given
                if widest < WIDEST:
                    shape = self._shaper.shaped(given.start, given.poses, widest)
                if shape is None:
                    continue
                path = some_timing(shape.geometry())
                start = shape.start
                q_start = self._exact(start.pose.placement(), start.x)
                check = check_path(self._cell, self._grasp, path, q_start=q_start, scene=self._scene)
                if check.verdict is PathVerdict.CERTIFIED:
                    return self._route(verdict, path, check, result, first, shape.positions, shape.rows)
                self._refused.append(check.verdict.value)
                if len(shape.poses) < 3:
                    break
        return None

    def _route(
        self,
        verdict: RouteVerdict,
        path: TimedPath,
        check: PathCheck,
        result: SearchResult | None,
        first: float,
        joints: Array,
        poses: Array,
    ) -> Route:
        """The answer with a way."""
        return Route(
            verdict=verdict,
            path=path,
            check=check,
            length=path.geometry().length,
            nodes=0 if result is None else result.nodes,
            first_s=first,
            total_s=time.perf_counter() - self._began,
            trees=() if result is None else tuple(map(_edges_of, result.trees)),
            joints=joints,
            poses=poses,
            refused=tuple(self._refused),
        )

    def _exact(self, T_world_object: pin.SE3, x: Array) -> Array:
        """The configuration (nq,) at joint positions (nv,) that holds the object at a pose to rounding."""
        return exact_start(Chain(self._cell, self._grasp), T_world_object, x)

    def _not_found(self, result: SearchResult) -> Route:
        spent = time.perf_counter() - self._began
        close = f"; the trees came within {result.closest:.2f} m" if np.isfinite(result.closest) else ""
        if self._refused:
            close = f"; of {len(self._refused)} shapes of ways that were found none was proved"
        return Route(
            verdict=RouteVerdict.NOT_FOUND,
            reason=(
                f"No way in {spent:.1f} s and {result.nodes} poses; nothing is proved{close}"
                f"{self._blame(result.stops)}."
            ),
            nodes=result.nodes,
            first_s=spent,
            total_s=spent,
            trees=tuple(map(_edges_of, result.trees)),
            refused=tuple(self._refused),
        )

    def _blame(self, stops: Counter[Stop]) -> str:
        """What stopped most edges."""
        if not stops:
            return ""
        (kind, index), _ = stops.most_common(1)[0]
        if kind == "pair":
            return "; {} and {} stop it most".format(*self._scene.labels[index])
        k = self._cell.arm_of_joint(index)
        own = int(np.flatnonzero(columns_of(self._cell, self._arms)[k] == index)[0])
        arm = self._arms[k]
        what = {
            "reach": "the end of its reach",
            "singular": "a singularity",
            "limit": f"the limit of {arm.joints[own]}",
        }
        return f"; arm {arm.arm.name} stops it most, at {what[kind]}"


def _duration(shape: Shape) -> float:
    return shape.duration


def _edges_of(tree: Tree) -> Array:
    """Origins at both ends of the edges (E, 2, 3) [m]."""
    pairs = [(tree.nodes[j].pose.p, node.pose.p) for node, j in zip(tree.nodes, tree.parents, strict=True) if j >= 0]
    return np.array(pairs).reshape(-1, 2, 3)
