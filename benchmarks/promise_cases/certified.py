"""Random cells whose paths and programs are CERTIFIED, run with default options as ``coopqp run`` runs them.

Arms of six and seven joints, some that start close to their limits; lines, corners, and programs on which tools turn,
slide and travel; with bodies and without. The oracle counts runs that do not come to the end of the path, and asks
Pinocchio for the distance of the arms' views of the object there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from coopqp import (
    Arm,
    Clearance,
    CollisionScene,
    CoopqpError,
    Grasp,
    LinePath,
    ObjectPath,
    QPController,
    RobotCell,
    WaypointPath,
    check_path,
)
from coopqp.planning import PathVerdict, time_program
from coopqp.programs import Phase, Program, Role, Slides, Travels, Turns
from coopqp.scenarios import ROBOTS, robot_path
from coopqp.spatial import Array
from promise_cases import Promise
from promise_cases.planning import beside, random_cell

_DT = 0.002
_SIX, _SEVEN = ("rx90l", "arm6c", "kr16_2", "irb1600"), ("arm7", "gantry7")
#: A run that takes more than this many times the path's duration does not finish; and steps at rest until it is over.
_LONGEST, _AT_REST = 20.0, 1500


@dataclass(frozen=True)
class Task:
    """What is checked and run."""

    cell: RobotCell
    grasp: Grasp
    path: ObjectPath
    q: Array
    scene: CollisionScene | None = None
    led: ObjectPath | None = None  #: the path with the elbows that the check proves, as ``coopqp run`` runs it
    verdict: PathVerdict | None = None


def promises(quick: bool) -> Iterator[Promise]:
    """The promises of this module; ``quick`` for a part of the cases."""
    for kind, count in KINDS.items():
        yield from _finished(kind, 2 if quick else count)


def _finished(kind: str, count: int) -> Iterator[Promise]:
    ran = seed = stuck = planned = timed = 0
    apart = 0.0
    while ran < count:
        seed += 1
        task = certified(kind, seed)
        if task is None:
            continue
        ran += 1
        finished, far = run(task)
        stuck += not finished
        apart = max(apart, far)
        if isinstance(task.path, Program) and task.scene is None and timed < count // 2:
            try:
                fast = time_program(task.cell, task.grasp, task.path, q_start=task.q)
            except CoopqpError:
                continue
            timed += 1
            again = checked(replace(task, path=fast))
            planned += not run(again)[0]
    yield Promise(f"{kind}: certified and run, not finished, of {ran}", stuck, 0, "runs")
    yield Promise(f"{kind}: arms' views of the object apart at the end", 1e6 * apart, 1.0, "µm")
    if timed:
        yield Promise(f"{kind}: certified, timed and run, not finished, of {timed}", planned, 0, "runs")


def certified(kind: str, seed: int) -> Task | None:
    """A random task of a kind that is CERTIFIED from its start; None where it is not."""
    try:
        task = checked(_MAKERS[kind](np.random.default_rng([311, seed])))
    except CoopqpError:
        return None
    return task if task.verdict is PathVerdict.CERTIFIED else None


def checked(task: Task) -> Task:
    """The task with its verdict."""
    check = check_path(task.cell, task.grasp, task.path, q_start=task.q, scene=task.scene)
    return replace(task, led=check.led_path(), verdict=check.verdict)


def run(task: Task) -> tuple[bool, float]:
    """Whether a run comes to the end of the path, and how far the arms' views of the object are apart there [m]."""
    path = task.path if task.led is None else task.led
    constraints = [] if task.scene is None else [Clearance(task.scene)]
    controller = QPController(task.cell, task.grasp, path, dt=_DT, constraints=constraints)
    controller.reset(task.q)
    rests = 0
    for _ in range(round(_LONGEST * path.duration / _DT)):
        step = controller.step()
        rests = rests + 1 if step.rate == 0.0 else 0
        if step.finished:
            return True, _apart(task, path, step.q_next)
        if rests > _AT_REST:
            break
    return False, 0.0


def _apart(task: Task, path: ObjectPath, q: Array) -> float:
    """The largest distance of the object's origin as each arm carries it from the end of the path [m]."""
    grasp = path.grasp_at(task.grasp, path.duration) if isinstance(path, Program) else task.grasp
    data, goal = task.cell.model.createData(), path.pose(path.duration)
    pin.framesForwardKinematics(task.cell.model, data, q)
    tools = zip(task.cell.tool_frames, grasp.T_object_tool, strict=True)
    points = [(data.oMf[frame] * X.inverse()).translation for frame, X in tools]
    return max(float(np.linalg.norm(point - goal.translation)) for point in points)


def _cell(
    rng: np.random.Generator, robots: tuple[str, ...], count: int, *, shapes: bool = False
) -> tuple[RobotCell, Grasp, pin.SE3, Array]:
    """Arms anywhere inside their limits that hold an object, its pose, and the configuration."""
    arms, tools, q = [], [], []
    origin = pin.SE3(pin.exp3(rng.normal(size=3)), rng.uniform(-0.5, 0.5, 3))
    for k in range(count):
        robot = str(rng.choice(robots))
        arm = Arm.from_urdf(f"a{k}", robot_path(robot), tool_frame=ROBOTS[robot].tool_frame, geometry=shapes)
        low, high = np.maximum(arm.limits.lower, -2.5), np.minimum(arm.limits.upper, 2.5)
        x, model = rng.uniform(low + 0.03 * (high - low), high - 0.03 * (high - low)), arm.model
        own, data = pin.neutral(model), model.createData()
        for i, value in enumerate(x):
            at = model.joints[i + 1]
            own[at.idx_q : at.idx_q + at.nq] = [value] if at.nq == 1 else [np.cos(value), np.sin(value)]
        pin.framesForwardKinematics(model, data, own)
        X = pin.SE3(pin.exp3(rng.normal(size=3)), rng.uniform(-0.3, 0.3, 3))
        arms.append(arm.placed(origin * X * data.oMf[model.getFrameId(arm.tool_frame)].inverse()))
        tools.append(X)
        q.append(own)
    cell = RobotCell(arms).with_limits(acceleration=float(rng.choice([5.0, 10.0, 20.0])))
    return cell, Grasp(tuple(tools)), origin, np.concatenate(q)


def _law(rng: np.random.Generator) -> str:
    return str(rng.choice(["quintic", "linear"]))


def _lines(robots: tuple[str, ...], reach: float) -> Callable[[np.random.Generator], Task]:
    """One to three lines of up to ``reach`` [m] each."""

    def made(rng: np.random.Generator) -> Task:
        cell, grasp, T, q = _cell(rng, robots, int(rng.integers(1, 4)))
        poses = [T]
        for _ in range(int(rng.integers(1, 4))):
            way, turn = rng.normal(size=3), 0.4 * rng.normal(size=3) * rng.integers(0, 2)
            way *= rng.uniform(0.1, reach) / np.linalg.norm(way)
            poses.append(pin.SE3(poses[-1].rotation @ pin.exp3(turn), poses[-1].translation + way))
        durations = rng.uniform(1.0, 3.0, len(poses) - 1).tolist()
        return Task(cell, grasp, WaypointPath(poses, durations=durations, time_law=_law(rng)), q)

    return made


def _programs(robots: tuple[str, ...], wide: float, *, bodies: bool = False) -> Callable[[np.random.Generator], Task]:
    """Two to five phases, in which tools turn, slide and travel; with bodies the first arm holds at rest."""

    def made(rng: np.random.Generator) -> Task:
        cell, grasp, T, q = _cell(rng, robots, int(rng.integers(1 + bodies, 4)), shapes=bodies)
        pivot, phases, names = rng.uniform(-0.3, 0.3, 3), list[Phase](), cell.arm_names
        for i in range(int(rng.integers(2, 6))):
            rests, arms, path = bool(rng.integers(3) == 0), dict[str, Role](), None
            moving = [k for k in range(len(cell)) if k > 0 or not bodies]
            for k in rng.permutation(moving)[: rng.integers(len(moving) + 1)].tolist():
                kind = int(rng.integers(4))
                if kind == 0:
                    arms[names[k]] = Turns(about=pivot, angle=float(rng.uniform(-2.0, 2.0) * wide))
                elif kind == 1:
                    arms[names[k]] = Slides(axis=rng.normal(size=3).tolist(), distance_m=float(rng.uniform(0.0, wide)))
                elif kind == 2 and rests:
                    X = grasp.T_object_tool[k]
                    there = pin.SE3(X.rotation, X.translation + rng.uniform(-wide, wide, 3))
                    arms[names[k]] = Travels(to=there, retreat_m=0.03)
            if not rests:
                way, turn = rng.uniform(-wide, wide, 3), rng.uniform(-wide, wide, 3)
                seconds = float(rng.uniform(1.0, 2.0))
                path = LinePath.displaced(T, translation=way, rotation=turn, duration=seconds, time_law=_law(rng))
                T = path.goal
            if all(isinstance(arms.get(name), Travels) for name in names):
                arms.popitem()
            phases.append(Phase(f"{i}", path=path, duration=1.5 if rests else None, arms=arms))
        scene = beside(rng, cell, grasp, q)[1] if bodies else None
        return Task(cell, grasp, Program(cell, grasp, phases), q, scene)

    return made


def _bodies(rng: np.random.Generator) -> Task:
    """Redundant arms beside spheres."""
    made = random_cell(rng)
    return Task(made.cell, made.grasp, made.path, made.q, made.scene)


_MAKERS: dict[str, Callable[[np.random.Generator], Task]] = {
    "six joints": _lines(_SIX, 0.3),
    "seven joints": _lines(_SEVEN, 0.6),
    "six and seven joints": _lines(_SIX + _SEVEN, 0.4),
    "bodies": _bodies,
    "programs": _programs(_SIX + _SEVEN, 0.15),
    "programs, seven joints": _programs(_SEVEN, 0.35),
    "programs and bodies": _programs(_SIX + _SEVEN, 0.1, bodies=True),
}
#: Kinds of tasks, and how many of each are run.
KINDS = dict(zip(_MAKERS, (30, 60, 40, 50, 40, 50, 30), strict=True))
