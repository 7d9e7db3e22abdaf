"""The relaxation of forces and the rate that they allow: closed forms, and numbers as recorded.

The records are from a commit at which the core and a definition in NumPy found them alike, to 1e-9. A change that means
to change them makes them anew: ``python tests/control/test_force_arithmetic.py``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from coopqp.core._core import CHECKING, MOVING, PRESSING, RELAXING

from coopqp.control.core.force_memory import relaxation_scalars, relaxation_size, relaxation_views, squeezes
from coopqp.core import _core
from coopqp.spatial import Array

pytestmark = pytest.mark.core
KEPT = Path(__file__).with_name("kept") / "force_arithmetic.npz"
#: After so small a time the arms hold until they are told to go on.
UNTIL_TOLD = 1e-9


def anyhow(rng: np.random.Generator, arms: int, **values: float) -> Array:
    """Memory of forces in any state that a run may come to; ``values`` of its scalars by name."""
    memory = np.zeros(relaxation_size(arms))
    m, x = relaxation_scalars(memory), relaxation_views(memory, arms)
    drawn: dict[str, Any] = {
        "wrench_filter": 0.02, "dead_band": 1.0, "relax_time": 0.2, "drift_time": 0.5, "ramp_time": 0.05,
        "wrench_silence": rng.choice([0.006, 0.05, 0.2, 0.2]), "most_speed": 0.02, "most_spin": 0.05,
        "most_reach": rng.choice([2e-4, 3e-3]),
        "most_turn": 0.01,
        "wait_time": 0.02, "move_below": rng.uniform(3.0, 40.0), "pressed_below": rng.uniform(3.0, 60.0),
        "force_slows": 5.0, "force_holds": 25.0, "has_palms": rng.integers(2), "squeeze": 10.0, "most_squeeze": 15.0,
        "stiffer": rng.choice([0.02, 0.4, 1.0, 3.0]), "stage": rng.integers(4), "stepped": rng.uniform() < 0.9,
        "asked": rng.choice([0.3, 1.0]), "force_cap": rng.uniform(), "last_rate": rng.uniform(),
        "last_speed": rng.choice([0.0, 1.0]), "at_end": rng.integers(2), "pressed_with": 10.0, "needed": 5.0,
        "start_size": rng.uniform(0.0, 10.0), "load_mass": 2.0, "weight_z": -20.0, "weight_x": 3.0, "weight_y": 2.0,
        "contact_limit": rng.choice([4.0, 10.0, math.inf]), "correction_share": 0.5, "contact_late": 0.02,
        "goes_on": rng.integers(2), "touches": rng.choice([0.0, 0.0, UNTIL_TOLD + 0.02]),
        "suspected": rng.uniform() < 0.2, "reference_dt": 0.004, "retreat_from": math.nan,
    }  # fmt: skip
    for name, value in (drawn | values).items():
        setattr(m, name, value)
    for name in ("internal_of", "yields", "unfed_of"):
        x[name][:] = rng.normal(size=x[name].shape) * (0.3 if name == "internal_of" else 1e-2)
    x["unfed_of"].reshape(arms, 6, arms, 6)[:] += np.eye(6)[None, :, None, :] * np.eye(arms)[:, None, :, None]
    for name in ("shift", "held", "drift"):
        x[name][:] = rng.normal(size=(arms, 6)) * 1e-3
    x["target"][:], x["squeezed"][:] = rng.normal(size=(2, arms, 6))
    x["holding"][:] = rng.uniform(size=arms) < 0.8
    x["holding"][0] = 1.0
    x["palms"][:] = rng.normal(size=x["palms"].shape) * 0.3
    x["palms"][:, :, 3, 2] += 3.0
    x["reference"][:9], x["centre"][:] = np.linalg.qr(rng.normal(size=(3, 3)))[0].ravel(), rng.normal(size=3)
    return memory


def felt(rng: np.random.Generator, arms: int, before: Array | None, load: Array) -> Array | None:
    """Wrenches of one sample: those before, or some with their share of a load, of which one may be missing."""
    kind = rng.uniform()
    if kind < 0.08:
        return None
    if kind < 0.2 and before is not None:
        return before
    wrenches = rng.normal(size=(arms, 6)) * rng.choice([1.0, 1.0, 6.0])
    wrenches[:, :3] += load / arms
    wrenches[:, 2] += rng.choice([0.0, 8.0])
    if kind > 0.92:
        wrenches[int(rng.integers(arms)), 2] = np.nan
    return wrenches


#: All scalars.
SCALARS = (
    "wrench_filter", "dead_band", "relax_time", "drift_time", "ramp_time", "wrench_silence", "most_speed",
    "most_spin", "most_reach", "most_turn", "wait_time", "move_below", "pressed_below", "force_slows", "force_holds",
    "has_palms", "squeeze", "most_squeeze", "largest_force", "stiffer", "relax_blend", "saturated", "stage",
    "stage_time", "stepped", "age", "asked", "force_cap", "last_rate", "last_speed", "at_end", "friction_used",
    "pressed_with", "needed", "sensor_fault", "sensor_arm", "sensor_amount", "allowed", "why", "why_arm", "rigid",
    "weight_x", "weight_y", "weight_z", "joint_acceleration", "suspected", "servo_samples", "servo_noise",
    "correction_share", "start_size", "joint_way", "load_mass", "contact_limit", "load_acceleration", "touches",
    "pushed", "sharpest", "asked_dt", "reference_dt", "contact_late", "goes_on", "retreat_speed", "retreat_left",
    "retreat_from", "retreats_at", "load_speed", "look_at",
)  # fmt: skip


def digest(memory: Array, arms: int) -> float:
    """One number that changes with every number of the memory."""
    m = relaxation_scalars(memory)
    vectors = (view.ravel() for view in relaxation_views(memory, arms).values())
    numbers = np.concatenate([[float(getattr(m, name)) for name in SCALARS], *vectors])
    weights = 1.0 + 0.5 * np.cos(1.7 * np.arange(len(numbers)))
    return float(weights @ np.nan_to_num(numbers, nan=7.0, posinf=11.0, neginf=-13.0))


def in_stage(stage: int) -> Iterator[tuple[Array, int, int]]:
    """Memories and their arms, after each relaxation and allowance of 16 runs, and what was heard or why it is slow."""
    rng, dt = np.random.default_rng(10 + stage), 0.004
    for run in range(16):
        arms = 2 + run % 2
        memory = anyhow(rng, arms, stage=stage)
        x, way, push = relaxation_views(memory, arms), rng.normal(size=3) * 0.2, rng.normal(size=3)
        wrenches = None
        if stage == MOVING and run % 3 == 0:
            push = -way * rng.uniform(0.9, 1.1, size=3)  # it runs into something
            x["internal_of"] *= 0.02
        x["travel"][0] = x["reference"][:9].reshape(3, 3) @ x["centre"]
        x["travel"][1] = way
        for i in range(30):
            x["reference"][9:] += way * dt
            pushed = push / np.linalg.norm(push) * (60.0 if 5 < i < 22 else 0.0)
            wrenches = felt(rng, arms, wrenches, -x["reference"][:9].reshape(3, 3).T @ pushed)
            yield memory, arms, _core.relax(memory, arms, wrenches, dt)
            _core.allow(memory, arms, dt)
            yield memory, arms, relaxation_scalars(memory).why


def of_any_numbers(stage: int) -> Iterator[tuple[Array, int, int]]:
    """The same of memories of any numbers: dead bands, ends of the reach, palms, wrenches that do not come, faults."""
    for seed in range(30):
        rng, arms = np.random.default_rng(1000 * stage + seed), 1 + seed % 5
        memory = np.zeros(relaxation_size(arms))
        m, x = relaxation_scalars(memory), relaxation_views(memory, arms)
        drawn = rng.uniform(-1.0, 1.0, len(SCALARS) + sum(view.size for view in x.values()))[len(SCALARS) :]
        for view in x.values():
            view.ravel()[:], drawn = drawn[: view.size], drawn[view.size :]
        for name, value in zip(SCALARS, rng.uniform(0.05, 2.0, len(SCALARS)), strict=True):
            setattr(m, name, value)
        for name, value in {
            "most_reach": m.most_reach * 10.0 ** rng.integers(-2, 2), "force_slows": 0.5,
            "force_holds": rng.choice([1.0, 50.0]), "saturated": 0.0, "stepped": rng.random() < 0.9, "stage": stage,
            "has_palms": rng.random() < 0.5, "sensor_arm": 0.0,
            "sensor_fault": rng.choice([0, 0, 0, 0, _core.SENSOR_WRONG]), "force_cap": rng.random(),
            "wait_time": rng.choice([0.15, 10.0]), "why": 0.0, "why_arm": 0.0, "most_squeeze": rng.choice([0.0, 30.0]),
        }.items():  # fmt: skip
            setattr(m, name, value)
        x["silent"][:] = 0.0
        x["holding"][:] = rng.random(arms) < rng.choice([0.5, 1.0])
        x["holding"][rng.integers(arms)] = 1.0
        if rng.random() < 0.5:  # palms that press
            x["palms"][:, :, 3] = [0.0, 0.0, 0.5, 0.0, 0.0, 0.0]
        for _ in range(5):
            wrenches = rng.normal(size=(arms, 6)) * 10.0 ** rng.integers(-2, 2)
            wrenches[:, 2] += rng.choice([0.0, 5.0])
            wrenches[rng.random(arms) < 0.3, rng.integers(6)] = np.nan
            yield memory, arms, _core.relax(memory, arms, None if rng.random() < 0.1 else wrenches, 0.1)
            _core.allow(memory, arms, 0.1)
            yield memory, arms, m.why
            m.last_rate = rng.random()


RUNS: dict[str, Callable[[int], Iterator[tuple[Array, int, int]]]] = {"runs": in_stage, "any": of_any_numbers}


def found(kind: str, stage: int) -> Array:
    """Digests and codes (K, 2)."""
    return np.array([(digest(memory, arms), code) for memory, arms, code in RUNS[kind](stage)])


@pytest.mark.parametrize("stage", [CHECKING, PRESSING, RELAXING, MOVING])
@pytest.mark.parametrize("kind", RUNS)
def test_forces_relax_and_allow_rates_as_recorded(kind: str, stage: int) -> None:
    numbers, expected = found(kind, stage), np.load(KEPT)[f"{kind}_{stage}"]
    np.testing.assert_array_equal(numbers[:, 1], expected[:, 1])
    np.testing.assert_allclose(numbers[:, 0], expected[:, 0], rtol=1e-9, atol=1e-9)
    if kind == "runs":
        moving = {_core.BY_CONTACT, _core.BY_REACH, _core.BY_FRICTION, _core.BY_FORCE, _core.NOTHING_MORE}
        assert {*numbers[1::2, 1]} >= {_core.BY_SENSOR, *(moving if stage == MOVING else {_core.BY_STAGE})}


def test_arms_squeeze_where_they_press_more_while_they_relax_than_at_the_start() -> None:
    """Not on palms, which have to press; and from the force on at which the object is held."""
    more = 1.01 * 1.1 * 30.0
    for values, found in (
        ({}, True), ({"stage": MOVING}, False), ({"stage": PRESSING}, False), ({"has_palms": 1.0}, False),
        ({"largest_force": 0.98 * more}, False), ({"force_holds": 1.01 * more}, False), ({"force_holds": more}, True),
    ):  # fmt: skip
        usual = {"stage": RELAXING, "has_palms": 0.0, "largest_force": more, "start_size": 30.0, "force_holds": 25.0}
        memory = anyhow(np.random.default_rng(0), 2, **(usual | values))
        assert squeezes(relaxation_scalars(memory)) == found, values


def test_a_rate_falls_in_proportion_and_rises_the_slower_the_more_is_felt() -> None:
    """Without palms, between the force that slows and the one that holds; by the closed forms."""
    dt = 0.01
    for size, cap, stiffer in ((0.0, 0.5, 1.0), (2.0, 0.5, 4.0), (4.9, 0.2, 0.5), (15.0, 1.0, 1.0), (30.0, 0.05, 1.0)):
        memory = anyhow(
            np.random.default_rng(0), 2, stage=MOVING, has_palms=0.0, largest_force=size, force_cap=cap,
            stiffer=stiffer, asked=1.0, touches=0.0,
        )  # fmt: skip
        _core.allow(memory, 2, dt)
        wanted = float(np.clip((25.0 - size) / 20.0, 0.0, 1.0))
        fall = max(cap, 0.1) / 0.6 * dt
        root = math.sqrt(max(stiffer, 1.0))
        rise = max(1.0 - root * size / 5.0, 0.1) / root * dt / 2.0
        assert relaxation_scalars(memory).allowed == pytest.approx(float(np.clip(wanted, cap - fall, cap + rise)))


@pytest.mark.parametrize(("used", "allowed"), [(0.92, 0.8), (0.95, 0.5), (0.99, 0.1), (0.89, 1.0)])
def test_friction_in_use_slows_the_object_from_nine_tenths_on(used: float, allowed: float) -> None:
    """In a line down to rest where all of it is used; the arm whose palm uses most is named."""
    memory = anyhow(
        np.random.default_rng(0), 2, stage=MOVING, has_palms=1.0, largest_force=0.0, asked=1.0, touches=0.0,
        stiffer=1.0, force_cap=allowed + 1e-6, friction_used=used,
    )  # fmt: skip
    x = relaxation_views(memory, 2)
    x["holding"][:], x["palms"][:], x["seen"][:] = 1.0, 0.0, 0.0
    x["palms"][:, 0, 0, 0] = x["palms"][:, :, 3, 2] = 1.0  # |f_x| ≤ f_z
    x["seen"][:, 2], x["seen"][:, 0] = 10.0, (5.0, 10.0 * used)
    _core.allow(memory, 2, 0.01)
    m = relaxation_scalars(memory)
    assert m.friction_used == pytest.approx(used)
    assert m.allowed == pytest.approx(allowed)
    assert m.why == (_core.BY_FRICTION if used > 0.9 else _core.NOTHING_MORE)
    assert used < 0.9 or m.why_arm == 1


@pytest.mark.parametrize(("share", "touches"), [(0.8, True), (0.86, False)])
def test_what_pushes_no_harder_than_the_arms_do_each_other_is_no_contact(share: float, touches: bool) -> None:
    """20 N on the object, of which one arm has a share: a contact is 1.2 times as hard as any internal force."""
    memory = anyhow(
        np.random.default_rng(0), 2, stage=MOVING, contact_limit=10.0, touches=0.0, suspected=0.0, load_mass=0.0,
        weight_x=0.0, weight_y=0.0, weight_z=0.0, sensor_fault=_core.SENSORS_FINE, last_speed=0.0,
    )  # fmt: skip
    x = relaxation_views(memory, 2)
    x["holding"][:], x["target"][:], x["internal_of"][:], x["unfed_of"][:] = 1.0, 0.0, np.eye(12), np.eye(12)
    x["reference"][:9], x["push"][0] = np.eye(3).ravel(), (20.0, 0.0, 0.0)
    wrenches = np.zeros((2, 6))
    wrenches[:, 0] = -20.0 * share, -20.0 * (1.0 - share)
    _core.relax(memory, 2, wrenches, 0.004)
    m = relaxation_scalars(memory)
    assert m.pushed == pytest.approx(20.0)
    assert bool(m.touches) is touches


def test_an_object_begins_the_slower_the_less_its_servos_are_as_told() -> None:
    """By √ρ, stiffer or softer; at the whole rate on palms, whose pads yield, and on servos that do not answer."""
    full = 0.45
    for stiffer, palms, rate in (
        (1.0, 0.0, full), (4.0, 0.0, full / 2.0), (0.25, 0.0, full / 2.0), (4.0, 1.0, 1.0),
        (0.05, 0.0, 1.0),
    ):  # fmt: skip
        memory = anyhow(
            np.random.default_rng(0), 2, stage=RELAXING, has_palms=palms, stiffer=stiffer, force_cap=1.0,
            stage_time=0.02, wait_time=0.02, move_below=30.0, pressed_below=30.0, contact_limit=math.inf,
            sensor_fault=_core.SENSORS_FINE,
        )  # fmt: skip
        _core.relax(memory, 2, np.zeros((2, 6)), 0.004)
        m = relaxation_scalars(memory)
        assert (m.stage, m.force_cap) == (MOVING, pytest.approx(rate)), (stiffer, palms)


if __name__ == "__main__":
    KEPT.parent.mkdir(exist_ok=True)
    np.savez_compressed(KEPT, **{f"{kind}_{stage}": found(kind, stage) for kind in RUNS for stage in range(4)})
