"""The ready tasks start and lead as their docstrings say, according to the arms' kinematics."""

from __future__ import annotations

import inspect
import itertools
from collections.abc import Callable, Iterator
from importlib import metadata
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from marks import slow_but_first

import coopqp.scenarios
from coopqp import InvalidInputError
from coopqp.errors import MissingExtraError, UnknownNameError
from coopqp.model import CellState
from coopqp.model.chain import Chain
from coopqp.model.inverse_kinematics import newton
from coopqp.scenarios import (
    LOADED,
    PROGRAMS,
    SCENARIOS,
    SHARED_JOINTS,
    Scenario,
    at_limit,
    at_singularity,
    dual_arm7,
    fast_lift,
    mixed_cell,
    panda_bar,
    ring,
    scenario,
    ur5_table,
    wide_grasp,
)
from coopqp.scenarios.arms import robot_data_path
from coopqp.simulation import chain_error, tool_placements

#: Scenarios with a path that the arms can follow to its end at full rate.
HARD = ("fast_lift", "at_limit", "at_singularity", "random_posts", "elbows", "forearms")
#: Those of LOADED move the arms as the paper's lift does; programs move the tools, too.
EASY = [name for name in SCENARIOS if name not in (*HARD, *LOADED, *PROGRAMS, *SHARED_JOINTS)]


def along(task: Scenario, samples: int = 40, *, beyond_limits: bool = True) -> Iterator[tuple[float, CellState]]:
    """Clock and state along the path by closed-chain inverse kinematics, until an arm cannot follow."""
    q, chain = task.q_start, Chain(task.cell, task.grasp)
    for clock in np.linspace(0.0, task.path.duration, samples + 1):
        q_next, errors = newton(chain, task.path.pose(clock), q, tolerance=1e-10, max_iter=20)
        if not np.abs(errors).max() < 1e-9 or np.abs(pin.difference(task.cell.model, q, q_next)).max() > 0.5:
            return  # out of reach, or another branch
        q = q_next
        state = CellState(task.cell, q)
        yield float(clock), state
        if not beyond_limits and state.limit_margins.min() < 0.0:
            return


@pytest.fixture(scope="module")
def built() -> dict[str, Scenario]:
    return {name: make() for name, make in SCENARIOS.items()}


def test_the_registry_has_every_function_of_the_package(built: dict[str, Scenario]) -> None:
    functions = {n for n, f in vars(coopqp.scenarios).items() if inspect.isfunction(f)} - {"scenario"}
    functions = {name for name in functions if not name.startswith("robot_")}
    assert set(SCENARIOS) == functions
    assert all(task.name == name for name, task in built.items())
    assert scenario("ring").cell.nv == 48
    with pytest.raises(UnknownNameError, match="Did you mean 'paper_lift'"):
        scenario("paper_left")


@pytest.mark.parametrize("name", SCENARIOS)
def test_the_arms_hold_the_object_at_the_start(built: dict[str, Scenario], name: str) -> None:
    task = built[name]
    (tools,) = tool_placements(task.cell, [task.q_start])
    for T, X in zip(tools, task.grasp.T_object_tool, strict=True):
        assert np.abs(pin.log6(task.path.pose(0.0).actInv(T * X.inverse())).vector).max() < 1e-9
    state = CellState(task.cell, task.q_start)
    prismatic = np.array(["P" in joint.shortname()[10:11] for joint in list(task.cell.model.joints)[1:]])
    assert state.limit_margins[prismatic].min(initial=np.inf) > 0.05
    assert state.limit_margins[~prismatic].min() > (0.24 if name in ("at_limit", *SHARED_JOINTS) else 0.5)
    assert state.sigma_min.min() > 0.12


#: Two arms of one body, with a small object between them.
TORSOS = ("elbows", "forearms")


@pytest.mark.parametrize("name", [name for name in SCENARIOS if name not in (*PROGRAMS, *SHARED_JOINTS)])
def test_it_looks_like_a_cell(built: dict[str, Scenario], name: str) -> None:
    """Bases upright and apart, grasps at the object's box or close to it, plausible size, mass and step."""
    task = built[name]
    bases = [arm.T_world_base for arm in task.cell.arms]
    for k, T in enumerate(bases):
        assert np.abs(T.rotation[:, 2] - [0.0, 0.0, 1.0]).max() < 1e-12
        assert all(
            np.linalg.norm((T.translation - other.translation)[:2]) > (0.2 if name in TORSOS else 0.6)
            for other in bases[:k]
        )
    half = 0.5 * np.array(task.object_size)
    for X in task.grasp.T_object_tool:
        outside = np.abs(task.T_object_body.actInv(X).translation) - half
        assert outside.max() < 0.02
    assert (0.15 if name in TORSOS else 0.3) < max(task.object_size) < 12.0
    assert 0.3 < task.object_mass / len(task.cell) < 20.0
    assert 1.0 < task.path.duration / task.dt < 5000
    speed = max(np.linalg.norm(task.path.twist(t)[:3]) for t in np.linspace(0.0, task.path.duration, 50))
    assert 0.0 < speed < 0.7


@pytest.mark.parametrize("name", EASY)
def test_the_arms_can_follow_the_whole_path(built: dict[str, Scenario], name: str) -> None:
    task = built[name]
    states = list(along(task, 60))
    assert states[-1][0] == task.path.duration
    assert min(s.limit_margins.min() for _, s in states) > 0.05
    assert min(s.sigma_min.min() for _, s in states) > (0.03 if name == "wide_grasp" else 0.1)
    used = 0.0
    for (t0, a), (t1, b) in itertools.pairwise(states):
        v = pin.difference(task.cell.model, a.q, b.q) / (t1 - t0)
        used = max(used, float(np.abs(v / task.cell.limits.velocity).max()))
    assert used < (0.8 if name == "wide_grasp" else 0.5)


def test_the_fast_lift_is_too_fast() -> None:
    task = fast_lift()
    states = list(along(task, 50))
    v = [
        np.abs(pin.difference(task.cell.model, a.q, b.q) / (t1 - t0)) for (t0, a), (t1, b) in itertools.pairwise(states)
    ]
    assert np.max(v) > 3.0
    assert np.all(task.cell.limits.velocity == 1.0)
    assert np.linalg.norm(task.path.twist(0.1)[:3]) == pytest.approx(0.6)
    assert np.all(fast_lift(joint_speed=2.0).cell.limits.velocity == 2.0)


@pytest.mark.parametrize("direction", [(0, 0, 1), (0, 0, -1), (1, 0, 0), (0, 2, 0), (-1, -1, 1)])
def test_the_path_at_a_limit_crosses_it(direction: tuple[int, int, int]) -> None:
    task = at_limit(direction=direction, margin=0.2)
    clock, last = list(along(task, 200, beyond_limits=False))[-1]
    assert last.limit_margins.min() < 0.0
    assert 0.2 < clock < task.path.duration
    assert last.sigma_min.min() > 0.05
    assert np.linalg.norm(task.path.twist(0.1)[:3]) == pytest.approx(0.25)


def test_the_fence_of_at_limit(rng: np.random.Generator) -> None:
    margin = rng.uniform(0.1, 0.5, size=18)
    task = at_limit(margin=margin, acceleration=3.0, rotation=(0.1, 0.2, 0.3))
    assert np.abs(task.q_start - task.cell.limits.lower - margin).max() < 1e-12
    assert np.abs(task.cell.limits.upper - task.q_start - margin).max() < 1e-12
    assert np.all(task.cell.limits.acceleration == 3.0)
    with pytest.raises(InvalidInputError, match="direction is zero"):
        at_limit(direction=(0, 0, 0))


@pytest.mark.parametrize("arm", slow_but_first([0, 1, 2]))
@pytest.mark.parametrize("kind", ["wrist", "elbow", "reach"])
def test_the_path_leads_the_named_arm_into_its_singularity(kind: Any, arm: int) -> None:
    task = at_singularity(kind, arm)
    smallest, others, end = np.inf, np.inf, 0.0
    joint = 6 * arm + (4 if kind == "wrist" else 2)
    straight = np.inf
    for end, state in along(task, 400):  # noqa: B007
        smallest = min(smallest, state.sigma_min[arm])
        others = min(others, np.delete(state.sigma_min, arm).min())
        straight = min(straight, abs(state.q[joint]))
        assert state.limit_margins.min() > 0.3
    assert smallest < (0.03 if kind != "wrist" else 0.003)
    assert straight < 0.1
    assert others > 0.05
    assert (end == task.path.duration) == (kind == "wrist")  # a straight wrist is no end of the workspace


@pytest.mark.slow
@pytest.mark.parametrize("miss", [0.1, 0.01, 0.001])
def test_a_wrist_that_is_missed_by_an_angle(miss: float) -> None:
    task = at_singularity("wrist", 1, miss=miss)
    nearest = min(abs(state.q[10]) for _, state in along(task, 2000))
    assert 0.5 * miss < nearest < 1.5 * miss


def test_bad_names_of_singularities() -> None:
    with pytest.raises(UnknownNameError, match="no singularity named 'shoulder'"):
        at_singularity("shoulder")  # type: ignore[arg-type]
    with pytest.raises(UnknownNameError, match="no arm named '3'"):
        at_singularity("wrist", 3)
    with pytest.raises(InvalidInputError, match="at_singularity: miss"):
        at_singularity("wrist", miss=-1.0)


@pytest.mark.parametrize("robot", ["rx90l", "arm7"])
@pytest.mark.parametrize("arms", [2, 3, 5, 12])
def test_rings_of_any_size(arms: int, robot: Any) -> None:
    task = ring(arms=arms, robot=robot)
    assert len(task.cell) == arms
    points = np.array([X.translation for X in task.grasp.T_object_tool])
    gaps = np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=1)
    assert np.ptp(gaps) < 1e-12
    assert gaps[0] > 0.44
    start, goal = task.path.pose(0.0), task.path.pose(task.path.duration)
    far = [np.linalg.norm(goal.act(p) - start.act(p)) for p in points]
    assert min(far) > 0.05
    assert max(far) < 0.32


@pytest.mark.parametrize("arms", [1, 65, 2.0, True, "8"])
def test_numbers_of_arms_that_make_no_ring(arms: Any) -> None:
    with pytest.raises(InvalidInputError, match="ring: arms is"):
        ring(arms=arms)


def test_only_some_robots_make_a_ring() -> None:
    with pytest.raises(UnknownNameError, match="no robot named 'arm5'"):
        ring(robot="arm5")  # type: ignore[arg-type]


def test_the_mixed_cell_has_continuous_and_prismatic_joints() -> None:
    task = mixed_cell()
    sizes = [s.stop - s.start for s in task.cell.v_slices]
    assert sorted(sizes) == [6, 6, 7, 7]
    assert task.cell.nq == task.cell.nv + 1
    assert any("P" in j.shortname()[10:11] for j in task.cell.model.joints)


def test_paths_can_be_changed() -> None:
    task = dual_arm7(translation=(0.0, 0.0, 0.1), rotation=(0.0, 0.0, 0.0), duration=2.0, time_law="linear")
    assert np.allclose(task.path.twist(1.0), [0, 0, 0.05, 0, 0, 0])
    assert wide_grasp(duration=2.0).dt == pytest.approx(0.005)


# -- robots from another package -------------------------------------------------------------------------------------


def test_the_pandas_hold_with_locked_fingers() -> None:
    task = panda_bar()
    assert [s.stop - s.start for s in task.cell.v_slices] == [7, 7]
    assert not any("finger" in name for name in task.cell.joint_names)
    assert np.isfinite(task.cell.limits.acceleration).all()


@pytest.mark.slow
@pytest.mark.parametrize(("make", "shapes"), [(panda_bar, 2), (ur5_table, 4)])
def test_meshes_are_there_unless_they_are_not_wanted(make: Callable[..., Scenario], shapes: int) -> None:
    assert make(geometry=False).cell.visual_model().ngeoms == 0
    assert make(geometry=True).cell.visual_model().ngeoms >= 7 * shapes


@pytest.mark.parametrize("make", [panda_bar, ur5_table])
def test_without_the_package_the_extra_is_named(make: Callable[..., Scenario], monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> metadata.Distribution:
        raise metadata.PackageNotFoundError(name)

    monkeypatch.setattr(metadata, "distribution", missing)
    with pytest.raises(MissingExtraError, match=r"pip install 'coopqp\[robots\]'"):
        make()


def test_a_file_that_the_package_lacks() -> None:
    assert robot_data_path("urdf/panda.urdf").is_file()
    with pytest.raises(MissingExtraError, match=r"with a file urdf/panda_of_tomorrow\.urdf"):
        robot_data_path("urdf/panda_of_tomorrow.urdf")


def test_chains_of_scenarios_are_closed_all_along(built: dict[str, Scenario]) -> None:
    """The inverse kinematics of :func:`along` and the metrics agree on what a closed chain is."""
    for name in EASY:
        task = built[name]
        _, state = list(along(task, 10))[-1]
        (tools,) = tool_placements(task.cell, [state.q])
        assert max(chain_error(tools, task.grasp)) < 1e-7
