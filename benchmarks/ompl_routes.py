"""OMPL's RRT-Connect with the kinematics and distances of coopqp: the peer of routes.py, in three ways.

``ompl callback`` searches poses of the object and asks at states whether the arms, by Newton's method from the start's
joints, hold the object there inside their limits, clear of bodies. ``ompl motion validator`` asks of whole motions:
the arms walk along them, as along the edges of coopqp. ``ompl joint space`` searches the joints of all arms, projected
on the closed chain (``ProjectedStateSpace``). A way is shortened by OMPL, and the object's poses along it are checked
by ``check_path``. OMPL takes one seed in a process: that of the first search.
"""

from __future__ import annotations

import functools
import importlib.util
import time
from collections.abc import Callable, Iterator
from typing import Any, final

import common  # noqa: F401  # first: it limits BLAS to one thread
import numpy as np
import pinocchio as pin
from common import Record
from route_cases import Problem

from coopqp import WaypointPath, check_path, inverse_kinematics
from coopqp.collision.edges import EdgeLimits, columns_of
from coopqp.model.batch import REACHED, ArmKinematics
from coopqp.planning import PathVerdict
from coopqp.planning.route.tree import Node, Pose, straight
from coopqp.spatial import Array

#: Names of the engines, and what to do where they are missing.
ENGINES = ("ompl callback", "ompl motion validator", "ompl joint space")
REMEDY = "run this in an environment of its own with coopqp and `pip install ompl`"
#: Motion between states that are asked for [m]; in the joint space [rad].
_STEP = 0.02
_JOINT_STEP = 0.1
#: Error of the closed chain that counts as none [m, rad].
_CLOSED = 1e-4
_BELOW, _ABOVE = 0.3, 0.4


def available() -> bool:
    """Whether OMPL is installed."""
    return importlib.util.find_spec("ompl") is not None


def rows(name: str, seed: int, problem: Problem, time_limit: float) -> Iterator[Record]:
    """Records of the engines on one problem."""
    from ompl import util

    util.setLogLevel(util.LogLevel.LOG_ERROR)
    _seed(seed + 1)
    setups: tuple[Callable[[Problem], Any], ...] = (_poses, functools.partial(_poses, validates=True), _joints)
    for engine, made in zip(ENGINES, setups, strict=True):
        setup, pose = made(problem)
        record: Record = {"problem": name, "seed": seed, "engine": engine}
        yield record | _solved(setup, pose, problem, time_limit)


_seeded: list[int] = []


def _seed(seed: int) -> None:
    """The seed of this process, once."""
    from ompl import util

    if not _seeded:
        util.RNG.setSeed(seed)
        _seeded.append(seed)


def _solved(setup: Any, pose: Callable[[Any], pin.SE3], problem: Problem, time_limit: float) -> Record:
    """What a search finds, shortened and checked; ``pose``: the object's pose in a state."""
    began = time.perf_counter()
    setup.solve(time_limit)
    first = time.perf_counter() - began
    found = bool(setup.haveExactSolutionPath())
    record: Record = {"found": found, "first_s": first}
    if not found:
        return record | {"total_s": first, "check": PathVerdict.UNDECIDED.value}
    setup.simplifySolution()
    poses = [pose(state) for state in setup.getSolutionPath().getStates()]
    path = WaypointPath(poses, durations=[1.0] * (len(poses) - 1))
    check = check_path(problem.cell, problem.grasp, path, q_start=problem.q_start, scene=problem.scene)
    geometry = path.geometry()
    pair = None if check.clearance is None else check.clearance.pair
    return record | {
        "total_s": time.perf_counter() - began,
        "length_m": None if geometry is None else geometry.length,
        "check": check.verdict.value,
        "clearance_mm": None if pair is None else 1e3 * pair.distance,
    }


def _poses(problem: Problem, *, validates: bool = False) -> tuple[Any, Callable[[Any], pin.SE3]]:
    """A search of poses; ``validates``: with walks of the arms along motions."""
    from ompl import base, geometric

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
    if validates:

        class Walks(base.MotionValidator):  # type: ignore[misc]
            def checkMotion(self, a: Any, b: Any) -> bool:
                return holds.walks(_pose(a), _pose(b))

        information.setMotionValidator(Walks(information))
    setup.setStartAndGoalStates(_state(space, problem.start), _state(space, problem.goal))
    setup.setPlanner(geometric.RRTConnect(information))
    return setup, _pose


def _joints(problem: Problem) -> tuple[Any, Callable[[Any], pin.SE3]]:
    """A search of the joints of all arms, projected on the closed chain."""
    from ompl import base, geometric

    cell, holds = problem.cell, _Holds(problem)
    n, closed = cell.nv, 6 * (len(cell.arms) - 1)

    class Chain(base.Constraint):  # type: ignore[misc]
        def __init__(self) -> None:
            super().__init__(n, closed, _CLOSED)

        def function(self, x: Array, out: Array) -> None:
            out[:] = holds.apart(np.asarray(x))

        def jacobian(self, x: Array, out: Array) -> None:
            x = np.asarray(x)
            here, h = holds.apart(x), 1e-7
            for j in range(n):
                out[:, j] = (holds.apart(x + h * np.eye(n)[j]) - here) / h

    ambient = base.RealVectorStateSpace(n)
    bounds = base.RealVectorBounds(n)
    for j in range(n):
        bounds.setLow(j, float(max(cell.limits.lower[j], -2.0 * np.pi)))
        bounds.setHigh(j, float(min(cell.limits.upper[j], 2.0 * np.pi)))
    ambient.setBounds(bounds)
    space = base.ProjectedStateSpace(ambient, Chain())
    information = base.ConstrainedSpaceInformation(space)
    space.setDelta(_JOINT_STEP)
    setup = geometric.SimpleSetup(information)

    def values(state: Any) -> Array:
        return np.array([state[j] for j in range(n)])

    setup.setStateValidityChecker(lambda state: holds.clear(values(state)))
    ends = []
    q_goal = inverse_kinematics(cell, problem.grasp, problem.goal, problem.q_start)
    for q in (problem.q_start, q_goal):
        state = space.allocState()
        state.copy(cell.positions(q).tolist())
        ends.append(state)
    setup.setStartAndGoalStates(*ends)
    setup.setPlanner(geometric.RRTConnect(information))
    return setup, lambda state: holds.pose(values(state))


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
        x = self._at(T_world_object)
        return x is not None and self.clear(x)

    def _at(self, T_world_object: pin.SE3) -> Array | None:
        """The arms' positions (nv,) at a pose, by Newton's method from the start's; None where there are none."""
        x = self._x.copy()
        for arm, own, X in zip(self._arms, self._columns, self._grasp.T_object_tool, strict=True):
            q, residual = arm.newton(Pose.of(T_world_object * X).row()[None], x[None, own])
            if not residual[0] <= REACHED:
                return None
            x[own] = q[0]
        return x

    def clear(self, x: Array) -> bool:
        """Whether joint positions (nv,) keep limits and distances."""
        inside = ((x >= self._limits.lower) & (x <= self._limits.upper)).all()
        return bool(inside and (self._edges.rooms(x) >= 0.0).all())

    def walks(self, a: pin.SE3, b: pin.SE3) -> bool:
        """Whether all arms walk from a pose straight to another, clear of bodies between samples, too."""
        x = self._at(a)
        if x is None or not self.clear(x):
            return False
        return straight(self._edges, Node(Pose.of(a), x, self._edges.rooms(x)), Pose.of(b)).complete

    def pose(self, x: Array) -> pin.SE3:
        """Where the first arm holds the object at joint positions (nv,)."""
        return self._views(x)[0]

    def apart(self, x: Array) -> Array:
        """How far the other arms' views of the object are from the first one's, 6 numbers each [m, rad]."""
        first, *others = self._views(x)
        return np.concatenate([pin.log6(first.actInv(view)).vector for view in others])

    def _views(self, x: Array) -> list[pin.SE3]:
        views = []
        for arm, own, X in zip(self._arms, self._columns, self._grasp.T_object_tool, strict=True):
            views.append(pin.SE3(arm.tool_poses(x[None, own])[0]) * X.inverse())
        return views


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
