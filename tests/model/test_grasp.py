"""The grasp: the object pose of every arm, the paper's triangle, and both methods of Figure 2."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, strategies as st
from numpy.typing import NDArray

from coopqp import Grasp, InvalidInputError, RobotCell
from coopqp.model import CellState, plate_from_centroid, plate_from_points
from coopqp.model.grasp import THETA, held_at, triangle_frames
from coopqp.scenarios import Scenario
from coopqp.spatial import adjoint

Array = NDArray[np.float64]
RandomQ = Callable[[RobotCell, np.random.Generator], Array]

lengths = st.floats(0.01, 5.0)
vectors = st.tuples(*[st.floats(-3.0, 3.0)] * 3).map(np.array)
poses = st.builds(lambda w, p: pin.SE3(pin.exp3(w), p), vectors, vectors)


def close(a: Any, b: Any, tolerance: float = 1e-13) -> None:
    np.testing.assert_allclose(getattr(a, "homogeneous", a), getattr(b, "homogeneous", b), rtol=0, atol=tolerance)


# -- where the arms carry the object -----------------------------------------------------------------------------------


@given(st.lists(poses, min_size=1, max_size=5), poses)
def test_tools_at_their_targets_agree_on_the_object(X: list[pin.SE3], T: pin.SE3) -> None:
    grasp = Grasp(tuple(X))
    assert len(grasp) == len(X)
    for tool, x in zip(grasp.tool_targets(T), X, strict=True):
        close(tool * x.inverse(), T, 1e-12)
        close(T.actInv(tool), x, 1e-12)


def test_a_latched_grasp_has_no_error(mixed_cell: RobotCell, random_q: RandomQ, rng: Any) -> None:
    pin.seed(4)
    for _ in range(20):
        q, T = random_q(mixed_cell, rng), pin.SE3.Random()
        grasp = Grasp.from_configuration(mixed_cell, q, T)
        state = CellState(mixed_cell, q)
        for O in grasp.carried(state):
            close(O, T)
        errors = grasp.relative_errors(state)
        assert errors.shape == (15, 6)
        assert np.abs(errors).max() < 1e-13
        for target, tool in zip(grasp.tool_targets(T), state.T_world_tool, strict=True):
            close(target, tool)


def test_relative_errors_are_logs_of_pairs_in_order(mixed_cell: RobotCell, random_q: RandomQ, rng: Any) -> None:
    grasp = Grasp.from_configuration(mixed_cell, random_q(mixed_cell, rng), pin.SE3.Identity())
    state = CellState(mixed_cell, random_q(mixed_cell, rng))
    O = grasp.carried(state)
    pairs = [(i, j) for i in range(6) for j in range(i + 1, 6)]
    for (i, j), e in zip(pairs, grasp.relative_errors(state), strict=True):
        close(O[i] * pin.exp6(pin.Motion(e)), O[j], 1e-9)
    single = RobotCell(mixed_cell.arms[:1])
    alone = CellState(single, np.zeros(7))
    assert Grasp((np.eye(4),)).relative_errors(alone).shape == (0, 6)


def test_relative_errors_do_not_depend_on_the_world(make_cell: Callable[..., RobotCell], rng: Any) -> None:
    pin.seed(6)
    bases, G = [pin.SE3.Random() for _ in range(3)], pin.SE3.Random()
    grasp = Grasp(tuple(pin.SE3.Random() for _ in range(3)))
    q = rng.uniform(-1, 1, 18)
    one, other = (
        grasp.relative_errors(CellState(make_cell(["rx90l"] * 3, b), q)) for b in (bases, [G * T for T in bases])
    )
    close(one, other, 1e-12)


def test_master_and_nominal_grasp_say_where_the_object_is(paper: Scenario) -> None:
    latched = Grasp.from_configuration(paper.cell, paper.q_start, nominal=paper.grasp)
    for X, nominal in zip(latched.T_object_tool, paper.grasp.T_object_tool, strict=True):
        close(X, nominal, 1e-11)


@given(st.integers(0, 2), st.sampled_from(["near", "far"]), vectors)
def test_a_tool_beyond_the_tolerance_is_named(paper: Scenario, k: int, how: str, w: Array) -> None:
    offset = 0.004 if how == "near" else 0.006
    aim = w + np.array([10.0, 0.0, 0.0])
    direction = aim / np.linalg.norm(aim)
    nominal = list(paper.grasp.T_object_tool)
    nominal[k] = nominal[k] * pin.SE3(np.eye(3), offset * direction)
    start = paper.path.start
    if how == "near":
        Grasp.from_configuration(paper.cell, paper.q_start, start, nominal=Grasp(tuple(nominal)))
        return
    with pytest.raises(InvalidInputError, match=f"arm '{paper.cell.arm_names[k]}' grasps 6.00 mm"):
        Grasp.from_configuration(paper.cell, paper.q_start, start, nominal=Grasp(tuple(nominal)))
    Grasp.from_configuration(paper.cell, paper.q_start, start, nominal=Grasp(tuple(nominal)), tolerance_m=0.0061)


def test_a_turned_tool_is_named_too(paper: Scenario) -> None:
    nominal = list(paper.grasp.T_object_tool)
    nominal[2] = nominal[2] * pin.SE3(pin.exp3(np.array([0.0, np.deg2rad(1.5), 0.0])), np.zeros(3))
    with pytest.raises(InvalidInputError, match=r"arm 'slave_2' grasps 0\.00 mm and 1\.500°"):
        Grasp.from_configuration(paper.cell, paper.q_start, paper.path.start, nominal=Grasp(tuple(nominal)))


def test_any_tolerance_down_to_none_is_kept_to(paper: Scenario) -> None:
    q, T = paper.q_start, paper.path.pose(0.0)
    exact = Grasp.from_configuration(paper.cell, q, T)
    Grasp.from_configuration(paper.cell, q, T, nominal=exact, tolerance_m=1e-9, tolerance_rad=1e-9)
    moved = exact.moved_by([pin.SE3(np.eye(3), np.array([0.0, 0.0, z])) for z in (0.0, 0.0, 1e-3)])
    turned = exact.moved_by([pin.SE3(pin.exp3(np.array([0.0, 0.0, a])), np.zeros(3)) for a in (0.0, 1e-3, 0.0)])
    for nominal, metres, radians, says in (
        (moved, 0.5e-3, 1.0, r"arm 'slave_2' grasps 1\.00 mm and 0\.000° .*tolerance 0\.5 mm, 57\.2958°"),
        (turned, 10.0, 0.5e-3, r"arm 'slave_1' grasps \d+\.\d\d mm and 0\.057° .*tolerance 10000 mm, 0\.0286479°"),
        (moved, 0.0, 1.0, r"grasps .*tolerance 0 mm"),
        (turned, 10.0, 0.0, r"grasps .*tolerance 10000 mm, 0°"),
    ):
        with pytest.raises(InvalidInputError, match=says):
            Grasp.from_configuration(paper.cell, q, T, nominal=nominal, tolerance_m=metres, tolerance_rad=radians)


def test_a_state_of_another_cell_has_no_tools_of_the_grasp(paper: Scenario, mixed_cell: RobotCell) -> None:
    other = CellState(mixed_cell, mixed_cell.configuration(np.zeros(mixed_cell.nv)))
    with pytest.raises(ValueError, match="zip"):
        paper.grasp.carried(other)
    with pytest.raises(ValueError, match="zip"):
        Grasp(paper.grasp.T_object_tool * 3).carried(other)


def test_tools_that_move_on_the_object_are_a_new_grasp() -> None:
    grasp = Grasp.triangle(0.2, 0.3)
    pin.seed(1)
    motions = [pin.SE3.Random() for _ in range(3)]
    for X, M, moved in zip(grasp.T_object_tool, motions, grasp.moved_by(motions).T_object_tool, strict=True):
        close(moved, M * X)
    for wrong in (motions[:2], [*motions, pin.SE3.Identity()]):
        with pytest.raises(ValueError, match="zip"):
            grasp.moved_by(wrong)


# -- directions in which a grasp gives way -----------------------------------------------------------------------------


def test_free_directions_are_kept_in_order_and_the_grasp_as_it_was() -> None:
    grasp = Grasp.triangle(0.2, 0.3)
    one = grasp.freed("b", "rx", range=(-0.5, 1)).freed("a", "z", range=(-9.0, 7.0))
    two = one.freed("b", "x", range=(-0.1, 0.2))
    assert [(f.arm, f.axis, f.low, f.high) for f in two.free] == [
        ("b", "rx", -0.5, 1.0), ("a", "z", -9.0, 7.0), ("b", "x", -0.1, 0.2)
    ]  # fmt: skip
    assert (len(grasp.free), len(one.free)) == (0, 2)
    assert [free.turns for free in two.free] == [True, False, False]
    assert two.T_object_tool == grasp.T_object_tool
    for X in grasp.T_object_tool:  # a slide has the direction of the axis, a turn also its moment about the origin
        R, p = X.rotation, X.translation
        close(two.free[1].column(X), np.concatenate([R[:, 2], np.zeros(3)]))
        close(two.free[0].column(X), np.concatenate([np.cross(p, R[:, 0]), R[:, 0]]))


@pytest.mark.parametrize("ends", [(0.0, 1.0), (-1.0, 0.0), (0.5, 1.0), (1.0, -1.0), (0.0, 0.0)])
def test_the_range_of_a_free_direction_has_zero_inside(ends: tuple[float, float]) -> None:
    said = f"Grasp.freed: b, rx: the range is {ends[0]:g} to {ends[1]:g}. Give one with 0 inside."
    with pytest.raises(InvalidInputError, match=f"^{re.escape(said)}$"):
        Grasp.triangle(0.2, 0.3).freed("b", "rx", range=ends)
    for bad in ("wide", None, np.nan, np.inf):
        with pytest.raises(InvalidInputError, match=r"Grasp\.freed: b, rx"):
            Grasp.triangle(0.2, 0.3).freed("b", "rx", range=(-1.0, bad))  # type: ignore[arg-type]


def test_a_grasp_that_gives_way_is_no_grasp_of_a_plain_cell(paper: Scenario) -> None:
    """The message names the direction that was freed first."""
    grasp = paper.grasp.freed("slave_1", "rz", range=(-1.0, 1.0)).freed("master", "x", range=(-1.0, 1.0))
    with pytest.raises(InvalidInputError, match=r"the grasp of arm 'slave_1' gives way in rz\. .*freed_cell"):
        grasp.check_arms(paper.cell)
    with pytest.raises(InvalidInputError, match="cell"):
        paper.grasp.check_arms(paper)  # type: ignore[arg-type]


# -- increments ------------------------------------------------------------------------------------------------------


def test_the_object_is_where_the_arms_hold_it_by_their_shares(paper: Scenario, rng: Any) -> None:
    """With all of the share an arm decides alone; with equal ones what they differ by cancels, to the second order."""
    away = 1e-4 * rng.normal(size=paper.cell.nv)
    state = CellState(paper.cell, paper.cell.moved(paper.q_start, away))
    carried = paper.grasp.carried(state)
    for k, alone in enumerate(np.eye(3)):
        assert held_at(paper.grasp, alone[:, None], state).isApprox(carried[k], 1e-12)
    middle = held_at(paper.grasp, np.full((3, 1), 1.0 / 3.0), state)
    errors = np.array([pin.log6(middle.actInv(other)).vector for other in carried])
    assert np.abs(errors).max() > 1e-5
    assert np.abs(errors.sum(axis=0)).max() < 1e-7


@given(st.lists(poses, min_size=1, max_size=4), st.tuples(*[st.floats(-2, 2)] * 6))
def test_increments_are_adjoints(X: list[pin.SE3], delta: list[float]) -> None:
    got = Grasp(tuple(X)).arm_increments(delta)
    assert got.shape == (len(X), 6)
    for x, d in zip(X, got, strict=True):
        close(adjoint(x) @ d, np.array(delta), 1e-11)


@given(poses, st.tuples(*[st.floats(-0.5, 0.5)] * 6))
def test_increments_keep_the_grasp(T: pin.SE3, delta: list[float]) -> None:
    """After finite motions Δ^k of the tools, all arms carry the object at the pose moved by Δ."""
    grasp = Grasp.triangle(0.6, 0.3)
    moved = T * pin.exp6(pin.Motion(np.array(delta)))
    for tool, target, d in zip(
        grasp.tool_targets(T), grasp.tool_targets(moved), grasp.arm_increments(delta), strict=True
    ):
        close(tool * pin.exp6(pin.Motion(d)), target, 1e-12)


# -- the triangle and Figure 2 ---------------------------------------------------------------------------------------


@given(lengths, lengths)
def test_the_triangle(alpha: float, beta: float) -> None:
    points = [(X.homogeneous @ THETA)[:3, 3] for X in Grasp.triangle(alpha, beta).T_object_tool]
    A, B, C = points
    assert np.linalg.norm(B - A) == pytest.approx(np.linalg.norm(C - A))
    close(C - B, np.array([2.0 * beta, 0.0, 0.0]))
    close((A + B + C) / 3.0, np.array([0.0, 2.0 * alpha, 0.0]), 1e-14)
    K_B, K_C = triangle_frames(alpha, beta)
    close(K_B[:3, 3], B, 0.0)
    close(K_C[:3, 3], C, 0.0)


@given(poses, lengths, lengths)
def test_both_ways_of_figure_2_agree(T: pin.SE3, alpha: float, beta: float) -> None:
    """The plate from its grasp points, and from its centroid and orientation."""
    A, B, C = (T.act(np.array(p)) for p in ([0.0, 0.0, 0.0], [-beta, 3 * alpha, 0.0], [beta, 3 * alpha, 0.0]))
    placed, a, b = plate_from_points(A, B, C)
    close(placed, T, 1e-8)  # the points are far from the origin and close together
    assert (a, b) == pytest.approx((alpha, beta), rel=1e-9, abs=1e-12)
    centroid = pin.SE3(T.rotation, (A + B + C) / 3.0)
    close(plate_from_centroid(centroid, alpha), T, 1e-12)


@given(poses, poses)
def test_a_moved_plate_is_the_plate_moved(T: pin.SE3, G: pin.SE3) -> None:
    points = [T.act(np.array(p)) for p in ([0.0, 0.0, 0.0], [-0.3, 1.8, 0.0], [0.3, 1.8, 0.0])]
    here, *_ = plate_from_points(*points)
    there, *_ = plate_from_points(*(G.act(p) for p in points))
    close(there, G * here, 1e-11)
    close(plate_from_centroid(G * T, 0.6), G * plate_from_centroid(T, 0.6), 1e-11)


# -- bad input -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "bad",
    [None, 3, pin.SE3.Identity(), np.eye(4), (), [], [np.eye(3)], ["X"], [2 * np.eye(4)],
     [np.diag([1.0, 1.0, -1.0, 1.0])], [np.full((4, 4), np.nan)]],
)  # fmt: skip
def test_what_is_no_grasp(bad: Any) -> None:
    with pytest.raises(InvalidInputError, match=r"Grasp\.T_object_tool"):
        Grasp(bad)


@pytest.mark.parametrize("bad", [0.0, -1.0, np.nan, np.inf, None, "wide", [1.0]])
def test_what_is_no_triangle(bad: Any) -> None:
    with pytest.raises(InvalidInputError, match="alpha"):
        Grasp.triangle(bad, 0.3)
    with pytest.raises(InvalidInputError, match="beta"):
        Grasp.triangle(0.6, bad)
    with pytest.raises(InvalidInputError, match="alpha"):
        plate_from_centroid(np.eye(4), bad)


@pytest.mark.parametrize(
    ("points", "says"),
    [
        (([0, 0, 0], [0, 0, 0], [0, 0, 0]), "do not span"),
        (([0, 0, 0], [1, 1, 0], [1, 1, 0]), "do not span"),
        (([0, 0, 0], [-1, 0, 0], [1, 0, 0]), "do not span"),  # on a line
        (([0, 0, 0], [1, 0, 0], [2, 0, 0]), "not isosceles"),
        (([0, 0, 0], [-1, 1, 0], [1, 1.1, 0]), "not isosceles"),
        (([0, 0], [-1, 1, 0], [1, 1, 0]), "plate_from_points: A"),
        (([0, 0, 0], [-1, np.nan, 0], [1, 1, 0]), "plate_from_points: B"),
        (([0, 0, 0], [-1, 1, 0], None), "plate_from_points: C"),
    ],
)
def test_what_is_no_plate(points: tuple[Any, Any, Any], says: str) -> None:
    with pytest.raises(InvalidInputError, match="plate_from_points") as caught:
        plate_from_points(*points)
    assert says in str(caught.value)


def test_a_plate_that_is_not_isosceles_says_the_lengths_of_its_sides() -> None:
    with pytest.raises(
        InvalidInputError, match=r"\|AB\| = 5 and \|AC\| = 13 m differ: not isosceles at A\. Use a general"
    ):
        plate_from_points((1.0, 2.0, 3.0), (4.0, 6.0, 3.0), (1.0, 7.0, 15.0))


def test_grasps_of_the_wrong_cell(paper: Scenario, mixed_cell: RobotCell) -> None:
    with pytest.raises(InvalidInputError, match=r"3 placements for 6 arms.*one T_object_tool per arm"):
        paper.grasp.check_arms(mixed_cell)
    q = mixed_cell.configuration(np.zeros(mixed_cell.nv))
    with pytest.raises(InvalidInputError, match="3 placements for 6 arms"):
        Grasp.from_configuration(mixed_cell, q, nominal=paper.grasp)
    with pytest.raises(InvalidInputError, match="3 placements for 6 arms"):
        Grasp.from_configuration(mixed_cell, q, pin.SE3.Identity(), nominal=paper.grasp)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"q": np.zeros(3)}, "CellState"),
        ({"q": np.full(18, np.nan)}, "NaN"),
        ({"T_world_object": 2.0 * np.eye(4)}, "T_world_object"),
        ({"T_world_object": None, "nominal": None}, "Give T_world_object, or nominal"),
        ({"tolerance_m": np.nan}, "tolerance_m"),
        ({"tolerance_rad": -1.0}, "tolerance_rad"),
    ],
)
def test_bad_latches(paper: Scenario, arguments: dict[str, Any], says: str) -> None:
    good = {"q": paper.q_start, "T_world_object": paper.path.start, "nominal": paper.grasp}
    with pytest.raises(InvalidInputError) as caught:
        Grasp.from_configuration(paper.cell, **{**good, **arguments})
    assert says in str(caught.value)


def test_bad_increments_and_targets(paper: Scenario) -> None:
    for bad in (np.zeros(3), np.full(6, np.nan), None, "Δ"):
        with pytest.raises(InvalidInputError, match=r"Grasp\.arm_increments"):
            paper.grasp.arm_increments(bad)
    with pytest.raises(InvalidInputError, match=r"Grasp\.tool_targets"):
        paper.grasp.tool_targets(np.ones((4, 4)))


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
def test_a_triangle_is_judged_by_its_shape_whatever_its_size(size: float) -> None:
    """The angle between base and height, as far as it is not a right one."""
    for skew, accepted in ((0.9e-6, True), (1.1e-6, False)):
        A, B, C = (size * np.array(p) for p in ((0.0, 0.0, 0.0), (-1.0, 2.0, 0.0), (1.0, 2.0, 0.0)))
        B, C = (p + size * np.array([2.0 * skew, 0.0, 0.0]) for p in (B, C))
        if accepted:
            _, alpha, beta = plate_from_points(A, B, C)
            assert (3.0 * alpha, beta) == pytest.approx((2.0 * size, size))
        else:
            with pytest.raises(InvalidInputError, match="not isosceles"):
                plate_from_points(A, B, C)


def test_a_grasp_takes_any_sequence_of_placements() -> None:
    T = pin.SE3.Random()
    for tools in ([T, T], (T, T), [T.homogeneous, T], np.array([T.homogeneous, T.homogeneous])):
        grasp = Grasp(tools)
        assert isinstance(grasp.T_object_tool, tuple)
        assert all(X.isApprox(T) for X in grasp.T_object_tool)
        assert len(replace(grasp, T_object_tool=grasp.T_object_tool[:1])) == 1
