"""OMPL's RRT-Connect over poses of the object, with the kinematics and distances of coopqp: the peer of routes.py.

It knows no joints at a node. ``ompl callback`` asks at states whether the arms, by Newton's method from the start's
joints, hold the object there inside their limits, clear of bodies.
"""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Iterator
from typing import Any, final

import common  # noqa: F401  # first: it limits BLAS to one thread
import numpy as np
import pinocchio as pin
from common import Record
from route_cases import Problem

from coopqp import WaypointPath, check_path
from coopqp.model.batch import REACHED, ArmKinematics
from coopqp.planning import PathVerdict
from coopqp.planning.route.edges import EdgeLimits, columns_of
from coopqp.planning.route.tree import Pose
from coopqp.spatial import Array

#: Names of the engines, and what to do where they are missing.
ENGINES = ("ompl callback",)
REMEDY = "run this in an environment of its own with coopqp and `pip install ompl`"
#: Motion between states that are asked for [m].
_STEP = 0.02
_BELOW, _ABOVE = 0.3, 0.4


def available() -> bool:
    """Whether OMPL is installed."""
    return importlib.util.find_spec("ompl") is not None


def rows(name: str, seed: int, problem: Problem, time_limit: float) -> Iterator[Record]:
    """Records of the engines on one problem."""
    from ompl import base, geometric, util

    util.setLogLevel(util.LogLevel.LOG_ERROR)
    util.RNG.setSeed(seed + 1)
    space = base.SE3StateSpace()
    origins = np.array([problem.start.translation, problem.goal.translation])
    bounds = base.RealVectorBounds(3)
    for i in range(3):
        bounds.setLow(i, float(origins[:, i].min() - _BELOW))
        bounds.setHigh(i, float(origins[:, i].max() + _ABOVE))
    space.setBounds(bounds)
    setup = geometric.SimpleSetup(space)
    holds = _Holds(problem)
    setup.setStateValidityChecker(lambda state: holds(_pose(state)))
    information = setup.getSpaceInformation()
    information.setStateValidityCheckingResolution(_STEP / space.getMaximumExtent())
    setup.setStartAndGoalStates(_state(space, problem.start), _state(space, problem.goal))
    setup.setPlanner(geometric.RRTConnect(information))
    began = time.perf_counter()
    setup.solve(time_limit)
    first = time.perf_counter() - began
    found = bool(setup.haveExactSolutionPath())
    record: Record = {"problem": name, "seed": seed, "engine": ENGINES[0], "found": found, "first_s": first}
    if not found:
        yield record | {"total_s": first, "check": PathVerdict.UNDECIDED.value}
        return
    setup.simplifySolution()
    states = setup.getSolutionPath().getStates()
    poses = [_pose(state) for state in states]
    path = WaypointPath(poses, durations=[1.0] * (len(poses) - 1))
    check = check_path(problem.cell, problem.grasp, path, q_start=problem.q_start, scene=problem.scene)
    geometry = path.geometry()
    pair = None if check.clearance is None else check.clearance.pair
    yield record | {
        "total_s": time.perf_counter() - began,
        "length_m": None if geometry is None else geometry.length,
        "check": check.verdict.value,
        "clearance_mm": None if pair is None else 1e3 * pair.distance,
    }


@final
class _Holds:
    """Whether all arms hold the object at a pose, inside their limits and clear of bodies; compiled, as in coopqp."""

    def __init__(self, problem: Problem) -> None:
        cell, self._grasp = problem.cell, problem.grasp
        self._arms = [ArmKinematics(arm) for arm in cell.arms]
        self._columns = columns_of(cell, self._arms)
        self._x, self._limits = cell.positions(problem.q_start), cell.limits
        required, _ = problem.scene.required_at(self._x[None])
        kept = EdgeLimits(self._limits.lower, self._limits.upper, required, np.zeros(len(required)))
        self._edges = problem.scene.edges(self._arms, self._grasp, kept)

    def __call__(self, T_world_object: pin.SE3) -> bool:
        """At a pose."""
        x = self._x.copy()
        for arm, own, X in zip(self._arms, self._columns, self._grasp.T_object_tool, strict=True):
            q, residual = arm.newton(Pose.of(T_world_object * X).row()[None], x[None, own])
            if not residual[0] <= REACHED:
                return False
            x[own] = q[0]
        if not ((x >= self._limits.lower) & (x <= self._limits.upper)).all():
            return False
        return bool((self._edges.rooms(x) >= 0.0).all())


def _pose(state: Any) -> pin.SE3:
    turn = state.rotation()
    p: Array = np.array([state.getX(), state.getY(), state.getZ()])
    return pin.SE3(pin.Quaternion(turn.w, turn.x, turn.y, turn.z).normalized().toRotationMatrix(), p)


def _state(space: Any, T: pin.SE3) -> Any:
    state = space.allocState()
    state.setXYZ(*T.translation.tolist())
    turn, own = pin.Quaternion(T.rotation), state.rotation()
    own.x, own.y, own.z, own.w = turn.x, turn.y, turn.z, turn.w
    return state
