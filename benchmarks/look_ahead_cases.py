"""The cases of look_ahead.py: random paths, random cells near limits and singularities, and random redundant cells.

The fastest motion along each path comes from a dense backward and forward pass (TOPP-RA) of this file alone: it knows
the joints' limits and derivatives on a fine grid, and nothing of the controller.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from coopqp import ControlStep, Grasp, LinePath, QPController, RobotCell, Status, WaypointPath
from coopqp.errors import UnreachableError
from coopqp.model.chain import Chain
from coopqp.model.inverse_kinematics import newton
from coopqp.paths import TimeLaw
from coopqp.scenarios import Scenario, at_limit, at_singularity, ring
from coopqp.scenarios.arms import robot_arm
from coopqp.simulation import tool_placements
from coopqp.simulation.evaluation.metrics import object_poses, tool_matrices
from coopqp.spatial import Array

#: Intervals of the grid that the fastest motion is found on.
GRID = 500


@dataclass(frozen=True, kw_only=True)
class Run:
    """What became of one run.

    Attributes:
        end: the object's clock where it came to rest, or the path's duration [s].
        time: until the object was within a thousandth of the duration of its end, or at the end of the path [s].
        chain_um, path_um: largest chain and path errors [µm].
        qp: steps that were answered by the QP.
        held: steps that held.
        finished: whether the path was finished.
    """

    end: float
    time: float
    chain_um: float
    path_um: float
    qp: int
    held: int
    finished: bool
    clocks: Array


def run(task: Scenario, *, longest: float = 60.0, until: float | None = None) -> Run:
    """Drive a task without disturbances until it is finished, or stands.

    Args:
        task: what to do.
        longest: give up after this time [s].
        until: read the time to this clock [s] instead of the run's own end.
    """
    controller = QPController(task.cell, task.grasp, task.path, dt=task.dt)
    controller.reset(task.q_start)
    steps: list[ControlStep] = []
    still, finished = 0, False
    while (len(steps) + 1) * task.dt < longest and not finished and still <= 60:
        step = controller.step()
        steps.append(step)
        still = still + 1 if step.clock_next - step.clock < 1e-7 * task.dt else 0
        finished = step.finished
    poses = np.array([task.path.pose(step.clock_next).homogeneous for step in steps])
    objects = object_poses(tool_matrices(task.cell, np.array([step.q_next for step in steps])), task.grasp)
    # the objects' origins, seen by the path
    errors = np.einsum("tji,tnj->tni", poses[:, :3, :3], objects[..., :3, 3] - poses[:, None, :3, 3])
    apart, off = np.abs(errors - errors.mean(axis=1, keepdims=True)).max(), np.abs(errors).max()
    qp = sum(step.solver.name != "none" for step in steps)
    held = sum(step.status in (Status.HOLDING, Status.FAULT) for step in steps)
    table = np.array([0.0, *(step.clock_next for step in steps)])
    end = table[-1] if until is None else until
    near = end if finished and until is None else end - 1e-3 * task.path.duration
    reached = np.flatnonzero(table >= near - 1e-12)
    time = np.inf
    if reached.size:
        i = int(reached[0])
        share = (near - table[i - 1]) / (table[i] - table[i - 1]) if i else 0.0
        time = task.dt * (i - 1 + share) if i else 0.0
    return Run(
        end=float(table[-1]), time=float(time), chain_um=float(1e6 * apart), path_um=float(1e6 * off), qp=qp, held=held,
        finished=finished, clocks=table,
    )  # fmt: skip


# -- the fastest motion ------------------------------------------------------------------------------------------------


def joints_along(task: Scenario, clocks: Array) -> Array | None:
    """Positions (T, nv) of six-joint arms along the path; None where they cannot be followed."""
    chain, q, table = Chain(task.cell, task.grasp), task.q_start, []
    for clock in clocks:
        q, errors = newton(chain, task.path.pose(float(clock)), q, tolerance=1e-12, max_iter=20)
        if not np.abs(errors).max() < 1e-8:
            return None
        table.append(task.cell.positions(q))
    return np.array(table)


class _Slopes:
    """q′ on the path, near a configuration that is known."""

    def __init__(self, task: Scenario) -> None:
        self._task, self._chain = task, Chain(task.cell, task.grasp)

    def at(self, clock: float, q: Array) -> Array:
        path, chain = self._task.path, self._chain
        pose = path.pose(clock)
        q, _ = newton(chain, pose, q, tolerance=1e-12, max_iter=6)
        chain.linearise(q, about=pose.translation)
        twist = path.twist(min(max(clock, 1e-9), path.duration - 1e-9))
        along = np.concatenate([pose.rotation @ twist[:3], pose.rotation @ twist[3:]])
        out: Array = chain.joint_velocities(np.broadcast_to(along, (chain.n_arms, 6)))
        return out


def fastest(
    task: Scenario,
    *,
    start: float = 0.0,
    end: float,
    at_most: float = 1.0,
    slope: float = np.inf,
    stops: bool = True,
    grid: int = GRID,
) -> tuple[Array, Array]:
    """Clocks and times of the fastest motion along the path from rest to ``end`` [s], under all of the limits.

    Args:
        task: six-joint arms and a path without corners between ``start`` and ``end``.
        start, end: where the motion begins and ends.
        at_most: largest rate.
        slope: largest change of the rate [1/s].
        stops: whether the object rests at its end.
        grid: intervals.
    """
    even = np.linspace(0.0, end, grid + 1)
    x = joints_along(task, even)
    if x is None:
        raise ValueError("the path cannot be followed")
    # Intervals of equal motion, as far as joints move.
    way = np.abs(np.diff(x, axis=0)).max(axis=1)
    way = np.concatenate([[0.0], np.cumsum(way / way.sum() + 0.5 / grid)])
    first = float(np.interp(start, even, way))
    clocks = np.interp(np.linspace(first, way[-1], grid + 1), way, even)
    clocks[0], clocks[-1] = start, end
    x = np.array([np.interp(clocks, even, column) for column in x.T]).T
    along, cell = _Slopes(task), task.cell
    slopes, bends, h = np.empty_like(x), np.empty_like(x), np.diff(clocks)
    d = min(1e-4 * end, 0.5 * float(h.min()))
    for i, clock in enumerate(clocks.tolist()):
        q = cell.configuration(x[i])
        a, b = max(clock - d, start), min(clock + d, end)
        slopes[i] = along.at(min(max(clock, start + 1e-9), end - 1e-9), q)
        bends[i] = (along.at(b, q) - along.at(a, q)) / (b - a)  # q″ by differences on the chain itself
    speed, most = cell.limits.velocity, cell.limits.acceleration
    cap = np.minimum(at_most**2, ((speed / np.maximum(np.abs(slopes), 1e-300)) ** 2).min(axis=1))
    K = np.empty(grid + 1)
    K[-1] = 0.0 if stops else cap[-1]
    rows = []
    for i in range(grid):
        ends = ((slopes[i], bends[i]), (slopes[i + 1] + 2.0 * h[i] * bends[i + 1], bends[i + 1]))
        a = np.concatenate([*(s * u for u, _ in ends for s in (1.0, -1.0)), [1.0, -1.0]])
        b = np.concatenate([*(s * z for _, z in ends for s in (1.0, -1.0)), [0.0, 0.0]])
        rows.append((a, b, np.concatenate([np.tile(most, 4), [slope, slope]])))
    for i in range(grid - 1, -1, -1):
        K[i] = _largest(*rows[i], h[i], K[i + 1], cap[i])
    z, times = np.zeros(grid + 1), np.zeros(grid + 1)
    z[0] = 0.0 if stops else K[0]
    for i in range(grid):
        z[i + 1] = max(min(z[i] + 2.0 * h[i] * _highest(*rows[i], z[i]), K[i + 1]), 0.0)
        times[i + 1] = times[i] + 2.0 * h[i] / max(np.sqrt(z[i]) + np.sqrt(z[i + 1]), 1e-12)
    return clocks, times


def _bounds(a: Array, b: Array, c: Array, z: float) -> tuple[float, float, float, float]:
    """Largest lower and least upper bound of u in a u + b z ≤ c, with their slopes in z."""
    up, down = a > 1e-12, a < -1e-12
    high, low = (c[up] - b[up] * z) / a[up], (c[down] - b[down] * z) / a[down]
    i, j = int(high.argmin()), int(low.argmax())
    return float(low[j]), -float(b[down][j] / a[down][j]), float(high[i]), -float(b[up][i] / a[up][i])


def _largest(a: Array, b: Array, c: Array, h: float, ahead: float, cap: float) -> float:
    """Largest z ≤ cap such that a u exists with a u + b z ≤ c and 0 ≤ z + 2 h u ≤ ahead."""
    a, b, c = np.append(a, [2.0 * h, -2.0 * h]), np.append(b, [1.0, -1.0]), np.append(c, [ahead, 0.0])
    still = (np.abs(a) <= 1e-12) & (b > 0.0)
    z = float(min([cap, *(c[still] / b[still]).tolist()]))
    for _ in range(50):
        low, low_slope, high, high_slope = _bounds(a, b, c, z)
        if low <= high + 1e-13 * (abs(low) + abs(high)) or z <= 0.0:
            break
        z = max(z - (low - high) / (low_slope - high_slope), 0.0)
    return z


def _highest(a: Array, b: Array, c: Array, z: float) -> float:
    up = a > 1e-12
    return float(((c[up] - b[up] * z) / a[up]).min()) if up.any() else np.inf


# -- random paths ------------------------------------------------------------------------------------------------------


def random_path(number: int, law: str) -> Scenario:
    """Two to eight six-joint arms, acceleration limits, and a path that they cannot follow as fast as it is asked.

    Every second quintic path has two segments, with a waypoint at rest.
    """
    rng = np.random.default_rng(1000 + number)
    task = ring(arms=2 + number % 7)
    limits = {"acceleration": float(rng.uniform(2.0, 6.0)), "velocity": float(rng.uniform(1.5, 3.0))}
    cell, start = task.cell.with_limits(**limits), task.path.pose(0.0)
    radius = max(0.5, 0.5 * len(cell) / (2.0 * np.pi))
    count = 1 + (law == "quintic" and number % 2 == 1)
    poses, times = [start], list[float]()
    for attempt in range(1000):
        if len(poses) > count:
            break
        if attempt % 20 == 19:
            poses, times = [start], []
        way, turn = rng.normal(size=3), rng.normal(size=3)
        way *= rng.uniform(0.15, 0.45) / np.linalg.norm(way)
        turn *= rng.uniform(0.1, 0.4) / radius / np.linalg.norm(turn)
        last = poses[-1]
        goal = pin.SE3(pin.exp3(turn) @ last.rotation, last.translation + way)
        line = WaypointPath([*poses, goal], durations=[1.0] * len(poses), time_law="linear")
        made = replace(task, cell=cell, path=line, dt=0.002)
        x = joints_along(made, np.linspace(0.0, line.duration, 60))
        if x is None or (x > cell.limits.upper - 0.02).any() or (x < cell.limits.lower + 0.02).any():
            continue
        if np.abs(np.diff(x, axis=0)).max() > 0.05:
            continue
        times.append(
            float(fastest(made, start=len(poses) - 1.0, end=float(len(poses)), at_most=np.inf, grid=100)[1][-1])
        )
        poses.append(goal)
    share = 0.5 if law == "linear" else 0.75
    path = WaypointPath(poses, durations=[share * t for t in times], time_law=law)
    return replace(made, name=f"path {number}, {law}", path=path)


def optimum_of_path(task: Scenario, at_most: float = np.inf) -> float:
    """Shortest time of a path with rest at every waypoint [s]."""
    assert isinstance(task.path, WaypointPath)
    total, start = 0.0, 0.0
    for segment in task.path.segments:
        end = start + segment.duration
        bounded = np.isfinite(at_most)
        if bounded or segment.time_law is TimeLaw.LINEAR:
            total += float(fastest(task, start=start, end=end, at_most=at_most, stops=not bounded)[1][-1])
        start = end
    return total


# -- random cells near limits and singularities ------------------------------------------------------------------------


def near_limit(number: int) -> Scenario:
    """Three arms whose joints meet their limits."""
    rng = np.random.default_rng(2000 + number)
    return at_limit(
        direction=tuple(rng.normal(size=3)),
        rotation=tuple(rng.normal(size=3) * (0.6 * (number % 2))),
        margin=rng.uniform(0.05, 0.4, size=18),
        speed=float(rng.uniform(0.1, 0.6)),
        acceleration=float(10.0 ** rng.uniform(0.0, 1.5)),
    )


def along_limit(number: int) -> Scenario:
    """Arms whose path passes within hundredths of a radian of their limits, and is finished."""
    task = random_path(100 + number, ("linear", "quintic")[number % 2])
    rng = np.random.default_rng(3000 + number)
    x = joints_along(task, np.linspace(0.0, task.path.duration, 60))
    assert x is not None
    margin = rng.uniform(0.001, 0.05, size=task.cell.nv)
    limits = task.cell.limits
    cell = task.cell.with_limits(
        lower=np.maximum(limits.lower, x.min(axis=0) - margin), upper=np.minimum(limits.upper, x.max(axis=0) + margin)
    )
    return replace(task, name=f"along a limit {number}", cell=cell)


def past_wrist(number: int) -> Scenario:
    """A path that passes the pole of a wrist."""
    rng = np.random.default_rng(4000 + number)
    return at_singularity(
        "wrist",
        number % 3,
        miss=float(10.0 ** rng.uniform(-1.7, -0.5)),
        speed=float(rng.uniform(0.1, 0.5)),
        acceleration=float(10.0 ** rng.uniform(0.3, 1.5)),
    )


def into_singularity(number: int) -> Scenario:
    """A path that ends in a stretched elbow, or at the end of the reach."""
    rng = np.random.default_rng(5000 + number)
    return at_singularity(
        ("elbow", "reach")[number % 2],
        int(rng.integers(3)),
        speed=float(rng.uniform(0.1, 0.5)),
        acceleration=float(10.0 ** rng.uniform(0.3, 1.5)),
    )


#: Kinds of cells near limits and singularities, and how many of each there are.
NEAR: dict[str, tuple[Callable[[int], Scenario], int]] = {
    "near a limit": (near_limit, 40),
    "along a limit": (along_limit, 24),
    "past a wrist": (past_wrist, 30),
    "into a singularity": (into_singularity, 16),
}


# -- random redundant cells --------------------------------------------------------------------------------------------

#: Robots of redundant cells, and a posture of each [deg or m].
_POSTURES = {
    "panda": (0.0, -20.0, 0.0, -120.0, 0.0, 100.0, 45.0),
    "gantry7": (0.0, 0.0, 45.0, 97.0, 0.0, -52.0, 0.0),
    "arm7": (0.0, 14.0, 0.0, 105.0, 0.0, 31.0, 0.0),
}


def redundant(number: int, *, tries: int = 40) -> Scenario:
    """Two seven-joint arms with narrow position limits on a path.

    An independent solution keeps the joints near the middle of the arms' own limits. The new limits are its own range
    and a margin, for some of the joints: the path is feasible by construction.
    """
    rng = np.random.default_rng(6000 + number)
    robot = tuple(_POSTURES)[number % 3]
    base = robot_arm(robot, geometry=False)
    slides = np.array([joint.shortname().startswith("JointModelP") for joint in base.model.joints][1:])
    for _ in range(tries):
        arms = [
            base.placed(pin.SE3(pin.utils.rotate("z", yaw), np.array([x, 0.0, 0.0])), name=name)
            for name, x, yaw in (("left", -0.7, 0.0), ("right", 0.7, np.pi))
        ]
        cell = RobotCell(arms)
        near = np.tile(_POSTURES[robot], 2) + np.tile(np.where(slides, 0.1, 20.0), 2) * rng.uniform(-1.0, 1.0, 14)
        q_start = np.where(np.tile(slides, 2), near, np.deg2rad(near))
        tools = tool_placements(cell, [q_start])[0]
        start = pin.SE3(np.eye(3), 0.5 * (tools[0].translation + tools[1].translation))
        grasp = Grasp(tuple(start.actInv(T) for T in tools))
        way, turn = rng.normal(size=3), rng.normal(size=3)
        path = LinePath.displaced(
            start,
            translation=rng.uniform(0.1, 0.35) / np.linalg.norm(way) * way,
            rotation=rng.uniform(0.1, 0.6) / np.linalg.norm(turn) * turn,
            duration=float(rng.uniform(0.7, 2.0)),
            time_law=("linear", "quintic")[int(rng.integers(2))],
        )
        task = Scenario(
            name=f"{robot} {number}", cell=cell, grasp=grasp, path=path, q_start=q_start, dt=0.002,
            object_size=(0.5, 0.05, 0.05), object_mass=1.0,
        )  # fmt: skip
        x = _towards_the_middle(task)
        if x is None:
            continue
        kept = rng.uniform(size=cell.nv) < 0.35
        low, high, margin = x.min(axis=0), x.max(axis=0), rng.uniform(0.02, 0.12, cell.nv)
        limits = cell.limits
        narrow = cell.with_limits(
            lower=np.where(kept, np.maximum(low - margin, limits.lower), limits.lower),
            upper=np.where(kept, np.minimum(high + margin, limits.upper), limits.upper),
            acceleration=float(rng.uniform(4.0, 15.0)),
        )
        return replace(task, cell=narrow)
    raise UnreachableError(f"no feasible cell of {robot} in {tries} tries")


#: So close to the path is on it, in the cells that are found [m, rad].
_ON_PATH = 1e-9


def _towards_the_middle(task: Scenario, *, steps: int = 150) -> Array | None:
    """Positions along the path that lead every joint towards the middle of its limits; None where they leave these."""
    cell, chain = task.cell, Chain(task.cell, task.grasp)
    limits, q = cell.limits, task.q_start
    middle, half = 0.5 * (limits.lower + limits.upper), 0.5 * (limits.upper - limits.lower)
    x = cell.positions(q)
    gain = 2.0 * float(np.random.default_rng(len(task.name)).uniform(0.2, 1.0))
    table = [x]
    for clock in np.linspace(0.0, task.path.duration, steps)[1:]:
        pose = task.path.pose(float(clock))
        R = pose.rotation
        for i in range(5):
            errors = chain.errors(chain.carried(q), pose)
            if i and np.abs(errors).max() < _ON_PATH:
                break
            if i == 4:
                return None
            if i < 2:  # then the joints hardly move any more
                chain.linearise(q, about=pose.translation)
            step = chain.joint_velocities(np.hstack([-errors[:, :3] @ R.T, -errors[:, 3:] @ R.T]))
            if not i:
                step += chain.null_part(gain / steps * (middle - x) / np.maximum(half, 0.2))
            if not np.abs(step).max() < 0.3:
                return None
            q = cell.moved(q, step)
        x = cell.positions(q)
        if (x > limits.upper).any() or (x < limits.lower).any():
            return None
        table.append(x)
    return np.array(table)
