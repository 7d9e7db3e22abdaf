"""What relaxes forces, in closed form: compliances, presses, silence, delays, contacts, and arms that let go."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from coopqp.core._core import BY_RELEASE, NOTHING_MORE

from coopqp import ForceController, ForceOptions, Grasp, InvalidInputError, QPController, Status, inverse_kinematics
from coopqp.control.core.force_memory import relaxation_views
from coopqp.forces import Grip, internal_wrenches
from coopqp.forces.admittance import Relaxation
from coopqp.forces.holding import Holding, bearing
from coopqp.forces.presses import of_grip
from coopqp.model import CellState
from coopqp.paths.grasp_motion import HAND_OVER_S
from coopqp.planning import Payload
from coopqp.scenarios import palm_box, paper_lift
from coopqp.spatial import Array

LIFT, PALMS, STIFF, DT = paper_lift(time_law="quintic"), palm_box(), 2e4, 0.01
STATE = CellState(LIFT.cell, LIFT.q_start)
TWISTS = np.array([X.action @ STATE.jacobian(k) for k, X in enumerate(LIFT.grasp.T_object_tool)])
STILL = [pin.SE3.Identity()] * 3
#: Shares of the arms in the object's pose, alike in all directions.
SHARES = np.array([0.5, 0.3, 0.2])[:, None] * np.ones((3, 6))
PALM = Grip(kind="palm", friction=0.6, radius=0.06)


def shares_of(holds: Any) -> Array:
    held = np.array(holds, dtype=float)[:, None] * (SHARES if len(holds) == 3 else np.full((2, 6), 0.5))
    return np.asarray(held / held.sum(axis=0))


def relaxation(**options: Any) -> Relaxation:
    settings = ForceOptions(**{"stiffness": STIFF, "filter_time": 0.0, "delay": 0.0, **options})
    made = Relaxation(LIFT.cell, LIFT.grasp, settings, dt=DT, shares_of=shares_of)
    made.look(LIFT.q_start)
    return made


def of_palms(**options: Any) -> Relaxation:
    payload = Payload(mass=20.0, centre=[0.1, 0.0, 0.0])
    settings = ForceOptions(
        **{"stiffness": 1e4, "palms": (PALM, PALM), "squeeze": 200.0, "payload": payload, **options}
    )
    return Relaxation(PALMS.cell, PALMS.grasp, settings, dt=DT, shares_of=shares_of)


def blocks(C: Array) -> Array:
    return np.asarray(sum(np.kron(np.diag(np.eye(len(C))[k]), own) for k, own in enumerate(C)))


def apart(shares: Array) -> Array:
    """Displacements of the arms less their share of all (6 N, 6 N)."""
    n = len(shares)
    return np.eye(6 * n) - np.tile(np.hstack([np.diag(s) for s in shares]), (n, 1))


# -- compliances ---------------------------------------------------------------------------------------------------


def test_grasps_answer_forces_by_the_compliance_of_the_servos() -> None:
    """Less the common motion; with each arm's stiffness as it is found, over what is found of all."""
    made = relaxation()
    soft = TWISTS @ TWISTS.swapaxes(1, 2) / STIFF
    np.testing.assert_allclose(relaxation_views(made.memory, 3)["yields"], apart(SHARES) @ blocks(soft), atol=1e-12)
    assert not made.aged
    made.scalars.age = 0.11
    assert made.aged
    made.take_stiffness(1.7, np.array([2.0, 0.5, 1.0]), LIFT.q_start)
    assert not made.aged
    assert made.stiffer == 1.7
    own = soft / np.array([2.0, 0.5, 1.0])[:, None, None]
    np.testing.assert_allclose(relaxation_views(made.memory, 3)["yields"], apart(SHARES) @ blocks(own), atol=1e-12)
    compliances = relaxation_views(made.memory, 3)["compliances"].reshape(18, 18)
    np.testing.assert_allclose(compliances, blocks(own), atol=1e-12)
    made.begin(np.zeros((3, 6)))
    assert made.stiffer == 1.0
    made.look(LIFT.q_start)
    np.testing.assert_allclose(relaxation_views(made.memory, 3)["yields"], apart(SHARES) @ blocks(soft), atol=1e-12)


@pytest.mark.parametrize(("found", "taken"), [(0.04, 0.05), (0.06, 0.06), (19.0, 19.0), (21.0, 20.0)])
def test_a_measured_stiffness_is_answered_within_a_range(found: float, taken: float) -> None:
    made = relaxation()
    made.take_stiffness(found, np.ones(3), LIFT.q_start)
    assert made.stiffer == taken


@pytest.mark.parametrize("payload", [False, True])
def test_sensors_are_compared_with_servos_and_the_load_that_is_fed_forward(payload: bool) -> None:
    """What a load explains counts as fed forward, if none is told."""
    told = Payload(mass=15.0, centre=[0.1, -0.2, 0.05]) if payload else None
    made, rng = relaxation(payload=told), np.random.default_rng(0)
    wrenches = rng.normal(size=(3, 6))
    made.step(wrenches, DT)
    bent = 1e-5 * rng.normal(size=18)
    R = LIFT.grasp.carried(STATE)[0].rotation
    back = [np.linalg.solve(A @ A.T / STIFF, A @ d) for A, d in zip(TWISTS, bent.reshape(3, 6), strict=True)]
    X = LIFT.grasp.T_object_tool
    off = np.array([x.actionInverse.T @ w for x, w in zip(X, wrenches, strict=True)]) - back
    if told is None:
        load = off.sum(axis=0)
    else:
        weight = R.T @ [0.0, 0.0, 9.81 * 15.0]
        load = np.r_[weight, np.cross([0.1, -0.2, 0.05], weight)]
    maps, metric = np.hstack([x.actionInverse.T for x in X]), np.tile([1.0] * 3 + [100.0] * 3, 3)
    least = (maps.T @ np.linalg.solve((maps / metric) @ maps.T, load) / metric).reshape(3, 6)
    fed = np.array([x.actionInverse.T @ w for x, w in zip(X, least, strict=True)])
    found = made.off_servos(LIFT.q_start + bent, LIFT.q_start)
    np.testing.assert_allclose(found, off - fed, atol=2e-3 * np.abs(off).max())


# -- presses -------------------------------------------------------------------------------------------------------


def pressed(answer: Any, *, grows: float = 0.0) -> tuple[int, int, Relaxation]:
    """Steps until the grasps stop, and until all is learned; ``answer`` are forces by how far the grasps have moved."""
    made, stopped, before = relaxation(filter_time=0.02, delay=0.01), 0, -1.0
    way = made.holding.inward
    G = of_grip(TWISTS @ TWISTS.swapaxes(1, 2) / STIFF)
    for i in range(400):
        size = float(np.abs(made.shift).max() / np.abs(way).max())
        if size > before and i > 12:
            stopped = i
        before = size
        natural = grows * DT * i * (G @ way.ravel()).reshape(3, 6)
        made.internal[:] = answer(size, (G @ way.ravel()).reshape(3, 6)) + natural + 0.5
        if made.press(DT):
            return stopped, i, made
    raise AssertionError("no end")


def test_arms_press_at_half_a_millimetre_a_second_until_a_force_is_felt() -> None:
    """3 N, or 0.9 N·m, after 0.01 mm, up to 0.5 mm; they wait before, and after, until all of it is heard."""
    force, torque = np.zeros((3, 6)), np.zeros((3, 6))
    force[1, :3], torque[2, 3:] = [0.0, 0.6, -0.8], [0.6, 0.8, 0.0]
    settled = 0.01 + 4.0 * 0.02 + 2.0 * DT
    wait = int(settled / DT + 1e-9)
    for push, least in ((force, 3.0), (torque, 0.9)):
        for size, distance in ((1.02 * least, 1e-4), (0.98 * least, 5e-4)):
            stopped, done, made = pressed(lambda far, _, p=push, s=size: s * p * (far >= 1e-4 - 1e-9))
            assert np.linalg.norm(made.shift[:, :3], axis=1).max() == pytest.approx(distance, rel=1e-6)
            assert stopped - wait == pytest.approx(distance / (5e-4 * DT), abs=1.5)
            assert done - stopped == pytest.approx(wait, abs=1.5)
    _, _, made = pressed(lambda far, _: 9.0 * force * (far > 0.0))
    assert np.linalg.norm(made.shift[:, :3], axis=1).max() == pytest.approx(1e-5)


@pytest.mark.parametrize("ratio", [0.5, 1.0, 4.0])
@pytest.mark.parametrize("grows", [0.0, 2e-5])
def test_a_press_tells_how_stiff_the_servos_are_also_where_forces_grow(ratio: float, grows: float) -> None:
    _, _, made = pressed(lambda far, stiff: ratio * far * stiff, grows=grows)
    assert made.stiffer == pytest.approx(ratio, rel=5e-3, abs=0.03 if grows else 0.0)


def test_arms_press_towards_the_middle_of_their_grasps() -> None:
    """Less the common motion; the largest by 1 m/m."""
    points = np.array([X.translation for X in LIFT.grasp.T_object_tool])
    way = np.c_[points.mean(axis=0) - points, np.zeros((3, 3))]
    way = (apart(SHARES) @ way.ravel()).reshape(3, 6)
    expected = way / np.linalg.norm(way[:, :3], axis=1).max()
    np.testing.assert_allclose(relaxation().holding.inward, expected, atol=1e-9)


# -- silence, delays, reach ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("lost", "silence"),
    [
        (None, 0.2), (0.0, 0.05), (0.01, 0.05), (0.3, DT * np.log(1e-6) / np.log(0.3)),
        (0.5, DT * np.log(1e-6) / np.log(0.5)), (0.9, DT * np.log(1e-6) / np.log(0.5)),
    ],
)  # fmt: skip
def test_a_sensor_may_be_silent_for_as_long_as_chance_allows(lost: float | None, silence: float) -> None:
    """So many lost samples in a row come once in a million; none are lost more often than half."""
    made = relaxation()
    made.wait_for(lost, DT)
    assert made.scalars.wrench_silence == pytest.approx(silence)


@pytest.mark.parametrize(("delay", "slower", "fine"), [(0.0, 1.0, True), (0.11, 2.0, True), (0.151, 161 / 60, False)])
def test_late_wrenches_are_relaxed_more_slowly(delay: float, slower: float, fine: bool) -> None:
    """So that (d + dt) / T is 0.4; beyond 0.15 s no pace is slow enough."""
    made = relaxation(relax_time=0.15, drift_time=0.2)
    wait = made.scalars.wait_time
    assert wait == pytest.approx(0.3)
    assert made.slow_down(delay, DT) == fine
    assert made.scalars.relax_time == pytest.approx(slower * 0.15)
    assert made.scalars.drift_time == pytest.approx(slower * 0.2)
    assert made.scalars.wait_time == pytest.approx(slower * wait)


def test_how_far_grasps_are_is_a_share_of_their_reach() -> None:
    made, shift = relaxation(reach=0.02, turn=0.1), np.zeros((3, 6))
    shift[1, :3], shift[2, 3:] = [0.006, 0.008, 0.0], [0.0, 0.03, 0.0]
    assert made.far(shift) == pytest.approx(0.5)
    assert made.far(3.0 * shift[::-1] * [1, 1, 1, 0.1, 1, 0.1]) == pytest.approx(1.5)
    assert made.far(shift * [0.0, 0.0, 0.0, 2.0, 2.0, 2.0]) == pytest.approx(0.6)


def held_off(made: Relaxation, offs: dict[int, Array], task: Any) -> Array:
    """Where the arms are if some of them hold the object elsewhere than told, shifted in its frame."""
    tools = [pin.exp6(offs.get(k, np.zeros(6))) * X for k, X in enumerate(task.grasp.T_object_tool)]
    return np.asarray(
        inverse_kinematics(task.cell, Grasp(tuple(tools)), task.path.pose(0.0), task.q_start, limits=False)
    )


def test_grasps_begin_where_the_arms_hold_the_object() -> None:
    """Less the common motion; one that is out of reach is named, with its distance and angle and what may be."""
    made = relaxation(reach=0.01, turn=0.02)
    d = np.array([1e-4, -2e-4, 3e-4, 1e-4, 2e-4, -1e-4])
    expected = (apart(SHARES) @ np.r_[np.zeros(6), d, np.zeros(6)]).reshape(3, 6)
    np.testing.assert_allclose(made.found(held_off(made, {1: d}, LIFT)), expected, atol=3e-7)
    far = {1: np.array([0.0, 0.012, 0.0, 0.0, 0.0, 0.0]), 2: np.array([0.0, 0.0, 0.0, 0.06, 0.0, 0.0])}
    with pytest.raises(InvalidInputError, match=r"arm slave_2 holds .* out of reach \(10 mm, 1\.15") as refused:
        made.found(held_off(made, far, LIFT))
    expected = (apart(SHARES) @ np.r_[np.zeros(6), far[1], far[2]]).reshape(3, 6)
    size, angle = np.linalg.norm(expected[2, :3]), np.linalg.norm(expected[2, 3:])
    assert f"{1e3 * size:.1f} mm and {np.rad2deg(angle):.2f}°" in str(refused.value)
    with pytest.raises(InvalidInputError, match="arm slave_1 holds"):
        made.found(held_off(made, {1: 5.0 * far[1]}, LIFT))
    assert np.abs(made.found(held_off(made, {1: np.array([0.0, 0.013, 0.0, 0.0, 0.0, 0.0])}, LIFT))).max() < 0.01


def test_palms_that_slid_out_of_reach_keep_their_places() -> None:
    made = of_palms(reach=0.01)
    near, far = (np.array([0.0, y, 0.0, 0.0, 0.0, 0.0]) for y in (0.006, 0.015))
    shift = made.found(held_off(made, {1: near}, PALMS))
    np.testing.assert_allclose(shift, [np.zeros(6), near], atol=1e-6)
    assert not made.found(held_off(made, {1: far}, PALMS)).any()


def test_sensors_are_pressed_where_all_arms_can_press_all_ways() -> None:
    """Not by palms, nor where they keep places, or some do not hold, or nobody wants it."""
    assert relaxation().sensor_check(LIFT.q_start, DT) is not None
    mind = np.ones((3, 6))
    mind[1, 2] = 0.0
    for made in (relaxation(presses=False), relaxation(directions=mind)):
        assert made.sensor_check(LIFT.q_start, DT) is None
    assert of_palms().sensor_check(PALMS.q_start, DT) is None
    some = relaxation()
    some.take_holding((True, True, False), (True, True, False), STILL, LIFT.q_start)
    assert some.sensor_check(LIFT.q_start, DT) is None


# -- what touches the object ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("force", "said"),
    [
        ([0.0, 0.0, 40.0], "40 N have pushed it towards +z"), ([-31.0, 0.0, 0.0], "31 N have pushed it towards -x"),
        ([3.0, -29.8, 4.0], "30 N have pushed it towards -y"),
        ([30.0, -40.0, 0.0], "50 N have pushed it towards (0.6, -0.8, 0.0)"),
        ([0.0, 14.0, 48.0], "50 N have pushed it towards +z"),
        ([15.8, 0.0, 47.5], "50 N have pushed it towards (0.3, 0.0, 0.9)"),
        ([0.0, 0.0, 0.0], "0 N have pushed it towards (0.0, 0.0, 0.0)"),
    ],
)  # fmt: skip
def test_a_push_is_told_by_an_axis_or_its_direction(force: Any, said: str) -> None:
    made = relaxation(payload=Payload(mass=20.0))
    relaxation_views(made.memory, 3)["push"][2] = force
    assert made.contact() == f"{said} of the world (from 39 N on)"


def test_a_contact_is_a_fifth_of_the_weight_and_25_newtons_at_least() -> None:
    """Where grips hold a payload that is told; palms and those who say nothing are held by no contact."""
    limits = [relaxation(payload=Payload(mass=m)).scalars.contact_limit for m in (1.0, 12.7, 12.8, 50.0)]
    np.testing.assert_allclose(limits, [25.0, 25.0, 0.2 * 9.81 * 12.8, 0.2 * 9.81 * 50.0])
    assert relaxation(payload=Payload(mass=50.0), contact_limit=7.0).scalars.contact_limit == 7.0
    assert relaxation().scalars.contact_limit == np.inf
    assert of_palms().scalars.contact_limit == np.inf
    assert of_palms(contact_limit=9.0).scalars.contact_limit == 9.0
    m = relaxation(payload=Payload(mass=5.0, centre=[1.0, 2.0, 3.0]), delay=0.005).scalars
    np.testing.assert_allclose([m.weight_x, m.weight_y, m.weight_z, m.load_mass], [0.0, 0.0, 5.0 * 9.81, 5.0])
    assert m.contact_late == pytest.approx(0.015)


def test_what_the_core_waits_for_before_the_object_moves() -> None:
    """Twice the relax time for grips; half a second of a squeeze of which a tenth may be missing for palms."""
    m, p = relaxation(relax_time=0.2, dead_band=4.0).scalars, of_palms().scalars
    assert (m.has_palms, m.wait_time, m.pressed_below, m.move_below) == (0.0, 0.4, np.inf, 8.0)
    assert (p.has_palms, p.wait_time, p.pressed_below, p.move_below) == (1.0, 0.5, 20.0, 20.0)
    assert relaxation(dead_band=1.0).scalars.move_below == 5.0
    assert (m.force_cap, m.rigid, p.rigid, m.correction_share, p.correction_share) == (1.0, 1.0, 0.0, 0.0, 1.0)
    assert p.pressed_with == 200.0


# -- who holds the object ------------------------------------------------------------------------------------------


def test_an_arm_that_presses_on_the_object_does_not_let_go() -> None:
    made = relaxation()
    for force, allowed, why in ((4.9, 0.7, NOTHING_MORE), (5.1, 0.0, BY_RELEASE)):
        made.scalars.allowed, made.scalars.why = 0.7, NOTHING_MORE
        made.internal[1, :3] = force * np.array([0.6, 0.0, -0.8])
        made.internal[0, :3], made.internal[1, 3:] = 90.0, 90.0
        assert made.allow_release(1) == allowed
        assert made.scalars.why == why
    assert made.scalars.why_arm == 1
    palms = of_palms()
    palms.scalars.allowed, palms.internal[:] = 0.7, 500.0
    assert palms.allow_release(0) == 0.7


def test_an_arm_that_lets_go_or_attaches_has_no_internal_force_at_first() -> None:
    """What it has felt is forgotten; the others' drift is counted from their common motion."""
    made, rng = relaxation(), np.random.default_rng(0)
    views, all_, two = relaxation_views(made.memory, 3), (True,) * 3, (True, True, False)
    for before, after in ((all_, two), (two, all_)):
        drift = rng.normal(size=(3, 6))
        made.internal[:], views["felt"][:], views["freed"][:], views["drift"][:] = 1.0, 2.0, 3.0, drift
        made.shift[2], views["held"][2], made.scalars.relax_blend = 0.4, 0.1, 1.0
        made.take_holding(after, after, STILL, LIFT.q_start)
        for k in range(3):
            kept = before[k] == after[k]
            assert (made.internal[k] == (1.0 if kept else 0.0)).all()
            assert (views["felt"][k] == (2.0 if kept else 0.0)).all()
            assert views["freed"][k] == (3.0 if kept else 0.0)
        assert (views["held"][2] == (0.4 if after[2] else 0.1)).all()
        held = np.repeat(np.array(after, dtype=float), 6)
        expected = held[:, None] * apart(shares_of(after)) * held
        np.testing.assert_allclose(views["drift"].ravel(), expected @ drift.ravel(), atol=1e-12)
        assert made.scalars.relax_blend == 0.0
        np.testing.assert_array_equal(views["holding"], after)
    made.internal[:] = 1.0
    made.take_holding(all_, all_, STILL, LIFT.q_start)
    assert (made.internal == 1.0).all()


def holding(**options: Any) -> Holding:
    return Holding(LIFT.cell, LIFT.grasp, ForceOptions(**{"stiffness": STIFF, **options}), shares_of)


def test_maps_of_arms_that_hold_leave_the_others_out() -> None:
    held, two = holding(), (True, False, True)
    np.testing.assert_allclose(held.relative, apart(SHARES), atol=1e-12)
    np.testing.assert_allclose(held.felt, np.eye(18), atol=1e-9)
    assert (held.everywhere, held.first) == (True, 0)
    assert held.take((False, True, True), (False, True, True), STILL)
    assert (held.everywhere, held.first) == (False, 1)
    held.start(two, two, STILL)
    rows = np.repeat(np.array(two, dtype=float), 6)
    np.testing.assert_allclose(held.relative, rows[:, None] * apart(shares_of(two)) * rows, atol=1e-12)
    assert not held.load_shares[6:12].any()
    np.testing.assert_allclose(held.load_shares.reshape(3, 6, 6).sum(axis=0), np.eye(6), atol=1e-9)
    points = np.array([X.translation for X in LIFT.grasp.T_object_tool])
    way = np.c_[points[[0, 2]].mean(axis=0) - points, np.zeros((3, 3))]
    way = (held.relative @ way.ravel()).reshape(3, 6)
    np.testing.assert_allclose(held.inward, way / np.linalg.norm(way[:, :3], axis=1).max(), atol=1e-9)


def test_arms_mind_the_forces_along_their_own_axes() -> None:
    mind = np.array([[0, 0, 0, 0, 0, 0], [1, 1, 0, 0, 0, 1], [0, 0, 1, 1, 1, 1]], dtype=float)
    felt, w = holding(directions=mind).felt, np.random.default_rng(0).normal(size=(3, 6))
    X = LIFT.grasp.T_object_tool
    there = np.concatenate([x.actionInverse.T @ own for x, own in zip(X, w, strict=True)])
    expected = np.concatenate([x.actionInverse.T @ (m * own) for x, m, own in zip(X, mind, w, strict=True)])
    np.testing.assert_allclose(felt @ there, expected, atol=1e-9)


def test_the_load_goes_over_evenly_and_the_filter_follows() -> None:
    """Within the time of a hand-over; it is over when what the sensors tell of it has settled, too."""
    held, dt, late_by = holding(filter_time=0.03), 0.013, 0.03
    assert not held.take((True,) * 3, (True,) * 3, STILL)
    assert not held.hand_on(dt)
    old = held.load_shares.copy()
    assert held.take((True,) * 3, (True, True, False), STILL)
    goal = np.zeros((18, 6))
    alone = Holding(LIFT.cell, LIFT.grasp, ForceOptions(stiffness=STIFF), shares_of)
    alone.start((True, True, False), (True, True, False), STILL)
    goal[:] = alone.load_shares
    late, time, over = old.copy(), 0.0, None
    for i in range(200):
        assert held.hands_over == (over is None)
        if over is not None:
            assert not held.hand_on(dt)
            break
        assert held.hand_on(dt)
        time += dt
        share = min(time / HAND_OVER_S, 1.0)
        np.testing.assert_allclose(held.load_shares, old + share * (goal - old), atol=1e-9)
        late += dt / (dt + late_by) * (old + share * (goal - old) - late)
        views = relaxation_views(relaxation(payload=Payload(mass=1.0)).memory, 3)
        payload = Payload(mass=1.0, centre=[0.1, 0.2, 0.3])
        if i % 20 == 0:
            other = Holding(LIFT.cell, LIFT.grasp, ForceOptions(stiffness=STIFF, payload=payload), shares_of)
            other.restore(held.kept())
            other.put(views, 1.0)
            lever = np.array([[0.0, -0.3, 0.2], [0.3, 0.0, -0.1], [-0.2, 0.1, 0.0]])
            np.testing.assert_allclose(views["carries"], late @ np.vstack([np.eye(3), lever]), atol=1e-9)
        if share == 1.0 and np.abs(late - goal).max() < 1e-4:
            over = i
    assert over is not None
    np.testing.assert_allclose(held.load_shares, goal, atol=1e-12)


def test_an_arm_that_lets_go_at_once_bears_nothing_at_once() -> None:
    held, two = holding(), (True, True, False)
    assert held.take(two, two, STILL)
    assert not held.load_shares[12:].any()
    np.testing.assert_allclose(held.load_shares.reshape(3, 6, 6).sum(axis=0), np.eye(6), atol=1e-9)
    assert held.hands_over


def test_arms_bear_the_load_that_do_not_let_go_soon() -> None:
    """Ahead along the program or back along it; all that hold, where none would be left."""

    class Motion:
        def holds(self, clock: float) -> tuple[bool, ...]:
            return (True, True, clock < 1.0) if clock < 5.0 else (False, False, True)

    motion: Any = Motion()
    early, late = 1.0 - 1.01 * HAND_OVER_S, 1.0 - 0.99 * HAND_OVER_S
    assert bearing((True,) * 3, motion, early, 1) == (True,) * 3
    assert bearing((True,) * 3, motion, late, 1) == (True, True, False)
    assert bearing((True,) * 3, motion, late, -1) == (True,) * 3
    assert bearing((True,) * 3, motion, late, 0) == (True,) * 3
    assert bearing((True, True, False), motion, 1.0 + 0.99 * HAND_OVER_S, -1) == (True, True, False)
    assert bearing((True, True, False), motion, 5.0 - 0.5 * HAND_OVER_S, 1) == (True, True, False)


def test_palms_aim_at_the_internal_wrench_of_their_squeeze() -> None:
    made = of_palms()
    views, press = relaxation_views(made.memory, 2), np.zeros((2, 6))
    press[:, 2] = 200.0
    expected = internal_wrenches(press, PALMS.grasp)
    np.testing.assert_allclose(views["squeezed"], expected, atol=1e-9)
    np.testing.assert_allclose(views["target"], expected, atol=1e-9)
    made.holding.put(views, 1.25)
    np.testing.assert_allclose(views["target"], 1.25 * expected, atol=1e-9)
    np.testing.assert_allclose(views["squeezed"], expected, atol=1e-9)


# -- the controller ------------------------------------------------------------------------------------------------


def test_a_sensor_that_falls_silent_ends_the_presses_and_the_grasps_go_back() -> None:
    """By their ramp: the rest of the way fades with its time."""
    made = ForceController(
        QPController(LIFT.cell, LIFT.grasp, LIFT.path, dt=DT), {"stiffness": STIFF, "ramp_time": 0.1}
    )
    made.reset(LIFT.q_start)
    rng, q = np.random.default_rng(0), LIFT.q_start
    for _ in range(36):
        q = made.step(q, wrenches=rng.normal(size=(3, 6))).q_next
    for _ in range(40):
        step = made.step(q)
        q = step.q_next
        if step.status is Status.HOLDING:
            break
    assert "no new wrench" in step.reason
    far = [made.shift]
    for _ in range(5):
        q = made.step(q).q_next
        far.append(made.shift)
    assert np.abs(far[0]).max() > 1e-6
    for before, after in itertools.pairwise(far):
        np.testing.assert_allclose(after, 0.9 * before, atol=1e-15)
    assert made.sensors is None
