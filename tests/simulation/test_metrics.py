"""The measures follow the paper's definitions, use configurations only, and are never perfect for a broken run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, strategies as st
from numpy.typing import NDArray

from coopqp import Grasp, InvalidInputError, LinePath, Recording, RobotCell
from coopqp.model import CellState
from coopqp.scenarios import Scenario
from coopqp.simulation import (
    chain_error,
    limit_excess,
    object_error,
    path_error,
    read_run,
    relative_orientation_error,
    relative_positioning_error,
    tool_placements,
)
from coopqp.simulation.evaluation import metrics

Array = NDArray[np.float64]

vectors = st.tuples(*[st.floats(-2.0, 2.0)] * 3).map(np.array)
poses = st.builds(lambda w, p: pin.SE3(pin.exp3(w), p), vectors, vectors)
grasps = st.lists(poses, min_size=2, max_size=4).map(lambda X: Grasp(tuple(X)))
NAN_POSE = pin.SE3(np.eye(3), np.full(3, np.nan))


def perturbed(grasp: Grasp, T: pin.SE3, seed: int, size: float = 0.1) -> list[pin.SE3]:
    rng = np.random.default_rng(seed)
    return [X * pin.exp6(pin.Motion(size * rng.normal(size=6))) for X in grasp.tool_targets(T)]


def measures(tools: list[pin.SE3], grasp: Grasp) -> Array:
    return np.array(
        [relative_positioning_error(tools, grasp), relative_orientation_error(tools, grasp), *chain_error(tools, grasp)]
    )


def test_placements_are_the_states(paper: Scenario, baseline: Callable[..., Recording]) -> None:
    run = baseline(40)
    all_tools = tool_placements(paper.cell, run.q)
    assert len(all_tools) == 41
    for q, tools in zip(run.q[::10], all_tools[::10], strict=True):
        for T, expected in zip(tools, CellState(paper.cell, q).T_world_tool, strict=True):
            np.testing.assert_allclose(T.homogeneous, expected.homogeneous, rtol=0, atol=1e-14)
    assert tool_placements(paper.cell, []) == []


@given(grasps, poses)
def test_a_perfect_grasp_has_no_error(grasp: Grasp, T: pin.SE3) -> None:
    tools = list(grasp.tool_targets(T))
    assert measures(tools, grasp).max() < 1e-13
    for k in range(len(grasp)):
        assert max(object_error(tools, grasp, T, k)) < 1e-13
    path = LinePath(T, T, duration=1.0)
    assert max(path_error(tools, grasp, path, 0.3)) < 1e-13


@given(grasps, poses, poses, st.integers(0, 2**32 - 1))
def test_the_world_does_not_matter(grasp: Grasp, T: pin.SE3, G: pin.SE3, seed: int) -> None:
    tools = perturbed(grasp, T, seed)
    moved = [G * tool for tool in tools]
    np.testing.assert_allclose(measures(tools, grasp), measures(moved, grasp), rtol=0, atol=1e-12)
    for k in range(len(grasp)):
        here, there = object_error(tools, grasp, T, k), object_error(moved, grasp, G * T, k)
        assert here == pytest.approx(there, abs=1e-12)


@given(grasps, poses, st.integers(0, 2**32 - 1))
def test_definitions(grasp: Grasp, T: pin.SE3, seed: int) -> None:
    """ε_p sums |p_ji − d_ji|² over pairs in tool frame i; ε_o sums angles; the chain error compares the O_k."""
    tools, X = perturbed(grasp, T, seed), grasp.T_object_tool
    pairs = [(i, j) for i in range(len(X)) for j in range(i + 1, len(X))]
    e_p = sum(
        np.sum(((tools[i].inverse() * tools[j]).translation - (X[i].inverse() * X[j]).translation) ** 2)
        for i, j in pairs
    )
    e_o = sum(
        np.sum(pin.log3((X[i].inverse() * X[j]).rotation.T @ (tools[i].inverse() * tools[j]).rotation) ** 2)
        for i, j in pairs
    )
    assert relative_positioning_error(tools, grasp) == pytest.approx(np.sqrt(e_p), abs=1e-13)
    assert relative_orientation_error(tools, grasp) == pytest.approx(np.sqrt(e_o), abs=1e-12)
    O = [tool * x.inverse() for tool, x in zip(tools, X, strict=True)]
    distance, angle = chain_error(tools, grasp)
    assert distance == pytest.approx(max(np.linalg.norm(O[i].translation - O[j].translation) for i, j in pairs))
    assert angle == pytest.approx(
        max(np.linalg.norm(pin.log3(O[i].rotation.T @ O[j].rotation)) for i, j in pairs), abs=1e-12
    )
    pose = T * pin.exp6(pin.Motion(np.full(6, 0.1)))
    path = LinePath(pose, T, duration=2.0)
    errors = [object_error(tools, grasp, pose, k) for k in range(len(X))]
    for (d, a), o in zip(errors, O, strict=True):
        assert d == pytest.approx(np.linalg.norm(o.translation - pose.translation))
        assert a == pytest.approx(np.linalg.norm(pin.log3(o.rotation.T @ pose.rotation)), abs=1e-12)
    assert path_error(tools, grasp, path, 0.0) == pytest.approx(tuple(max(e[i] for e in errors) for i in range(2)))


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-8, 1e-3, 1.0, np.pi - 1e-8, np.pi])
def test_angles_keep_their_digits(angle: float) -> None:
    grasp = Grasp((np.eye(4), np.eye(4)))
    turned = pin.SE3(pin.exp3(np.array([0.0, 0.6 * angle, 0.8 * angle])), np.zeros(3))
    tools = [pin.SE3.Identity(), turned]
    assert relative_orientation_error(tools, grasp) == pytest.approx(angle, rel=1e-9, abs=1e-15)
    assert chain_error(tools, grasp)[1] == pytest.approx(angle, rel=1e-9, abs=1e-15)


def any_run(cell: RobotCell, rng: np.random.Generator, samples: int) -> Recording:
    """A recording of commanded, measured and wanted poses that have nothing to do with each other."""
    turns = rng.uniform(-np.pi, np.pi, (2, samples, cell.nv))
    q, told = (np.array([cell.configuration(x) for x in rows]) for rows in turns)
    steps = np.zeros(samples - 1)
    return Recording(
        time=np.arange(float(samples)), q=q, q_command=told, velocity=np.zeros((samples - 1, cell.nv)),
        clock=np.arange(float(samples)), rate=steps, status=steps,
        reference=np.array([pin.exp6(pin.Motion(rng.normal(size=6))).homogeneous for _ in range(samples)]),
        T_object_tool=np.array([pin.exp6(pin.Motion(rng.normal(size=6))).homogeneous for _ in range(len(cell))]),
        notes=(), metadata={},
    )  # fmt: skip


@pytest.mark.parametrize("as_commanded", [False, True])
def test_errors_of_a_run_are_those_of_its_samples(mixed_cell: RobotCell, rng: Any, as_commanded: bool) -> None:
    """Commanded ones between the arms, measured ones on the path; 4 to 7 joints, prismatic and continuous ones."""
    run = any_run(mixed_cell, rng, 12)
    run = replace(run, q=run.q_command) if as_commanded else run
    found = read_run(mixed_cell, run)
    commanded, measured = (tool_placements(mixed_cell, q) for q in (run.q_command, run.q))
    for i, (told, seen) in enumerate(zip(commanded, measured, strict=True)):
        between = measures(told, run.grasp)
        off = np.array([object_error(seen, run.grasp, pin.SE3(run.reference[i]), k) for k in range(len(told))])
        expected = [*between, *off.max(axis=0)]
        got = [1e-3 * found.eps_p_mm[i], np.deg2rad(found.eps_o_deg[i]), 1e-3 * found.chain_mm[i],
               np.deg2rad(found.chain_deg[i]), 1e-3 * found.object_mm[i], np.deg2rad(found.object_deg[i])]  # fmt: skip
        np.testing.assert_allclose(got, expected, rtol=0, atol=1e-12)
        np.testing.assert_allclose(
            found.sigma_min[i], CellState(mixed_cell, run.q_command[i]).sigma_min, rtol=0, atol=1e-12
        )


@pytest.mark.parametrize("away", [0.0, 1e-15, 1e-9, 1e-5, 1e-3, 0.02, 0.05])
def test_small_singular_values_keep_their_digits(
    paper: Scenario, baseline: Callable[..., Recording], away: float
) -> None:
    """The wrist of the RX-90L is singular where its fifth joint is zero."""
    run = baseline(40)
    q = run.q_command.copy()
    q[:, 4::6] = away
    expected = np.array([CellState(paper.cell, row).sigma_min for row in q])
    np.testing.assert_allclose(read_run(paper.cell, replace(run, q_command=q)).sigma_min, expected, rtol=0, atol=1e-14)


def test_samples_that_are_not_numbers_have_errors_that_are_not(mixed_cell: RobotCell, rng: Any) -> None:
    run = any_run(mixed_cell, rng, 6)
    for bad in (np.nan, np.inf):
        q, told = run.q.copy(), run.q_command.copy()
        q[1, 0] = told[4, -1] = bad
        found = read_run(mixed_cell, replace(run, q=q, q_command=told))
        for name, sample in [("object_mm", 1), ("object_deg", 1), *((n, 4) for n in (
            "eps_p_mm", "eps_o_deg", "chain_mm", "chain_deg", "sigma_min"
        ))]:  # fmt: skip
            values = getattr(found, name)
            assert np.isnan(values[sample]).any(), name
            assert np.isfinite(np.delete(values, sample, axis=0)).all(), name


def test_a_rotation_about_a_grasp_is_invisible_to_eps_p_only() -> None:
    """ε_p alone is insufficient: it does not see a tool that turns about its grasp point."""
    grasp = Grasp.triangle(0.6, 0.3)
    tools = list(grasp.tool_targets(pin.SE3(pin.exp3(np.array([0.3, -0.8, 0.5])), np.array([0.4, 0.9, -0.2]))))
    tools[2] = tools[2] * pin.SE3(pin.exp3(np.array([0.0, 0.0, 0.01])), np.zeros(3))
    assert relative_positioning_error(tools, grasp) < 1e-14
    assert relative_orientation_error(tools, grasp) == pytest.approx(0.01 * np.sqrt(2.0))
    assert chain_error(tools, grasp)[0] == pytest.approx(0.01 * 0.3, rel=1e-3)  # at A, 0.3 m from that axis


def test_excess_over_limits(mixed_cell: RobotCell, rng: Any) -> None:
    limits = mixed_cell.limits
    low = np.where(np.isfinite(limits.lower), limits.lower, -1.0)
    high = np.where(np.isfinite(limits.upper), limits.upper, 1.0)
    x = rng.uniform(low, high, (20, mixed_cell.nv))
    v = rng.uniform(-1, 1, (19, mixed_cell.nv)) * limits.velocity

    def excess(x: Array, v: Array) -> float:
        return limit_excess(mixed_cell, [mixed_cell.configuration(row) for row in x], v)

    assert excess(x, v) == 0.0
    assert limit_excess(mixed_cell, [], []) == 0.0
    for j in (0, 3, 15):
        over = x.copy()
        over[7, j] = high[j] + 0.125
        assert excess(over, v) == pytest.approx(0.125)
        under = x.copy()
        under[0, j] = low[j] - 0.25
        assert excess(under, v) == pytest.approx(0.25)
        fast = v.copy()
        fast[18, j] = -limits.velocity[j] - 0.5
        assert excess(x, fast) == pytest.approx(0.5)
    turned = x.copy()
    turned[3, -1] = 40.0  # a continuous joint has no position limit
    assert excess(turned, v) == 0.0


def test_nan_never_measures_as_perfect(paper: Scenario) -> None:
    tools = list(paper.grasp.tool_targets(pin.SE3.Identity()))
    for k in range(3):
        broken = [*tools[:k], NAN_POSE, *tools[k + 1 :]]
        assert np.isnan(relative_positioning_error(broken, paper.grasp))
        assert np.isnan(chain_error(broken, paper.grasp)[0])
        assert np.isnan(object_error(broken, paper.grasp, pin.SE3.Identity(), k)[0])
        assert np.isnan(path_error(broken, paper.grasp, paper.path, 0.0)[0])
    q, v = np.tile(paper.q_start, (3, 1)), np.zeros((2, 18))
    for bad in (np.nan, np.inf, -np.inf):
        for row, column in ((0, 0), (1, 17)):
            broken_q, broken_v = q.copy(), v.copy()
            broken_q[row, column] = broken_v[row, column] = bad
            assert not limit_excess(paper.cell, broken_q, v) <= 1e9
            assert not limit_excess(paper.cell, q, broken_v) <= 1e9


@pytest.mark.parametrize("bad", [np.zeros(18), np.zeros((2, 17)), np.zeros((1, 2, 18)), "run", [[0.0] * 18, [0.0]], 5])
def test_bad_tables(paper: Scenario, bad: Any) -> None:
    with pytest.raises(InvalidInputError, match="metrics: configurations"):
        tool_placements(paper.cell, bad)
    with pytest.raises(InvalidInputError, match="metrics: configurations"):
        limit_excess(paper.cell, bad, np.zeros((2, 18)))
    with pytest.raises(InvalidInputError, match="metrics: velocities"):
        limit_excess(paper.cell, [paper.q_start], bad)


def test_tools_of_another_cell(paper: Scenario) -> None:
    two = [pin.SE3.Identity()] * 2
    for measure in (relative_positioning_error, relative_orientation_error, chain_error):
        with pytest.raises(InvalidInputError, match="2 tools and a grasp of 3 arms"):
            measure(two, paper.grasp)
    with pytest.raises(InvalidInputError, match="2 tools"):
        object_error(two, paper.grasp, pin.SE3.Identity())
    with pytest.raises(InvalidInputError, match="2 tools"):
        path_error(two, paper.grasp, paper.path, 0.0)


@pytest.mark.parametrize("largest", [1, 60, 200_000])
def test_gaps_of_many_samples_are_those_of_each_in_any_parts(
    mixed_cell: RobotCell, rng: Any, monkeypatch: pytest.MonkeyPatch, largest: int
) -> None:
    """First those between two arms, then those of each arm and the path; with grasps that have given way."""
    run = any_run(mixed_cell, rng, 7)
    shift = 0.1 * rng.normal(size=(7, len(mixed_cell), 6))
    monkeypatch.setattr(metrics, "_LARGEST_TABLE", largest)
    distance, angle = metrics.object_gaps(mixed_cell, run.grasp, run.q, run.reference, shift)
    tools = tool_placements(mixed_cell, run.q)
    n = len(mixed_cell)
    for t in range(7):
        X = run.grasp.T_object_tool
        poses = [T * X[k].inverse() * pin.exp6(-shift[t, k]) for k, T in enumerate(tools[t])]
        pairs = [(poses[i], poses[j]) for i in range(n) for j in range(i + 1, n)]
        pairs += [(pose, pin.SE3(run.reference[t])) for pose in poses]
        apart = [a.actInv(b) for a, b in pairs]
        np.testing.assert_allclose(distance[t], [np.linalg.norm(T.translation) for T in apart], atol=1e-12)
        np.testing.assert_allclose(angle[t], [np.linalg.norm(pin.log3(T.rotation)) for T in apart], atol=1e-7)
