"""Supervision: the effect of noise on the thresholds is independent of the length of a step."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from marks import slow_but_first

from coopqp import Cause, InvalidInputError, QPController, QPOptions, Status, SupervisionOptions
from coopqp.control.monitoring.drift import Drift
from coopqp.control.monitoring.stress import StressWatch
from coopqp.control.monitoring.supervision import Supervision, Watch
from coopqp.native import available_kernels, constants
from coopqp.scenarios import mixed_cell, paper_lift
from coopqp.spatial import Array

pytestmark = pytest.mark.core


@pytest.mark.slow
@pytest.mark.parametrize("steps", [40, 41, 100, 400])
def test_the_noise_margin_stays_a_number_for_long_steps(steps: int) -> None:
    """Noise holds no step, whoever runs it, and after it the watch still sees an arm that is not where it should be."""
    lift = paper_lift()
    loops = [
        QPController(lift.cell, lift.grasp, lift.path, dt=lift.path.duration / steps, options=QPOptions(kernel=kernel))
        for kernel in available_kernels()
    ]
    for loop in loops:
        loop.reset(lift.q_start)
    q, rng = lift.q_start, np.random.default_rng(0)
    for _ in range(steps):
        measured = q + rng.uniform(-1e-4, 1e-4, size=q.size)
        done = [loop.step(measured) for loop in loops]
        q = done[-1].q_next
        for step in done:
            np.testing.assert_allclose(step.velocity, done[-1].velocity, rtol=0.0, atol=1e-9)
            assert step.status is Status.TRACKING, step.explain()
    if steps < 100:
        return  # such steps are too long to tell arms that are apart from noise
    for _ in range(10):
        measured = q + np.repeat([0.0, 0.01, 0.0], 6) + rng.uniform(-1e-4, 1e-4, size=q.size)
        done = [loop.step(measured) for loop in loops]
    for step in done:
        assert step.status is Status.HOLDING
        assert "arm slave_1" in step.reason


@pytest.mark.parametrize("dt", [1e-4, 0.0075, 0.07, 0.075, 0.2, 1.0])
def test_the_noise_counts_alike_with_steps_of_any_length(dt: float) -> None:
    """By the margin alone: where arms are out of step by noise only, nothing is slowed."""
    lift = paper_lift()
    rng = np.random.default_rng(0)
    watch = Supervision(lift.cell, lift.grasp, SupervisionOptions(stall_samples=None, filter_time=0.0))
    for _ in range(400):
        seen = watch.watch(lift.q_start, lift.q_start, rng.normal(size=(3, 6)) * 1e-4, dt)
        assert np.isfinite(seen.rate_cap)
        assert not seen.hold


@pytest.mark.parametrize(("late", "amplitude", "dt"), [(10, 0.05, 1e-3), (8, 0.3, 2.5e-3), (20, 0.5, 1e-3)])
def test_an_arm_that_turns_round_late_has_not_stalled(late: int, amplitude: float, dt: float) -> None:
    """With latency, a reversing arm seems to stand while its command moves and the other arms follow."""
    lift = paper_lift()
    watch = Supervision(lift.cell, lift.grasp, SupervisionOptions(), dt=dt)
    still = np.zeros((3, 6))

    def at(t: float) -> Array:
        q = np.full(18, 0.3 * t)
        q[6:12] = amplitude * np.cos(2.0 * np.pi * t)  # slave_1 turns round at 0.5 s
        return q

    for i in range(round(1.0 / dt)):
        seen = watch.watch(at(dt * max(i - late, 0)), at(dt * i), still, dt)
        assert not seen.hold, f"{dt * i:.4f} s: {seen.reason}"


@pytest.mark.parametrize("speed", [0.06, 0.3, 1.0])
def test_a_stall_is_known_once_it_opens_a_gap(speed: float) -> None:
    """A stall is detected when a joint is 0.5 mrad from its command, plus the samples of the decision."""
    lift = paper_lift()
    watch = Supervision(lift.cell, lift.grasp, SupervisionOptions(), dt=1e-3)
    still, stalls = np.zeros((3, 6)), 100
    for i in range(200):
        command = np.full(18, 1e-3 * i * speed)
        measured = command.copy()
        measured[12:] = 1e-3 * min(i, stalls) * speed
        seen = watch.watch(measured, command, still, 1e-3)
        if seen.hold:
            break
    assert i - stalls == max(4, np.ceil(0.5 / speed))
    assert seen.arm == 2
    assert "stalled" in seen.reason


@pytest.mark.parametrize(
    "options",
    [
        {"stiffness": 0.0},
        {"stiffness": np.nan},
        {"stiffness": (1e5, -1.0)},
        {"stiffness": 1e5, "force_limit": 0.0},
        {"stiffness": 1e5, "servo_delay": -1e-3},
    ],
)
def test_bad_stiffness_and_limits_are_named(options: dict[str, Any]) -> None:
    with pytest.raises(InvalidInputError, match="SupervisionOptions"):
        SupervisionOptions(**options)


NOT_POSITIVE = (0.0, -1.0, np.nan, np.inf, None, "far", [1.0])
NEGATIVE = NOT_POSITIVE[1:]


@pytest.mark.parametrize(
    ("option", "bad", "good"),
    [
        *((name, NOT_POSITIVE, (1.0, 1e-9)) for name in ("fault_from", "silent_time", "joint_jump", "force_limit")),
        ("hold_from", NOT_POSITIVE, (0.00025, 1.0)),
        ("slow_from", (*NOT_POSITIVE[:4], 0.0008), (None, 1e-9, 0.00075)),
        *(
            (name, NEGATIVE, (0.0, 1.0))
            for name in ("servo_delay", "filter_time", "noise_margin", "recovery_time", "let_in")
        ),
        ("stall_share", (*NOT_POSITIVE, 1.1), (1e-9, 1.0)),
        ("stall_samples", (0, -1, 1.5, "four", 10_001), (None, 1, 10_000)),
        ("dt_range", (0.5, (0.5,), (0.0, 5.0), (1.1, 5.0), (0.1, 0.9), (0.1, np.inf), None), ((1.0, 1.0), (0.1, 9.0))),
    ],
)  # fmt: skip
def test_an_option_out_of_range_is_named(option: str, bad: tuple[Any, ...], good: tuple[Any, ...]) -> None:
    for value in bad:
        with pytest.raises(InvalidInputError, match=f"SupervisionOptions: {option}"):
            SupervisionOptions(**{option: value})
    for value in good:
        assert getattr(SupervisionOptions(**{option: value}), option) == value


def test_stiffness_is_one_number_or_one_per_joint() -> None:
    lift = paper_lift()
    for stiffness in (1e5, np.full(18, 1e5), [1e5] * 18):
        options = SupervisionOptions(stiffness=stiffness)
        assert Supervision(lift.cell, lift.grasp, options)._stress is not None
        assert options == SupervisionOptions(stiffness=stiffness)
    with pytest.raises(InvalidInputError, match="17 numbers for 18 joints"):
        Supervision(lift.cell, lift.grasp, SupervisionOptions(stiffness=(1e5,) * 17))


def test_arms_that_press_too_hard_are_held_until_they_press_half_as_hard() -> None:
    lift = paper_lift()
    options = SupervisionOptions(stiffness=1e5, force_limit=100.0, filter_time=0.0)
    watch = Supervision(lift.cell, lift.grasp, options)
    still, q, unit = np.zeros((3, 6)), lift.q_start, np.zeros(18)
    unit[7] = 1e-4
    probe = StressWatch(lift.cell, lift.grasp, stiffness=np.full(18, 1e5), delay=0.0, filter_time=0.0)
    probe.read(q - unit, q, 1e-3)
    per_newton = unit / probe.forces[1]
    held, last = [], 0.0
    for force in (50.0, 95.0, 101.0, 90.0, 51.0, 49.0, 95.0):
        for now in np.linspace(last, force, 100):  # slowly
            seen = watch.watch(q - now * per_newton, q, still, 0.01)
        last = force
        held.append(seen.hold)
        assert seen.reason.startswith(f"{force:.0f} N at the grasp of arm slave_1 by its servos (limit") is seen.hold
    assert held == [False, False, True, True, True, False, False]


@pytest.mark.parametrize(("pace", "force"), [(1e3, 75.0), (2.5e3, 50.0), (1e4, 50.0), (100.0, 97.5)])
def test_arms_that_will_press_too_hard_are_held_before_they_do(pace: float, force: float) -> None:
    """A force that would come to its limit within 25 ms holds, from half of it on."""
    lift = paper_lift()
    options = SupervisionOptions(stiffness=1e5, force_limit=100.0, filter_time=0.0)
    watch = Supervision(lift.cell, lift.grasp, options)
    probe = StressWatch(lift.cell, lift.grasp, stiffness=np.full(18, 1e5), delay=0.0, filter_time=0.0)
    unit, dt = 1e-4 * np.eye(18)[7], 1e-4
    probe.read(lift.q_start - unit, lift.q_start, dt)
    grows = pace * dt * unit / probe.forces[1]
    for i in range(round(100.0 / (pace * dt))):
        seen = watch.watch(lift.q_start - i * grows, lift.q_start, np.zeros((3, 6)), dt)
        if seen.hold:
            break
    assert pace * dt * i == pytest.approx(force, abs=5.0 + pace * dt)
    assert "N at the grasp of arm slave_1 by its servos, soon 1" in seen.reason
    assert seen.cause is Cause.TRACKING


def watch_of(**options: Any) -> Callable[[float, float], Watch]:
    """A watch as a function of the object's z [m] and the measured error of slave_1 along x [m], called every 1 ms."""
    lift = paper_lift()
    watch = Supervision(lift.cell, lift.grasp, SupervisionOptions(stall_samples=None, **options))

    def see(z: float, off: float) -> Watch:
        command = np.full(18, z)  # every joint turns by 1 rad for 1 m
        return watch.watch(command, command, np.outer([0.0, off, 0.0], [1.0, 0.0, 0.0, 0.0, 0.0, 0.0]), 1e-3)

    return see


def lifted(*, slope: float = 0.0, lag: float = 0.0, seconds: float = 2.25, **options: Any) -> tuple[Array, Array]:
    """A quintic lift by 0.3 m at the rate of the watch: the caps of the rate, and the error of slave_1 [m].

    The error is ``slope`` times the way plus ``lag`` times the speed.
    """
    see, clock, z, caps, offs = watch_of(**options), 0.0, 0.0, [], []
    off = 0.0
    while clock < seconds and len(caps) < 3e3 * seconds:
        cap = see(z, off).rate_cap
        clock += 1e-3 * cap
        u = min(clock / seconds, 1.0)
        last, z = z, 0.3 * u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
        off = slope * z - lag * (z - last) / 1e-3
        caps.append(cap)
        offs.append(abs(off))
    return np.array(caps), np.array(offs)


@pytest.mark.slow
@pytest.mark.parametrize("seconds", [2.25, 6.0])
def test_a_drift_with_the_way_is_let_in(seconds: float) -> None:
    caps, offs = lifted(slope=8e-3, seconds=seconds)
    assert offs[-1] == pytest.approx(2.4e-3, rel=1e-2)  # it arrives
    assert caps.min() > 0.1
    assert len(caps) < 1.5e3 * seconds
    stopped, offs = lifted(slope=8e-3, seconds=seconds, let_in=0.0)
    assert stopped[-1] < 1e-3
    assert offs[-1] < 1e-3


def test_a_lag_is_not_let_in() -> None:
    caps, offs = lifted(lag=0.01)
    assert caps.min() < 0.5
    assert offs.max() < 1e-3  # unslowed 2.5 mm


@pytest.mark.slow
def test_a_drift_beyond_what_is_let_in_holds() -> None:
    caps, offs = lifted(slope=20e-3)
    assert caps[-1] < 1e-3
    assert 3e-3 < offs[-1] < 4e-3


@pytest.mark.slow
def test_at_rest_nothing_is_let_in() -> None:
    see = watch_of()
    held = [see(0.0, 1e-3 * min(1.0, i / 1000.0)).hold for i in range(5000)]
    assert all(held[1000:])


def test_a_jump_is_let_in_as_slowly_as_a_drift_may_be() -> None:
    """The allowance grows by at most 5 mm/s at 0.25 m/s."""
    see = watch_of()
    held = [see(0.25e-3 * i, 0.0 if i < 1000 else 1.5e-3).hold for i in range(1150)]
    assert not any(held[:1000])
    assert all(held[1005:1100])


def test_a_turn_parts_the_arms_at_their_grasps() -> None:
    """If one arm turns the object about its origin, the distance between the grasps shows it."""
    lift = paper_lift()
    watch = Supervision(lift.cell, lift.grasp, SupervisionOptions(stall_samples=None, filter_time=0.0))
    q, away = lift.q_start, np.zeros((3, 6))
    for i in range(100):
        away[1, 3] = min(i, 50) * 1e-5  # 0.5 mrad, 0.9 mm at the farthest grasp
        seen = watch.watch(q, q, away, 1e-3)
    assert seen.hold
    assert "slave_1" in seen.reason


def test_lost_samples_part_nobody() -> None:
    """With three lost samples in a row at 0.5 m/s an arm is not out of step; an arm that really stops is."""
    lift = paper_lift()
    watch = Supervision(lift.cell, lift.grasp, SupervisionOptions(stall_samples=None))
    told, seen_at = lift.q_start, lift.q_start
    for i in range(400):
        told = told + 5e-4
        lost = 100 <= i % 200 < (103 if i < 200 else 110)
        seen_at = np.concatenate([told[:6], seen_at[6:12] if lost else told[6:12], told[12:]])
        away = np.zeros((3, 6))
        away[1, 2] = seen_at[6] - told[6]  # 1 rad of every joint for 1 m
        seen = watch.watch(seen_at, told, away, 1e-3)
        assert seen.rate_cap == 1.0 or i > 302, i
        if i == 309:
            assert seen.hold
            assert "slave_1" in seen.reason
            break


def out_of_step_for(seconds: float, *, then: float, **options: Any) -> list[Watch]:
    """What the watch says after an arm was off while all moved at 0.25 m/s, and at rest is where it should be."""
    see, z = watch_of(**options), 0.0
    for i in range(round(1e3 * seconds)):
        z += 0.25e-3
        see(z, min(2e-3, 4e-6 * i))
    return [see(z, 0.0) for _ in range(round(1e3 * then))]


@pytest.mark.parametrize("seconds", [0.5, 1.0, 2.0])
def test_a_drift_that_is_gone_is_forgotten_at_rest(seconds: float) -> None:
    """Else arms that are where they were told to be would be held for good."""
    seen = out_of_step_for(seconds, then=2.0)
    assert any(s.hold for s in seen[:50])
    assert not any(s.hold for s in seen[500:])
    assert seen[-1].rate_cap == 1.0


@pytest.mark.parametrize("off", slow_but_first([0.022, 0.1, 0.29]))
@pytest.mark.parametrize("filter_time", [0.0, 0.002])
def test_one_sample_holds_but_is_no_fault_and_two_are(off: float, filter_time: float) -> None:
    for many in (1, 2, 3):
        see = watch_of(noise_margin=0.0, filter_time=filter_time)
        seen = [see(0.1 * i, 0.0) for i in range(10)]
        seen += [see(1.0 + 1e-6 * i, off) for i in range(many)]
        assert seen[-1].hold
        enough = filter_time == 0.0 or off >= 0.1  # the filter, too, has to let it through
        assert any(s.fault for s in seen) is (many >= 2 and enough)
        after = [see(1.1 + 1e-6 * i, 0.0) for i in range(300)]
        assert not any(s.fault for s in after)
        assert after[-1].rate_cap == 1.0


def test_a_sample_that_is_sent_again_is_no_second_one() -> None:
    lift = paper_lift()
    watch = Supervision(lift.cell, lift.grasp, SupervisionOptions(stall_samples=None, noise_margin=0.0))
    q = lift.q_start
    for i in range(10):
        watch.watch(q + 1e-6 * i, q, np.zeros((3, 6)), 1e-3)
    faults = []
    for i in range(5):
        away = np.zeros((3, 6))
        away[1, 0] = 0.2
        measured = q + 1e-6 * i
        measured[6:12] = q[6:12] + 0.2
        faults.append(watch.watch(measured, q, away, 1e-3).fault)
    assert faults == [False, False, False, False, True]  # three lost, then it stands


@pytest.mark.parametrize("arm", [0, 1, 2])
def test_the_arm_that_is_off_is_named(arm: int) -> None:
    lift = paper_lift()
    watch = Supervision(lift.cell, lift.grasp, SupervisionOptions(stall_samples=None))
    away = np.zeros((3, 6))
    away[arm, 1] = 1e-3
    for i in range(20):
        seen = watch.watch(lift.q_start + 1e-9 * i, lift.q_start, away, 1e-3)
    assert seen.hold
    assert seen.arm == arm
    assert lift.cell.arm_names[arm] in seen.reason


def test_steady_motion_is_no_noise() -> None:
    """The margin for noise makes no difference to an arm that leaves the others at one speed."""
    strict, margin = watch_of(noise_margin=0.0), watch_of(noise_margin=100.0)
    caps = np.array([[see(1e-9 * i, 1e-4 + 2e-6 * i).rate_cap for see in (strict, margin)] for i in range(500)])
    assert caps[0, 0] == 1.0
    assert caps[-1, 0] == 0.0
    np.testing.assert_allclose(caps[:, 0], caps[:, 1], atol=1e-9)


def test_two_far_samples_are_a_fault_from_the_start_and_with_lost_ones_between() -> None:
    lift = paper_lift()
    watch = Supervision(lift.cell, lift.grasp, SupervisionOptions(stall_samples=None, noise_margin=0.0))
    away = np.outer([0.0, 0.2, 0.0], np.eye(6)[0])
    faults = [watch.watch(lift.q_start + off, lift.q_start, away.copy(), 1e-3).fault for off in (0.2, 0.2, 0.2, 0.21)]
    assert faults == [False, False, False, True]


@pytest.mark.parametrize("off", [0.4e-3, 2e-3])
def test_a_slowed_object_is_let_go_at_a_pace(off: float) -> None:
    """A tenth of a second from rest, with the name of the arm that was off."""
    see = watch_of(noise_margin=0.0)
    slowed = [see(1e-9 * i, off) for i in range(100)]
    assert all("slave_1 is " in s.reason for s in slowed[20:])
    after = [see(1e-7 + 1e-9 * i, 0.0) for i in range(150)]
    caps = np.array([s.rate_cap for s in (slowed[-1], *after)])
    assert (np.diff(caps) <= 0.01 + 1e-12).all()
    rising = [s for s in after if s.rate_cap < 1.0 and not s.hold and "is" not in s.reason.split()]
    assert len(rising) >= 20
    assert {(s.arm, s.reason) for s in rising} == {(1, "arm slave_1 was out of step")}
    assert after[-1] == Watch()


@pytest.mark.parametrize("moving_again", [70, 35])
def test_silence_of_all_arms_is_told_after_a_while(moving_again: int) -> None:
    """Where no arm follows, the arms hold after 30 ms and the samples of a decision. Motion of all counts anew."""
    lift = paper_lift()
    watch = Supervision(lift.cell, lift.grasp, SupervisionOptions())
    command, measured, held = lift.q_start, lift.q_start, []
    for i in range(70):
        command = command + 1e-3
        if i < 10 or moving_again <= i < moving_again + 10:
            measured = command
        if watch.watch(measured, command, np.zeros((3, 6)), 1e-3).hold:
            held.append(i)
    if moving_again < 70:  # silent for 25 ms, twice
        assert not held
    else:
        assert 10 + 30 <= held[0] <= 10 + 36


@pytest.mark.parametrize("widest", [0.8e-3, 1e-3, 5e-3, 0.02])
def test_a_stalled_arm_that_catches_up_is_let_go(widest: float) -> None:
    """From 0.5 mrad, or from 0.3 times its largest gap, if that is more."""
    lift = paper_lift()
    watch = Supervision(lift.cell, lift.grasp, SupervisionOptions(recovery_time=0.0))
    still, command = np.zeros((3, 6)), lift.q_start.copy()
    for _ in range(20):
        command = command + widest / 20.0
        measured = command.copy()
        measured[12:] = lift.q_start[12:]
        seen = watch.watch(measured, command, still, 1e-3)
    assert seen.hold
    assert seen.arm == 2
    enough = max(5e-4, 0.3 * widest)
    for gap, held in ((widest, True), (0.5 * (widest + enough), True), (1.01 * enough, True), (0.99 * enough, False)):
        measured = command.copy()
        measured[12:] -= gap
        assert watch.watch(measured, command, still, 1e-3).hold is held, gap


def troubled(watch: Supervision, off: float) -> list[Watch]:
    """One arm leaves the others, presses and then stalls, and comes back."""
    lift, seen, rng = paper_lift(), [], np.random.default_rng(5)
    for i in range(120):
        command = lift.q_start + 4e-4 * i
        measured = command + rng.uniform(-1e-6, 1e-6, 18)
        measured[6:12] -= 2e-3 * off * (i > 20)
        if 40 <= i < 80:
            measured[12:] = lift.q_start[12:] + 0.016
        away = rng.normal(size=(3, 6)) * 1e-6
        away[1, 0] -= off * 1e-3 * min(max(i - 10, 0) / 20.0, max(60 - i, 0) / 20.0, 1.0)
        seen.append(watch.watch(measured, command, away, 1e-3))
    return seen


@pytest.mark.parametrize("stiffness", [None, 2e4])
@pytest.mark.parametrize("steps", [0, 30, 55, 120])
def test_what_was_seen_before_a_reset_is_forgotten(steps: int, stiffness: float | None) -> None:
    lift = paper_lift()
    options = SupervisionOptions(stiffness=stiffness, force_limit=50.0)
    watch, new = (Supervision(lift.cell, lift.grasp, options) for _ in range(2))
    rng = np.random.default_rng(6)
    for i in range(steps):
        command = lift.q_start - 1e-3 * i
        measured = command + rng.uniform(-1e-4, 1e-4, 18)
        measured[:6] = lift.q_start[:6]
        watch.watch(measured, command, rng.normal(size=(3, 6)) * 0.03, 1e-3)
    watch.reset()
    assert troubled(watch, 1.0) == (expected := troubled(new, 1.0))
    assert not expected[0].hold
    assert {s.hold for s in expected} == {True, False}
    for words in ("stalled", "out of step") if stiffness is None else (" N ",):
        assert any(words in s.reason for s in expected)


def test_after_a_reset_a_gap_is_no_stall() -> None:
    lift = paper_lift()
    watch = Supervision(lift.cell, lift.grasp, SupervisionOptions())
    watch.reset()
    assert watch.watch(lift.q_start - 1e-3, lift.q_start, np.zeros((3, 6)), 1e-3) == Watch()


def test_the_lowest_cap_counts_and_of_equal_ones_the_first() -> None:
    watch = Watch()
    for cap, arm in ((1.0, 3), (0.5, 0), (0.5, 1), (0.7, 2)):
        watch.lower(Watch(rate_cap=cap, arm=arm, reason=f"{arm}"))
    assert watch == Watch(rate_cap=0.5, arm=0, reason="0")
    watch.lower(Watch.holding("held"))
    assert watch == Watch(rate_cap=0.0, hold=True, reason="held", cause=Cause.INPUT)
    watch.lower(Watch.holding("held again"))
    assert watch.reason == "held"
    watch.lower(Watch.holding("over", fault=True))
    watch.lower(Watch.holding("another", fault=True))
    assert watch == Watch(rate_cap=0.0, hold=True, fault=True, reason="over", cause=Cause.INPUT)


def test_a_cosine_and_sine_are_brought_to_the_circle() -> None:
    controller, q, _, joint = turning(0.7)
    cell = controller.cell
    watch = Supervision(cell, controller.grasp, SupervisionOptions())
    i = int(cell.position_index[joint])
    for radius in (0.96, 1.0, 1.04):
        found = q.copy()
        found[i : i + 2] *= radius
        given = found.copy()
        measured, trouble = watch.accept_measurement(given, q)
        assert not trouble
        np.testing.assert_allclose(measured, q, rtol=0.0, atol=1e-15)
        assert np.array_equal(given, found)  # the caller's array stays as it is
    for radius in (0.94, 1.06):
        found = q.copy()
        found[i : i + 2] *= radius
        measured, trouble = watch.accept_measurement(found, q)
        assert measured is q
        assert f"q_measured[{i}] and [{i + 1}] are no cosine and sine" in trouble


def turning(position: float) -> tuple[QPController, Array, Array, int]:
    """A cell with a continuous joint at a position: its controller, configuration, joint positions, and that joint."""
    task = mixed_cell()
    joint = int(np.flatnonzero(task.cell.continuous)[0])
    x = task.cell.positions(task.q_start)
    x[joint] = position
    return QPController(task.cell, task.grasp, task.path, dt=1e-3), task.cell.configuration(x), x, joint


@pytest.mark.parametrize("position", [0.0, 0.25 * np.pi, 0.5 * np.pi, 3.1, -np.pi])
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_the_jump_of_a_continuous_joint_is_an_angle(position: float, side: float) -> None:
    """Across half a turn as well; its cosine and sine alone change by less than the angle, or hardly at all."""
    controller, q, x, joint = turning(position)
    watch, cell = Supervision(controller.cell, controller.grasp, SupervisionOptions()), controller.cell
    for jump, believed in ((0.299, True), (0.301, False), (0.4, False)):
        off = x.copy()
        off[joint] += side * jump
        reason = watch.accept_measurement(cell.configuration(off), q)[1]
        assert (not reason) is believed
        assert (
            believed or reason == f"joint {cell.joint_names[joint]} is measured {jump:.3g} rad (or m) from its command"
        )


def test_a_continuous_joint_stalls_at_the_same_angle_everywhere() -> None:
    """Where its cosine hardly changes, where its sine hardly does, and across half a turn."""
    when = []
    for position in (0.0, 0.25 * np.pi, 0.5 * np.pi, np.pi - 2e-4):
        controller, _, x, joint = turning(position)
        cell = controller.cell
        watch = Supervision(cell, controller.grasp, SupervisionOptions())
        own = cell.v_slices[cell.arm_of_joint(joint)]
        for i in range(200):
            told = x + 0.95e-4 * i
            told[own] = x[own]
            found = told.copy()
            told[joint] += 0.95e-4 * i
            if watch.watch(cell.configuration(found), cell.configuration(told), np.zeros((4, 6)), 1e-3).hold:
                break
        when.append(i)
    assert when == [6] * 4  # 0.5 mrad from its command


def test_the_drift_is_the_filters_of_its_derivation(rng: np.random.Generator) -> None:
    """Of drift and lag, (b, c), apart = (1, s) · (b, c) is seen, in matrices.

    Towards 0 the drift goes as the filter says, away from it by a share of the way at most, and never past ``largest``.
    """
    dt, noise, largest = 2.0 * constants.DRIFT_PERIOD, 1e-5, 2e-3
    found = Drift(2, largest)
    x, P, Q = np.zeros(2), np.diag([0.0, constants.LAG**2]), np.diag([constants.WANDER**2 * dt, 0.0])
    q, seen, speed, met = np.zeros(1), 0.0, 0.0, set()
    new = dt / (constants.SMOOTHING + dt)
    found.without(np.zeros((2, 6)), noise, q, 0.0)
    for i in range(1200):
        way = dt * (0.4 + 0.3 * np.sin(0.02 * i))
        q = q + way
        apart = np.zeros((2, 6))
        apart[0, 1] = (4e-3 if 300 < i < 600 else -5e-4 if i >= 600 else 5e-4) + 1e-5 * rng.normal()
        told = apart - found.without(apart, noise, q, dt)
        # the filter
        seen, speed, P = seen + new * (apart[0, 1] - seen), speed + new * (way / dt - speed), P + Q
        h = np.array([1.0, speed])
        gain = P @ h / (h @ P @ h + (constants.DRIFT_FLOOR**2 + noise**2) * constants.DRIFT_SAMPLE / dt)
        change, most = gain * (seen - h @ x), constants.LARGEST_SLOPE * way
        wanted = x[0] + change[0]
        stop = min(x[0], 0.0), max(x[0], 0.0)
        b = float(np.clip(wanted, stop[0] - most, stop[1] + most))
        P = P - np.outer(gain, P @ h)
        P[1, 1] = constants.LAG**2 if b != wanted else max(P[1, 1], constants.LEAST_LAG**2)
        met |= {"slowed"} if b != wanted else {"shrunk"} if abs(b) < abs(x[0]) else {"grown"}
        x = np.array([np.clip(b, -largest, largest), x[1] + change[1]])
        met |= {"largest"} if abs(x[0]) == largest else set()
        assert told[0, 1] == pytest.approx(x[0], abs=1e-12), i
        assert not np.delete(told.ravel(), 1).any()
    assert met == {"slowed", "shrunk", "grown", "largest"}
