"""What a search for a way answers."""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from coopqp.errors import InvalidInputError, UndecidedError
from coopqp.paths.timed import TimedPath
from coopqp.planning.check import PathCheck, check_motion
from coopqp.planning.planner import Plan, plan
from coopqp.planning.timing import SHARE, timed_motion
from coopqp.spatial import Array

#: Numbers of knots that are tried where the timing fails numerically.
_KNOTS = (350, 530)


class RouteVerdict(enum.Enum):
    """Whether there is a way."""

    STRAIGHT = "STRAIGHT"  #: the straight way is free, which is proved
    FOUND = "FOUND"  #: a way was found, and is proved
    NOT_FOUND = "NOT_FOUND"  #: none was found; nothing is proved
    INFEASIBLE = "INFEASIBLE"  #: the arms cannot hold the object at the start, or at any goal


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Route:
    """The answer of :func:`find_path`.

    Attributes:
        verdict: whether there is a way.
        path: the way with rounded corners, in some time from rest to rest; None if there is none. It has a motion of
            the elbows of redundant arms (``path.elbows``) where their least motion does not get through.
        check: its proof; None if there is none.
        reason: why there is no way; empty if there is.
        length: length of the way [m]; 1 rad counts as 0.3 m. NaN if there is none.
        nodes: poses in both trees.
        first_s: time until a way without contact was found, or none was [s].
        total_s: time until it was shortened, rounded and proved [s].
        trees: origins of the object along the edges of both trees (E, 2, 3) [m], for pictures.
        joints: joint positions along the way (K, nv) [rad or m]; None if there is none.
        poses: poses of the object there, rows of R (9), p (3): (K, 12).
        refused: verdicts of the check on ways that were searched and not proved.
    """

    verdict: RouteVerdict
    path: TimedPath | None = None
    check: PathCheck | None = None
    reason: str = ""
    length: float = np.nan
    nodes: int = 0
    first_s: float = 0.0
    total_s: float = 0.0
    trees: tuple[Array, ...] = ()
    joints: Array | None = None
    poses: Array | None = None
    refused: tuple[str, ...] = ()

    @property
    def found(self) -> bool:
        """True if there is a way: STRAIGHT or FOUND."""
        return self.path is not None

    def timed(self, **options: Any) -> Plan:
        """The fastest motion along the way, from rest to rest; options as for :func:`plan`.

        Raises:
            InvalidInputError: there is no way.
            UnreachableError, UndecidedError, MissingExtraError: as for :func:`plan`.
        """
        if self.path is None or self.check is None:
            raise InvalidInputError("there is no way", "Route.timed", "Ask whether it is `found` before.")
        check, path = self.check, self.path
        if path.elbows is not None:
            return self._led(path, check, options)
        for knots in (options.pop("knots", None), *_KNOTS):
            try:
                return plan(
                    check.cell, check.grasp, path, q_start=check.q_start, scene=check.scene, knots=knots, **options
                )
            except UndecidedError as error:
                failed = error  # of the numbers: with other knots it succeeds mostly
        raise failed

    def _led(self, path: TimedPath, check: PathCheck, options: dict[str, Any]) -> Plan:
        """The fastest motion whose elbows go as they were found."""
        from scipy.interpolate import CubicSpline  # takes long to import

        assert path.elbows is not None
        assert check.q_start is not None
        assert check.scene is not None
        lead = CubicSpline([path.at(clock)[0] for clock in path.elbows.clocks.tolist()], path.elbows.x)
        settings = {"payload": None, "bounds": (), "jerk": None, "share": SHARE, "knots": None, **options}
        motion = timed_motion(check.cell, check.grasp, path, q_start=check.q_start, lead=lead, **settings)
        own = check_motion(check.cell, check.grasp, motion.path, motion.x, check.scene)
        if own is None or not own.feasible:
            raise UndecidedError(
                "it is not proved that the fastest motion of the elbows keeps clear; run `path` itself"
            )
        timed = motion.path.kept_clear()
        return Plan(q_start=check.q_start, grasp=check.grasp, path=timed, start=None, check=own.on(timed))

    def explain(self) -> str:
        """The answer in sentences."""
        if self.path is None:
            return self.reason
        straight = self.verdict is RouteVerdict.STRAIGHT
        head = "The straight way is free." if straight else f"A way of {self.length:.2f} m was found."
        return head if self.check is None else f"{head}\n{self.check.explain()}"

    def record(self) -> dict[str, Any]:
        """Plain data for JSON."""
        return {
            "verdict": self.verdict.value,
            "reason": self.reason,
            "length_m": None if np.isnan(self.length) else self.length,
            "nodes": self.nodes,
            "first_s": self.first_s,
            "total_s": self.total_s,
            "check": None if self.check is None else self.check.record(),
        }

    def __repr__(self) -> str:
        length = f", {self.length:.2f} m" if self.found else ""
        return f"Route({self.verdict.value.lower()}{length}; {self.nodes} nodes)"
