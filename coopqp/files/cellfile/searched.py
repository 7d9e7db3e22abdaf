"""A way round for the task of a cell file: the search that a file asks for, and one in place of its path."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from coopqp.collision.scene import CollisionScene
from coopqp.errors import CoopqpError, UndecidedError, UnreachableError
from coopqp.files.cellfile.build_arm import build_placement
from coopqp.files.cellfile.search_tables import GoalTable, SearchTable
from coopqp.model.cell import RobotCell
from coopqp.model.grasp import Grasp
from coopqp.model.inverse_kinematics import inverse_kinematics
from coopqp.paths.elbows import Elbows
from coopqp.paths.path import ObjectPath
from coopqp.paths.timed import SpeedProfile, TimedPath
from coopqp.planning.route.finding import find_path
from coopqp.planning.route.goals import FreeTurn, TurnedGoal
from coopqp.planning.route.route import Route, RouteVerdict
from coopqp.spatial import Array, Placement

#: Speed along a way where a file gives none [m/s].
SPEED = 0.25


@dataclass(frozen=True, kw_only=True, eq=False)
class SearchTask:
    """What is searched.

    Attributes:
        cell, grasp: the arms, and how they hold the object.
        start: pose of the object at the start.
        goal: its pose at the end, or one with free turns.
        q_start: the start (nq,); None if it is to be found.
        scene: the bodies that keep distances.
        options: further arguments of :func:`coopqp.find_path`.
        speed: largest speed along the way at full rate [m/s].
    """

    cell: RobotCell
    grasp: Grasp
    start: pin.SE3
    goal: Placement | TurnedGoal
    q_start: Array | None
    scene: CollisionScene
    options: dict[str, Any]
    speed: float

    def route(self, *, watch: Callable[[int], bool | None] | None = None, **changes: Any) -> Route:
        """Search; ``changes`` replace options."""
        options = {**self.options, **changes}
        return find_path(
            self.cell, self.grasp, self.start, self.goal, self.scene, q_start=self.q_start, watch=watch, **options
        )

    def path(self, route: Route) -> TimedPath:
        """The way in the time of this task.

        Raises:
            UnreachableError, UndecidedError: there is none.
        """
        if route.path is None:
            raise (UnreachableError if route.verdict is RouteVerdict.INFEASIBLE else UndecidedError)(route.reason)
        profile, elbows = route.path.profile, route.path.elbows
        share = self.speed / float(np.sqrt(profile.squares.max()))
        if elbows is not None:
            elbows = Elbows(elbows.clocks / share, elbows.x, share * elbows.slopes)
        timed = SpeedProfile(profile.s, share**2 * profile.squares)
        return TimedPath(route.path.geometry(), timed, keeps_clear=route.path.keeps_clear, elbows=elbows)


def search_task(
    table: Any,
    path: ObjectPath | None,
    cell: RobotCell,
    grasp: Grasp,
    q_start: Array | None,
    scene: CollisionScene | None,
    *,
    is_near: bool,
) -> SearchTask:
    """The search for a file: the one that its path asks for, or one between the ends of another path.

    Args:
        table: the table ``path`` of the file.
        path: the path of another kind.
        cell, grasp: the arms, and how they hold the object.
        q_start: the start of the file (nq,), if it has one.
        scene: its bodies.
        is_near: the start is only near.

    Raises:
        CoopqpError: the file has no bodies, or its path has no end.
    """
    if scene is None:
        raise CoopqpError("a way round needs to know what is in the way: add a table [collision] with obstacles.")
    options: dict[str, Any] = {}
    speed = SPEED
    goal: Placement | TurnedGoal
    if path is None:
        assert isinstance(table, SearchTable)
        start, goal = build_placement(table.start), _goal(table.goal)
        options, speed = table.options, table.speed_m_per_s
    else:
        start, goal = path.pose(0.0), path.pose(path.duration)
    if q_start is not None and is_near:
        q_start = inverse_kinematics(cell, grasp, start, q_start)
    return SearchTask(
        cell=cell, grasp=grasp, start=start, goal=goal, q_start=q_start, scene=scene, options=options, speed=speed
    )


def _goal(table: GoalTable) -> Placement | TurnedGoal:
    T = build_placement(table)
    free = [FreeTurn(turn.axis, *np.deg2rad(turn.range_deg).tolist()) for turn in table.free]
    return TurnedGoal(T, free) if free else T
