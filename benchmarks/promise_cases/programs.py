"""Programs: a part that opens, a tool that draws, regrasp, gates, hand-over, random programs, and what a step costs.

What judges chain and path is Pinocchio's forward kinematics; where tools belong on the object follows from the angles
and ways that were asked for, not from the program's own numbers.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pinocchio as pin

from coopqp import (
    ControlStep,
    Grasp,
    LinePath,
    QPController,
    RobotCell,
    Status,
    check_path,
)
from coopqp.control import couple
from coopqp.planning import time_program
from coopqp.programs import Phase, Program, Role, Slides, Travels, Turns, Waits
from coopqp.scenarios import (
    Scenario,
    bar_with_pins,
    conveyor,
    draw_on_plate,
    five_joint_pins,
    hand_over,
    paper_lift,
    pliers,
    positioner,
    robot_arm,
)
from promise_cases import Promise
from promise_cases.regrasps import in_engine

_DT, _ACCELERATION = 0.002, 5.0
_PIN = np.array([0.0, 0.8, 0.0])
#: Placements of all tools on the object at a clock of the program.
_Placed = Callable[[float], list[pin.SE3]]


def _lift(duration: float = 3.0, law: str = "quintic") -> Scenario:
    task = paper_lift(duration=duration, time_law=law)
    return replace(task, cell=task.cell.with_limits(acceleration=_ACCELERATION))


class _Judge:
    """How far tools are from where they belong [m]: between any two, and from the path."""

    def __init__(self, task: Scenario, placed: _Placed) -> None:
        self.task, self.placed, self.data = task, placed, task.cell.model.createData()
        self.chain = self.path = 0.0

    def see(self, step: ControlStep) -> None:
        cell = self.task.cell
        pin.framesForwardKinematics(cell.model, self.data, step.q_next)
        places = zip(cell.tool_frames, self.placed(step.clock_next), strict=True)
        points = [(self.data.oMf[frame] * X.inverse()).translation for frame, X in places]
        asked = self.task.path.pose(step.clock_next).translation
        self.chain = max([self.chain, *(float(np.linalg.norm(a - b)) for a, b in itertools.combinations(points, 2))])
        self.path = max([self.path, *(float(np.linalg.norm(point - asked)) for point in points)])


def _program_places(task: Scenario) -> _Placed:
    program = task.path
    assert isinstance(program, Program)
    return lambda clock: list(program.grasp_at(task.grasp, clock).T_object_tool)


def _quintic(x: float) -> float:
    x = min(max(x, 0.0), 1.0)
    return x**3 * (10.0 - 15.0 * x + 6.0 * x**2)


def _opened(task: Scenario, angle: float) -> _Placed:
    """The tools of :func:`coopqp.scenarios.pliers`, from its angle alone."""

    def placed(clock: float) -> list[pin.SE3]:
        turn = 0.5 * angle * (_quintic(clock / 3.0) - _quintic((clock - 3.0) / 2.0))
        found = []
        for X, sign in zip(task.grasp.T_object_tool, (0.0, 1.0, -1.0), strict=True):
            R = pin.utils.rotate("z", sign * turn)
            found.append(pin.SE3(R, _PIN - R @ _PIN) * X)
        return found

    return placed


def _started(task: Scenario, dt: float = _DT) -> QPController:
    controller = QPController(task.cell, task.grasp, task.path, dt=dt)
    controller.reset(task.q_start)
    return controller


def _to_the_end(controller: QPController, judge: _Judge | None = None, most: int = 20_000) -> list[ControlStep]:
    steps: list[ControlStep] = []
    for _ in range(most):
        steps.append(controller.step())
        if judge is not None:
            judge.see(steps[-1])
        if steps[-1].finished or steps[-1].status is Status.BLOCKED:
            break
    return steps


def _pliers(quick: bool) -> Iterator[Promise]:
    for degrees in (10, 20):
        task = pliers(angle=float(np.deg2rad(degrees)))
        chain = path = 0.0
        for seed in range(2 if quick else 6):
            controller, judge = _started(task), _Judge(task, _opened(task, float(np.deg2rad(degrees))))
            rng = np.random.default_rng(seed)
            for i in range(8000):
                kind = rng.integers(400)
                if kind < 4:
                    controller.set_override(float(rng.uniform(0.2, 1.0)))
                elif kind == 4:
                    controller.pause()
                elif kind in (5, 6):
                    controller.resume()
                elif kind == 7 and i > 500:
                    controller.reverse(float(rng.uniform(0.0, controller.program_clock)))
                elif kind in (8, 9, 10):
                    controller.forward()
                step = controller.step()
                judge.see(step)
                if step.finished:
                    break
            chain, path = max(chain, judge.chain), max(path, judge.path)
        yield Promise(f"pliers by {degrees}°, random override, pauses, way back: chain", 1e6 * chain, 0.5, "µm")
        yield Promise(f"pliers by {degrees}°, random override, pauses, way back: path", 1e6 * path, 0.5, "µm")


def _wide(quick: bool) -> Iterator[Promise]:
    late, unnamed = 0, 0
    for degrees in (40, 90) if quick else (30, 40, 50, 60, 75, 90, 120):
        task = pliers(angle=float(np.deg2rad(degrees)))
        controller = _started(task)
        steps = _to_the_end(controller)
        if steps[-1].finished:
            continue
        standing = sum(step.rate < 1e-2 for step in steps[100:])
        late = max(late, standing)
        unnamed += not any(limit.arm for limit in steps[-1].binding)
    yield Promise("what stops larger openings: steps at rest until BLOCKED", late, 50, "steps")
    yield Promise("what stops larger openings: without the arm's name", unnamed, 0, "runs")


def _tools(quick: bool) -> Iterator[Promise]:
    del quick
    for make in (draw_on_plate, positioner, conveyor):
        task = make()
        judge = _Judge(task, _program_places(task))
        _to_the_end(_started(task, 0.005 if make is not draw_on_plate else _DT), judge)
        yield Promise(f"tool on a part that others carry, {make.__name__}: from its place", 1e6 * judge.path, 0.5, "µm")


def _coupled(quick: bool) -> Iterator[Promise]:
    """Two groups on two clocks: how far the second's tool is from its place, over what the steps say."""
    del quick
    task, index = _lift(law="linear"), ([0, 1], [2])
    X, x = task.grasp.T_object_tool, task.cell.positions(task.q_start)
    controllers = []
    for own, acceleration in zip(index, (_ACCELERATION, 0.1 * _ACCELERATION), strict=True):
        cell = RobotCell([task.cell.arms[k] for k in own]).with_limits(acceleration=acceleration)
        controller = QPController(cell, Grasp(tuple(X[k] for k in own)), task.path, dt=_DT)
        controller.reset(cell.configuration(np.concatenate([x[task.cell.v_slices[k]] for k in own])))
        controllers.append(controller)
    coupled, worst, off = couple(*controllers), 0.0, 0.0
    for _ in range(5000):
        steps, points = coupled.step(), []
        for controller, step in zip(controllers, steps, strict=True):
            data = controller.cell.model.createData()
            pin.framesForwardKinematics(controller.cell.model, data, step.q_next)
            view = data.oMf[controller.cell.tool_frames[0]] * controller.grasp.T_object_tool[0].inverse()
            points.append((view * X[2]).translation)
        far = float(np.linalg.norm(points[0] - points[1]))
        off, worst = max(off, far), max(worst, (far - 1e-6) / max(coupled.bound, 1e-9))
        if all(step.finished for step in steps):
            break
    yield Promise("two groups coupled by overrides, a tenth of the acceleration: off by", 1e3 * off, 3.1, "mm")
    yield Promise("two groups coupled by overrides: distance over what the steps say", worst, 1.0, "")


def _regrasped(k: int, *, rests: bool) -> Scenario:
    task = _lift()
    X = task.grasp.T_object_tool[k]
    way = np.array([0.0, 0.1, 0.0]) if k == 0 else np.array([(-0.1, 0.1)[k - 1], 0.0, 0.0])
    travel = {task.cell.arm_names[k]: Travels(to=pin.SE3(X.rotation, X.translation + way))}
    if rests:
        phases = [Phase("over", arms=travel, duration=2.0), Phase("lift", path=task.path)]
    else:
        phases = [Phase("over", path=task.path, arms=travel), Phase("rest", duration=0.5)]
    return replace(task, path=Program(task.cell, task.grasp, phases))


def _regrasp(quick: bool) -> Iterator[Promise]:
    del quick
    worst, slowest = 0.0, 1.0
    for k, rests in itertools.product(range(3), (True, False)):
        task = _regrasped(k, rests=rests)
        judge = _Judge(task, _program_places(task))
        steps = _to_the_end(_started(task), judge)
        worst = max(worst, judge.chain, judge.path, 0.0 if steps[-1].finished else np.inf)
        if not rests:
            slowest = min(slowest, *(step.rate for step in steps[50:]))
    yield Promise("regrasp of each arm, at rest and under way: chain, path", 1e6 * worst, 0.5, "µm")
    yield Promise("regrasp under way: lost path speed", 1.0 - slowest, 1e-6, "")


def _gated() -> Scenario:
    task = _lift(law="linear")
    middle = task.path.pose(1.0)
    assert isinstance(task.path, LinePath)
    first = LinePath(task.path.start, middle, duration=1.0, time_law="linear")
    second = LinePath(middle, task.path.goal, duration=2.0, time_law="linear")
    phases = [Phase("up", path=first, until="closed"), Phase("on", path=second)]
    return replace(task, path=Program(task.cell, task.grasp, phases))


def _gates(quick: bool) -> Iterator[Promise]:
    del quick
    task = _gated()
    controller, whole = _started(task), _started(_lift(law="linear"))
    for _ in range(200):
        controller.step()
        whole.step()
    controller.signal("closed")
    lost = max(whole.step().rate - controller.step().rate for _ in range(600))
    yield Promise("gate, signal in time: lost path speed", max(lost, 0.0), 1e-3, "")
    controller, rates = _started(task), [0.0]
    while len(rates) < 300 or rates[-1] > 0.7 * max(rates):
        rates.append(controller.step().rate)
    controller.signal("closed")
    after = [controller.step().rate for _ in range(10)]
    yield Promise("gate, signal late: fall of the path speed after it", max(rates[-1] - min(after), 0.0), 0.05, "")
    controller, judge = _started(task), _Judge(task, _program_places(task))
    for _ in range(2000):
        step = controller.step()
        judge.see(step)
    missing = float(step.status is not Status.WAITING)
    yield Promise("gate, no signal: chain, path at rest", 1e6 * max(judge.chain, judge.path), 0.5, "µm")
    yield Promise("gate, no signal: steps that do not say WAITING in the end", missing, 0, "")
    task = hand_over()
    steps = _to_the_end(_started(task))
    slowest = min(step.rate for step in steps if 0.4 < step.clock < 2.6)
    yield Promise("hand_over, the leader leaves a part that moves at 0.1 m/s: lost path speed", 1.0 - slowest, 0.2, "")


def _random(seed: int) -> Scenario:
    """20 phases: lines and rests, in which arms open and close the part, slide, travel or wait."""
    rng, task = np.random.default_rng(seed), _lift()
    wide = float(rng.choice([0.03, 0.06, 0.12]))
    here, phases = task.path.pose(0.0), list[Phase]()
    X, names = list(task.grasp.T_object_tool), task.cell.arm_names
    for i in range(20):
        rests, arms = bool(rng.integers(3) == 0), dict[str, Role]()
        for k in rng.permutation(3)[: rng.integers(3)].tolist():
            kind = int(rng.integers(4))
            if kind == 0:
                arms[names[k]] = Turns(about=_PIN, angle=float(rng.uniform(-wide, wide)))
            elif kind == 1:
                arms[names[k]] = Slides(axis=rng.normal(size=3).tolist(), distance_m=float(rng.uniform(0.0, wide)))
            elif kind == 2 and rests:
                there = pin.SE3(X[k].rotation, X[k].translation + rng.uniform(-wide, wide, 3))
                arms[names[k]] = Travels(to=there, retreat_m=0.03)
        path = None
        if not rests:
            way, turn = rng.uniform(-wide, wide, 3), rng.uniform(-wide, wide, 3)
            path = LinePath.displaced(here, translation=way, rotation=turn, duration=float(rng.uniform(1.0, 2.0)))
            here = path.goal
        if all(isinstance(arms.get(name), (Travels, Waits)) for name in names):
            arms.popitem()
        phases.append(Phase(f"{i}", path=path, duration=1.5 if rests else None, arms=arms))
    return replace(task, path=Program(task.cell, task.grasp, phases))


def _checked(quick: bool) -> Iterator[Promise]:
    broken = undecided = wrong = feasible = 0
    seeds = 20 if quick else 200
    for seed in range(seeds):
        task = _random(seed)
        program = task.path
        assert isinstance(program, Program)
        check = check_path(task.cell, task.grasp, program, q_start=task.q_start)
        undecided += check.verdict.value in ("UNDECIDED", "SAMPLED")
        feasible += check.feasible
        step = _to_the_end(_started(task, 0.01), most=30_000)[-1]
        if check.verdict.value == "CERTIFIED":
            broken += not step.finished
        elif check.verdict.value == "INFEASIBLE":
            named = next(phase for phase in check.phases if phase.verdict is not None and phase.why)
            where = program.phase_at(min(step.clock_next + 1e-6, program.duration)).name
            arms = {limit.arm for limit in step.binding}
            wrong += step.finished or where != named.name or named.arm not in arms
    yield Promise(f"{seeds} random programs of 20 phases: certified ones that do not finish", broken, 0, "")
    yield Promise(f"{seeds} random programs: not decided ({feasible} feasible)", 100.0 * undecided / seeds, 5.0, "%")
    yield Promise(f"{seeds} random programs: wrong phase or arm named", wrong, 0, "")


def _planned(quick: bool) -> Iterator[Promise]:
    worst, broken = 0.0, 0.0
    makes: list[Callable[[], Scenario]] = [pliers, lambda: _regrasped(1, rests=True), lambda: _regrasped(0, rests=True)]
    for make in makes[:1] if quick else makes:
        task = make()
        program = task.path
        assert isinstance(program, Program)
        optimum = time_program(task.cell, task.grasp, program, q_start=task.q_start, share=1.0).duration
        planned = time_program(task.cell, task.grasp, program, q_start=task.q_start)
        task = replace(task, path=planned)
        judge = _Judge(task, _program_places(task))
        steps = _to_the_end(_started(task), judge)
        worst = max(worst, _DT * len(steps) / optimum if steps[-1].finished else np.inf)
        broken = max(broken, judge.chain, judge.path)
    yield Promise("run of a planned program, over the optimum of its phases", worst, 1.03, "")
    yield Promise("run of a planned program: chain, path", 1e6 * broken, 0.5, "µm")


def _pins(quick: bool) -> Iterator[Promise]:
    del quick
    task = five_joint_pins()
    judge = _Judge(task, lambda clock: list(task.grasp.T_object_tool))
    steps = _to_the_end(_started(task), judge)
    off = max(judge.chain, judge.path) if steps[-1].finished else np.inf
    yield Promise("two arms of five joints with pins, six-dimensional path: chain, path", 1e6 * off, 0.1, "µm")
    task = bar_with_pins()
    wide = LinePath.displaced(task.path.pose(0.0), rotation=(0.0, 0.0, 3.0), duration=6.0, time_law="linear")
    reached = float(np.rad2deg(0.5 * _to_the_end(_started(replace(task, path=wide)))[-1].clock))
    yield Promise("two RX-90L on a bar with pins: yaw short of 96°", 96.0 - reached, 0.0, "°")


def _rigid_bar() -> Scenario:
    """The bar of :func:`coopqp.scenarios.bar_with_pins` in rigid grips, and less far."""
    pins = bar_with_pins(yaw=1.0)
    arms = [robot_arm("rx90l", name=arm.name, T_world_base=arm.T_world_base) for arm in pins.cell.arms]
    cell = RobotCell(arms).with_limits(acceleration=_ACCELERATION)
    q_start = np.concatenate([pins.q_start[:6], pins.q_start[7:13]])
    return replace(pins, cell=cell, q_start=q_start)


def _costs(quick: bool) -> Iterator[Promise]:
    fixed = _lift()
    task = pliers()
    bar, pins = _rigid_bar(), bar_with_pins(yaw=1.0)
    ratios, hinged = [], []
    for _ in range(7 if quick else 15):
        spent = []
        for one in (fixed, task, bar, pins):
            controller = _started(one)
            for _ in range(100):
                controller.step()
            began = time.process_time()
            for _ in range(1000):
                controller.step()
            spent.append(time.process_time() - began)
        ratios.append(spent[1] / spent[0])
        hinged.append(spent[3] / spent[2])
    yield Promise("step with two moving grasps, over one with fixed grasps", float(np.median(ratios)), 1.4, "")
    yield Promise("step with a hinge per arm, over one with rigid grips", float(np.median(hinged)), 1.3, "")


def promises(quick: bool) -> Iterator[Promise]:
    """Promises about programs."""
    for part in (_pliers, _wide, _tools, _coupled, _regrasp, _gates, _checked, _planned, in_engine, _pins, _costs):
        yield from part(quick)
