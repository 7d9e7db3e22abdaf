"""Odd arrays, poses, numbers and times as arguments: a named error or a correct round trip."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from random import Random
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from fuzzing import (
    MANY,
    MORE,
    Tried,
    answer,
    array_like,
    contents,
    is_refused,
    number_like,
    pose_like,
    positive_like,
)
from hypothesis import given, settings, strategies as st

from coopqp import (
    CommonError,
    ForceController,
    ForceOptions,
    Grasp,
    HoldPath,
    JointLimits,
    LinePath,
    PostureOptions,
    PreviewOptions,
    QPController,
    QPOptions,
    RobotCell,
    ServoPath,
    Status,
    SupervisionOptions,
    WaypointPath,
    inverse_kinematics,
)
from coopqp.baselines import (
    IndependentQPController,
    IndependentQPOptions,
    PseudoInverseController,
    PseudoInverseOptions,
)
from coopqp.control import RankWeights
from coopqp.model import CellState, plate_from_centroid, plate_from_points
from coopqp.paths.path import ScrewParameters
from coopqp.scenarios import mixed_cell, paper_lift
from coopqp.simulation import Disturbances, KinematicPlant, Monitor, PhysicsOptions, Tolerances, ViolationKind
from coopqp.solvers import DaqpSettings, OsqpSettings, ProxqpSettings

pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")
LIFT, MIXED = paper_lift(), mixed_cell()
#: For a property whose every example is a motion.
FEW = settings(max_examples=max(settings().max_examples // 2, 1))
N = LIFT.cell.nv
START = LIFT.path.pose(0.0)
LIMITS = LIFT.cell.limits
ARM = LIFT.cell.arms[0]
FOLLOWER = QPController(LIFT.cell, LIFT.grasp, LIFT.path, dt=0.01)


def same(given: Any, meant: Any) -> bool:
    return np.array_equal(np.asarray(given), meant)


# -- arrays ------------------------------------------------------------------------------------------------------------

#: (a usual value, a function of the array, a check of its result). These functions accept exactly the arrays of finite
#: numbers with this shape.
VECTORS: dict[str, tuple[Any, Callable[[Any], Any], Callable[[Any, Any], bool]]] = {
    "CellState": (LIFT.q_start, lambda x: CellState(LIFT.cell, x), lambda r, m: same(r.q, m)),
    "check_configuration": (LIFT.q_start, lambda x: LIFT.cell.check_configuration(x, "here"), same),
    "configuration": (LIFT.q_start, LIFT.cell.configuration, same),
    "KinematicPlant": (LIFT.q_start, KinematicPlant(LIFT.cell).reset, same),
    "arm_increments": (np.ones(6), LIFT.grasp.arm_increments, lambda r, m: r.shape == (3, 6)),
    "displaced, translation": (
        [0.1, 0.2, 0.3],
        lambda x: LinePath.displaced(START, translation=x, duration=1.0),
        lambda r, m: same(r.goal.translation, START.translation + m),
    ),
    "from_configuration": (
        LIFT.q_start,
        lambda x: Grasp.from_configuration(LIFT.cell, x, START),
        lambda r, m: np.abs(r.relative_errors(CellState(LIFT.cell, m))).max() < 1e-9,
    ),
    "PostureOptions.target": (
        LIFT.q_start,
        lambda x: QPController(
            LIFT.cell,
            LIFT.grasp,
            LIFT.path,
            dt=0.01,
            options=QPOptions(posture=PostureOptions(target="none" if x is None else x)),
        ),
        lambda r, m: True,
    ),
}


@pytest.mark.slow
def test_arrays_of_finite_numbers_and_nothing_else(catalogue: Any) -> None:
    tried, doors = Tried(), list(VECTORS)

    def holds(rng: Random) -> None:
        usual, build, right = VECTORS[rng.choice(doors)]
        worn, meant = array_like(rng, usual)
        before = contents(worn)
        result = answer(lambda: (build(worn),))
        acceptable = meant is not None and np.isfinite(meant).all()
        assert (result is not None) == acceptable
        if result is not None:
            tried.accepted += 1
            assert right(result[0], meant)
        assert contents(worn) == before

    tried.each(holds, MORE)
    tried.row(catalogue, f"arrays at {len(VECTORS)} doors that take any finite one", MORE)


def rows(x: Any, n: int) -> list[Any]:
    """The rows of the value, or the value itself in place of each row."""
    return [x[i] for i in range(n)] if has_rows(x, n) else [x] * n


def has_rows(x: Any, n: int) -> bool:
    return isinstance(x, (np.ndarray, list, tuple)) and np.ndim(x) > 0 and len(x) == n


#: Functions that need more than finite numbers. The result of everything they accept must be right.
PICKY: dict[str, tuple[Any, Callable[[Any], Any], Callable[[Any, Any], bool]]] = {
    "displaced, rotation": (
        [0.1, 0.2, 0.3],
        lambda x: LinePath.displaced(START, rotation=x, duration=1.0),
        lambda r, m: np.allclose(r.goal.rotation, pin.exp3(m) @ START.rotation, atol=1e-6),
    ),
    "JointLimits": (
        [[-1.0, -2.0, 0.0], [1.0, 0.5, 2.0], [1.0, 2.0, 3.0], [5.0, 6.0, 7.0]],
        lambda x: JointLimits(*rows(x, 4)),
        lambda r, m: (
            same([r.lower, r.upper, r.velocity, r.acceleration], m)
            and bool((r.lower < r.upper).all() and (r.velocity > 0.0).all() and (r.acceleration > 0.0).all())
        ),
    ),
    "with_limits, velocity": (
        LIMITS.velocity,
        lambda x: LIFT.cell.with_limits(velocity=x),
        lambda r, m: same(r.limits.velocity, m) and bool((m > 0.0).all()),
    ),
    "with_limits, lower": (
        ARM.limits.lower,
        lambda x: ARM.with_limits(lower=x),
        lambda r, m: same(r.limits.lower, m) and bool((m < ARM.limits.upper).all()),
    ),
    "inverse_kinematics": (
        LIFT.q_start,
        lambda x: inverse_kinematics(LIFT.cell, LIFT.grasp, START, x, max_iter=5),
        lambda q, m: np.abs(LIFT.grasp.relative_errors(CellState(LIFT.cell, q))).max() < 1e-8,
    ),
    "reset": (
        LIFT.q_start,
        FOLLOWER.reset,
        lambda r, m: np.abs(m - LIFT.q_start).max() < 0.1,
    ),
    "configuration of turning joints": (
        MIXED.q_start,
        lambda x: MIXED.cell.check_configuration(x, "here"),
        lambda r, m: np.allclose(r, m, atol=1e-5),
    ),
    "plate_from_points": (
        [[0.0, 0.0, 0.0], [-0.2, 0.6, 0.0], [0.2, 0.6, 0.0]],
        lambda x: plate_from_points(*rows(x, 3)),
        lambda r, m: np.allclose(r[0].translation, m[0]) and r[1] > 0.0 and r[2] > 0.0,
    ),
    "CommonError": (
        np.full((3, 6), 1.0 / 3.0),
        lambda x: CommonError.per_axis(x).shares(LIFT.cell),
        lambda r, m: same(r, m) and np.allclose(m.sum(axis=0), 1.0),
    ),
}


#: Functions that also accept one number for all joints.
SCALARS_TOO = ("with_limits, velocity", "with_limits, lower")


@pytest.mark.slow
def test_what_is_accepted_is_right(catalogue: Any) -> None:
    tried, doors = Tried(), list(PICKY)

    def holds(rng: Random) -> None:
        usual, build, right = PICKY[door := rng.choice(doors)]
        worn, meant = array_like(rng, usual)
        if np.ndim(usual) > 1 and not (meant is not None and has_rows(worn, len(usual))):
            return  # without rows the value tests nothing here
        result = answer(lambda: (build(worn),))
        if result is not None:
            tried.accepted += 1
            if door in SCALARS_TOO and np.size(worn) == 1:
                meant = np.full(np.shape(usual), float(np.ravel(worn)[0]))
            assert meant is not None
            assert right(result[0], meant)

    tried.each(holds, MORE)
    tried.row(catalogue, f"arrays at {len(PICKY)} doors that ask for more", MORE)


# -- poses -------------------------------------------------------------------------------------------------------------


def _servo(T: Any) -> Any:
    controller = QPController(LIFT.cell, LIFT.grasp, ServoPath(START), dt=0.01)
    controller.reset(LIFT.q_start)
    kept = controller.path.target
    try:
        controller.retarget(T)
    except ValueError:
        assert controller.path.target is kept  # the target is unchanged
        raise
    return controller.path.target


#: Functions of a pose that return a placement equal to the given pose.
POSES: dict[str, Callable[[Any], Any]] = {
    "LinePath, start": lambda T: LinePath(T, START, duration=1.0).start,
    "LinePath, goal": lambda T: LinePath(START, T, duration=1.0).goal,
    "displaced": lambda T: LinePath.displaced(T, duration=1.0).pose(0.0),
    "WaypointPath": lambda T: WaypointPath([START, T, START], durations=[1.0, 2.0]).pose(1.0),
    "HoldPath": lambda T: HoldPath(T).pose(0.3),
    "ServoPath": lambda T: ServoPath(T).pose(0.0),
    "retarget": _servo,
    "ScrewParameters": lambda T: pin.SE3(
        pin.exp3((s := ScrewParameters.between(pin.SE3.Identity(), T)).angle * s.r), s.p
    ),
    "Grasp": lambda T: Grasp((T, START)).T_object_tool[0],
    "tool_targets": lambda T: Grasp((pin.SE3.Identity(),)).tool_targets(T)[0],
    "from_configuration": lambda T: Grasp.from_configuration(LIFT.cell, LIFT.q_start, T).carried(
        CellState(LIFT.cell, LIFT.q_start)
    )[2],
    "plate_from_centroid": lambda T: plate_from_centroid(T, 1.0) * pin.SE3(np.eye(3), np.array([0.0, 2.0, 0.0])),
    "placed": lambda T: RobotCell([ARM.placed(T)]).arms[0].T_world_base,
    "Disturbances": lambda T: (
        pin.SE3(np.asarray(getattr(T, "homogeneous", T), dtype=float)) if Disturbances(base_offset={"a": T}) else None
    ),
}


@pytest.mark.slow
def test_poses_and_nothing_else(catalogue: Any) -> None:
    tried, doors = Tried(), list(POSES)

    def holds(rng: Random) -> None:
        door = rng.choice(doors)
        worn, T = pose_like(rng)
        result = answer(lambda: POSES[door](worn))
        assert (result is not None) == (T is not None)
        if result is not None:
            tried.accepted += 1
            assert np.abs(result.homogeneous - T.homogeneous).max() < 1e-6

    tried.each(holds, MORE)
    tried.row(catalogue, f"poses at {len(POSES)} doors", MORE)


@pytest.mark.slow
def test_a_pose_to_be_reached(catalogue: Any) -> None:
    """inverse_kinematics refuses an invalid pose, reports an unreachable one, and reaches any other."""
    tried = Tried()

    def holds(rng: Random) -> None:
        worn, T = pose_like(rng)
        share = rng.choice([0.0, 0.3, rng.uniform(0.0, 0.3)])
        if T is not None:  # sometimes near enough to be reachable
            worn = T = START * pin.exp6(share * pin.log6(T).vector / (1.0 + np.linalg.norm(pin.log6(T).vector)))
        q = answer(lambda: inverse_kinematics(LIFT.cell, LIFT.grasp, worn, LIFT.q_start, max_iter=8))
        if q is not None:
            tried.accepted += 1
            assert T is not None
            for O in LIFT.grasp.carried(CellState(LIFT.cell, q)):
                assert np.abs(O.homogeneous - T.homogeneous).max() < 1e-8

    tried.each(holds)
    tried.row(catalogue, "poses, inverse_kinematics")


# -- numbers and options -----------------------------------------------------------------------------------------------

OPTIONS = (
    QPOptions,
    SupervisionOptions,
    PreviewOptions,
    PostureOptions,
    RankWeights,
    PseudoInverseOptions,
    IndependentQPOptions,
    Tolerances,
    Disturbances,
    PhysicsOptions,
    ForceOptions,
    DaqpSettings,
    OsqpSettings,
    ProxqpSettings,
)


def numbers_of(options: Any) -> list[str]:
    """Names of the fields that are numbers or tuples of them."""
    defaults = options()
    return [f.name for f in fields(options) if type(getattr(defaults, f.name)) in (float, int, tuple)]


def sound(value: Any) -> bool:
    """True for a finite number or a valid other value, also inside sequences."""
    if isinstance(value, tuple):
        return all(map(sound, value))
    return type(value) is not float or bool(np.isfinite(value))


def test_options_of_any_value(catalogue: Any) -> None:
    """Each number of each options class is refused by name or stored unchanged."""
    tried = Tried()
    every = [(options, name) for options in OPTIONS for name in numbers_of(options)]

    def holds(rng: Random) -> None:
        (options, name), value = rng.choice(every), number_like(rng)
        made = answer(lambda: options(**{name: value}))
        if made is None:
            return
        tried.accepted += 1
        kept = getattr(made, name)
        if value is None:
            assert kept is None  # None switches the option off
        elif isinstance(kept, tuple):
            assert all(type(x) is float and np.isfinite(x) for x in kept)
        else:
            assert isinstance(kept, (float, int, np.integer))
            assert abs(kept) < np.inf
            assert kept == (value if isinstance(value, int) else float(value))

    tried.each(holds, MORE)
    tried.row(catalogue, f"numbers in {len(every)} fields of {len(OPTIONS)} options classes", MORE)


@pytest.mark.slow
def test_accepted_options_never_make_a_step_fail(catalogue: Any) -> None:
    """With any options a step returns a command within the limits, or the constructor refuses them."""
    tried = Tried()
    tasks = [replace(LIFT, cell=LIFT.cell.with_limits(acceleration=a), dt=0.01) for a in (np.inf, 5.0)]
    kinds = (QPOptions, SupervisionOptions, PreviewOptions, PostureOptions, RankWeights)
    names = {kind: numbers_of(kind) for kind in kinds}
    part = {
        SupervisionOptions: "supervision",
        PreviewOptions: "preview",
        PostureOptions: "posture",
        RankWeights: "weights",
    }

    def holds(rng: Random) -> None:
        kind, task, noise = rng.choice(kinds), rng.choice(tasks), rng.choice([0.0, 1e-4, 1e-2])
        changed = {rng.choice(names[kind]): positive_like(rng) for _ in range(2)}
        options = answer(lambda: kind(**changed))
        if options is None:
            return
        whole = options if kind is QPOptions else QPOptions(**{part[kind]: options})
        whole = replace(whole, shortcut=rng.random() < 0.5)
        controller = QPController(task.cell, task.grasp, task.path, dt=task.dt, options=whole)
        if answer(lambda: (controller.reset(task.q_start),)) is None:
            return
        tried.accepted += 1
        monitor = Monitor(task.cell, task.grasp, tolerances=LIMITS_ONLY)
        normal = np.random.default_rng(3).standard_normal
        q = task.q_start
        steps = []
        for _ in range(2):
            steps.append(controller.step(q + noise * normal(q.size)))
            q = steps[-1].q_next
        monitor.observe_all(steps)
        assert monitor.verdict().ok, monitor.verdict()

    tried.each(holds)
    tried.row(catalogue, "options that are accepted, then steps")


@pytest.mark.slow
def test_accepted_options_of_forces_never_make_a_step_fail(catalogue: Any) -> None:
    """With any two of them, from the first step until the object moves: commands within the limits, or a refusal."""
    tried = Tried()
    task = replace(LIFT, dt=0.01)
    usual, names = {"stiffness": 1e5, "check_time": 0.02}, numbers_of(ForceOptions)

    def holds(rng: Random) -> None:
        changed = {rng.choice(names): positive_like(rng, 0.0) for _ in range(rng.choice([1, 2]))}
        size = rng.choice([0.0, 1.0, 30.0])
        inner = QPController(task.cell, task.grasp, task.path, dt=task.dt)
        made = answer(lambda: ForceController(inner, ForceOptions(**{**usual, **changed})))
        if made is None:
            return
        if is_refused(lambda: made.reset(task.q_start)):
            return
        tried.accepted += 1
        monitor = Monitor(task.cell, task.grasp, tolerances=LIMITS_ONLY)
        normal, q, steps = np.random.default_rng(rng.randrange(10)).standard_normal, task.q_start, []
        for _ in range(60):
            steps.append(made.step(q, wrenches=size * normal((len(task.cell), 6))))
            q = steps[-1].q_next
        monitor.observe_all(steps)
        assert monitor.verdict().ok, monitor.verdict()
        assert np.isfinite(made.shift).all()

    tried.each(holds, FEW)
    tried.row(catalogue, "options of forces that are accepted, then steps", FEW)


LIMITS_ONLY = Tolerances(chain_mm=1e9, chain_deg=1e9, object_mm=1e9, object_deg=1e9)


# -- time --------------------------------------------------------------------------------------------------------------

ODD_TIMES = [0.0, -1.0, np.nan, 1e-12, 10.0, -1e-3, 1e300, 5e-324, np.inf]


def time_like(rng: Random) -> Any:
    return rng.choice([number_like(rng), number_like(rng), rng.choice(ODD_TIMES), rng.uniform(1e-6, 10.0)])


DURATIONS: dict[str, Callable[[Any], Any]] = {
    "QPController": lambda t: QPController(LIFT.cell, LIFT.grasp, LIFT.path, dt=t).dt,
    "PseudoInverseController": lambda t: PseudoInverseController(LIFT.cell, LIFT.grasp, LIFT.path, dt=t).dt,
    "IndependentQPController": lambda t: IndependentQPController(LIFT.cell, LIFT.grasp, LIFT.path, dt=t).dt,
    "LinePath": lambda t: LinePath(START, START, duration=t).duration,
    "HoldPath": lambda t: HoldPath(START, duration=t).duration,
    "WaypointPath": lambda t: WaypointPath([START, START], durations=[t]).duration,
    "ServoPath, speed": lambda t: ServoPath(START, speed=t).speed,
}


@pytest.mark.slow
def test_times_that_are_none(catalogue: Any) -> None:
    tried, doors = Tried(), list(DURATIONS)

    def holds(rng: Random) -> None:
        door, t = rng.choice(doors), time_like(rng)
        kept = answer(lambda: DURATIONS[door](t))
        if kept is not None:
            tried.accepted += 1
            assert type(kept) is float
            assert kept == float(t)
            assert 0.0 < kept < np.inf
        elif type(t) is float:
            assert not 0.0 < t < (1.0 if door in ("QPController", "IndependentQPController") else np.inf)

    tried.each(holds, MORE)
    tried.row(catalogue, f"times at {len(DURATIONS)} doors", MORE)


@pytest.mark.slow
def test_a_path_at_any_clock(catalogue: Any) -> None:
    tried = Tried()
    other = START * pin.exp6(np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6]))
    servo = ServoPath(START)
    servo.set_target(other, clock=0.5)
    paths = [
        LinePath(START, other, duration=2.0),
        LinePath(START, other, duration=2.0, time_law="linear"),
        WaypointPath([START, other, START], durations=[1.0, 1e-6]),
        HoldPath(other),
        servo,
    ]
    clocks = st.one_of(st.floats(), st.floats(-1.0, 4.0), st.sampled_from([np.nan, np.inf, -np.inf, 1e300, 5e-324]))

    @MANY
    @given(st.sampled_from(paths), clocks, clocks)
    def holds(path: Any, clock: float, dt: float) -> None:
        tried.number += 1
        for read in (path.pose, path.twist):
            found = answer(lambda read=read: read(clock))
            if found is not None:
                tried.accepted += 1
                assert np.isfinite(found.homogeneous if isinstance(found, pin.SE3) else found).all()
            else:
                assert np.isnan(clock)
        increment = answer(lambda: path.increment(clock, dt))
        if increment is not None:
            assert np.isfinite(increment).all()

    holds()
    tried.row(catalogue, "times, a path at any clock")


# -- what a step is given ----------------------------------------------------------------------------------------------


MAKERS: dict[str, Any] = {
    "QP": QPController,
    "QP, turning joints": QPController,
    "independent": IndependentQPController,
    "pseudo-inverse": PseudoInverseController,
}


@pytest.mark.slow
@pytest.mark.parametrize("kinds", [["QP"], ["QP, turning joints", "independent", "pseudo-inverse"]], ids=len)
def test_a_step_answers_to_anything(kinds: list[str], catalogue: Any) -> None:
    """For any measurement and any step length the command is within the limits, without an exception."""
    tried = Tried()
    made: dict[tuple[str, bool], Any] = {}
    for kind in kinds:
        task = MIXED if kind == "QP, turning joints" else LIFT
        for limited in (False, True):
            cell = task.cell.with_limits(acceleration=8.0) if limited else task.cell
            made[kind, limited] = MAKERS[kind](cell, task.grasp, task.path, dt=0.01)

    def holds(rng: Random) -> None:
        (kind, _), controller = rng.choice(list(made.items()))
        q = MIXED.q_start if kind == "QP, turning joints" else LIFT.q_start
        controller.reset(q)
        monitor = Monitor(controller.cell, controller.grasp, tolerances=LIMITS_ONLY)
        steps = [controller.step()]
        for _ in range(rng.choice([1, 2])):
            worn = array_like(rng, q)[0] if rng.random() < 0.5 else None
            before = contents(worn)
            step = controller.step(worn, dt=time_like(rng) if rng.random() < 0.5 else None)
            assert contents(worn) == before
            steps.append(step)
            assert step.reason or step.status not in (Status.HOLDING, Status.FAULT)
            assert step.explain()
            tried.accepted += step.status not in (Status.HOLDING, Status.FAULT)
        monitor.observe_all([*steps, controller.step()])
        breaches = set(monitor.verdict().counts)
        if not kind.startswith("QP"):  # the controllers for comparison promise less
            breaches -= {ViolationKind.VELOCITY, ViolationKind.POSITION, ViolationKind.ACCELERATION}
        assert not breaches, monitor.verdict()

    tried.each(holds)
    tried.row(catalogue, f"a step of anything, {', '.join(kinds)}")


@pytest.mark.slow
def test_a_refused_value_changes_nothing(catalogue: Any) -> None:
    """A refused reset or target has no effect on a controller."""
    tried = Tried()

    def fresh() -> QPController:
        controller = QPController(LIFT.cell, LIFT.grasp, ServoPath(START), dt=0.01)
        controller.reset(LIFT.q_start)
        controller.retarget(START * pin.exp6(np.array([0.0, 0.1, 0.1, 0.0, 0.0, 0.2])))
        return controller

    a, b = fresh(), fresh()

    def holds(rng: Random) -> None:
        q, T = array_like(rng, LIFT.q_start), pose_like(rng)
        if q[1] is None or not np.isfinite(q[1]).all():
            assert is_refused(lambda: a.reset(q[0]))
        if T[1] is None:
            assert is_refused(lambda: a.retarget(T[0]))
        assert np.array_equal(a.step().velocity, b.step().velocity)

    tried.each(holds)
    tried.row(catalogue, "a refused reset or target changes nothing")
