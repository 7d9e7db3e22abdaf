"""The search that a phase of a program asks for."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, final

from coopqp.checks import as_scalar
from coopqp.errors import InvalidInputError, UndecidedError, UnreachableError
from coopqp.model.cell import RobotCell
from coopqp.model.grasp import Grasp
from coopqp.paths.path import ObjectPath
from coopqp.paths.timed import SpeedProfile, TimedPath
from coopqp.planning.route.finding import find_path
from coopqp.planning.route.goals import ArmGoal, TurnedGoal
from coopqp.planning.route.route import RouteVerdict
from coopqp.programs.search import SearchedWay
from coopqp.spatial import Array, Placement, as_placement


@final
@dataclass(frozen=True, eq=False)
class Search(SearchedWay):
    """The path of a phase that is searched when the program is built, by :func:`coopqp.find_path`, and proved.

    It begins where the phase before ends, and all arms go with the object. Corners of the way are rounded off.

    Args:
        to: where it goes: a pose, or as in :func:`coopqp.find_path` one with free turns.
        scene: the bodies that keep distances, a :class:`coopqp.CollisionScene` of the same cell.
        speed: largest speed along the way [m/s]; 1 rad counts as 0.3 m.
        options: further arguments of :func:`coopqp.find_path`: nodes, time_limit, seed, region, clearance.
        start: where a first phase begins; others begin where the phase before ends.
    """

    to: Placement | TurnedGoal | ArmGoal
    scene: Any
    speed: float = 0.25
    options: Mapping[str, Any] = field(default_factory=dict)
    start: Placement | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "speed", as_scalar(self.speed, "Search: speed"))
        object.__setattr__(self, "options", dict(self.options))

    def found(self, cell: RobotCell, grasp: Grasp, start: Placement, q: Array | None, where: str) -> ObjectPath:
        """See :class:`SearchedWay`."""
        scene = self.scene.of_cell(cell, grasp)
        route = find_path(cell, grasp, as_placement(start, where), self.to, scene, q_start=q, **self.options)
        if route.path is None:
            error = UnreachableError if route.verdict is RouteVerdict.INFEASIBLE else UndecidedError
            raise error(f"{where}: {route.reason}")
        if route.path.elbows is not None:
            raise InvalidInputError(
                "its way needs a motion of the elbows, which a phase does not carry",
                where,
                "Search with find_path, and follow that path alone.",
            )
        profile = route.path.profile
        share = self.speed / math.sqrt(float(profile.squares.max()))
        return TimedPath(route.path.geometry(), SpeedProfile(profile.s, share**2 * profile.squares))
