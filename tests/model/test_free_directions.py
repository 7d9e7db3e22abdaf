"""Grasps that give way: hinges, sliders, balls, pins and points; loose objects, and passive joints by closure."""

from __future__ import annotations

import itertools

import numpy as np
import pinocchio as pin
import pytest
from torsos import lift_cell

from coopqp import Grasp, InvalidInputError, LinePath, QPController, simulate
from coopqp.errors import LooseObjectError, UnknownNameError
from coopqp.model import CellState, Free, freed_cell, refuse_loose
from coopqp.model.free_directions import LOOSE, looseness
from coopqp.scenarios import bar_with_pins, five_joint_pair, five_joint_pins
from coopqp.simulation import check_run, tool_placements
from coopqp.spatial import Array, adjoint

KINDS = {
    "hinge": ("rz",),
    "slider": ("z",),
    "pin": ("z", "rz"),
    "ball": ("rx", "ry", "rz"),
    "point": ("x", "y", "rx", "ry", "rz"),
}
#: Tools along the x axis of the object. "common": all z axes lie on it; "turned": each points elsewhere.
COMMON = [pin.SE3(pin.utils.rotate("y", 0.5 * np.pi), np.array([x, 0.0, 0.0])) for x in (-0.3, 0.3, 0.0)]
TURNED = [
    pin.SE3(pin.exp3(np.array(turn)), np.array(at))
    for turn, at in (
        ((0.3, -0.2, 0.9), (-0.3, 0.0, 0.1)), ((-1.1, 0.4, 0.2), (0.3, 0.1, 0.0)), ((0.2, 1.3, -0.5), (0.0, 0.3, -0.1))
    )
]  # fmt: skip


def held(places: list[pin.SE3], kinds: tuple[str, ...]) -> tuple[list[str], Grasp]:
    names = [f"arm {k}" for k in range(len(kinds))]
    grasp = Grasp(tuple(places[: len(kinds)]))
    for name, kind in zip(names, kinds, strict=True):
        for axis in KINDS[kind]:
            grasp = grasp.freed(name, axis, range=(-1.0, 1.0))
    return names, grasp


def freedom_left(places: list[pin.SE3], kinds: tuple[str, ...]) -> int:
    """Dimension of the object motions that all tools at rest allow: of the common part of the ranges, one by one."""
    order = ("x", "y", "z", "rx", "ry", "rz")
    common: Array | None = None
    for X, kind in zip(places, kinds, strict=False):
        F = adjoint(X)[:, [order.index(axis) for axis in KINDS[kind]]]
        if common is None:
            common = F
            continue
        if not common.shape[1]:
            return 0
        both = np.hstack([common, -F])  # common a = F b
        _, s, Vt = np.linalg.svd(both)
        null = Vt[int((s > 1e-9).sum()) :].T
        common = common @ null[: common.shape[1]]
        common = common[:, : np.linalg.matrix_rank(common, tol=1e-9)] if common.size else common[:, :0]
    return 0 if common is None else int(np.linalg.matrix_rank(common, tol=1e-9)) if common.size else 0


@pytest.mark.parametrize("places", [COMMON, TURNED], ids=["common axes", "other axes"])
@pytest.mark.parametrize("arms", [2, 3])
def test_every_loose_grasp_is_refused_and_no_other(places: list[pin.SE3], arms: int) -> None:
    for kinds in itertools.product(KINDS, repeat=arms):
        names, grasp = held(places, kinds)
        value, twist = looseness(names, grasp)
        loose = freedom_left(places, kinds) > 0
        assert (value < LOOSE) == loose, (kinds, value)
        if not loose:
            assert value > 0.02, (kinds, value)
            refuse_loose(names, grasp)
            continue
        with pytest.raises(LooseObjectError, match="loose"):
            refuse_loose(names, grasp)
        for k, X in enumerate(places[:arms]):  # the twist is in the range of each
            F = adjoint(X)[:, [("x", "y", "z", "rx", "ry", "rz").index(axis) for axis in KINDS[kinds[k]]]]
            left = twist - F @ np.linalg.lstsq(F, twist, rcond=None)[0]
            assert np.abs(left).max() < 1e-9 * max(1.0, np.abs(twist).max())


def test_an_arm_that_lets_go_may_leave_the_object_loose() -> None:
    names, grasp = held(TURNED, ("ball", "ball", "hinge"))
    refuse_loose(names, grasp)
    with pytest.raises(LooseObjectError, match=r"turn about"):
        refuse_loose(names, grasp, (True, True, False))


@pytest.mark.parametrize("kinds", [("", "hinge", ""), ("hinge", "", "ball"), ("", "", ""), ("pin", "ball", "point")])
@pytest.mark.parametrize("holding", [None, (True, True, False), (False, True, True)])
def test_looseness_is_the_least_singular_value_of_what_the_grips_leave(
    kinds: tuple[str, ...], holding: tuple[bool, ...] | None
) -> None:
    """Against its definition, with twists at the middle of the grips in units of their distance; "" is rigid."""
    names = ["a", "b", "c"]
    grasp = Grasp(tuple(TURNED))
    for name, kind in zip(names, kinds, strict=True):
        for axis in KINDS.get(kind, ()):
            grasp = grasp.freed(name, axis, range=(-1.0, 1.0))
    kept = [k for k in range(3) if holding is None or holding[k]]
    middle = np.mean([TURNED[k].translation for k in kept], axis=0)
    unit = max(float(np.linalg.norm(TURNED[k].translation - middle)) for k in kept)
    order = ("x", "y", "z", "rx", "ry", "rz")
    stack = []
    for k in kept:
        seen = adjoint(pin.SE3(TURNED[k].rotation, (TURNED[k].translation - middle) / unit))
        F = seen[:, [order.index(axis) for axis in KINDS.get(kinds[k], ())]]
        stack.append(np.eye(6) - F @ np.linalg.pinv(F))
    expected = np.linalg.svd(np.vstack(stack), compute_uv=False)[-1]
    assert looseness(names, grasp, holding)[0] == pytest.approx(expected, abs=1e-12)


def test_the_message_of_a_loose_object_says_how_it_moves() -> None:
    """A bar between two hinges about its own axis turns; one between two sliders along x slides."""
    ends = [pin.SE3(np.eye(3), np.array([x, 0.0, 0.2])) for x in (-0.3, 0.3)]
    for axis, says in (("rx", r"turn about \(-?1, -?0, -?0\)"), ("x", r"slide along \(-?1, -?0, -?0\)")):
        grasp = Grasp(tuple(ends))
        for name in ("a", "b"):
            grasp = grasp.freed(name, axis, range=(-1.0, 1.0))
        with pytest.raises(LooseObjectError, match="it can " + says.replace("-?0", r"-?[0-9.e-]+")):
            refuse_loose(("a", "b"), grasp)
        one = Grasp(tuple(ends)).freed("a", axis, range=(-1.0, 1.0))
        refuse_loose(("a", "b"), one)
        with pytest.raises(LooseObjectError):
            refuse_loose(("a", "b"), one, (True, False))


def test_passive_joints_are_joints_of_the_tool_with_their_own_limits() -> None:
    """At zero the tools are where they were; a slide and two turns move the last frame along and about its axes."""
    task = five_joint_pair()
    grasp = task.grasp
    for axis, ends in (("y", (-0.1, 0.2)), ("rz", (-1.0, 0.5)), ("rx", (-0.3, 9.0))):
        grasp = grasp.freed("right", axis, range=ends)
    freed = freed_cell(task.cell, grasp)
    k = task.cell.index("right")
    assert [freed.cell.joint_names[j] for j in freed.passive] == [f"right/free_{x}" for x in ("y", "rz", "rx")]
    assert freed.cell.arms[1 - k] is task.cell.arms[1 - k]
    limits, plain = freed.cell.limits, task.cell.limits
    np.testing.assert_array_equal(limits.lower[freed.passive], [-0.1, -1.0, -0.3])
    np.testing.assert_array_equal(limits.upper[freed.passive], [0.2, 0.5, 9.0])
    np.testing.assert_array_equal(limits.velocity[freed.passive], [5.0, 20.0, 20.0])
    np.testing.assert_array_equal(limits.acceleration[freed.passive], np.inf)
    for field in ("lower", "upper", "velocity", "acceleration"):
        np.testing.assert_array_equal(getattr(limits, field)[freed.actuated], getattr(plain, field))
    x = np.zeros(freed.cell.nv)
    x[freed.actuated] = task.cell.positions(task.q_start)
    before = CellState(task.cell, task.q_start).T_world_tool
    for T, U in zip(CellState(freed.cell, x).T_world_tool, before, strict=True):
        np.testing.assert_allclose(T.homogeneous, U.homogeneous, rtol=0, atol=1e-13)
    x[freed.passive] = 0.15, 0.4, -0.2
    moved = before[k] * pin.SE3(pin.utils.rotate("z", 0.4) @ pin.utils.rotate("x", -0.2), np.array([0.0, 0.15, 0.0]))
    tools = CellState(freed.cell, x).T_world_tool
    np.testing.assert_allclose(tools[k].homogeneous, moved.homogeneous, rtol=0, atol=1e-13)


def test_far_passive_joints_close_the_chain_too() -> None:
    """From an estimate that is away by more than a step may be."""
    task = five_joint_pair()
    grasp = task.grasp.freed("right", "rx", range=(-2.0, 2.0)).freed("left", "rx", range=(-2.0, 2.0))
    freed = freed_cell(task.cell, grasp)
    start = freed.configuration(task.cell.positions(task.q_start))
    np.testing.assert_allclose(freed.cell.positions(start)[freed.passive], 0.0, atol=1e-9)
    far = freed.cell.positions(start)
    far[freed.passive] = 0.9, -1.1
    again = freed.configuration(far[freed.actuated], near=freed.cell.configuration(far))
    np.testing.assert_allclose(again, start, rtol=0, atol=1e-9)
    assert np.abs(freed.grasp.relative_errors(CellState(freed.cell, again))).max() < 1e-9
    for bad in (np.zeros(9), np.full(10, np.nan), np.zeros((1, 10))):
        with pytest.raises(InvalidInputError, match=r"FreedCell\.configuration: .*Give 10 positions"):
            freed.configuration(bad)


def test_two_five_joint_arms_with_pins_make_every_motion() -> None:
    task = five_joint_pins()
    controller = QPController(task.cell, task.grasp, task.path, dt=0.005)
    run = simulate(controller, q_start=task.q_start)
    assert run.finished
    assert check_run(run, task.cell).ok
    last = tool_placements(task.cell, run.q_command[-1:])[0]
    for T, X in zip(last, task.grasp.T_object_tool, strict=True):
        away = pin.log6(task.path.pose(task.path.duration).actInv(T * X.inverse())).vector
        assert np.abs(away).max() < 1e-7


def test_pins_let_a_bar_turn_further_than_rigid_grips() -> None:
    task = bar_with_pins()
    wide = LinePath.displaced(task.path.pose(0.0), rotation=(0.0, 0.0, 3.0), duration=6.0, time_law="linear")
    run = simulate(QPController(task.cell, task.grasp, wide, dt=0.01), q_start=task.q_start)
    assert np.rad2deg(3.0 * run.clock[-1] / 6.0) > 96.0


def test_passive_joints_follow_from_the_actuated_ones(rng: np.random.Generator) -> None:
    plain = five_joint_pair()
    grasp = plain.grasp
    for name in plain.cell.arm_names:
        grasp = grasp.freed(name, "rx", range=(-1.0, 1.0))
    freed = freed_cell(plain.cell, grasp)
    assert [freed.cell.joint_names[j] for j in freed.passive] == ["left/free_rx", "right/free_rx"]
    assert len(freed.actuated) == plain.cell.nv
    path = LinePath.displaced(
        plain.path.pose(0.0), translation=(0.02, 0.03, 0.05), rotation=(0.1, 0.05, 0.2), duration=1.0
    )
    start = freed.configuration(plain.cell.positions(plain.q_start))
    run = simulate(QPController(freed.cell, freed.grasp, path, dt=0.01), q_start=start)
    for q in run.q_command[rng.integers(len(run.q_command), size=5)]:
        x = freed.cell.positions(q)
        found = freed.cell.positions(freed.configuration(x[freed.actuated], near=start))
        assert np.abs(found - x).max() < 1e-8


def test_bad_free_directions_are_refused_by_name() -> None:
    task = five_joint_pair()
    hinged = task.grasp.freed("left", "rx", range=(-1.0, 1.0))
    assert hinged.free == (Free("left", "rx", -1.0, 1.0),)
    with pytest.raises(InvalidInputError, match=r"arm 'left' gives way in rx.*freed_cell"):
        QPController(task.cell, hinged, task.path, dt=0.01)
    with pytest.raises(UnknownNameError, match="r_x"):
        task.grasp.freed("left", "r_x", range=(-1.0, 1.0))
    with pytest.raises(InvalidInputError, match="0 inside"):
        task.grasp.freed("left", "rx", range=(0.5, 1.0))
    with pytest.raises(InvalidInputError, match="free already"):
        hinged.freed("left", "rx", range=(-1.0, 1.0))
    with pytest.raises(UnknownNameError, match="middle"):
        freed_cell(task.cell, task.grasp.freed("middle", "rx", range=(-1.0, 1.0)))
    for places in (task.grasp.T_object_tool[:1], task.grasp.T_object_tool * 2):
        with pytest.raises(InvalidInputError, match=f"{len(places)} placements for 2 arms"):
            freed_cell(task.cell, Grasp(places, hinged.free))
    cell, grasp = lift_cell()
    with pytest.raises(InvalidInputError, match=r"^freed_cell: arms 'left' and 'right' share 'lift'.*Lock them"):
        freed_cell(cell, grasp.freed("left", "rx", range=(-1.0, 1.0)))
    loose = hinged.freed("left", "rz", range=(-1.0, 1.0)).freed("right", "rz", range=(-1.0, 1.0))
    with pytest.raises(LooseObjectError, match="turn about"):
        freed_cell(task.cell, loose)
    with pytest.raises(InvalidInputError, match="10 positions"):
        freed_cell(task.cell, hinged.freed("right", "rx", range=(-1.0, 1.0))).configuration([0.0])
