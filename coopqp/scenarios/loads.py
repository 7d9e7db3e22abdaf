"""Scenarios where forces matter: they run in the physics engine (extra ``mujoco``)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pinocchio as pin

from coopqp.checks import as_scalar
from coopqp.errors import UnknownNameError
from coopqp.paths.scenario import EngineSettings, Scenario
from coopqp.scenarios.paper import paper_lift
from coopqp.scenarios.stations import STANCES, facing, moved, put_together
from coopqp.scenarios.units import Degrees, Kilograms, Metres, Newtons, Seconds

#: Age of the wrenches when they arrive [s].
_LATE = {"wrench_latency": 0.01}
#: Forces deflect the arms: only a large deviation stops the object.
_TOLERANT = {"supervision": {"slow_from": 0.005, "hold_from": 0.01, "stall_samples": 10_000}}


def base_off_lift(
    *, arm: str = "slave_2", distance: Metres = 1e-3, angle: Degrees = 0.1, duration: Seconds = 3.0
) -> Scenario:
    """The paper's lift with one base off; the arms relax the forces that follow from it.

    Args:
        arm: the arm whose base is off.
        distance, angle: its error along and about the diagonal of its axes [m, deg].
        duration: duration of the path [s].

    Raises:
        UnknownNameError: no such arm.
    """
    lift = paper_lift(time_law="quintic", duration=duration)
    if arm not in lift.cell.arm_names:
        raise UnknownNameError("arm", str(arm), lift.cell.arm_names, "base_off_lift")
    off = {arm: _along_the_diagonal(distance, angle)}
    return replace(
        lift,
        name="base_off_lift",
        engine=EngineSettings(disturbances={"base_offset": off, **_LATE}, forces={}, internal_force=30.0),
    )


def _along_the_diagonal(distance: float, angle_deg: float) -> pin.SE3:
    """A shift along the diagonal of the axes [m], and a turn about it [deg]."""
    diagonal = np.ones(3) / np.sqrt(3.0)
    return pin.SE3(pin.exp3(np.deg2rad(angle_deg) * diagonal), distance * diagonal)


def hot_plate(*, growth: Metres = 2.2e-3, period: Seconds = 12.0, duration: Seconds = 3.0) -> Scenario:
    """The paper's lift with a plate that grows as it warms up; the arms give way.

    Args:
        growth: growth of the plate's length in a quarter of the period [m].
        period: period of growth and shrinkage [s].
        duration: duration of the path [s].
    """
    lift = paper_lift(time_law="quintic", duration=duration)
    share = as_scalar(growth, "hot_plate: growth", open_low=False) / lift.object_size[1]
    grows = {"object_growth": share, "growth_period": period, **_LATE}
    return replace(
        lift,
        name="hot_plate",
        engine=EngineSettings(disturbances=grows, forces={}, controller=_TOLERANT, internal_force=30.0),
    )


def heavy_lift(*, mass: Kilograms = 53.0, internal_force: Newtons = 50.0, duration: Seconds = 6.0) -> Scenario:
    """The paper's lift with a plate that three arms carry only if they share its load well.

    In equal parts 53 kg would take more torque than the arms have.

    Args:
        mass: mass of the plate [kg].
        internal_force: largest internal force of an arm [N].
        duration: duration of the path [s].
    """
    lift = paper_lift(time_law="quintic", duration=duration)
    return replace(
        lift,
        name="heavy_lift",
        dt=0.0075,
        object_mass=as_scalar(mass, "heavy_lift: mass"),
        engine=EngineSettings(shares_load=True, torque_share=0.98, internal_force=internal_force),
    )


def torque_lift(
    *,
    servo: str = "disturbance observer",
    wrist_sensors: bool = True,
    assumed_mass: float = 0.5,
    assumed_payload: float = 0.5,
    duration: Seconds = 3.0,
) -> Scenario:
    """The paper's lift by torque-controlled arms whose drives take arms and plate for half as heavy as they are.

    Args:
        servo, wrist_sensors, assumed_mass, assumed_payload: as in :class:`coopqp.simulation.PhysicsOptions`.
        duration: duration of the path [s].
    """
    lift = paper_lift(time_law="quintic", duration=duration)
    drives = {
        "servo": servo,
        "wrist_sensors": wrist_sensors,
        "assumed_mass": assumed_mass,
        "assumed_payload": assumed_payload,
    }
    late = {"wrench_latency": 0.005}
    return replace(
        lift,
        name="torque_lift",
        engine=EngineSettings(options=drives, disturbances=late, shares_load=True, internal_force=20.0),
    )


def palm_box(
    *,
    squeeze: Newtons = 200.0,
    most_squeeze: Newtons = 260.0,
    mass: Kilograms = 20.0,
    friction: float = 0.6,
    base_off: bool = False,
    duration: Seconds = 3.0,
) -> Scenario:
    """Two RX-90L lift a box between their open palms, by friction alone.

    Args:
        squeeze: normal force of the palms [N]; 20 kg need 164 N at least.
        most_squeeze: largest normal force, where friction runs out [N].
        mass: mass of the box [kg].
        friction: μ between palms and box.
        base_off: the right arm's base is off by 1 mm and 0.1°.
        duration: duration of the path [s].
    """
    path = moved(0.60, (0.05, 0.05, 0.25), (0.0, 0.0, 0.2), duration)
    stations = facing("rx90l", 0.20, STANCES["rx90l"]._replace(height=0.60))
    made = put_together("palm_box", stations, path, dt=0.005, object_size=(0.40, 0.30, 0.30), object_mass=mass)
    off = {"right": _along_the_diagonal(1e-3, 0.1)} if base_off else {}
    palm = {"kind": "palm", "friction": friction, "radius": 0.06, "squeeze": 0.8 * squeeze}
    engine = EngineSettings(
        disturbances={"base_offset": off, **_LATE},
        palms=(palm, palm),
        forces={"squeeze": squeeze, "most_squeeze": max(most_squeeze, squeeze)},
        controller=_TOLERANT,
        tolerances={"object_mm": 5.0},
    )
    return replace(made, engine=engine)


#: The scenarios of this module by name.
LOADED: dict[str, Callable[[], Scenario]] = {
    make.__name__: make for make in (base_off_lift, hot_plate, heavy_lift, torque_lift, palm_box)
}
