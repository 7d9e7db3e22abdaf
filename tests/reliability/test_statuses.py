"""Rows I3, I7 (lengths of a step) and I8: a status is true, every stop has a name, and an odd start is said."""

from __future__ import annotations

import dataclasses
import re
import warnings
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from runs import fast_lift, limited_once

from coopqp import (
    ControlStep,
    InvalidInputError,
    LinePath,
    PreviewOptions,
    QPController,
    QPOptions,
    ServoPath,
    Status,
)
from coopqp.errors import StartWarning
from coopqp.model import CellState
from coopqp.scenarios import Scenario, at_limit, at_singularity, dual_arm7, five_joint_pair, mixed_cell, paper_lift
from coopqp.simulation.evaluation.metrics import errors_from, object_poses, tool_matrices
from coopqp.spatial import Array

#: What a status may not be beyond these distances [m, rad]; rounding decides within the last.
FAR, ROUNDING = (1e-3, np.deg2rad(0.1)), 1e-9
STOPPED = (Status.BLOCKED, Status.HOLDING, Status.FAULT)


MAKES: tuple[Callable[[], Scenario], ...] = (
    paper_lift, fast_lift, mixed_cell, dual_arm7, lambda: at_limit(direction=(0.1, 0.05, 1.0)), at_singularity,
    lambda: at_singularity("elbow"), lambda: at_singularity("reach"),
)  # fmt: skip


def off_path(task: Scenario, steps: Sequence[ControlStep], poses: Sequence[pin.SE3]) -> list[tuple[float, float]]:
    """Of the object as the first arm is told to hold it from the poses of its path, from Pinocchio alone [m, rad]."""
    held = object_poses(tool_matrices(task.cell, np.array([step.q for step in steps])), task.grasp)[:, :1]
    distance, angle = errors_from(held, np.array([T.homogeneous for T in poses]))
    return list(zip(distance[:, 0].tolist(), angle[:, 0].tolist(), strict=True))


def untrue(step: ControlStep, d: float, a: float) -> bool:
    """The object is far off its path and that is not said, or the other way round, or another distance is said."""
    if step.status in (Status.HOLDING, Status.FAULT):
        return False
    if any(abs(size - far) < ROUNDING for size, far in zip((d, a), FAR, strict=True)):
        return False
    said = step.status is Status.OFF_PATH
    if said != (d > FAR[0] or a > FAR[1]):
        return True
    found = re.match(r"The object is (?:([\d.]+) mm)?(?: and )?(?:([\d.]+)°)? off its path", step.explain())
    if not said or found is None:
        return said
    mm, degrees = (None if x is None else float(x) for x in found.groups())
    right = (mm is None) == (d <= FAR[0]) and (degrees is None) == (a <= FAR[1])
    right &= mm is None or abs(mm - 1e3 * d) <= 0.06
    right &= degrees is None or abs(degrees - np.rad2deg(a)) <= 0.006
    return not right


def nameless(step: ControlStep) -> bool:
    return step.status in STOPPED and not (step.binding or step.reason)


def outside(task: Scenario, steps: Sequence[ControlStep]) -> int:
    """How many commands of a run from rest are not finite, or break a limit of speed or acceleration."""
    v, limits = np.array([step.velocity for step in steps]), task.cell.limits
    q, dt = np.array([step.q_next for step in steps]), np.array([[step.dt] for step in steps])
    good = np.isfinite(q).all(axis=1) & (np.abs(v) <= limits.velocity + 1e-9).all(axis=1)
    change = np.abs(np.diff(v, axis=0, prepend=np.zeros((1, task.cell.nv))))
    good &= (change <= limits.acceleration * dt * (1.0 + 1e-6) + 1e-9).all(axis=1)
    return int((~good).sum())


def turned(T: pin.SE3, rng: np.random.Generator, far: float) -> pin.SE3:
    return pin.SE3(T.rotation @ pin.exp3(0.3 * rng.standard_normal(3)), T.translation + far * rng.standard_normal(3))


@dataclasses.dataclass
class Tally:
    steps: int = 0
    untrue: int = 0
    nameless: int = 0
    outside: int = 0
    seen: set[Status] = dataclasses.field(default_factory=set)


def wild(seed: int, tally: Tally, *, jitter: bool) -> None:
    """A run in which path, target, override and the length of a step change at random."""
    rng = np.random.default_rng(seed)
    task = limited_once(MAKES[seed % len(MAKES)], float(rng.choice([np.inf, 5.0, 20.0])))
    dt = float(10.0 ** rng.uniform(-4.0, -1.0)) if jitter else 0.004
    options: dict[str, Any] = {"shortcut": bool(rng.uniform() < 0.8)}
    if rng.uniform() < 0.4:
        options["preview"] = None if rng.uniform() < 0.5 else PreviewOptions(newton_steps=int(rng.integers(1, 4)))
    kind, start = ("path", "servo", "other paths")[int(rng.integers(3))], task.path.pose(0.0)
    if kind == "servo":
        task = dataclasses.replace(task, path=ServoPath(start))
    controller = QPController(task.cell, task.grasp, task.path, dt=dt, options=QPOptions(**options))
    controller.reset(task.q_start)
    step, steps, poses = None, [], []
    for i in range(100):
        if i % 30 == 10 and isinstance(controller.path, ServoPath):
            controller.retarget(turned(start, rng, 10.0 ** rng.uniform(-2.0, 0.5)))
        if i % 30 == 10 and kind == "other paths" and step is not None:
            T = controller.path.pose(step.clock_next)
            here = turned(T, rng, 0.0) if rng.uniform() < 0.3 else T
            controller.follow(LinePath(here, turned(here, rng, 0.2), duration=1.0))
        if rng.uniform() < 0.05:
            controller.set_override(float(rng.uniform()))
        if rng.uniform() < 0.05:
            (controller.pause if rng.uniform() < 0.3 else controller.resume)()
        length = dt * float(rng.uniform(0.1, 4.9)) if jitter and rng.uniform() < 0.3 else None
        step = controller.step(dt=length)
        steps.append(step)
        poses.append(step.path.pose(step.clock))  # a target moves its path
        if step.finished:
            break
    tally.steps, tally.seen = tally.steps + len(steps), tally.seen.union(step.status for step in steps)
    tally.nameless += sum(nameless(step) for step in steps)
    tally.outside += outside(task, steps)
    tally.untrue += sum(untrue(step, *off) for step, off in zip(steps, off_path(task, steps, poses), strict=True))


@pytest.mark.slow
def test_no_step_says_what_is_not_so(catalogue: Any, count: Any) -> None:
    tally = Tally()
    for seed in range(count(60)):
        wild(seed, tally, jitter=False)
    assert tally.seen >= {Status.TRACKING, Status.SLOWED, Status.BLOCKED, Status.PAUSED, Status.OFF_PATH}
    name = "paths, targets and overrides at random"
    catalogue.row(
        "I3", f"{name}: status or distance not true", cases=tally.steps, measured=tally.untrue, target=0,
        note="beyond 1 mm or 0.1° OFF_PATH with the distance, within never",
    )  # fmt: skip
    catalogue.row(
        "I3", f"{name}: BLOCKED or HOLDING without a name", cases=tally.steps, measured=tally.nameless, target=0
    )


@pytest.mark.slow
def test_any_length_of_a_step_has_a_name_for_every_stop(catalogue: Any, count: Any) -> None:
    tally = Tally()
    for seed in range(count(60)):
        wild(1000 + seed, tally, jitter=True)
    wrong = tally.nameless + tally.outside + tally.untrue
    name = "dt of 0.1 to 100 ms, a third of the steps of 0.1 to 4.9 dt: a limit, a false status, no name"
    catalogue.row("I7", name, cases=tally.steps, measured=wrong, target=0)


@pytest.mark.slow
def test_a_previewed_object_is_never_said_to_be_off_its_path(catalogue: Any) -> None:
    steps = alarms = 0
    for make in (paper_lift, mixed_cell, dual_arm7, five_joint_pair, MAKES[4]):
        for acceleration in (np.inf, 10.0, 5.0):
            task = limited_once(make, acceleration)
            controller = QPController(task.cell, task.grasp, task.path, dt=0.003)
            controller.reset(task.q_start)
            for _ in range(1000):
                step = controller.step()
                steps, alarms = steps + 1, alarms + (step.status is Status.OFF_PATH)
    what = "previewed runs: OFF_PATH said in vain"
    catalogue.row("I3", what, cases=steps, measured=alarms, target=0)


# -- I8 ----------------------------------------------------------------------------------------------------------------


def said_at_reset(controller: QPController, q: Array) -> str:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        controller.reset(q)
    return "; ".join(str(w.message) for w in caught if issubclass(w.category, StartWarning))


@pytest.mark.slow
def test_a_start_off_the_grasp_or_the_path_is_said(catalogue: Any, count: Any) -> None:
    """By 0.1 mm to the tolerance; the words end when the arms are where they should be."""
    rng, silent, cases, wrong = np.random.default_rng(3), 0, 0, 0
    while cases < count(30):
        task = limited_once(MAKES[cases % 4], float(rng.choice([np.inf, 10.0])))
        controller = QPController(task.cell, task.grasp, task.path, dt=0.005)
        q = task.cell.moved(task.q_start, 10.0 ** rng.uniform(-4.0, -2.0) * rng.standard_normal(task.cell.nv))
        O = task.grasp.carried(CellState(task.cell, q))
        start = task.path.pose(0.0)
        parted = max(float(np.linalg.norm(T.translation - O[0].translation)) for T in O)
        away = float(np.linalg.norm(O[0].translation - start.translation))
        try:
            words = said_at_reset(controller, q)
        except InvalidInputError:
            continue  # beyond the tolerance
        cases += 1
        reason = controller.step().reason
        for kind, size in (("off its grasp", parted), ("off its path", away)):
            if size >= 1e-4:
                silent += (kind not in words) + (kind not in reason)
        for _ in range(300):
            step = controller.step()
        wrong += step.reason != "" or step.status not in (Status.TRACKING, Status.SLOWED)
    name = "starts off the grasp or the path by 0.1 mm to 20 mm"
    catalogue.row(
        "I8", f"{name}: not said", cases=cases, measured=silent, target=0, note="at reset and in the first step"
    )
    catalogue.row("I8", f"{name}: said for ever", cases=cases, measured=wrong, target=0)


@pytest.mark.slow
def test_a_start_outside_limits_is_said(catalogue: Any, count: Any) -> None:
    rng, silent, cases = np.random.default_rng(4), 0, 0
    for i in range(count(30)):
        task = MAKES[i % 4]()
        x, limits = task.cell.positions(task.q_start), task.cell.limits
        lower, upper = limits.lower.copy(), limits.upper.copy()
        j, by = int(rng.integers(task.cell.nv)), float(10.0 ** rng.uniform(-4.0, -1.0))
        lower[j], upper[j] = (x[j] - 1.0, x[j] - by) if i % 2 else (x[j] + by, x[j] + 1.0)
        task = dataclasses.replace(task, cell=task.cell.with_limits(lower=lower, upper=upper))
        controller = QPController(task.cell, task.grasp, task.path, dt=0.005)
        arm, _, joint = task.cell.joint_names[j].partition("/")
        words = f"arm {arm} started outside its limits: {joint}"
        silent += (words not in said_at_reset(controller, task.q_start)) + (words not in controller.step().explain())
        cases += 1
    name = "starts 0.1 to 100 mrad outside a joint's limit: arm and joint not said"
    catalogue.row("I8", name, cases=cases, measured=silent, target=0, note="at reset and in the first step")
