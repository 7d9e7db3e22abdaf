"""Settings of forces, grips and sensors: what is refused by name, bounds in closed form, results that stay."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from coopqp import ForceOptions, InvalidInputError, LimitKind
from coopqp.forces import (
    ArmCorrection,
    Calibration,
    CalibrationOptions,
    DeterminingMotion,
    Grip,
    InternalStress,
    LoadUse,
    SensorFinding,
    SensorJudgement,
    SharedLoad,
    WristSensor,
)
from coopqp.forces.wrist_sensor import SensorMaps
from coopqp.planning import Payload
from coopqp.scenarios import Scenario


@pytest.mark.parametrize(
    "kind",
    [
        ArmCorrection, Calibration, CalibrationOptions, DeterminingMotion, ForceOptions, Grip, InternalStress, LoadUse,
        SensorFinding, SensorJudgement, SharedLoad, WristSensor,
    ],
)  # fmt: skip
def test_settings_and_results_stay_as_they_are_and_are_compared_by_identity(kind: Any) -> None:
    """They hold arrays: they can be keys, and no attribute can be given another value."""
    one, other = object.__new__(kind), object.__new__(kind)
    assert len({one, other, one}) == 2
    assert one != other
    with pytest.raises(AttributeError, match="cannot assign"):
        setattr(one, next(iter(kind.__dataclass_fields__)), 1.0)


@pytest.mark.parametrize("kind", [CalibrationOptions, ForceOptions, Grip, WristSensor])
def test_settings_are_given_by_name(kind: Any) -> None:
    with pytest.raises(TypeError, match="positional"):
        kind(1.0)


# -- settings ----------------------------------------------------------------------------------------------------------


ZERO_OR_MORE = ("delay", "filter_time", "dead_band", "check_time", "squeeze", "most_squeeze")
MORE = (
    "softness_doubt", "relax_time", "drift_time", "speed", "spin", "ramp_time", "reach", "turn", "sensor_tolerance",
    "move_below", "slow_from", "hold_from", "silent_time",
)  # fmt: skip


@pytest.mark.parametrize("name", [*ZERO_OR_MORE, *MORE])
@pytest.mark.parametrize("value", [-1e-9, 0.0, np.nan, np.inf, "much"])
def test_settings_of_forces_are_positive_numbers(name: str, value: Any) -> None:
    if name in ZERO_OR_MORE and value == 0.0:
        assert getattr(ForceOptions(stiffness=1e4, **{name: value}), name) == 0.0
        return
    with pytest.raises(InvalidInputError, match=name):
        ForceOptions(stiffness=1e4, **{name: value})


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"slow_from": 50.0}, "slow_from is 50 N, hold_from 50 N"),
        ({"presses": 1}, "presses"),
        ({"sensors": [1]}, "ForceOptions: sensors"),
        ({"sensors": {"a": 1.0}}, r"sensors\['a'\]"),
        ({"payload": Payload(mass=1.0), "contact_limit": -5.0}, "contact_limit"),
        ({"payload": Payload(mass=1.0), "contact_limit": 0.0}, "contact_limit"),
        ({"contact_limit": 30.0}, "a contact_limit without a payload"),
        ({"squeeze": 1.0}, "a squeeze without palms"),
        ({"palms": (Grip(kind="palm", friction=0.5),), "squeeze": 0.0}, "squeeze"),
        ({"palms": (Grip(kind="palm", friction=0.5, normal=(0.0, 0.01, 1.0)),), "squeeze": 9.0}, "along an axis"),
        ({"palms": (1.0,), "squeeze": 9.0}, "no palm along an axis"),
    ],
)
def test_bad_settings_of_forces_are_named(settings: dict[str, Any], said: str) -> None:
    with pytest.raises(InvalidInputError, match=said):
        ForceOptions(stiffness=1e4, **settings)


def test_settings_of_forces_that_are_right() -> None:
    palm = Grip(kind="palm", friction=0.5, normal=(0.0, -1.0, 0.0))
    options = ForceOptions(palms=[palm, palm], squeeze=10.0, most_squeeze=10.0)  # type: ignore[arg-type]
    assert options.palms == (palm, palm)
    np.testing.assert_array_equal(options.minded(2), [[0.0, 1.0, 0.0, 1.0, 1.0, 1.0]] * 2)
    np.testing.assert_array_equal(ForceOptions().minded(3), np.ones((3, 6)))
    own = [[0, 1, 0, 1, 0, 1], [1, 1, 1, 0, 0, 0]]
    np.testing.assert_array_equal(ForceOptions(directions=own).minded(2), own)
    with pytest.raises(InvalidInputError, match="directions"):
        ForceOptions(directions=own).minded(3)
    assert ForceOptions(payload=Payload(mass=1.0), contact_limit=5.0).contact_limit == 5.0
    assert ForceOptions(slow_from=49.9).slow_from == 49.9


def test_bounds_of_grips() -> None:
    """Each limit as ``|A c| ≤ b·c + d``: what is given, in the components that are transmitted."""
    grip = Grip(force=50.0, torque=6.0, wrench=[10.0, np.inf, 30.0, np.inf, 5.0, np.inf])
    found = {(b.kind, b.d): b.A for b in grip.bounds()}
    assert {(kind.name, d) for kind, d in found} == {
        ("GRIP_FORCE", 50.0), ("GRIP_TORQUE", 6.0), ("WRIST", 10.0), ("WRIST", 30.0), ("WRIST", 5.0),
    }  # fmt: skip
    np.testing.assert_array_equal(found[LimitKind.GRIP_FORCE, 50.0], np.eye(6)[:3])
    np.testing.assert_array_equal(found[LimitKind.GRIP_TORQUE, 6.0], np.eye(6)[3:])
    for i, d in ((0, 10.0), (2, 30.0), (4, 5.0)):
        np.testing.assert_array_equal(found[LimitKind.WRIST, d], np.eye(6)[i : i + 1])
    assert all(not b.b.any() for b in grip.bounds())
    assert Grip().bounds() == []
    free = Grip(kind="torque-free", force=50.0, torque=6.0, wrench=np.full(6, 7.0))
    assert free.components == 3
    assert [b.A.shape for b in free.bounds()] == [(3, 3), (1, 3), (1, 3), (1, 3)]
    assert Grip(kind="palm", friction=0.5).components == 3
    assert Grip(kind="palm", friction=0.5, radius=1e-3).components == 6
    for name in ("force", "torque"):
        for bad in (-1.0, 0.0, np.nan, -np.inf):
            with pytest.raises(InvalidInputError, match=f"Grip: {name}"):
                Grip(**{name: bad})  # type: ignore[arg-type]
    with pytest.raises(InvalidInputError, match="Grip: friction"):
        Grip(kind="palm", friction=10.1)
    for settings in ({"radius": 0.1}, {"squeeze": 1.0}, {"friction": 0.0}):
        with pytest.raises(InvalidInputError, match="of a torque-free grip"):
            Grip(kind="torque-free", **settings)
    for wrench in (np.zeros(6), [1, 1, 1, 1, 1, -1], np.ones(7), np.full(6, np.nan)):
        with pytest.raises(InvalidInputError, match="entries ≤ 0"):
            Grip(wrench=wrench)


@pytest.mark.parametrize("normal", [(0.0, 0.0, 2.0), (1.0, 0.0, 0.0), (0.3, -0.4, 0.9)])
def test_a_palm_holds_by_friction_within_its_pad(normal: Any) -> None:
    """``|(f_t, m_n / ⅔r)| ≤ μ f_n`` and ``|m_t| ≤ r f_n``, ``f_n`` at least the squeeze, about any normal."""
    rng, mu, r = np.random.default_rng(0), 0.4, 0.05
    palm = Grip(kind="palm", friction=mu, radius=r, squeeze=3.0, normal=normal)
    u = np.array(normal) / np.linalg.norm(normal)
    np.testing.assert_allclose(palm.normal, u)
    bounds = {b.kind: b for b in palm.bounds()}
    assert set(bounds) == {LimitKind.FRICTION, LimitKind.TILT, LimitKind.SQUEEZE}
    for c in rng.normal(size=(5, 6)):
        f, m = c[:3], c[3:]
        across, tilt = f - u * (f @ u), m - u * (m @ u)
        slip = np.hypot(np.linalg.norm(across), (m @ u) / (2.0 / 3.0 * r))
        for kind, norm, bound in (
            (LimitKind.FRICTION, slip, mu * (f @ u)),
            (LimitKind.TILT, np.linalg.norm(tilt) / r, f @ u),
            (LimitKind.SQUEEZE, 0.0, f @ u - 3.0),
        ):
            assert np.linalg.norm(bounds[kind].A @ c) == pytest.approx(norm)
            assert bounds[kind].b @ c + bounds[kind].d == pytest.approx(bound)


def test_wrist_sensors_read_as_they_are_described(paper: Scenario) -> None:
    """``[g_f R f; g_t R τ] + b`` of the arm that is read; settings that are no such sensor are named."""
    R = np.asarray(pin.exp3(np.array([0.3, -0.2, 0.5])))
    sensor = WristSensor(reads="slave_2", rotation=R, force_gain=-2.0, torque_gain=3.0, bias=np.arange(6.0))
    maps = SensorMaps(paper.cell, {"master": sensor, "slave_2": WristSensor(reads="master")})
    w = np.random.default_rng(0).normal(size=(3, 6))
    read = maps.readings(w)
    np.testing.assert_allclose(read[0], np.r_[-2.0 * R @ w[2, :3], 3.0 * R @ w[2, 3:]] + np.arange(6.0))
    np.testing.assert_allclose(read[1:], [w[1], w[0]])
    lost = read.copy()
    lost[0] = np.nan
    told = maps.wrenches(lost)
    assert np.isnan(told[2]).all()
    np.testing.assert_allclose(told[:2], w[:2])
    plain = WristSensor()
    np.testing.assert_array_equal(plain.map, np.eye(6))
    assert (plain.delay, plain.reads) == (0.0, None)
    mirrored = np.diag([1.0, 1.0, -1.0])
    for settings, named in (
        ({"rotation": mirrored}, "rotation"), ({"rotation": np.eye(4)}, "rotation"),
        ({"rotation": R + 1e-5}, "rotation"), ({"bias": np.zeros(5)}, "bias"),
        ({"force_gain": np.nan}, "force_gain"), ({"torque_gain": np.inf}, "torque_gain"),
        ({"delay": -1e-9}, "delay"), ({"delay": np.inf}, "delay"),
    ):  # fmt: skip
        with pytest.raises(InvalidInputError, match=f"WristSensor: {named}"):
            WristSensor(**settings)
    for dead in ("force_gain", "torque_gain"):
        with pytest.raises(InvalidInputError, match="the sensor of arm slave_1 is dead"):
            SensorMaps(paper.cell, {"slave_1": WristSensor(**{dead: 0.0})}).check()  # type: ignore[arg-type]
    SensorMaps(paper.cell, {"slave_1": WristSensor(force_gain=1e-6)}).check()


def test_forces_are_relaxed_as_told_by_default() -> None:
    """What programs that give only the stiffness rely on: times [s], forces [N], speeds and reach [m, rad]."""
    options = ForceOptions(stiffness=1e4)
    expected: dict[str, Any] = {
        "softness_doubt": 1.5, "relax_time": 0.06, "drift_time": 0.1, "delay": 0.01, "filter_time": 0.02,
        "dead_band": 1.0, "speed": 0.02, "spin": 0.05, "ramp_time": 0.1, "reach": 0.01, "turn": 0.02,
        "check_time": 0.2, "sensor_tolerance": 10.0, "move_below": 5.0, "slow_from": 20.0, "hold_from": 50.0,
        "silent_time": 0.05, "squeeze": 0.0, "most_squeeze": 0.0, "presses": True, "contact_limit": None,
        "payload": None, "palms": None, "sensors": {},
    }  # fmt: skip
    assert {name: getattr(options, name) for name in expected} == expected
