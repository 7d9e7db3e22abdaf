"""The baseline: the paper's Steps 0 to 5 as published, its variants, and its figures."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings, strategies as st
from numpy.typing import NDArray
from runs import of_the_paper

from coopqp import (
    Grasp,
    HoldPath,
    InvalidInputError,
    LinePath,
    Recording,
    RobotCell,
    Status,
    WaypointPath,
    inverse_kinematics,
    simulate,
)
from coopqp.baselines import PseudoInverseController, PseudoInverseOptions
from coopqp.errors import UnknownNameError
from coopqp.model import CellState
from coopqp.scenarios import Scenario
from coopqp.scenarios.paper import BASE_DISTANCE_H, slave_base
from coopqp.simulation import (
    limit_excess,
    object_error,
    relative_orientation_error,
    relative_positioning_error,
    tool_placements,
)

Array = NDArray[np.float64]
Baseline = Callable[..., Recording]


def controller(task: Scenario, steps: int = 40, **options: Any) -> PseudoInverseController:
    made = of_the_paper(task, steps, **options)
    made.reset(task.q_start)
    return made


def eps_p_mm(task: Scenario, run: Recording) -> float:
    return 1e3 * max(relative_positioning_error(tools, task.grasp) for tools in tool_placements(task.cell, run.q))


def eps_o_deg(task: Scenario, run: Recording) -> float:
    return float(
        np.rad2deg(max(relative_orientation_error(tools, task.grasp) for tools in tool_placements(task.cell, run.q)))
    )


# -- the figures -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("steps", "eps_p", "eps_o"), [(40, 8.70, 0.504), (400, 0.871, 0.0517), (1000, 0.348, 0.0207)])
def test_figure_5(paper: Scenario, baseline: Baseline, steps: int, eps_p: float, eps_o: float) -> None:
    run = baseline(steps)
    assert run.n_steps == steps
    assert eps_p_mm(paper, run) == pytest.approx(eps_p, rel=0.02)
    assert eps_o_deg(paper, run) == pytest.approx(eps_o, rel=0.02)
    assert limit_excess(paper.cell, run.q, run.velocity) == 0.0


@pytest.mark.parametrize(
    ("options", "steps", "eps_p", "eps_o", "tolerance"),
    [
        ({"increment": "literal"}, 40, 9.71, 0.624, 0.02),
        ({"increment": "literal"}, 400, 0.977, 0.0634, 0.02),
        ({"increment": "exact"}, 40, 8.69, 0.499, 0.02),
        ({"increment": "exact"}, 400, 0.870, 0.0517, 0.02),
        ({"reset_every": 10}, 400, 0.022, None, 0.1),
        ({"reset_every": 50}, 400, 0.118, None, 0.1),
        ({"reset_every": 100}, 400, 0.232, None, 0.1),
        ({"increment": "exact", "integration": "midpoint"}, 40, 0.055, 0.010, 0.1),
        ({"increment": "exact", "integration": "midpoint"}, 400, 5.6e-4, 1.0e-4, 0.1),
    ],
)
def test_variants(
    paper: Scenario, baseline: Baseline, options: Any, steps: int, eps_p: float, eps_o: float | None, tolerance: float
) -> None:
    run = baseline(steps, **options)
    assert eps_p_mm(paper, run) == pytest.approx(eps_p, rel=tolerance)
    if eps_o is not None:
        assert eps_o_deg(paper, run) == pytest.approx(eps_o, rel=max(tolerance, 0.05))


def test_the_midpoint_is_good_enough(paper: Scenario, baseline: Baseline) -> None:
    for increment in ("rotated", "exact"):
        assert eps_p_mm(paper, baseline(40, integration="midpoint", increment=increment)) <= 0.06


@pytest.mark.parametrize(("options", "order"), [({}, 1), ({"integration": "midpoint", "increment": "exact"}, 2)])
def test_order_of_convergence(paper: Scenario, baseline: Baseline, options: Any, order: int) -> None:
    errors = [eps_p_mm(paper, baseline(n, **options)) for n in (50, 100, 200)]
    np.testing.assert_allclose(np.log2(np.array(errors[:-1]) / errors[1:]), order, atol=0.1)


def test_the_error_grows_along_the_way(paper: Scenario, baseline: Baseline) -> None:
    errors = [relative_positioning_error(t, paper.grasp) for t in tool_placements(paper.cell, baseline(400).q)]
    assert errors[0] < 1e-12
    assert all(a < b for a, b in zip(errors[::40], errors[40::40], strict=False))


def test_what_follows_the_path_arrives(paper: Scenario, baseline: Baseline) -> None:
    """The absolute pose of A has only open-loop drift. The literal increment is a screw with another end pose."""
    final = {
        name: 1e3 * object_error(tool_placements(paper.cell, run.q[-1:])[0], paper.grasp, paper.path.goal)[0]
        for name, run in {
            "rotated": baseline(400),
            "exact": baseline(400, increment="exact"),
            "reset": baseline(400, reset_every=10),
            "literal": baseline(1000, increment="literal"),
        }.items()
    }
    assert final["literal"] == pytest.approx(103.0, rel=0.01)
    assert final["rotated"] < 1.5
    assert final["exact"] < 1.0
    assert final["reset"] < 1e-7


def test_wider_grasps_are_worse(paper: Scenario, baseline: Baseline) -> None:
    """With β = 0.6 and 3α = 0.8 m, ε_p exceeds 1 mm at N = 400: the paper's claim is for narrow grasps."""
    master = paper.cell.arms[0]
    slaves = [master.placed(slave_base(b, BASE_DISTANCE_H - 1.0), name=n) for b, n in ((0.5, "s1"), (-0.5, "s2"))]
    cell, grasp = RobotCell([master, *slaves]), Grasp.triangle(0.8 / 3.0, 0.6)
    q_start = inverse_kinematics(cell, grasp, paper.path.start, paper.q_start)
    run = simulate(PseudoInverseController(cell, grasp, paper.path, dt=3.0 / 400), q_start=q_start)
    wide = 1e3 * max(relative_positioning_error(tools, grasp) for tools in tool_placements(cell, run.q))
    assert wide > 1.2 > 1.0 > eps_p_mm(paper, baseline(400))


# -- one step --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("increment", ["rotated", "literal", "exact"])
def test_a_step_is_eq_16_and_17(paper: Scenario, increment: str) -> None:
    made = controller(paper, 40, increment=increment)
    screw, clock = paper.path.screw, 0.0
    for _ in range(5):
        step = made.step()
        p, turn = screw.p / 40, screw.angle * screw.r / 40
        if increment == "rotated":
            p = pin.exp3(-clock / 3.0 * screw.angle * screw.r) @ p
        delta = np.concatenate([p, turn])
        if increment == "exact":
            delta = pin.log6(paper.path.pose(clock).actInv(paper.path.pose(clock + 3.0 / 40))).vector
        expected = paper.grasp.arm_increments(delta)
        np.testing.assert_allclose(step.arm_increments, expected, rtol=0, atol=1e-13)
        np.testing.assert_allclose(step.q_next, step.q + step.velocity * step.dt, rtol=0, atol=1e-14)
        assert step.clock == pytest.approx(clock)
        assert step.clock_next == pytest.approx(clock + 3.0 / 40)
        assert (step.status, step.rate, step.reason) == (Status.TRACKING, 1.0, "")
        clock = step.clock_next


def test_inputs_are_not_touched_and_outputs_not_shared(paper: Scenario) -> None:
    q = paper.q_start.copy()
    made = controller(paper)
    made.reset(q)
    first = made.step(q)
    kept = [x.copy() for x in (first.q, first.velocity, first.q_next)]
    assert np.array_equal(q, paper.q_start)
    q[:] = 99.0
    made.step(np.full(18, np.nan))  # open loop: the measurement has no effect
    made.step("nonsense")
    for a, b in zip(kept, (first.q, first.velocity, first.q_next), strict=True):
        assert np.array_equal(a, b)


def test_two_controllers_share_nothing(paper: Scenario) -> None:
    a, b = controller(paper), controller(paper)
    alone = [controller(paper).step().q_next]
    a.step()
    assert np.array_equal(b.step().q_next, alone[0])
    a.reset(paper.q_start)  # a reset forgets everything
    assert np.array_equal(a.step().q_next, alone[0])


def test_a_reset_counts_from_the_start_again(paper: Scenario) -> None:
    made = controller(paper, 40, reset_every=3)
    fresh = [made.step().q_next for _ in range(4)]
    made.reset(paper.q_start)
    assert all(np.array_equal(made.step().q_next, q) for q in fresh)


def test_runs_are_deterministic(paper: Scenario) -> None:
    first, second = (simulate(controller(paper, 30), q_start=paper.q_start) for _ in range(2))
    assert first.q.tobytes() == second.q.tobytes()
    assert first.velocity.tobytes() == second.velocity.tobytes()


@settings(max_examples=settings().max_examples // 4)
@given(st.integers(1, 60), st.floats(0.5, 1.5))
def test_any_step_length_ends_at_the_end(paper: Scenario, steps: int, factor: float) -> None:
    made = PseudoInverseController(paper.cell, paper.grasp, paper.path, dt=3.0 / steps * factor)
    made.reset(paper.q_start)
    step, count = made.step(), 1
    while not step.finished:
        step, count = made.step(), count + 1
        assert count <= 2 * steps + 2
    assert step.clock_next == 3.0
    assert count == pytest.approx(steps / factor, abs=1.0)
    rest = made.step()  # after the end the object rests
    assert not rest.velocity.any()
    assert rest.clock_next == 3.0


def test_uneven_steps_follow_the_same_path(paper: Scenario, rng: Any) -> None:
    made = controller(paper, 100, increment="exact", integration="midpoint")
    step = made.step()
    while not step.finished:
        step = made.step(dt=rng.uniform(0.01, 0.05))
    tools = tool_placements(paper.cell, [step.q_next])[0]
    assert object_error(tools, paper.grasp, paper.path.goal)[0] < 1e-4


def test_quintic_time_law(paper: Scenario) -> None:
    path = LinePath(paper.path.start, paper.path.goal, duration=3.0, time_law="quintic")
    for increment in ("rotated", "exact"):
        made = PseudoInverseController(
            paper.cell, paper.grasp, path, dt=3.0 / 400, options=PseudoInverseOptions(increment=increment)
        )
        run = simulate(made, q_start=paper.q_start)
        speed = np.abs(run.velocity).max(axis=1)
        assert max(speed[0], speed[-1]) < 1e-3 * speed.max()
        assert object_error(tool_placements(paper.cell, run.q[-1:])[0], paper.grasp, path.goal)[0] < 2e-3


def test_exact_increments_follow_any_path(paper: Scenario) -> None:
    start = paper.path.start
    up = pin.SE3(start.rotation, start.translation + np.array([0.0, 0.0, 0.1]))
    path = WaypointPath([start, up, paper.path.goal], durations=[1.0, 2.0])
    made = PseudoInverseController(
        paper.cell, paper.grasp, path, dt=0.01, options=PseudoInverseOptions(increment="exact", integration="midpoint")
    )
    run = simulate(made, q_start=paper.q_start)
    assert object_error(tool_placements(paper.cell, run.q[100:101])[0], paper.grasp, up)[0] < 1e-5
    assert object_error(tool_placements(paper.cell, run.q[-1:])[0], paper.grasp, path.pose(3.0))[0] < 1e-5


# -- any cell --------------------------------------------------------------------------------------------------------


def mixed_task(make_cell: Any, order: list[int], G: pin.SE3) -> tuple[RobotCell, Grasp, LinePath, Array]:
    pin.seed(21)
    robots, bases = ["rx90l", "arm7", "arm6c", "gantry7"], [pin.SE3.Random() for _ in range(4)]
    whole = make_cell(robots, bases)
    x = np.linspace(0.4, 0.9, whole.nv)
    start = pin.SE3.Random()
    grasp = Grasp.from_configuration(whole, whole.configuration(x), start)
    cell = make_cell([robots[i] for i in order], [G * bases[i] for i in order])
    y = np.concatenate([x[whole.v_slices[i]] for i in order])
    path = LinePath(G * start, G * start * pin.exp6(pin.Motion(np.full(6, 0.05))), duration=1.0)
    return cell, Grasp(tuple(grasp.T_object_tool[i] for i in order)), path, cell.configuration(y)


def run_mixed(make_cell: Any, order: list[int], G: pin.SE3) -> tuple[RobotCell, Array]:
    cell, grasp, path, q = mixed_task(make_cell, order, G)
    run = simulate(PseudoInverseController(cell, grasp, path, dt=0.05), q_start=q)
    return cell, run.velocity


@settings(max_examples=settings().max_examples // 4)
@given(st.permutations(range(4)), st.tuples(*[st.floats(-2, 2)] * 6))
def test_order_of_arms_and_world_do_not_matter(make_cell: Any, order: list[int], xi: list[float]) -> None:
    reference, v = run_mixed_once(make_cell)
    _, u = run_mixed(make_cell, order, pin.exp6(pin.Motion(np.array(xi))))
    expected = np.concatenate([v[:, reference.v_slices[i]] for i in order], axis=1)
    np.testing.assert_allclose(u, expected, rtol=0, atol=1e-9)


_reference: list[tuple[RobotCell, Array]] = []


def run_mixed_once(make_cell: Any) -> tuple[RobotCell, Array]:
    if not _reference:
        _reference.append(run_mixed(make_cell, [0, 1, 2, 3], pin.SE3.Identity()))
    return _reference[0]


def test_redundant_arms_take_the_least_motion(make_cell: Any) -> None:
    cell, grasp, path, q = mixed_task(make_cell, [0, 1, 2, 3], pin.SE3.Identity())
    made = PseudoInverseController(cell, grasp, path, dt=0.01)
    made.reset(q)
    step = made.step()
    for k, s in enumerate(cell.v_slices):
        J = CellState(cell, q).jacobian(k)
        expected = np.linalg.pinv(J) @ step.arm_increments[k]
        np.testing.assert_allclose(step.velocity[s] * step.dt, expected, rtol=0, atol=1e-13)
    assert np.hypot(*step.q_next[cell.q_slices[2]][-2:]) == pytest.approx(1.0, abs=1e-14)


# -- singularities ---------------------------------------------------------------------------------------------------


def near_singular(paper: Scenario, angle: float, **options: Any) -> tuple[PseudoInverseController, Array]:
    q = paper.q_start.copy()
    q[4] = angle  # the master's wrist
    grasp = Grasp.from_configuration(paper.cell, q, paper.path.start)
    made = PseudoInverseController(paper.cell, grasp, paper.path, dt=0.01, options=PseudoInverseOptions(**options))
    made.reset(q)
    return made, q


def test_damping_keeps_joint_speeds_down(paper: Scenario) -> None:
    sharp = np.abs(near_singular(paper, 1e-4)[0].step().velocity).max()
    soft = np.abs(near_singular(paper, 1e-4, damping=0.1)[0].step().velocity).max()
    assert sharp > 100.0 * soft
    assert soft < 5.0
    at_it = near_singular(paper, 0.0)[0].step().velocity
    assert np.isfinite(at_it).all()


def test_damping_fades_in(paper: Scenario) -> None:
    """No damping above the threshold, λ_max at the singularity, and the documented damping in between."""
    for angle in (0.0, 0.02, 0.05, 0.5):
        made, q = near_singular(paper, angle, damping=0.1, damping_from=0.04)
        step = made.step()
        J = CellState(paper.cell, q).jacobian(0)
        sigma = np.linalg.svd(J, compute_uv=False)[-1]
        damping = 0.1**2 * max(0.0, 1.0 - (sigma / 0.04) ** 2)
        delta = made.grasp.arm_increments(made._object_increment(0.0, 0.01))[0]
        expected = J.T @ np.linalg.solve(J @ J.T + damping * np.eye(6), delta) / 0.01
        np.testing.assert_allclose(step.velocity[:6], expected, rtol=0, atol=1e-9)


# -- bad input -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"increment": "literally"}, "Did you mean 'literal'?"),
        ({"increment": None}, "rotated, literal, exact"),
        ({"integration": "rk4"}, "euler, midpoint"),
        ({"reset_every": 0}, "reset_every"),
        ({"reset_every": -3}, "reset_every"),
        ({"reset_every": 2.5}, "reset_every"),
        ({"reset_every": "often"}, "reset_every"),
        ({"damping": -0.1}, "damping"),
        ({"damping": np.nan}, "damping"),
        ({"damping_from": 0.0}, "damping_from"),
    ],
)
def test_bad_options(options: dict[str, Any], says: str) -> None:
    with pytest.raises((InvalidInputError, UnknownNameError)) as caught:
        PseudoInverseOptions(**options)
    assert says in str(caught.value)


@pytest.mark.parametrize("dt", [0.0, -0.1, np.nan, np.inf, None, "fast"])
def test_bad_period(paper: Scenario, dt: Any) -> None:
    with pytest.raises(InvalidInputError, match="PseudoInverseController: dt"):
        PseudoInverseController(paper.cell, paper.grasp, paper.path, dt=dt)


def test_bad_combinations(paper: Scenario, mixed_cell: RobotCell) -> None:
    with pytest.raises(InvalidInputError, match="3 placements for 6 arms"):
        PseudoInverseController(mixed_cell, paper.grasp, paper.path, dt=0.1)
    for increment in ("rotated", "literal"):
        with pytest.raises(InvalidInputError, match=f"'{increment}' increment needs a LinePath, got HoldPath.*exact"):
            PseudoInverseController(
                paper.cell,
                paper.grasp,
                HoldPath(paper.path.start),
                dt=0.1,
                options=PseudoInverseOptions(increment=increment),
            )


def test_a_start_where_the_arms_do_not_meet_the_grasp(paper: Scenario) -> None:
    made = PseudoInverseController(paper.cell, paper.grasp, paper.path, dt=0.1)
    with pytest.raises(InvalidInputError, match=r"step before reset.*Call reset"):
        made.step()
    for k, joint in ((0, 1), (1, 8), (2, 13)):
        q = paper.q_start.copy()
        q[joint] += 0.1
        with pytest.raises(InvalidInputError, match=f"arm '{paper.cell.arm_names[k]}' holds the object") as caught:
            made.reset(q)
        assert "inverse_kinematics" in str(caught.value)
    for bad in (np.zeros(17), np.full(18, np.nan), None):
        with pytest.raises(InvalidInputError, match="reset: q"):
            made.reset(bad)
    with pytest.raises(InvalidInputError, match="step before reset"):
        made.step()


@pytest.mark.parametrize("dt", [0.0, -0.1, np.nan, np.inf, "fast", [0.1]])
def test_a_step_of_no_length_holds(paper: Scenario, dt: Any) -> None:
    made = controller(paper)
    first = made.step()
    held = made.step(dt=dt)
    assert held.status is Status.HOLDING
    assert "dt" in held.explain()
    assert not held.velocity.any()
    assert np.array_equal(held.q_next, first.q_next)
    assert held.clock_next == held.clock == first.clock_next
    other = controller(paper)
    other.step()
    assert np.array_equal(made.step().q_next, other.step().q_next), "and then goes on as if nothing had been"


def test_a_reset_out_of_reach_is_left_out(paper: Scenario) -> None:
    """The object leaves the workspace: the baseline continues without the reset and gives the reason."""
    path = LinePath.displaced(paper.path.start, translation=(0.0, 0.0, 3.0), duration=3.0, time_law="linear")
    made = PseudoInverseController(paper.cell, paper.grasp, path, dt=0.1, options=PseudoInverseOptions(reset_every=10))
    made.reset(paper.q_start)
    reasons = [made.step().reason for _ in range(30)]
    assert any("no periodic reset" in reason and "does not reach" in reason for reason in reasons)
    assert reasons[0] == ""
