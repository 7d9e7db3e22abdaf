"""Commission wrist sensors on a plant: hold the object, press, and say what each sensor reads."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import final

import numpy as np
import pinocchio as pin

from coopqp.control.qp import QPController
from coopqp.forces.force_controller import ForceController
from coopqp.forces.force_options import ForceOptions
from coopqp.forces.sensor_findings import SensorFinding, SensorJudgement
from coopqp.forces.wrist_sensor import WristSensor
from coopqp.paths.path import HoldPath
from coopqp.paths.scenario import Scenario
from coopqp.planning.payload import Payload
from coopqp.simulation.plants.physics import PhysicsPlant
from coopqp.spatial import Array

#: Longest commissioning [s].
LONGEST = 30.0
#: Values this close to what they should be are what they should be: a fit is no better.
_TURN, _GAIN = np.deg2rad(5.0), 0.08


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Commissioning:
    """What :func:`commission_sensors` found.

    Attributes:
        judgement: each sensor after the corrections that were known; None if the sensors fell silent.
        reason: why there is no judgement.
        sensors: all sensors as they are now known, by arm; None if one of them cannot be corrected.
        added: largest force that the presses added at a grasp, as the plant knows it [N].
    """

    judgement: SensorJudgement | None
    reason: str
    sensors: dict[str, WristSensor] | None
    added: float


def commission_sensors(
    scenario: Scenario,
    plant: PhysicsPlant,
    *,
    known: Mapping[str, WristSensor] | None = None,
    stiffness: Array | None = None,
) -> Commissioning:
    """Press the arms against each other on a plant, at the start of a scenario, and identify the wrist sensors.

    Args:
        scenario: the cell, the grasp, the start and the object.
        plant: the plant, with sensors as they really are.
        known: what is known of the sensors, by arm.
        stiffness: what is known of the joint servos (nv,) [N·m/rad or N/m]; by default what the plant has.

    Raises:
        InvalidInputError: the plant's drives are torque-controlled, or a known sensor is dead.
    """
    s, known = scenario, dict(known or {})
    controller = pressing_controller(s, known=known, stiffness=plant.stiffness if stiffness is None else stiffness)
    q = plant.reset(s.q_start)
    controller.reset(q)
    rest = plant.sensed_wrenches()
    added, reason = 0.0, "the sensors could not be heard"
    for _ in range(round(LONGEST / s.dt)):
        step = controller.step(q, wrenches=plant.measured_wrenches())
        q = plant.apply(step)
        added = max(added, float(np.linalg.norm((plant.sensed_wrenches() - rest)[:, :3], axis=1).max()))
        if controller.sensors is not None:
            break
        if step.status.value in ("holding", "fault"):
            reason = step.reason
            return Commissioning(judgement=None, reason=reason, sensors=None, added=added)
    return commissioning_of(controller, known=known, reason=reason, added=added)


def pressing_controller(
    scenario: Scenario, *, known: Mapping[str, WristSensor], stiffness: Array | None
) -> ForceController:
    """A controller that holds the object at the start of a scenario, and presses the arms against each other.

    Args:
        scenario: the cell, the grasp, the start and the object.
        known: what is known of the sensors, by arm.
        stiffness: of the joint servos (nv,) [N·m/rad or N/m]; None for what :class:`ForceOptions` takes.
    """
    s = scenario
    delay = max([0.01, *(sensor.delay for sensor in known.values())])
    options = ForceOptions(
        presses=True,
        stiffness=stiffness,
        payload=Payload(mass=s.object_mass, centre=tuple(s.T_object_body.translation)),
        delay=delay,
        relax_time=max(0.06, 3.0 * (delay + s.dt)),
        sensors=known,
    )
    inner = QPController(s.cell, s.grasp, HoldPath(s.path.pose(0.0), duration=LONGEST), dt=s.dt)
    return ForceController(inner, options)


def commissioning_of(
    controller: ForceController, *, known: Mapping[str, WristSensor], reason: str, added: float
) -> Commissioning:
    """What a controller found by its presses; ``reason``: why it found nothing, if it did not."""
    found = controller.sensors
    if found is None:
        return Commissioning(judgement=None, reason=reason, sensors=None, added=added)
    return Commissioning(
        judgement=found, reason="", sensors=_together(found, known, controller.cell.arm_names), added=added
    )


def _together(
    found: SensorJudgement, known: Mapping[str, WristSensor], names: tuple[str, ...]
) -> dict[str, WristSensor] | None:
    """Sensors of which ``known`` was corrected, and ``found`` was left; None if one cannot be corrected."""
    if any(f.undecided or not (f.force_gain and f.torque_gain) or f.dead for f in found.findings):
        return None
    by_arm = dict(zip(names, found.findings, strict=True))
    out = {}
    for name in names:
        first = known.get(name, WristSensor())
        then = _as_sensor(by_arm[first.reads or name])
        out[name] = WristSensor(
            reads=then.reads,
            rotation=first.rotation @ then.rotation,
            force_gain=first.force_gain * then.force_gain,
            torque_gain=first.torque_gain * then.torque_gain,
            bias=first.map @ then.bias + first.bias,
            delay=then.delay,
        )
    return out


def _as_sensor(found: SensorFinding) -> WristSensor:
    """A finding as a sensor; what is as good as right counts as right."""
    turned = float(np.linalg.norm(pin.log3(found.rotation)))
    gains = [1.0 if abs(g - 1.0) < _GAIN else g for g in (found.force_gain, found.torque_gain)]
    return WristSensor(
        reads=found.sits_at,
        rotation=np.eye(3) if turned < _TURN else found.rotation,
        force_gain=gains[0],
        torque_gain=gains[1],
        bias=found.bias,
        delay=max(found.delay, 0.0),
    )
