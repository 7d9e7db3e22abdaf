"""The relaxation of forces and the rate that they allow: the plain definition and the core find the same numbers."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from coopqp.control.core import minding_of
from coopqp.control.core.relax_plain import minding_scalars, minding_size, minding_views, squeezes
from coopqp.native import available_kernels, constants, layout
from coopqp.spatial import Array

if "compiled" not in available_kernels():
    pytest.skip("there is no compiled core here", allow_module_level=True)

pytestmark = pytest.mark.core
CHECKING, PRESSING, RELAXING, MOVING = range(4)


def anyhow(rng: np.random.Generator, arms: int, **values: float) -> Array:
    """Memory of forces in any state that a run may come to; ``values`` of its scalars by name."""
    memory = np.zeros(minding_size(arms))
    m, x = minding_scalars(memory), minding_views(memory, arms)
    drawn: dict[str, Any] = {
        "wrench_filter": 0.02, "dead_band": 1.0, "relax_time": 0.2, "drift_time": 0.5, "ramp_time": 0.05,
        "wrench_silence": rng.choice([0.006, 0.05, 0.2, 0.2]), "most_speed": 0.02, "most_spin": 0.05,
        "most_reach": rng.choice([2e-4, 3e-3]),
        "most_turn": 0.01,
        "wait": 0.02, "move_below": rng.uniform(3.0, 40.0), "pressed_below": rng.uniform(3.0, 60.0),
        "force_slows": 5.0, "force_holds": 25.0, "has_palms": rng.integers(2), "squeeze": 10.0, "most_squeeze": 15.0,
        "stiffer": rng.choice([0.02, 0.4, 1.0, 3.0]), "stage": rng.integers(4), "stepped": rng.uniform() < 0.9,
        "asked": rng.choice([0.3, 1.0]), "force_cap": rng.uniform(), "last_rate": rng.uniform(),
        "last_speed": rng.choice([0.0, 1.0]), "at_end": rng.integers(2), "pressed_with": 10.0, "needed": 5.0,
        "start_size": rng.uniform(0.0, 10.0), "load_mass": 2.0, "weight_z": -20.0, "weight_x": 3.0, "weight_y": 2.0,
        "contact_limit": rng.choice([4.0, 10.0, math.inf]), "corrects": 0.5, "contact_late": 0.02,
        "goes_on": rng.integers(2), "touches": rng.choice([0.0, 0.0, constants.UNTIL_TOLD + 0.02]),
        "suspected": rng.uniform() < 0.2, "reference_dt": 0.004, "back_from": math.nan,
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


@pytest.mark.parametrize("stage", [CHECKING, PRESSING, RELAXING, MOVING])
def test_both_relax_alike_and_allow_the_same_rate(stage: int, rng: np.random.Generator) -> None:
    (relax, allow), (relax_core, allow_core) = minding_of("plain"), minding_of("compiled")
    dt, whys = 0.004, set()
    for run in range(16):
        arms = 2 + run % 2
        memory = anyhow(rng, arms, stage=stage)
        x, way, push = minding_views(memory, arms), rng.normal(size=3) * 0.2, rng.normal(size=3)
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
            other = memory.copy()
            heard = relax(memory, arms, wrenches, dt)
            assert heard == relax_core(other, arms, wrenches, dt)
            np.testing.assert_allclose(memory, other, rtol=1e-9, atol=1e-10, err_msg=f"relaxed, {run}: {i}")
            allow(memory, arms, dt)
            allow_core(other, arms, dt)
            np.testing.assert_allclose(memory, other, rtol=1e-9, atol=1e-10, err_msg=f"allowed, {run}: {i}")
            whys.add(layout.WHYS[int(minding_scalars(memory).why)])
    moving = {"BY_CONTACT", "BY_REACH", "BY_FRICTION", "BY_FORCE", "NOTHING_MORE"}
    assert whys >= {"BY_SENSOR", *(moving if stage == MOVING else {"BY_STAGE"})}


def test_arms_squeeze_where_they_press_more_while_they_relax_than_at_the_start() -> None:
    """Not on palms, which have to press; and from the force on at which the object is held."""
    more = 1.01 * constants.MORE_THAN_AT_START * 30.0
    for values, found in (
        ({}, True), ({"stage": MOVING}, False), ({"stage": PRESSING}, False), ({"has_palms": 1.0}, False),
        ({"size": 0.98 * more}, False), ({"force_holds": 1.01 * more}, False), ({"force_holds": more}, True),
    ):  # fmt: skip
        usual = {"stage": RELAXING, "has_palms": 0.0, "size": more, "start_size": 30.0, "force_holds": 25.0}
        memory = anyhow(np.random.default_rng(0), 2, **(usual | values))
        assert squeezes(minding_scalars(memory)) == found, values


def test_a_rate_falls_in_proportion_and_rises_the_slower_the_more_is_felt() -> None:
    """Without palms, between the force that slows and the one that holds; by the closed forms."""
    allow, dt = minding_of("plain")[1], 0.01
    for size, cap, stiffer in ((0.0, 0.5, 1.0), (2.0, 0.5, 4.0), (4.9, 0.2, 0.5), (15.0, 1.0, 1.0), (30.0, 0.05, 1.0)):
        memory = anyhow(
            np.random.default_rng(0), 2, stage=MOVING, has_palms=0.0, size=size, force_cap=cap, stiffer=stiffer,
            asked=1.0, touches=0.0,
        )  # fmt: skip
        allow(memory, 2, dt)
        wanted = float(np.clip((25.0 - size) / 20.0, 0.0, 1.0))
        fall = max(cap, constants.SLOW_RATE) / constants.RATE_FALLS * dt
        root = math.sqrt(max(stiffer, 1.0))
        rise = max(1.0 - root * size / 5.0, constants.LEAST_CALM) / root * dt / constants.RATE_RISES
        assert minding_scalars(memory).allowed == pytest.approx(float(np.clip(wanted, cap - fall, cap + rise)))


@pytest.mark.parametrize("kernel", ["plain", "compiled"])
def test_an_object_begins_the_slower_the_less_its_servos_are_as_told(kernel: str) -> None:
    """By √ρ, stiffer or softer; at the whole rate on palms, whose pads yield, and on servos that do not answer."""
    relax, full = minding_of(kernel)[0], constants.CAREFUL_START
    for stiffer, palms, rate in (
        (1.0, 0.0, full), (4.0, 0.0, full / 2.0), (0.25, 0.0, full / 2.0), (4.0, 1.0, 1.0),
        (constants.SOFTEST, 0.0, 1.0),
    ):  # fmt: skip
        memory = anyhow(
            np.random.default_rng(0), 2, stage=RELAXING, has_palms=palms, stiffer=stiffer, force_cap=1.0, since=0.02,
            wait=0.02, move_below=30.0, pressed_below=30.0, contact_limit=math.inf,
            sensor_fault=layout.SENSORS.index("SENSORS_FINE"),
        )  # fmt: skip
        relax(memory, 2, np.zeros((2, 6)), 0.004)
        m = minding_scalars(memory)
        assert (m.stage, m.force_cap) == (MOVING, pytest.approx(rate)), (stiffer, palms)
