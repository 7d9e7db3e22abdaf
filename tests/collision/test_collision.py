"""Nothing touches: distances, rows, stops ahead and the judges of clearance, each by a way of its own."""

from __future__ import annotations

import copy
import pickle
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import eigenpy
import numpy as np
import pinocchio as pin
import pytest
from convex import core_of, distance
from coopqp.core._core import YIELDS
from golden import Golden
from hypothesis import given, settings, strategies as st
from marks import slow_but_first, slow_unless
from places import BAR
from runs import built
from user_paths import Opaque

from coopqp import (
    Cause,
    Clearance,
    CollisionScene,
    InvalidInputError,
    Knot,
    LimitKind,
    QPController,
    Status,
    check_path,
    find_path,
    load_cell_file,
    simulate,
)
from coopqp.collision import Body, Box, Capsule, Cylinder, Hull, Mesh, PairRules, Sphere
from coopqp.collision.distances import Distances, LowerBounds
from coopqp.collision.evasion import Evasion
from coopqp.constraints.velocity import MOST_ROWS, ConstraintTrouble
from coopqp.core import _core
from coopqp.errors import MissingExtraError, UnknownNameError
from coopqp.files import CellFileError
from coopqp.model import CellState
from coopqp.model.chain import Chain
from coopqp.planning import PathVerdict
from coopqp.scenarios import (
    Scenario,
    dual_arm7,
    elbow_and_knob,
    elbows,
    forearms,
    mixed_cell,
    panda_bar,
    paper_lift,
    plate_and_post,
    plate_and_table,
    random_posts,
)
from coopqp.simulation import Closeness, Monitor, check_run, evaluate, read_run
from coopqp.simulation.evaluation.closeness import with_clearance

MARGIN = 0.02


def scene_of(scenario: Scenario, **changes: Any) -> CollisionScene:
    return CollisionScene.of(scenario, **{"margin": MARGIN, **changes})


def run(scenario: Scenario, scene: CollisionScene, *, acceleration: float = np.inf) -> Any:
    cell = scene.cell.with_limits(acceleration=acceleration) if np.isfinite(acceleration) else scene.cell
    scene = replace(scene, cell=cell)
    controller = QPController(
        cell,
        scenario.grasp,
        scenario.path,
        dt=scenario.dt,
        constraints=[Clearance(scene)],
    )
    steps: list[Any] = []
    recording = simulate(controller, q_start=scenario.q_start, patience=0.2, observe=steps.append)
    return recording, steps, scene


def lid(scenario: Scenario, gap: float) -> Body:
    """A body above the plate."""
    middle = (scenario.path.pose(0.0) * scenario.T_object_body).translation
    return Body("lid", Box((0.3, 0.3, 0.05)), pin.SE3(np.eye(3), middle + np.array([0.0, 0.0, 0.045 + gap])))


# -- distances -----------------------------------------------------------------------------------------------------


def test_the_judges_distances_are_those_of_another_way_and_of_the_controllers(lift: Scenario) -> None:
    scene, rng = CollisionScene.of(plate_and_post(post="box"), margin=0.0), np.random.default_rng(1)
    distances, judge_ = Distances(scene.built), Closeness(scene)
    shapes = list(scene.built.geometry.geometryObjects)
    cores, ends = [core_of(shape.geometry) for shape in shapes], list(scene.built.geometry.collisionPairs)
    data = scene.cell.model.createData()
    for _ in range(4):
        q = lift.q_start + rng.uniform(-0.3, 0.3, lift.cell.nq)
        d = distances.all(q)
        pin.forwardKinematics(scene.cell.model, data, q)
        for k in rng.permutation(len(d))[:60].tolist():
            i, j = int(ends[k].first), int(ends[k].second)
            A, B = (data.oMi[shapes[n].parentJoint] * shapes[n].placement for n in (i, j))
            proved = distance(cores[i], cores[j], A.rotation, A.translation, B.rotation, B.translation)
            assert judge_.at(q, k) == pytest.approx(proved, abs=1e-8)
            if d[k] > 1e-6:
                assert judge_.at(q, k) == pytest.approx(d[k], abs=1e-8)


@settings(deadline=None, max_examples=60)
@given(seed=st.integers(0, 10**6))
def test_distance_of_convex_bodies_keeps_its_bounds(seed: int) -> None:
    # ‖a − b‖ of any two points is no less, and moving one body away along the axis adds what it adds
    import coal

    rng = np.random.default_rng(seed)
    makers = (
        lambda: coal.Box(*rng.uniform(0.02, 0.3, 3)),
        lambda: coal.Sphere(rng.uniform(0.02, 0.2)),
        lambda: coal.Capsule(rng.uniform(0.02, 0.2), rng.uniform(0.02, 0.4)),
        lambda: coal.Cylinder(rng.uniform(0.02, 0.2), rng.uniform(0.02, 0.4)),
    )
    a, b = (core_of(makers[rng.integers(4)]()) for _ in range(2))
    A, B = pin.exp6(rng.normal(size=6)), pin.exp6(rng.normal(size=6))
    d = distance(a, b, A.rotation, A.translation, B.rotation, B.translation)
    back = distance(b, a, B.rotation, B.translation, A.rotation, A.translation)
    assert back == pytest.approx(d, abs=1e-9)
    shift = rng.normal(size=3) * 0.1
    moved = distance(a, b, A.rotation, A.translation, B.rotation, B.translation + shift)
    assert abs(moved - d) <= np.linalg.norm(shift) + 1e-9
    if d > 0.0:  # both moved alike changes nothing
        G = pin.exp6(rng.normal(size=6))
        GA, GB = G * A, G * B
        assert distance(a, b, GA.rotation, GA.translation, GB.rotation, GB.translation) == pytest.approx(d, abs=1e-9)


@pytest.mark.parametrize("scenario", [paper_lift(), dual_arm7(), mixed_cell()], ids=lambda s: s.name)
def test_gradients_are_differences(scenario: Scenario) -> None:
    scene, h = CollisionScene.of(scenario, margin=0.0), 1e-5
    distances, cell = Distances(scene.built), scenario.cell
    d = distances.all(scenario.q_start)
    near = np.argsort(d)[:30]
    near = near[d[near] > 1e-3]
    G = distances.gradient(near).rows.copy()
    smooth = 0
    for j in range(cell.nv):
        step = np.zeros(cell.nv)
        step[j] = h
        ahead, back = (distances.all(cell.moved(scenario.q_start, s))[near] for s in (step, -step))
        one_side = np.abs((ahead - d[near]) - (d[near] - back)) > 1e-3 * h  # a corner of the distance
        smooth += int((~one_side).sum())
        assert np.abs(G[:, j] - (ahead - back) / (2 * h))[~one_side].max(initial=0.0) < 1e-3
    assert smooth > 0.7 * cell.nv * len(near)


@pytest.mark.parametrize("scenario", [paper_lift(), mixed_cell()], ids=lambda s: s.name)
def test_no_motion_changes_a_distance_by_more_than_its_bound(scenario: Scenario) -> None:
    scene = CollisionScene.of(scenario, margin=0.0)
    distances, cell, rng = Distances(scene.built), scenario.cell, np.random.default_rng(3)
    low, high = np.maximum(cell.limits.lower, -3.0), np.minimum(cell.limits.upper, 3.0)
    for _ in range(40):
        x = rng.uniform(low, high)
        step = rng.normal(size=cell.nv) * 10.0 ** rng.uniform(-4.0, -0.5)
        before, after = (distances.all(cell.configuration(at)) for at in (x, x + step))
        apart = (before > 0.0) & (after > 0.0)  # how deep bodies overlap is another question
        assert (np.abs(after - before) <= scene.built.reach @ np.abs(step) + 1e-7)[apart].all()


def test_bounds_that_follow_the_joints_stay_below_the_distances(lift: Scenario) -> None:
    scene, rng = CollisionScene.of(lift, margin=0.0), np.random.default_rng(5)
    distances, other = Distances(scene.built), Distances(scene.built)
    bounds = LowerBounds(scene.built, distances)
    q = lift.q_start.copy()
    for _ in range(30):
        q = q + rng.normal(size=lift.cell.nq) * 0.01
        bounds.follow(lift.cell.positions(q))
        distances.place(q)
        bounds.ask(np.flatnonzero(bounds.clearances < 0.02).tolist())
        bounds.sharpen()
        d = other.all(q)
        assert (bounds.clearances <= d + 1e-8).all()
        reach, slack = bounds.certificate()
        for _ in range(5 if slack > 0.0 else 0):  # wherever the certificate reaches nothing touches
            step = rng.normal(size=lift.cell.nv)
            step *= 0.999 * slack / (reach @ np.abs(step))
            assert other.all(lift.cell.moved(q, step)).min() >= -1e-8


@pytest.mark.core
@settings(deadline=None, max_examples=40)
@given(seed=st.integers(0, 10**6))
def test_the_cores_bounds_are_those_in_numpy(seed: int) -> None:
    rng = np.random.default_rng(seed)
    pairs, nv = int(rng.integers(1, 40)), int(rng.integers(1, 15))
    reach, kinds = rng.uniform(0.0, 2.0, (nv, pairs)), rng.integers(-1, 2, (pairs, nv)).astype(float)
    rooms, x, turns = rng.uniform(-0.05, 0.2, pairs), rng.uniform(-4.0, 4.0, nv), (rng.uniform(size=nv) < 0.3) * 1.0
    rooms[rng.uniform(size=pairs) < 0.1] = -1e3
    some = [int(k) for k in rng.choice(pairs, size=min(pairs, 4), replace=False)]
    ends, J, most = rng.normal(size=(len(some), 6)), rng.normal(size=(nv, 6)), rng.uniform(0.0, 3.0, nv)
    # The joints move; each clearance loses the most that their way can take, the shorter way of those without ends.
    own, at = rooms.copy(), np.zeros(nv)
    _core.follow(own, reach, at, 1e-2 * x, np.zeros(nv))
    way = np.abs(x - 1e-2 * x)
    way = np.where(turns > 0.0, np.minimum(way, np.abs(2.0 * np.pi - way)), way)
    _core.follow(own, reach, at, x, turns)
    np.testing.assert_array_equal(at, x)
    np.testing.assert_allclose(own, rooms - np.abs(1e-2 * x) @ reach - way @ reach, rtol=1e-12, atol=1e-14)
    # The largest share of a clearance that a joint's motion takes; none where a clearance is used up.
    own[some] = np.abs(rooms[some])
    shares, weights, wide = np.zeros(pairs), np.ones(nv), own - own.min() + 0.02
    used_up = not (own > 0.01).all()
    assert _core.certify(own, reach, 0.01, shares, weights) == (not used_up)
    np.testing.assert_allclose(weights, 0.0 if used_up else (reach / (own - 0.01)).max(axis=1), rtol=1e-12)
    assert _core.certify(wide, reach, 0.01, shares, weights)
    np.testing.assert_allclose(weights, (reach / (wide - 0.01)).max(axis=1), rtol=1e-12)
    # ḋ = G v ≥ −ξ d of pairs with normals n at points p, and the rows that joints can break.
    G, lower, (n, p) = np.zeros((len(some), nv)), np.zeros(len(some)), (ends[:, :3], ends[:, 3:])
    _core.rows(ends, J, kinds, own, some, 5.0, G, lower)
    np.testing.assert_allclose(G, (np.hstack([n, np.cross(p, n)]) @ J.T) * kinds[some], rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(lower, -5.0 * np.maximum(own[some], 0.0), rtol=1e-14)
    assert _core.binding(G, lower, most) == np.flatnonzero(np.abs(G) @ most > -lower).tolist()
    assert _core.near(own, np.full(pairs, 0.1)) == np.flatnonzero(own < 0.1).tolist()
    takes = reach.sum(axis=0)
    assert _core.soonest(own, takes, 1e-9) == int((takes / np.maximum(own, 1e-9)).argmax())


# -- rows over the memory of a compiled step ---------------------------------------------------------------------------


def rows_memory(nv: int, rows: int) -> dict[str, Any]:
    sizes = {"G": rows * nv, "lower": rows, "upper": rows, "soft": rows, "owner": rows}
    of_joints = ("positions", "command", "quiet_centre", "quiet_reach")
    of_joints += ("quiet_ahead_centre", "quiet_ahead_reach", "node_positions", "node_slope", "node_curvature")
    of_joints += ("evading_positions", "evading_slope")
    one = ("dt", "quiet_slack", "quiet_approach", "quiet_ahead_slack", "quiet_ahead_approach")
    return {name: np.zeros(sizes.get(name, 1 if name in one else nv)) for name in (*sizes, *of_joints, *one)}


def max_of_two(scenario: Scenario, of_joints: Any) -> float:
    """The sum over the joints of the two arms where it is largest."""
    sums = sorted(float(of_joints[own].sum()) for own in scenario.cell.v_slices)
    return sum(sums[-2:])


@pytest.mark.core
def test_a_scene_without_pairs_slows_nothing_down() -> None:
    """Arms without shapes, as many descriptions have them, and an object of two parts."""
    task = panda_bar(geometry=False)
    parts = [Body(name, Box((0.1, 0.1, 0.1))) for name in ("one", "other")]
    scene = CollisionScene(cell=task.cell, grasp=task.grasp, carried=parts)
    assert not scene.pairs
    beside, alone = (built(task, constraints=given) for given in ([Clearance(scene)], []))
    for _ in range(50):
        np.testing.assert_array_equal(beside.step().velocity, alone.step().velocity)


@pytest.mark.parametrize("scenario", [plate_and_post(), forearms()], ids=["six", "seven"])
def test_rows_in_memory_are_those_of_the_definition(scenario: Scenario) -> None:
    scene, cell, rng = CollisionScene.of(scenario, margin=0.01), scenario.cell, np.random.default_rng(3)
    memory, definition, dt = rows_memory(cell.nv, MOST_ROWS), Clearance(scene), 0.004
    both = Clearance(scene)
    nearby = both.in_memory(memory)
    assert nearby is not None
    start, speed = cell.positions(scenario.q_start), np.minimum(cell.limits.velocity, 3.0)
    x, found, tighter, refused, quiets = start, 0, 0, 0, 0
    probe, other = Distances(scene.built), np.random.default_rng(4)
    for i in range(60):
        q, v, blind = cell.configuration(x), rng.uniform(-1.0, 1.0, cell.nv) * speed, bool(i % 7 == 0)
        memory["positions"][:], memory["command"][:], memory["dt"][:] = x, v, dt
        rows = definition.rows_by_label(q, dt, blind=blind)
        try:
            count = nearby.rows(blind)
        except OverflowError:
            assert blind  # the definition has the nearest ones, and counts
            count, refused = -1, refused + 1
        if count >= 0:
            assert memory["owner"][:count].astype(int).tolist() == rows.which.tolist()
            np.testing.assert_array_equal(memory["G"][: count * cell.nv].reshape(count, cell.nv), rows.G)
            np.testing.assert_array_equal(memory["lower"][:count], rows.lower)
            assert np.isinf(memory["upper"][:count]).all()
            quiet = definition.quiet
            assert memory["quiet_approach"].item() == quiet.approach
            assert quiet.slack > 0.0 or memory["quiet_slack"].item() < 0.0
            if memory["quiet_slack"].item() > 0.0:  # all keep their margins where it says so
                way = other.normal(size=cell.nv)
                away = max_of_two(scenario, memory["quiet_reach"] * np.abs(way))
                np.testing.assert_array_equal(memory["quiet_centre"], x)
                there = probe.all(cell.configuration(x + way * (0.999 * memory["quiet_slack"].item() / away)))
                assert (there >= scene.built.margins - 1e-8).all()
                quiets += 1
            lower = definition.tightened(rows, cell.moved(q, dt * v), v, dt)
            assert nearby.tightened() == (lower is not None)
            if lower is not None:
                np.testing.assert_allclose(memory["lower"][:count], lower, rtol=1e-12, atol=1e-12)
            found, tighter = found + (count > 0), tighter + (lower is not None)
        # on along the step, or somewhere else
        x = x + dt * v if i % 3 else start + rng.uniform(-0.8, 0.8, cell.nv)
    assert both.passes == 60 - refused
    assert found >= 10
    assert quiets >= 5
    assert tighter >= 3


@pytest.mark.core
def test_the_core_bounds_distances_from_below_and_closely(lift: Scenario) -> None:
    """Shapes of every kind, placed at random, against coal: also after searches that began elsewhere."""
    rng, cell = np.random.default_rng(5), lift.cell
    shapes = [
        Box((0.1, 0.2, 0.3)), Sphere(0.1), Capsule(0.05, 0.3), Cylinder(0.1, 0.2), Cylinder(0.2, 0.02),
        Hull(rng.normal(size=(30, 3)) * 0.1),
    ]  # fmt: skip
    middle = lift.path.pose(0.0).translation
    bodies = [
        Body(f"body {i}", shape, pin.SE3(pin.exp3(rng.normal(size=3)), middle + 0.7 * rng.normal(size=3)))
        for i, shape in enumerate(shapes)
    ]
    held = [Body("held", Hull(rng.normal(size=(12, 3)) * 0.1))]
    scene = CollisionScene(cell=cell, grasp=lift.grasp, margin=0.0, obstacles=bodies, carried=held)
    nearby, distances = Clearance(scene).in_memory(rows_memory(cell.nv, MOST_ROWS)), Distances(scene.built)
    start, apart = cell.positions(lift.q_start), 0
    for _ in range(20):
        x = start + rng.uniform(-1.0, 1.0, cell.nv)
        d = distances.all(cell.configuration(x))
        found = np.array([nearby.bound(x, k) for k in range(len(d))])
        assert (found <= d + 1e-8).all()
        clear = d > 1e-3
        assert (found[clear] >= d[clear] - 1e-3 * d[clear] - 1e-4).all()
        apart += int(clear.sum())
    assert apart > 1000


@pytest.mark.core
def test_rows_in_memory_refuse_what_does_not_fit(lift: Scenario) -> None:
    clearance, memory = Clearance(scene_of(lift, margin=0.0)), rows_memory(lift.cell.nv, 4)
    for name in memory:
        with pytest.raises((ValueError, BufferError)):
            clearance.in_memory({**memory, name: np.zeros(5)}, ahead="ahead" in name)
    read_only = np.zeros(lift.cell.nv * 4)
    read_only.flags.writeable = False
    with pytest.raises(ValueError, match="fit together"):
        clearance.in_memory({**memory, "G": read_only})
    moving = scene_of(lift, margin=0.0, moving=[replace(lid(lift, 0.1), name="cart")])
    assert Clearance(moving).in_memory(memory) is None


@pytest.mark.core
@pytest.mark.parametrize("name", ["q_index", "continuous", "questions", "points"])
def test_rows_in_memory_refuse_what_does_not_fit_what_coal_is_asked(
    name: str, lift: Scenario, monkeypatch: pytest.MonkeyPatch
) -> None:
    build: Any = _core.Nearby

    def one_more(arrays: Any, settings: Any, coal: Any, shapes: Any) -> Any:
        given = coal[name]
        longer = [*given, given[-1]]
        return build(arrays, settings, {**coal, name: longer if isinstance(given, list) else np.array(longer)}, shapes)

    monkeypatch.setattr(_core, "Nearby", one_more)
    with pytest.raises(ValueError, match="fit together"):
        Clearance(scene_of(lift, margin=0.0)).in_memory(rows_memory(lift.cell.nv, 4))


@pytest.mark.core
@pytest.mark.parametrize(("corners", "hulls"), [(4, False), (4, True), (0, True)])
def test_shapes_whose_corners_are_no_points_are_refused(
    corners: int, hulls: bool, lift: Scenario, monkeypatch: pytest.MonkeyPatch
) -> None:
    build: Any = _core.Nearby

    def other(arrays: Any, settings: Any, coal: Any, shapes: Any) -> Any:
        some = [np.ones(corners) if (own.size > 0) == hulls else own for own in shapes["corners"]]
        return build(arrays, settings, coal, {**shapes, "corners": some})

    hull = Body("stone", Hull(0.1 * np.random.default_rng(5).normal(size=(12, 3))))
    clearance = Clearance(scene_of(lift, margin=0.0, obstacles=[hull]))
    assert clearance.in_memory(rows_memory(lift.cell.nv, 4)) is not None
    monkeypatch.setattr(_core, "Nearby", other)
    with pytest.raises(ValueError, match="fit together"):
        clearance.in_memory(rows_memory(lift.cell.nv, 4))


@pytest.mark.core
@pytest.mark.parametrize("longest", [0.1, 1.0])
def test_rows_in_memory_stop_the_object_at_the_knots_where_the_definition_does(longest: float) -> None:
    """On ways of any length to a knot: bodies are met at its ends, or passed in between."""
    scenario, rng, stopped = forearms(), np.random.default_rng(6), []
    scene, cell = CollisionScene.of(scenario, margin=0.01), scenario.cell
    memory, definition = rows_memory(cell.nv, 4), Clearance(scene)
    nearby: Any = Clearance(scene).in_memory(memory, ahead=True)
    definition.check(scenario.q_start)
    for _ in range(50):
        x = cell.positions(scenario.q_start) + rng.uniform(-0.5, 0.5, cell.nv)
        slope, curvature, span = rng.normal(size=cell.nv), 5.0 * rng.normal(size=cell.nv), rng.uniform(0.01, longest)
        memory["node_positions"][:], memory["node_slope"][:], memory["node_curvature"][:] = x, slope, curvature
        label = definition.stopping_pair(Knot(0.0, CellState(cell, cell.configuration(x)), slope, curvature, span))
        stopped.append((nearby.stopping(0, span) >= 0, label >= 0))
    core, by_definition = np.array(stopped).T
    np.testing.assert_array_equal(core, by_definition)
    assert 5 < core.sum() < 45


@pytest.mark.core
def test_arms_evade_in_memory_as_by_the_definition_whenever_distances_were_asked() -> None:
    """To the last bit where they were asked in pieces before; the definition has the normals of coal, less sharp."""
    scenario, rng, evading = forearms(), np.random.default_rng(7), 0
    scene, cell = CollisionScene.of(scenario, margin=0.01), scenario.cell
    memories, definition = [rows_memory(cell.nv, 4) for _ in range(2)], Clearance(scene)
    late, early = (Clearance(scene).in_memory(memory, ahead=True) for memory in memories)
    x = start = cell.positions(scenario.q_start)
    for _ in range(60):
        x = 0.5 * (x + start) + rng.uniform(-0.1, 0.1, cell.nv)
        if min(pair.distance for pair in scene.distances(cell.configuration(x))) < 0.0:
            continue
        slope, expected = rng.normal(size=(2, cell.nv))
        for memory, nearby in zip(memories, (late, early), strict=True):
            assert nearby is not None
            memory["evading_positions"][:], memory["evading_slope"][:] = x, expected
            while nearby is early and nearby.surveys():
                pass
            memory["evading_slope"][:] = slope
            assert nearby.evade()
        wanted = definition.evaded(cell.configuration(x), slope)
        moved = np.abs(wanted - slope).max()
        evading += bool(moved > 0.0)
        np.testing.assert_array_equal(memories[1]["evading_slope"], memories[0]["evading_slope"])
        np.testing.assert_allclose(memories[0]["evading_slope"], wanted, atol=2e-3 * max(1.0, moved))
    assert evading > 10


@pytest.mark.core
def test_only_knots_that_exist_stop_the_object(lift: Scenario) -> None:
    nearby: Any = Clearance(scene_of(lift, margin=0.0)).in_memory(rows_memory(lift.cell.nv, 4), ahead=True)
    nearby.stopping(0, 0.0)
    for place in (-1, 1, 10**6):
        with pytest.raises(IndexError, match="no such grid point"):
            nearby.stopping(place, 0.0)


@pytest.mark.core
def test_rows_in_memory_that_were_not_built_say_so() -> None:
    unbuilt = _core.Nearby.__new__(_core.Nearby)
    for ask in (unbuilt.tightened, lambda: unbuilt.rows(True)):
        with pytest.raises(TypeError), pytest.warns(RuntimeWarning, match="uninitialized"):
            ask()


@pytest.mark.core
def test_rows_are_in_memory_only_where_coal_and_pinocchio_share_theirs(lift: Scenario) -> None:
    clearance, memory = Clearance(scene_of(lift, margin=0.0)), rows_memory(lift.cell.nv, 4)
    eigenpy.sharedMemory(False)
    try:
        assert clearance.in_memory(memory) is None
    finally:
        eigenpy.sharedMemory(True)
    assert clearance.in_memory(memory) is not None


@pytest.mark.core
def test_where_rows_in_memory_fail_the_definition_goes_on_and_interrupts_are_raised() -> None:
    scenario = plate_and_post()
    own, failing = (
        QPController(scenario.cell, scenario.grasp, scenario.path, dt=0.05, constraints=[Clearance(scene_of(scenario))])
        for _ in range(2)
    )
    asked = 0

    def fails(_: bool) -> int:
        nonlocal asked
        asked += 1
        raise RuntimeError("nothing is known")

    failing._loop._core.bind(clear=fails, further_rows=fails, tightened=bool)
    for controller in (own, failing):
        controller.reset(scenario.q_start)
    for _ in range(36):
        # Rows that cannot bind take part in the definition's arithmetic alone: rounding.
        np.testing.assert_allclose(own.step().q_next, failing.step().q_next, rtol=0.0, atol=1e-12)
    assert asked > 5

    def interrupted(_: bool) -> int:
        raise KeyboardInterrupt

    failing._loop._core.bind(clear=interrupted, further_rows=interrupted, tightened=bool)
    own.step()  # near in this step, too
    with pytest.raises(KeyboardInterrupt):
        failing.step()
    failing.reset(scenario.q_start)
    assert failing._loop._core.hold() is None  # nobody works in it
    failing._loop._core.release()


@pytest.mark.core
def test_a_command_is_shown_to_be_clear_without_asking_for_all_that_is_near() -> None:
    """Commands of growing size: clear is said only where rows, asked for after it, are kept by the command."""
    scenario = plate_and_post()
    scene, said = scene_of(scenario), []
    for size in np.geomspace(1e-3, 10.0, 25):
        controller = built(scenario, dt=0.05, constraints=[Clearance(scene)])
        loop = controller._loop
        rows = loop.constraints.given[0]._native[0]
        rng = np.random.default_rng(3)
        loop.at["command"][:] = size * rng.normal(size=scenario.cell.nv)
        said.append(rows.clear(False))
        count = rows.rows(False)
        G = loop.at["further"][: count * scenario.cell.nv].reshape(count, scenario.cell.nv)
        kept = bool((G @ loop.at["command"] >= loop.at["further_lower"][:count]).all())
        assert kept or not said[-1]
    assert said[0]
    assert not said[-1]


def test_distances_do_not_depend_on_what_was_asked_before() -> None:
    scene, rng = CollisionScene.of(plate_and_post(), margin=0.0), np.random.default_rng(4)
    asked, fresh = Distances(scene.built), Distances(scene.built)
    q = plate_and_post().q_start
    for _ in range(20):
        q = q + rng.normal(size=q.size) * 1e-3
        asked.all(q)
    np.testing.assert_array_equal(asked.all(q), fresh.all(q))


# -- on a known path -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("acceleration", slow_unless(np.isfinite, [np.inf, 5.0]))
@pytest.mark.parametrize(
    "scenario",
    [
        plate_and_post(),
        pytest.param(plate_and_post(post="box"), marks=pytest.mark.slow),
        plate_and_table(),
        pytest.param(plate_and_table(tilt=0.1), marks=pytest.mark.slow),
    ],
    ids=["capsule", "box", "table", "tilted"],
)
def test_the_object_stops_at_the_margin_on_its_path(scenario: Scenario, acceleration: float) -> None:
    recording, steps, scene = run(scenario, scene_of(scenario), acceleration=acceleration)
    last, body = steps[-1], scenario.obstacles[0].name
    assert last.status is Status.BLOCKED
    assert [limit.kind for limit in last.binding] == [LimitKind.COLLISION]
    assert set(last.binding[0].between) == {"object", body}
    assert last.binding[0].distance == pytest.approx(MARGIN, abs=1e-5)
    assert f"object and {body}: 20.0 mm" in last.explain()
    verdict = check_run(recording, scene.cell, scene=scene)  # chain and path, and distances by another way
    assert verdict.ok, verdict
    assert verdict.worst.chain_m < 1e-6
    assert verdict.worst.path_m < 1e-6
    assert max(step.given_up.chain for step in steps) == 0.0
    rest = next(i for i, step in enumerate(steps) if step.rate < 1e-9)
    blocked = next(i for i, step in enumerate(steps) if step.status is Status.BLOCKED)
    assert blocked <= rest + 50
    rates = np.array([step.rate for step in steps])
    moves = np.diff(rates[np.argmax(rates > 0.5) :])
    assert (np.diff(np.sign(moves[np.abs(moves) > 1e-6])) != 0).sum() <= 1  # it slows down once


@pytest.mark.slow
@pytest.mark.parametrize("acceleration", [np.inf, 5.0])
def test_a_path_not_known_ahead_ends_at_the_margin_too(acceleration: float) -> None:
    scenario = plate_and_post()
    blind = replace(scenario, path=Opaque(scenario.path, known_ahead=False))
    recording, steps, scene = run(blind, scene_of(blind), acceleration=acceleration)
    verdict = check_run(recording, scene.cell, scene=scene)
    assert verdict.ok, verdict
    assert verdict.worst.path_m < 1e-6
    assert set(steps[-1].binding[0].between) == {"object", "post"}


@pytest.mark.slow
@pytest.mark.core
@pytest.mark.parametrize("known", [True, False])
def test_a_distance_is_kept_as_recorded(known: bool, golden: Golden) -> None:
    scenario = plate_and_table(tilt=0.1)
    if not known:
        scenario = replace(scenario, path=Opaque(scenario.path, known_ahead=False))
    done = golden.of(None, 5e-9)
    for step in run(scenario, scene_of(scenario), acceleration=5.0)[1]:
        done.add(step)


def test_far_from_everything_the_steps_are_those_without_a_scene(lift: Scenario) -> None:
    far = replace(lift, obstacles=(Body("far", Sphere(0.1), pin.SE3(np.eye(3), np.array([9.0, 0.0, 0.0]))),))
    recording, steps, _ = run(far, scene_of(far, margin=0.005))
    plain = simulate(QPController(lift.cell, lift.grasp, lift.path, dt=lift.dt), q_start=lift.q_start)
    assert recording.finished
    assert np.array_equal(recording.q_command, plain.q_command)
    assert {step.status for step in steps} == {Status.TRACKING}


# -- starts inside the margin ----------------------------------------------------------------------------------------


def test_a_start_inside_the_margin_is_refused_by_name(lift: Scenario) -> None:
    near = replace(lift, obstacles=(lid(lift, 0.008),))
    with pytest.raises(InvalidInputError, match=r"object and lid are 8\.0 mm .* margin of 20 mm"):
        run(near, scene_of(near))


def test_a_start_in_which_bodies_overlap_says_by_how_much(lift: Scenario) -> None:
    """A table stands 2 mm up into the plate."""
    place = lift.path.pose(0.0) * lift.T_object_body
    place.translation[2] += 2e-3 - 0.5 * lift.object_size[2] - 0.05
    table = Body("table", Box((0.1, 0.1, 0.1)), place)
    scene = CollisionScene.of(lift, obstacles=[table], margin=0.02)
    controller = QPController(lift.cell, lift.grasp, lift.path, dt=lift.dt, constraints=[Clearance(scene)])
    with pytest.raises(InvalidInputError, match=r"object and table overlap by 2\.0 mm, inside their margin of 20 mm"):
        controller.reset(lift.q_start)
    found = check_path(lift.cell, lift.grasp, lift.path, q_start=lift.q_start, scene=scene)
    assert "object and table start overlapping by 2 mm, inside their margin" in found.explain()


@pytest.mark.parametrize("acceleration", [np.inf, 5.0])
@pytest.mark.parametrize("side", slow_but_first([1.0, -1.0]))
def test_an_allowed_start_inside_the_margin_only_parts(lift: Scenario, side: float, acceleration: float) -> None:
    gap = 0.008 if side > 0.0 else -0.098
    near = replace(lift, obstacles=(lid(lift, gap),))
    recording, steps, scene = run(near, scene_of(near, inside=[("object", "lid")]), acceleration=acceleration)
    judge_ = Closeness(scene)
    k = next(i for i, label in enumerate(scene.built.labels) if set(label) == {"object", "lid"})
    d = np.array([judge_.at(q, k) for q in recording.q_command])
    assert np.diff(d).min() >= -1e-9
    assert recording.finished is (side < 0.0)
    if side > 0.0:
        assert steps[-1].status is Status.BLOCKED


# -- the judges ----------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_monitor_finds_what_comes_too_close(lift: Scenario) -> None:
    scenario = plate_and_post()
    free = simulate(QPController(lift.cell, lift.grasp, scenario.path, dt=lift.dt), q_start=scenario.q_start)
    verdict = check_run(free, scenario.cell, scene=scene_of(scenario))
    assert [kind.name for kind in verdict.counts] == ["CLEARANCE"]
    assert "object and post" in str(verdict)
    for q in (free.q_command, free.q_command[::-1]):  # deepest at its end, or at its start
        watched = Monitor(scenario.cell, free.grasp, keep=10_000, scene=scene_of(scenario))
        found = watched.check_recorded(replace(free, q_command=q))
        amounts = [violation.amount for violation in found.violations if violation.kind.name == "CLEARANCE"]
        assert found.worst.clearance_m == pytest.approx(max(amounts), abs=2e-6)
    monitor = Monitor(scenario.cell, scenario.grasp, scenario.path, scene=scene_of(scenario))
    controller = QPController(lift.cell, lift.grasp, scenario.path, dt=lift.dt)
    controller.reset(scenario.q_start)
    while monitor.verdict().ok or not monitor.verdict().steps:
        monitor.observe(controller.step())
    assert monitor.verdict().violations[0].step == verdict.violations[0].step


def test_between_two_steps_counts_too() -> None:
    # two configurations that are clear, with a post between them
    scenario = dual_arm7()
    q0, q1 = scenario.q_start, scenario.q_start.copy()
    q1[0] += 1.6
    scene = CollisionScene(
        cell=scenario.cell,
        grasp=scenario.grasp,
        margin=0.0,
        obstacles=[Body("post", Sphere(0.01), pin.SE3(np.eye(3), _swept(scenario, q0, q1)))],
    )
    judge_ = Closeness(scene)
    ends = [min(p.distance for p in scene.distances(q) if "post" in (p.first, p.second)) for q in (q0, q1)]
    assert min(ends) > 0.005
    judge_.start(q0)
    assert any(pair.second == "post" for _, pair, _ in judge_.watch(np.array([q0, q1]), tolerance=1e-6))


def _swept(scenario: Scenario, q0: Any, q1: Any) -> Any:
    data, model = scenario.cell.model.createData(), scenario.cell.model
    pin.forwardKinematics(model, data, 0.5 * (q0 + q1))
    shape = next(s for s in scenario.cell.collision_model().geometryObjects if s.name.startswith("left/link_4"))
    return (data.oMi[shape.parentJoint] * shape.placement).translation


@pytest.mark.slow
@pytest.mark.parametrize("avoided", [True, False])
def test_the_verdict_says_where_it_was_closest(avoided: bool) -> None:
    scenario = plate_and_post()
    scene = scene_of(scenario)
    constraints = [Clearance(scene)] if avoided else []
    controller = QPController(scenario.cell, scenario.grasp, scenario.path, dt=scenario.dt, constraints=constraints)
    recording = simulate(controller, q_start=scenario.q_start, patience=0.1)
    recording = with_clearance(recording, scene, avoided=avoided)
    found = evaluate(scenario.cell, recording, read_run(scenario.cell, recording))[-1]
    assert found.holds is avoided
    said = "nothing touched: closest 20 mm, object and post at" if avoided else "object and post at"
    assert found.answer.startswith(said)
    entry = recording.metadata["clearance"]
    assert min(entry["distances_m"]) == pytest.approx(entry["closest_m"], abs=2e-3)
    nearest = int(np.argmin(entry["distances_m"]))
    assert sorted(entry["pairs"][nearest]) == sorted(entry["between"])
    assert len(entry["pairs"]) == len(entry["times_s"])
    if not avoided:  # since when it has touched, by coal along the path: 2.13 s
        assert entry["time_s"] == pytest.approx(2.13, abs=0.02)


# -- bad scenes ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: Box((0.1, np.nan, 0.1)), "NaN"),
        (lambda: Box((0.1, 0.1)), "shape"),
        (lambda: Sphere(0.0), "outside"),
        (lambda: Sphere(1e9), "metres"),
        (lambda: Capsule(np.nan, 0.1), "outside"),
        (lambda: Cylinder(0.1, -1.0), "outside"),
        (lambda: Hull(np.zeros((3, 3))), "points"),
        (lambda: Hull(np.c_[np.random.default_rng(0).normal(size=(9, 2)), np.zeros(9)]), "plane"),
        (lambda: Hull([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, np.inf]]), "finite"),
        (lambda: Mesh("nowhere.stl"), "no file"),
        (lambda: Body("", Sphere(0.1)), "name"),
        (lambda: Body("post", "sphere"), "shape"),
    ],
)
def test_bad_shapes_are_refused_when_built(make: Any, said: str) -> None:
    with pytest.raises(InvalidInputError, match=said):
        make()


@pytest.mark.parametrize(
    ("changes", "error", "said"),
    [
        ({"margin": np.nan}, InvalidInputError, "margin"),
        ({"margin": -0.1}, InvalidInputError, "margin"),
        ({"margins": {("object", "pots"): 0.1}}, UnknownNameError, "pots"),
        ({"margins": {("object", "post"): -0.1}}, InvalidInputError, "margins"),
        ({"ignored": [("object", "pots")]}, UnknownNameError, "pots"),
        ({"ignored": ["object"]}, InvalidInputError, "no pair"),
        ({"inside": [("object",)]}, InvalidInputError, "no pair"),
        ({"without": ["master/elbow"]}, UnknownNameError, "elbow"),
        ({"on_links": {"master/hand": [Body("hand", Sphere(0.1))]}}, UnknownNameError, "hand"),
        ({"srdf": {"master": "nowhere.srdf"}}, InvalidInputError, "no file"),
        ({"srdf": {"boss": "<robot name='r'/>"}}, UnknownNameError, "boss"),
        ({"obstacles": Body("post", Sphere(0.1))}, InvalidInputError, "list"),
        ({"obstacles": ["post"]}, InvalidInputError, "list"),
        ({"rules": 3}, InvalidInputError, "PairRules"),
        ({"obstacles": [Body("object", Sphere(0.1))]}, InvalidInputError, "two bodies are named 'object'"),
        ({"obstacles": [Body("master/link_6", Sphere(0.1))]}, InvalidInputError, "two bodies"),
        ({"moving": [Body("cart", Sphere(0.1)), Body("cart", Sphere(0.2))]}, InvalidInputError, "two bodies"),
        ({"moving": [Body("post", Sphere(0.1))]}, InvalidInputError, "two bodies"),
        ({"obstacles": [Body("*", Sphere(0.1))]}, InvalidInputError, "stands for several"),
        ({"obstacles": [Body("master", Sphere(0.1))]}, InvalidInputError, "stands for several"),
        (
            {"on_links": {f"{arm}/link_6": [Body("gripper", Sphere(0.1))] for arm in ("master", "slave_1")}},
            InvalidInputError,
            "two bodies are named 'gripper'",
        ),
    ],
)
def test_bad_scenes_are_refused_when_built(changes: dict[str, Any], error: type, said: str) -> None:
    with pytest.raises(error, match=said):
        CollisionScene.of(plate_and_post(), **changes)


def _stl(file: Path, corners: Any) -> Path:
    """A binary STL of triangles (n, 3, 3)."""
    rows = np.zeros(len(corners), dtype=[("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")])
    rows["v"] = corners
    file.write_bytes(b"\0" * 80 + np.uint32(len(corners)).tobytes() + rows.tobytes())
    return file


def _cubes(centres: Any) -> Any:
    """Triangles of cubes with sides of 0.1 m, their normals outwards."""
    faces = []
    for axis in range(3):
        for side in (-1.0, 1.0):
            e, f = np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3]
            middle = side * np.eye(3)[axis]
            a, b, c, d = (middle + x * e + y * f for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1)))
            faces += [[a, b, c], [a, c, d]] if side > 0.0 else [[a, c, b], [a, d, c]]
    return np.concatenate([0.05 * np.array(faces) + centre for centre in np.asarray(centres, dtype=float)])


@pytest.mark.parametrize(
    ("triangles", "said"), [(0, "mesh"), pytest.param(1_000_000, "triangles", marks=pytest.mark.slow)]
)
def test_empty_and_huge_meshes_are_refused(tmp_path: Path, triangles: int, said: str) -> None:
    mesh = Mesh(_stl(tmp_path / "mesh.stl", np.random.default_rng(0).random((triangles, 3, 3), dtype=np.float32)))
    with pytest.raises(InvalidInputError, match=said):
        CollisionScene.of(plate_and_post(), obstacles=[Body("rock", mesh)])


def test_a_hull_much_larger_than_its_mesh_is_named(tmp_path: Path) -> None:
    cube, pair = _cubes([[0, 0, 0]]), _cubes([[0, 0, 0], [0.4, 0, 0]])  # the hull of two is 2.5 times their volume
    meshes = [Body(name, Mesh(_stl(tmp_path / f"{name}.stl", c))) for name, c in (("cube", cube), ("pair", pair))]
    task = plate_and_post()
    scene = CollisionScene.of(task, obstacles=meshes)
    said = "pair counts as the convex hull of its mesh, with 2.5 times the volume (decompose takes its parts)"
    assert scene.notes == (said,)
    inwards = Body("pair", Mesh(_stl(tmp_path / "inwards.stl", pair[:, ::-1])))
    assert CollisionScene.of(plate_and_post(), obstacles=[inwards]).notes == (said,)
    check = check_path(task.cell, task.grasp, task.path, q_start=task.q_start, scene=scene)
    assert check.clearance is not None
    assert f"note: {said}." in check.explain().splitlines()
    assert check.clearance.record()["notes"] == [said]
    T = task.path.pose(0.0)
    around = Body("pair", meshes[1].shape, pin.SE3(np.eye(3), T.translation - np.array([0.2, 0.0, 0.0])))
    blocked = CollisionScene.of(task, obstacles=[around])
    route = find_path(task.cell, task.grasp, T, task.path.pose(task.path.duration), blocked)
    assert "pair come inside their margin" in route.reason
    assert route.reason.endswith(f" Note: {said}.")
    run = simulate(QPController(task.cell, task.grasp, task.path, dt=0.05), q_start=task.q_start)
    run = with_clearance(run, scene, avoided=False)
    assert said in next(f.answer for f in evaluate(task.cell, run, read_run(task.cell, run)) if "clear" in f.question)
    around = pin.SE3(np.eye(3), task.path.pose(0.0).translation - [0.2, 0.0, 0.0])
    scene = CollisionScene.of(task, obstacles=[replace(meshes[1], placement=around)])
    with pytest.raises(InvalidInputError, match=r"and pair overlap .* pair counts as the convex hull of its mesh"):
        QPController(task.cell, task.grasp, task.path, dt=1e-3, constraints=[Clearance(scene)]).reset(task.q_start)


@pytest.mark.slow
def test_convex_parts_leave_the_gaps_of_a_mesh_free(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    task, centres = plate_and_post(), np.array([[0.0, 0.0, 0.0], [0.4, 0.0, 0.0]])
    mesh = Body("pair", Mesh(_stl(tmp_path / "pair.stl", _cubes(centres))), pin.SE3(np.eye(3), np.array([3.0, 0, 1])))
    boxes = [Body("pair", Box((0.1, 0.1, 0.1)), mesh.placement * pin.SE3(np.eye(3), c)) for c in centres]
    of_boxes = CollisionScene.of(task, obstacles=boxes).distances(task.q_start)
    for _ in range(2):  # the second time from the cache
        parts = CollisionScene.of(task, obstacles=[mesh], decompose=["pair"])
        assert not parts.notes
        found = {(pair.first, pair.second): pair.distance for pair in parts.distances(task.q_start)}
        assert found == pytest.approx({(pair.first, pair.second): pair.distance for pair in of_boxes}, abs=2e-5)
        (kept,) = (tmp_path / "cache" / "coopqp" / "convex").iterdir()
    kept.write_bytes(kept.read_bytes()[:100])  # a damaged one is made anew
    assert CollisionScene.of(task, obstacles=[mesh], decompose=["*"]).pairs == parts.pairs
    assert kept.stat().st_size > 100


def test_what_cannot_be_decomposed_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    task, cart = plate_and_post(), Body("cart", Sphere(0.1), pin.SE3(np.eye(3), np.array([9.0, 0, 0])))
    with pytest.raises(InvalidInputError, match="cart moves"):
        CollisionScene.of(task, moving=[cart], decompose=["cart"])
    with pytest.raises(UnknownNameError, match=r"pst.*Did you mean 'post'"):
        CollisionScene.of(task, decompose=["pst"])
    monkeypatch.setitem(sys.modules, "coacd", None)
    with pytest.raises(MissingExtraError, match="decompose"):
        CollisionScene.of(task, decompose=["post"])


# -- scenes --------------------------------------------------------------------------------------------------------


def test_pair_rules_leave_out_what_touches_by_design(lift: Scenario) -> None:
    scene = CollisionScene.of(lift, margin=0.0)
    assert ("master/shoulder_link", "master/forearm_link") in scene.pairs
    assert ("master/upper_arm_link", "master/forearm_link") not in scene.pairs
    assert not any({"object", "master/link_6"} == set(pair) for pair in scene.pairs)
    assert any({"object", "slave_1/forearm_link"} == set(pair) for pair in scene.pairs)
    assert min(pair.distance for pair in scene.distances(lift.q_start)) > 0.0
    fewer = CollisionScene.of(lift, margin=0.0, rules=PairRules(apart=5), ignored=[("master", "slave_1")])
    assert not any(a.startswith("master") and b.startswith("slave_1") for a, b in fewer.pairs)
    assert len(fewer.pairs) < len(scene.pairs)


def test_an_srdf_switches_pairs_off_per_arm(lift: Scenario) -> None:
    text = '<robot name="r"><disable_collisions link1="shoulder_link" link2="forearm_link" reason="Never"/></robot>'
    pairs = CollisionScene.of(lift, srdf={"master": text}).pairs
    assert ("master/shoulder_link", "master/forearm_link") not in pairs
    assert ("slave_1/shoulder_link", "slave_1/forearm_link") in pairs


def test_margins_of_pairs_and_bodies_on_links(lift: Scenario) -> None:
    scene = CollisionScene.of(
        plate_and_post(),
        margins={("object", "post"): 0.05, ("post", "slave_1"): 0.03},
        on_links={"master/forearm_link": [Body("camera", Sphere(0.05))]},
        without=["slave_2"],
    )
    margins = dict(zip(scene.built.labels, scene.built.margins.tolist(), strict=True))
    assert margins["object", "post"] == 0.05
    assert {m for (a, b), m in margins.items() if b == "post" and a.startswith("slave_1")} == {0.03}
    assert "camera" in scene.names
    assert not any(name.startswith("slave_2/") for name in scene.names)


@pytest.mark.slow
def test_copies_of_a_scene_and_its_constraint_are_the_same() -> None:
    scenario = plate_and_post()
    scene = scene_of(scenario)
    for other in (copy.deepcopy(scene), pickle.loads(pickle.dumps(scene))):
        assert other.pairs == scene.pairs
        assert other.distances(scenario.q_start) == scene.distances(scenario.q_start)
    controller = QPController(
        scenario.cell, scenario.grasp, scenario.path, dt=scenario.dt, constraints=[Clearance(scene)]
    )
    controller.reset(scenario.q_start)
    for _ in range(235):
        controller.step()
    others = [copy.copy(controller), copy.deepcopy(controller), pickle.loads(pickle.dumps(controller))]
    for _ in range(15):
        step = controller.step()
        for other in others:
            assert np.array_equal(other.step().q_next, step.q_next)


def test_rows_are_few_and_name_both_bodies() -> None:
    scenario = plate_and_post()
    clearance = Clearance(scene_of(scenario))
    rows = clearance.rows_by_label(scenario.q_start, 0.002, blind=False)
    assert len(rows.which) <= MOST_ROWS
    assert all(limit.kind is LimitKind.COLLISION for limit in clearance.labels)
    assert (rows.lower <= 0.0).all()  # rest is admissible


# -- random posts --------------------------------------------------------------------------------------------------


#: Of the 200 of the benchmark: posts that are evaded (2 arms: 8, 26, 60), that stop the object, and free ways.
_POSTS = [(2, 8), (2, 16), (2, 26), (2, 60), (3, 0), (3, 12), (4, 1), (8, 0)]


@pytest.mark.slow
@pytest.mark.parametrize(("arms", "seed"), _POSTS)
def test_random_posts_are_never_touched_and_certified_ways_are_finished(arms: int, seed: int) -> None:
    scenario = random_posts(seed, arms=arms)
    scene = scene_of(scenario, margin=0.005)
    found = check_path(scene.cell, scenario.grasp, scenario.path, q_start=scenario.q_start, scene=scene)
    recording, steps, _ = run(scenario, scene)
    verdict = check_run(recording, scene.cell, scene=scene)
    assert verdict.ok, (seed, verdict)
    assert max(verdict.worst.chain_m, verdict.worst.path_m) <= 1e-6
    assert max(step.given_up.chain for step in steps) == 0.0
    if found.verdict is PathVerdict.CERTIFIED:
        assert recording.finished
    if found.verdict is PathVerdict.INFEASIBLE:
        assert not recording.finished


# -- elbows --------------------------------------------------------------------------------------------------------


def reversals(steps: list[Any]) -> int:
    """How often the rate turns between rising and falling."""
    change = np.diff([step.rate for step in steps])
    change = change[np.abs(change) > 1e-6]
    return int((np.diff(np.sign(change)) != 0).sum())


@pytest.mark.slow
@pytest.mark.parametrize("acceleration", [np.inf, 5.0])
def test_an_elbow_evades_and_the_object_stays_on_its_path(acceleration: float) -> None:
    scenario = elbow_and_knob()
    recording, steps, scene = run(scenario, scene_of(scenario), acceleration=acceleration)
    assert recording.finished
    verdict = check_run(recording, scene.cell, scene=scene)
    assert verdict.ok, verdict
    assert max(verdict.worst.chain_m, verdict.worst.path_m) < 1e-6
    assert reversals(steps) <= 10
    still = [step for step in steps if step.status is Status.BLOCKED]
    assert not still
    without = simulate(
        QPController(scene.cell, scenario.grasp, scenario.path, dt=scenario.dt), q_start=scenario.q_start
    )
    assert not check_run(without, scene.cell, scene=scene).ok


@pytest.mark.slow
@pytest.mark.parametrize("acceleration", [np.inf, 5.0])
@pytest.mark.parametrize(("make", "margin"), [(elbows, MARGIN), (forearms, 0.03)])
def test_arms_evade_each_other(make: Any, margin: float, acceleration: float) -> None:
    scenario = make()
    recording, steps, scene = run(scenario, scene_of(scenario, margin=margin), acceleration=acceleration)
    assert recording.finished
    verdict = check_run(recording, scene.cell, scene=scene)
    assert verdict.ok, verdict
    assert max(verdict.worst.chain_m, verdict.worst.path_m) < 1e-6
    assert max(step.given_up.chain for step in steps) == 0.0
    assert reversals(steps) <= 10
    without = simulate(
        QPController(scene.cell, scenario.grasp, scenario.path, dt=scenario.dt), q_start=scenario.q_start
    )
    judged = check_run(without, scene.cell, scene=scene)
    assert [kind.name for kind in judged.counts] == ["CLEARANCE"]


def test_without_comfort_an_elbow_stops_the_object_by_name() -> None:
    scenario = elbow_and_knob()
    clearance = Clearance(scene_of(scenario), comfort=0.0)
    controller = QPController(scenario.cell, scenario.grasp, scenario.path, dt=scenario.dt, constraints=[clearance])
    steps: list[Any] = []
    recording = simulate(controller, q_start=scenario.q_start, patience=0.1, observe=steps.append)
    assert not recording.finished
    assert set(steps[-1].binding[0].between) == {"left/link_3", "knob"}


@settings(deadline=None, max_examples=60)
@given(seed=st.integers(0, 10**6))
def test_evasion_is_the_least_self_motion_that_keeps_its_rows(seed: int) -> None:
    rng, scenario = np.random.default_rng(seed), dual_arm7()
    cell, evasion = scenario.cell, Evasion(scenario.cell)
    q = cell.moved(scenario.q_start, rng.uniform(-0.2, 0.2, cell.nv))
    N, slope = evasion.basis(q), rng.normal(size=cell.nv)
    G, wanted = rng.normal(size=(2, cell.nv)), rng.normal(size=2)
    keeps = rng.normal(size=N.shape[1])  # a self-motion that keeps them
    lower = G @ (slope + N @ keeps) - np.abs(wanted)
    found = evasion.slope(q, slope, G, lower)
    state = CellState(cell, q)
    for k, own in enumerate(cell.v_slices):  # the tools do not feel it
        assert np.abs(state.jacobian(k) @ (found - slope)[own]).max() < 1e-9
    z = np.linalg.lstsq(N, found - slope, rcond=None)[0]

    def cost(z: Any) -> float:
        short = np.maximum(lower - G @ (slope + N @ z), 0.0)
        return float(z @ z + YIELDS**2 * short @ short)

    # Of a motion that keeps them a small share may be missing, and none is better.
    assert (G @ found >= lower - np.linalg.norm(keeps) / YIELDS - 1e-9).all()
    assert cost(z) <= cost(keeps) + 1e-9
    for _ in range(20):
        other = z + rng.normal(size=z.size) * 10.0 ** rng.uniform(-3.0, 0.0)
        assert cost(z) <= cost(other) + 1e-9


# -- bodies that move ------------------------------------------------------------------------------------------------


def _cart(
    scenario: Scenario, *, give_way: bool, steps: int = 1100, height: float = 0.18
) -> tuple[list[float], list[Any], Clearance]:
    """Distances to a cart that comes at 0.3 m/s, and the steps."""
    dt, middle = 0.004, (scenario.path.pose(0.0) * scenario.T_object_body).translation

    def place(t: float) -> pin.SE3:
        return pin.SE3(np.eye(3), middle + np.array([0.0, -1.0 + 0.3 * t, height]))

    scene = scene_of(scenario, moving=[Body("cart", Box((0.2, 0.2, 0.2)), place(0.0))])
    clearance = Clearance(scene, give_way=give_way)
    controller = QPController(scenario.cell, scenario.grasp, scenario.path, dt=dt, constraints=[clearance])
    controller.reset(scenario.q_start)
    limit = next(limit for limit in clearance.labels if set(limit.between) == {"object", "cart"})
    distances, taken = [], []
    for i in range(steps):
        clearance.move("cart", place(i * dt), (0.0, 0.3, 0.0, 0.0, 0.0, 0.0))
        taken.append(controller.step())
        distances.append(clearance.measured(limit, taken[-1].q).distance or 0.0)
    return distances, taken, clearance


@pytest.mark.slow
@pytest.mark.parametrize("height", [0.18, 0.34])
def test_the_object_gives_way_to_a_body_that_moves(lift: Scenario, height: float) -> None:
    distances, steps, _ = _cart(lift, give_way=True, steps=800, height=height)
    assert min(distances) >= MARGIN
    assert any(step.status is Status.OFF_PATH for step in steps)
    assert max(step.given_up.chain for step in steps) == 0.0
    # At 340 mm an arm is stretched; joints that turned round there at full speed would part the arms by 0.2 mm.
    chain = Chain(lift.cell, lift.grasp)
    parted = [np.ptp(chain.errors(chain.carried(step.q_next), lift.path.pose(0.0))[:, :3], axis=0) for step in steps]
    assert np.max(parted) < 1e-6
    named = {limit for step in steps for limit in step.binding if limit.kind is LimitKind.ACCELERATION}
    assert all(f"{limit.arm}/{limit.joint}" in lift.cell.joint_names for limit in named)
    assert bool(named) == (height == 0.34)


@pytest.mark.slow
def test_nothing_comes_closer_to_a_body_that_closes_in(lift: Scenario) -> None:
    distances, steps, clearance = _cart(lift, give_way=False)
    assert max(np.abs(step.given_up.off_path).max() for step in steps) < 1e-9  # it stays on its path
    d = np.array(distances)
    late = d[:-1] - MARGIN < 0.3 * 0.4  # the arms need that long to stop
    assert late.sum() > 100
    assert (-np.diff(d)[late] / 0.004).max() <= 0.3 + 1e-3  # the cart's own speed
    assert clearance.quiet.slack < 0.0  # never certified


def test_arms_brake_within_their_accelerations_on_the_path_and_rest_before_the_margin(lift: Scenario) -> None:
    limited = replace(lift, cell=lift.cell.with_limits(acceleration=5.0))
    distances, steps, _ = _cart(limited, give_way=False, steps=450, height=0.34)
    assert max(np.abs(step.given_up.off_path).max() for step in steps) < 1e-6
    assert max(step.given_up.chain for step in steps) == 0.0
    late = int(np.argmax(np.array(distances) < MARGIN))  # the cart comes on
    assert late > 0
    assert all(step.rate < 1e-9 for step in steps[late:])


def test_a_body_that_comes_on_is_named_and_an_overlap_holds(lift: Scenario) -> None:
    cell, dt, middle = lift.cell, 0.004, (lift.path.pose(0.0) * lift.T_object_body).translation
    scene = scene_of(lift, moving=[Body("cart", Sphere(0.1), pin.SE3.Identity())])
    clearance = Clearance(scene)
    controller = QPController(cell, lift.grasp, lift.path, dt=dt, constraints=[clearance])
    clearance.move("cart", pin.SE3(np.eye(3), middle + np.array([0.0, 0.0, 0.6])))
    controller.reset(lift.q_start)
    limit = next(limit for limit in clearance.labels if set(limit.between) == {"object", "cart"})
    kinds = set()
    for i in range(150):
        height = 0.25 - 0.002 * i if i < 100 else 0.6  # through the plate, and away
        clearance.move("cart", pin.SE3(np.eye(3), middle + np.array([0.0, 0.0, height])), (0, 0, -0.5, 0, 0, 0))
        step = controller.step()
        distance = clearance.measured(limit, step.q).distance
        assert distance is not None
        inside, named = distance < MARGIN - 1e-6, limit in step.binding
        overlaps = distance < -1e-6
        kinds.add((inside, overlaps))
        assert named or not inside, (i, distance, step)
        if inside:
            assert "object and cart" in step.reason, (i, distance, step)
        assert (step.status is Status.HOLDING) == overlaps, (i, distance, step)
        if overlaps:
            assert step.cause is Cause.CLEARANCE
            assert "overlap" in step.reason
    assert kinds == {(False, False), (True, False), (True, True)}


def test_links_that_overlap_hold_while_a_body_moves(lift: Scenario) -> None:
    """Arms that give way to a body may have no room left but each other's."""
    scene = scene_of(lift, moving=[Body("cart", Sphere(0.1), pin.SE3(np.eye(3), np.array([5.0, 0.0, 0.0])))])
    clearance = Clearance(scene, give_way=True)
    clearance.check(lift.q_start)
    rng, cell, found = np.random.default_rng(0), lift.cell, 0
    for _ in range(30):
        q = cell.configuration(cell.positions(lift.q_start) + rng.uniform(-1.5, 1.5, cell.nv))
        limits = [clearance.measured(limit, q) for limit in clearance.labels if limit.between]
        deep = [limit for limit in limits if limit.distance is not None and limit.distance < -1e-3]
        clearance.move("cart", pin.SE3(np.eye(3), np.array([5.0, 0.0, 0.0])))
        if not deep:
            clearance.rows_by_label(q, 0.004, blind=True)
            continue
        found += 1
        worst = min(deep, key=lambda limit: limit.distance or 0.0)
        with pytest.raises(ConstraintTrouble, match=f"{worst.between[0]} and {worst.between[1]} overlap by") as raised:
            clearance.rows_by_label(q, 0.004, blind=True)
        assert raised.value.cause is Cause.CLEARANCE
    assert 0 < found < 30


def test_rows_hold_while_nobody_says_where_a_body_is(lift: Scenario) -> None:
    # The path is not known ahead, so rows alone keep the plate below the post; the arms come to rest before it.
    blind = replace(plate_and_post(), path=Opaque(plate_and_post().path, known_ahead=False))
    cell = blind.cell.with_limits(acceleration=5.0)
    cart = Body("cart", Sphere(0.1), pin.SE3(np.eye(3), np.array([5.0, 0.0, 0.0])))
    scene = CollisionScene.of(replace(blind, cell=cell), margin=MARGIN, moving=[cart])
    clearance = Clearance(scene)
    controller = QPController(cell, blind.grasp, blind.path, dt=0.004, constraints=[clearance])
    controller.reset(blind.q_start)
    for i in range(440):
        if i < 400:
            clearance.move("cart", cart.placement)
        step = controller.step()
    assert step.status is Status.HOLDING
    assert "cart" in step.reason
    with pytest.raises(ConstraintTrouble) as raised:
        clearance.rows_by_label(step.q, 0.004, blind=True)
    pairs = {frozenset(clearance.labels[k].between) for k in raised.value.rows.which}
    assert frozenset(("object", "post")) in pairs


def test_a_body_that_nobody_moves_holds_by_name(lift: Scenario) -> None:
    scene = scene_of(lift, moving=[Body("cart", Sphere(0.1), pin.SE3(np.eye(3), np.array([5.0, 0.0, 0.0])))])
    controller = QPController(lift.cell, lift.grasp, lift.path, dt=0.004, constraints=[Clearance(scene)])
    controller.reset(lift.q_start)
    for _ in range(40):
        step = controller.step()
    assert step.status is Status.HOLDING
    assert "cart" in step.reason
    with pytest.raises(UnknownNameError, match="van"):
        Clearance(scene).move("van", np.eye(4))


# -- cell files ------------------------------------------------------------------------------------------------------

TABLE = """
[collision]
margin_m = 0.02
ignored = [["left", "right"]]
margins = [{ between = ["object", "post"], margin_m = 0.03 }]

[[collision.obstacles]]
name = "post"
shape = "capsule"
radius_m = 0.03
length_m = 0.1
at = { xyz_m = [0.0, 0.1, 0.54] }
"""


@pytest.mark.slow
def test_a_cell_file_says_what_to_keep_away_from(tmp_path: Path) -> None:
    file = tmp_path / "bar.toml"
    file.write_text(BAR.read_text(encoding="utf-8") + TABLE, encoding="utf-8")
    task = load_cell_file(file)
    recording = task.run()
    entry = recording.metadata["clearance"]
    assert entry["avoided"]
    assert not recording.finished
    assert entry["closest_m"] >= 0.02 - 1e-6
    assert any("post" in limit.between for limits in recording.bindings for limit in limits)
    file.write_text(BAR.read_text(encoding="utf-8"), encoding="utf-8")
    free = load_cell_file(file).run()
    assert not free.metadata["clearance"]["avoided"]
    assert evaluate(task.scenario.cell, free, read_run(task.scenario.cell, free))[-1].holds


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("radius_m = 0.03\n", "", "radius_m"),
        ('shape = "capsule"', 'shape = "cone"', "shape"),
        ("radius_m = 0.03", "radius_m = nan", "radius_m"),
        ('["object", "post"]', '["object", "pots"]', "pots"),
        ("margin_m = 0.02", "margin_m = -1", "margin_m"),
    ],
)
def test_bad_tables_are_named(tmp_path: Path, old: str, new: str, said: str) -> None:
    file = tmp_path / "bar.toml"
    file.write_text(BAR.read_text(encoding="utf-8") + TABLE.replace(old, new), encoding="utf-8")
    with pytest.raises(CellFileError, match=said):
        load_cell_file(file)


def test_bodies_that_overlap_have_a_finite_depth(lift: Scenario) -> None:
    # coal's search of a depth may fail, and then answers −1.8e308.
    distances = Distances(CollisionScene.of(lift).built)
    distances._results = [SimpleNamespace(min_distance=-np.finfo(float).max) for _ in distances._results]  # type: ignore[misc]
    d = distances.all(lift.q_start)
    assert (d < 0.0).all()
    assert np.isfinite(2.0 * d).all()
    assert distances.one(0) == d[0]


# -- the work of a step ------------------------------------------------------------------------------------------------


def posts_around(lift: Scenario, count: int) -> list[Body]:
    """Spheres 1.3 to 1.6 m from the object, none of them in its way."""
    rng, middle = np.random.default_rng(8), lift.path.pose(0.0).translation
    ways = rng.normal(size=(count, 3)) * (1.0, 1.0, 0.2)
    ways *= rng.uniform(1.3, 1.6, (count, 1)) / np.linalg.norm(ways, axis=1)[:, None]
    return [Body(f"post {i}", Sphere(0.03), pin.SE3(np.eye(3), middle + way)) for i, way in enumerate(ways)]


@pytest.mark.core
def test_a_step_asks_for_few_distances(monkeypatch: pytest.MonkeyPatch) -> None:
    lift, asked, per_step = paper_lift(time_law="quintic"), [0], []
    ask = pin.computeDistance

    def counts(*arguments: Any) -> Any:
        asked[0] += 1
        return ask(*arguments)

    monkeypatch.setattr(pin, "computeDistance", counts)
    clearance = Clearance(CollisionScene.of(lift, obstacles=posts_around(lift, 12), margin=0.005))
    controller = QPController(lift.cell, lift.grasp, lift.path, dt=2e-3, constraints=[clearance])
    controller.reset(lift.q_start)
    for _ in range(1500):
        asked[0] = 0
        step = controller.step()
        per_step.append(asked[0])
    assert step.finished
    assert step.status is Status.TRACKING
    assert max(per_step) <= 1  # the core's own bounds suffice; where a knot asked for all at once it was up to 60
    distances = Distances(clearance.scene.built)
    distances.place(lift.q_start)
    distances.one(0)
    assert asked[0] > 0  # what is asked is counted
