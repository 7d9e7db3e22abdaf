"""Joints that arms share: one command, one proof for all arms, a group at a singularity, runs with a torso.

What judges a run is one Pinocchio model of the whole robot, read from the URDF by itself. The group takes
some minutes, most of them for the checks of the random motions; it says how far it is.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pinocchio as pin

from coopqp import Arm, Grasp, InvalidInputError, LinePath, QPController, Robot, RobotCell, check_path, simulate
from coopqp.model import Chain
from coopqp.planning import PathCheck
from coopqp.scenarios import SHARED_JOINTS, robot_path, scenario
from coopqp.simulation import Recording
from promise_cases import Promise
from promise_cases.shared_cells import SIDES, TORSOS, Whole, lift_cell, median_step, random_motion, say, torso_cell


def _followed(check: PathCheck, *, dt: float = 0.01, longest: float = 30.0) -> Recording:
    controller = QPController(check.cell, check.grasp, check.led_path(), dt=dt)
    return simulate(controller, q_start=check.q_start, duration=longest)


def _rise(low: float, high: float, duration: float) -> LinePath:
    ends = [pin.SE3(np.eye(3), np.array([0.55, 0.0, z])) for z in (low, high)]
    return LinePath(ends[0], ends[1], duration=duration)


def promises(quick: bool) -> Iterator[Promise]:
    """The cases, with fixed seeds."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        yield from _robots(folder, TORSOS[:3] if quick else TORSOS)
        yield from _singular(folder)
        yield from _lift()
        yield from _scenarios()
        yield from _cost(5 if quick else 25)
        yield from _random(folder, 6 if quick else 100)


def _robots(folder: Path, torsos: tuple[tuple[tuple[str, str], ...], ...]) -> Iterator[Promise]:
    """Dual-arm URDFs, given as two arms and as one robot."""
    wrong = 0
    for number, torso in enumerate(torsos):
        say(f"robot {number + 1} of {len(torsos)}")
        cell, grasp, file = torso_cell(torso, folder)
        tools = {side: f"{side}_link_5" for side in SIDES}
        try:
            RobotCell([Arm.from_urdf(side, file, tool_frame=frame, geometry=False) for side, frame in tools.items()])
            wrong += 1  # two commands for one joint
        except InvalidInputError:
            pass
        goal = pin.SE3(pin.exp3(np.array([0.1, 0.0, 0.2])), np.array([0.6, 0.1, 0.3 * len(torso) + 0.7]))
        start = pin.SE3(np.eye(3), np.array([0.5, 0.0, 0.3 * len(torso) + 0.5]))
        check = check_path(cell, grasp, LinePath(start, goal, duration=3.0))
        if check.feasible:
            wrong += bool(Whole(cell, grasp, file).errors(check, 100))
    case = f"motions that one robot cannot make, certified, {len(torsos)} dual-arm URDFs"
    yield Promise(case, wrong, 0.0, "motions")


def _singular(folder: Path) -> Iterator[Promise]:
    """A group at configurations at which one arm is singular by itself."""
    rng, cell = np.random.default_rng(7), torso_cell(TORSOS[6], folder)[0]
    grasp = Grasp(tuple(pin.SE3(pin.exp3(rng.normal(size=3)), 0.3 * rng.normal(size=3)) for _ in range(2)))
    chain, worst, D = Chain(cell, grasp), 0.0, np.diag(cell.limits.velocity)
    for _ in range(20):
        x = rng.uniform(-1.0, 1.0, cell.nv)
        x[cell.joint_names.index("left/left_4")] = 0.0  # the axes before and after it are one line
        chain.linearise(cell.configuration(x), np.array([0.4, 0.0, 0.8]))
        W, A = rng.normal(size=(2, 6)), chain.dense()
        worst = max(worst, float(np.abs(chain.joint_velocities(W) - D @ np.linalg.pinv(A @ D) @ W.ravel()).max()))
    yield Promise("one arm singular, its group not: against the group's pseudo-inverse", worst, 1e-6, "rad/s")


def _lift() -> Iterator[Promise]:
    """A lift whose arms do not reach both ends of a path at one height; one that keeps up, and one that does not."""
    for speed, duration, bound in ((0.1, 8.0, 0.1), (0.02, 4.0, 1.0)):
        cell, grasp, file = lift_cell(velocity_limits={"lift": speed})
        check = check_path(cell, grasp, _rise(0.2, 1.7, duration))
        run = _followed(check)
        apart, off = Whole(cell, grasp, file).run(run)
        case = f"a lift of {speed:g} m/s, 1.5 m in {duration:g} s"
        yield Promise(f"{case}: runs that do not finish", float(not run.finished), 0.0, "runs")
        yield Promise(f"{case}: chain", apart, bound, "µm")
        yield Promise(f"{case}: object off its path", off, bound, "µm")


#: The robots of the scenarios, and the files of their models.
ROBOTS = {"torso_lift": "lift2", "two_on_a_rail": "rail2"}
_TOOLS = {side: f"{side}_tool" for side in SIDES}


def _scenarios() -> Iterator[Promise]:
    """Scenarios of arms that share a joint, at 5 rad/s², led as the check proves it."""
    for name in SHARED_JOINTS:
        task = scenario(name)
        cell = task.cell.with_limits(acceleration=np.minimum(task.cell.limits.acceleration, 5.0))
        check = check_path(cell, task.grasp, task.path)
        run = _followed(check, dt=task.dt)
        apart, off = Whole(cell, task.grasp, robot_path(ROBOTS[name])).run(run)
        yield Promise(f"{name} at 5 rad/s²: runs that do not finish", float(not run.finished), 0.0, "runs")
        yield Promise(f"{name} at 5 rad/s²: chain", apart, 0.1, "µm")
        yield Promise(f"{name} at 5 rad/s²: object off its path", off, 1.0, "µm")


def _cost(rounds: int) -> Iterator[Promise]:
    """A step of arms that share a joint over one of the same arms with that joint locked, in turn."""
    for name in SHARED_JOINTS:
        task = scenario(name)
        (shared,) = task.cell.shared.tolist()
        joint, place = task.cell.joint_names[shared].partition("/")[2], task.cell.positions(task.q_start)[shared]
        locked = Robot(robot_path(ROBOTS[name]), _TOOLS, name=name, locked_joints={joint: place})
        alone = RobotCell([locked]).with_limits(acceleration=np.delete(task.cell.limits.acceleration, shared))
        cells = ((task.cell, task.q_start), (alone, np.delete(task.q_start, shared)))
        here = task.path.pose(0.0)
        for pacing, pause in (("hot", 0.0), ("1 kHz", 1e-3)):
            times = np.zeros((rounds, len(cells)))
            for row in times:
                for i, (cell, q) in enumerate(cells):
                    path = LinePath.displaced(
                        here, translation=(0.0, 0.05, 0.05), rotation=(0.0, 0.0, 0.1), duration=2.0
                    )
                    controller = QPController(cell, task.grasp, path, dt=0.005)
                    controller.reset(q)
                    row[i] = median_step(controller, 300, pause)
            ratio = float(np.median(times[:, 0] / times[:, 1]))
            case = f"{name}: step, its shared joint over the same arms without, {pacing}"
            yield Promise(f"{case} ({np.median(times[:, 0]):.1f} µs)", ratio, 1.3, "")


def _random(folder: Path, count: int) -> Iterator[Promise]:
    """Random motions of a bar by a lift and by a robot with a waist, and the same at fixed heights."""
    rng = np.random.default_rng(11)
    unfinished = wrong = certified = lost = fixed_ones = moving_ones = 0
    apart = 0.0
    heights = np.linspace(0.05, 0.55, 5)
    for number in range(count):
        say(f"random motion {number + 1} of {count}")
        lift = number % 2 == 0
        cell, grasp, file, path = random_motion(rng, folder, lift=lift)
        check = check_path(cell, grasp, path)
        good = check.feasible
        if lift:
            some = any(check_path(*lift_cell(**_at(h))[:2], path).feasible for h in heights.tolist())
            fixed_ones, moving_ones = fixed_ones + some, moving_ones + good
            lost += some and not good
        if good:
            certified += 1
            whole = Whole(cell, grasp, file)
            wrong += whole.errors(check, 60)
            run = _followed(check)
            unfinished += not run.finished
            apart = max(apart, whole.run(run)[0])
    yield Promise(
        f"random motions of a bar ({count}): proved at a fixed height, not with the lift", lost, 0.0, "motions"
    )
    ratio = fixed_ones / max(moving_ones, 1)
    yield Promise(
        f"the same ({fixed_ones} : {moving_ones}): proved at fixed heights over with it", ratio, 1.0 / 1.2, ""
    )
    yield Promise(f"the same, {certified} certified: samples that break what is proved", wrong, 0.0, "samples")
    yield Promise(f"the same, {certified} certified: runs that do not finish", unfinished, 0.0, "runs")
    yield Promise(f"the same, {certified} certified: chain", apart, 1.0, "µm")


def _at(height: float) -> dict[str, dict[str, float]]:
    """Limits that hold the lift at a height."""
    return {"lower_limits": {"lift": height - 1e-6}, "upper_limits": {"lift": height + 1e-6}}
