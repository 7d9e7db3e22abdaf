"""Robots with several arms beside what they are compared with: fixed heights, proofs of one arm, arms one by one.

Heights are those of the torso of TIAGo Pro (extra ``robots``); without the extra they are left out. They take most of
the time.
"""

from __future__ import annotations

import itertools
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pinocchio as pin

from coopqp import Arm, Grasp, LinePath, QPController, Robot, RobotCell, WaypointPath, check_path, simulate
from coopqp.errors import MissingExtraError
from coopqp.paths import ObjectPath
from coopqp.planning import PathCheck, PathVerdict
from coopqp.scenarios import SHARED_JOINTS, paper_lift, robot_data_path, robot_path, scenario
from coopqp.simulation import Recording
from coopqp.spatial import Array
from promise_cases import Promise
from promise_cases.heights import TurningArm, rises
from promise_cases.shared_cells import SIDES, median_step, random_motion, say


def promises(quick: bool) -> Iterator[Promise]:
    """The cases, with fixed seeds."""
    with tempfile.TemporaryDirectory() as name:
        yield from _proofs(Path(name), 4 if quick else 24)
        yield from _without_shared_joints(20 if quick else 100)
    try:
        urdf = robot_data_path("tiago_pro_description/robots/tiago_pro.urdf")
    except MissingExtraError:
        print("without the extra robots: no rises of TIAGo Pro", file=sys.stderr, flush=True)
        return
    yield from _rises(urdf, RISES[:1] if quick else RISES)


# -- the highest rise --------------------------------------------------------------------------------------------------

#: Where the bar is at the start: x and z [m].
RISES = ((0.6, 0.45), (0.6, 0.30), (0.5, 0.30))
TORSO = "torso_lift_joint"
#: Half the length of the bar, the highest rise that is tried, and to what it is found [m].
HALF, HIGHEST, TO = 0.25, 1.6, 0.01
#: Heights at which the torso is locked, over its stroke.
HEIGHTS = 8


def _tiago(urdf: Path, height: float | None) -> tuple[RobotCell, Grasp]:
    """TIAGo Pro, whose wrists hold a bar along y from behind; its torso free, or locked at a height [m]."""
    tools = {side: f"arm_{side}_7_link" for side in SIDES}
    model = pin.buildModelFromUrdf(str(urdf), True)  # True: with joints that mimic others, of the grippers
    locked = {model.names[i]: 0.0 for i, joint in enumerate(model.joints) if "Mimic" in joint.shortname()}
    if height is not None:
        locked[TORSO] = height
    robot = Robot(urdf, tools, name="tiago", geometry=False, locked_joints=locked)
    ahead = pin.rpy.rpyToMatrix(0.0, 0.5 * np.pi, 0.0)  # wrists point forward, turned about their axes as mirrored
    ends = ((HALF, 0.5 * np.pi), (-HALF, -0.5 * np.pi))
    held = [pin.SE3(ahead @ pin.utils.rotate("z", roll), np.array([0.0, y, 0.0])) for y, roll in ends]
    return RobotCell([robot]), Grasp(tuple(held))


def _rises(urdf: Path, cases: tuple[tuple[float, float], ...]) -> Iterator[Promise]:
    """The highest rise that is proved at the best of some heights of the torso, over that with the torso free.

    Beside both are those of :mod:`promise_cases.heights`: where the torso's top is good for the start, too, it adds
    nothing, so the ratio can be large only where planning at fixed heights misses what the arms can do.
    """
    free = _tiago(urdf, None)
    (torso,) = free[0].shared.tolist()
    low, high = (float(limit[torso]) for limit in (free[0].limits.lower, free[0].limits.upper))
    fixed = [_tiago(urdf, float(h)) for h in np.linspace(low, high, HEIGHTS)]
    model = pin.buildModelFromUrdf(str(urdf), True)
    arms = [TurningArm(model, arm.tool_frame, TORSO) for arm in free[0].arms]
    for x, z in cases:
        say(f"the highest rise from x = {x:g} m, z = {z:g} m")
        best, moving = (_highest(cells, x, z) for cells in (fixed, [free]))
        held = [partial(_tool_at, x, X) for X in free[1].T_object_tool]
        possible = rises(list(zip(arms, held, strict=True)), z, HIGHEST)
        case = f"TIAGo Pro, a bar at x = {x:g} from z = {z:g}: rise at the best height over that with the torso"
        yield Promise(
            f"{case} ({1e3 * best:.0f} : {1e3 * moving:.0f} mm; the arms can {1e3 * possible.at_rest:.0f} : "
            f"{1e3 * possible.moving:.0f})",
            best / moving, 1.0 / 1.2, "",
        )  # fmt: skip
        yield Promise(
            "the same: rise that the arms can make with the torso, over the proved one",
            possible.moving / moving,
            1.05,
            "",
        )


def _tool_at(x: float, T_object_tool: pin.SE3, height: float) -> Array:
    """T_world_tool (4, 4) of an arm that holds the bar at a height."""
    T_world_tool = pin.SE3(np.eye(3), np.array([x, 0.0, height])) * T_object_tool
    return np.array(T_world_tool.homogeneous)


def _highest(cells: list[tuple[RobotCell, Grasp]], x: float, z: float) -> float:
    """The highest rise [m] that some cell is proved to follow, to :data:`TO`; NaN without any."""

    def proved(cell: RobotCell, grasp: Grasp, rise: float) -> bool:
        ends = [pin.SE3(np.eye(3), np.array([x, 0.0, height])) for height in (z, z + rise)]
        return check_path(cell, grasp, LinePath(ends[0], ends[1], duration=30.0)).feasible

    best = 0.0
    for cell, grasp in cells:
        if proved(cell, grasp, best + TO):  # else no better than those before
            low, high = best + TO, HIGHEST
            while high - low > TO:
                middle = 0.5 * (low + high)
                low, high = (middle, high) if proved(cell, grasp, middle) else (low, middle)
            best = low
    return best or float("nan")


# -- the proof ---------------------------------------------------------------------------------------------------------


def _proofs(folder: Path, count: int) -> Iterator[Promise]:
    """Proofs of motions of shared joints: how many intervals they take, and whether all arms have the same motion."""
    given = alone = 0
    apart = between = 0.0
    for number, check in enumerate(_certified(folder, count)):
        say(f"proof {number + 1} of {count}")
        pairs = [_intervals(check, k) for k in range(len(check.arms))]
        given, alone = given + sum(pair[0] for pair in pairs), alone + sum(pair[1] for pair in pairs)
        apart, between = (max(pair) for pair in zip((apart, between), _parted(check), strict=True))
    case = f"{count} motions of arms that share a joint"
    yield Promise(f"{case}: intervals of the proof over those of the same arms by themselves", given / alone, 1.3, "")
    yield Promise(f"{case}: the joint in one arm's proof and in the other's, at the ends of intervals", apart, 0.0, "")
    yield Promise(f"{case}: the same between them", between, 0.0, "")


def _certified(folder: Path, count: int) -> Iterator[PathCheck]:
    """Certified motions: of the scenarios, and of random bars by a lift and by a robot with a waist."""
    rng, made = np.random.default_rng(23), 0
    for name in SHARED_JOINTS:
        task = scenario(name)
        yield check_path(task.cell, task.grasp, task.path)
        made += 1
    while made < count:
        cell, grasp, _, path = random_motion(rng, folder, lift=bool(made % 2))
        check = check_path(cell, grasp, path)
        if check.verdict is PathVerdict.CERTIFIED:
            made += 1
            yield check


def _intervals(check: PathCheck, k: int) -> tuple[int, int]:
    """Intervals that prove an arm's motion: with shared joints, and as an arm by itself; none where it has no proof."""
    together = check.arms[k].chosen
    assert check.q_start is not None
    cell, start = RobotCell([check.cell.arms[k]]), check.cell.positions(check.q_start)[check.cell.columns[k]]
    grasp = Grasp((check.grasp.T_object_tool[k],))
    found = check_path(cell, grasp, check.path, q_start=cell.configuration(start))
    alone = found.arms[0].chosen
    if found.verdict is not PathVerdict.CERTIFIED or together is None or alone is None:
        return 0, 0
    return len(together.trajectory.places) - 1, len(alone.trajectory.places) - 1


def _parted(check: PathCheck) -> tuple[float, float]:
    """Largest difference of the shared joints of two arms: at places that both have, and between them."""
    poses = check.proved_trajectory()
    assert poses is not None
    first, *others = [arm.chosen.trajectory for arm in check.arms if arm.chosen is not None]
    shared = first.kinematics.shared
    places = np.linspace(0.0, float(first.places[-1]), 1009)
    T, apart, between = poses.poses(places), 0.0, 0.0
    here = first.at(places, T)[0][:, shared]
    for other in others:
        _, i, j = np.intersect1d(first.places, other.places, return_indices=True)
        apart = max(apart, float(np.abs(first.q[i][:, shared] - other.q[j][:, other.kinematics.shared]).max()))
        there = other.at(places, T)[0][:, other.kinematics.shared]
        between = max(between, float(np.abs(here - there).max()))
    return apart, between


# -- cells without shared joints ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Both:
    """One task for arms that are given one by one, and for the same arms as those of robots.

    Attributes:
        name: of the arms and the path.
        arms, robots: the two cells.
        grasp, path, q: the task, and its start (nq,).
    """

    name: str
    arms: RobotCell
    robots: RobotCell
    grasp: Grasp
    path: ObjectPath
    q: Array


def _tasks() -> Iterator[_Both]:
    """Two arms of one description, and three robots with one arm each; along a line, and around corners."""
    for name, robot, joint, ahead in (("torso_lift", "lift2", "lift", -0.05), ("two_on_a_rail", "rail2", "rail", 0.05)):
        task, file = scenario(name), robot_path(robot)
        (s,) = task.cell.shared.tolist()
        locked = {joint: float(task.cell.positions(task.q_start)[s])}
        tools = {side: f"{side}_tool" for side in SIDES}
        arms = [Arm.from_urdf(side, file, tool_frame=frame, locked_joints=locked) for side, frame in tools.items()]
        yield from _with_paths(
            f"{robot} with its {joint} locked", RobotCell(arms), RobotCell([Robot(file, tools, locked_joints=locked)]),
            np.delete(task.cell.limits.acceleration, s), task.grasp, task.path.pose(0.0), np.delete(task.q_start, s),
            ahead,
        )  # fmt: skip
    lift = paper_lift()
    made = [
        Robot(robot_path("rx90l"), {arm.name: arm.tool_frame}, name=f"robot {k}", T_world_base=arm.T_world_base)
        for k, arm in enumerate(lift.cell.arms)
    ]
    yield from _with_paths(
        "three RX-90L", lift.cell, RobotCell(made), lift.cell.limits.acceleration, lift.grasp, lift.path.pose(0.0),
        lift.q_start, 0.05,
    )  # fmt: skip


def _with_paths(
    name: str,
    arms: RobotCell,
    robots: RobotCell,
    acceleration: Array,
    grasp: Grasp,
    here: pin.SE3,
    q: Array,
    ahead: float,
) -> Iterator[_Both]:
    """The task along a line, and around corners: too fast for the arms, so that the look-ahead has to slow it."""
    cells = [cell.with_limits(**{**_limits(arms), "acceleration": acceleration}) for cell in (arms, robots)]
    moves = (
        ((ahead, 0.0, 0.1), (0.0, 0.0, 0.1)),
        ((0.0, 0.05, 0.05), (0.0, 0.1, 0.0)),
        ((-ahead, 0.0, 0.0), (0.0,) * 3),
    )
    poses = [here]
    for translation, rotation in moves:
        poses.append(pin.SE3(pin.exp3(np.array(rotation)) @ here.rotation, here.translation + translation))
    for kind, path in (
        ("a line", LinePath(poses[0], poses[1], duration=0.2)),
        ("corners", WaypointPath(poses, durations=[0.1, 0.1, 0.1], time_law="linear")),
    ):
        yield _Both(f"{name}, {kind}", cells[0], cells[1], grasp, path, q)


def _limits(cell: RobotCell) -> dict[str, Array]:
    return {field: getattr(cell.limits, field) for field in ("lower", "upper", "velocity")}


def _without_shared_joints(rounds: int) -> Iterator[Promise]:
    """Runs of arms given one by one and of the same arms as those of robots: their bits, and the time of a step."""
    tasks = list(_tasks())
    differ, slowest, runs = 0, 1.0, 0
    for task in tasks:
        say(task.name)
        one, other = (_run(task, cell) for cell in (task.arms, task.robots))
        assert one.finished
        runs, slowest = runs + 1, min(slowest, float(one.rate.min()))
        differ += not _same(one, other)
    yield Promise(
        f"{runs} runs without shared joints (rates from {slowest:.2g}): commands with other bits", differ, 0, "runs"
    )
    for task, (pacing, pause) in itertools.product(tasks[::2], (("hot", 0.0), ("1 kHz", 1e-3))):
        say(f"{task.name}, steps {pacing}")
        times = np.zeros((rounds if pause else 4 * rounds, 2))
        for number, row in enumerate(times):
            for i in (0, 1) if number % 2 else (1, 0):
                cell = (task.arms, task.robots)[i]
                controller = QPController(cell, task.grasp, task.path, dt=_DT)
                controller.reset(task.q)
                row[i] = median_step(controller, _STEPS, pause)
        ratio = float(np.median(times[:, 1] / times[:, 0]))
        case = f"{task.name}, {pacing}: step of robots over that of arms"
        yield Promise(f"{case} ({np.median(times[:, 0]):.2f} µs)", ratio, 1.01, "")


#: Step of the runs [s], and steps that are timed in a row.
_DT, _STEPS = 0.005, 100


def _run(task: _Both, cell: RobotCell) -> Recording:
    controller = QPController(cell, task.grasp, task.path, dt=_DT)
    return simulate(controller, q_start=task.q, duration=20.0)


def _same(one: Recording, other: Recording) -> bool:
    """The same commands, bit for bit, and the same rates."""
    fields = ("q_command", "rate")
    return all(np.array_equal(getattr(one, field), getattr(other, field)) for field in fields)
