"""Settings of the relaxation of forces between the arms."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np

from coopqp.checks import Doc, as_floats, as_tuple, as_vector, documented, keep_scalars, require
from coopqp.errors import InvalidInputError
from coopqp.forces.grips import Grip
from coopqp.forces.wrist_sensor import WristSensor
from coopqp.planning.payload import Payload
from coopqp.spatial import Array


@documented
@dataclass(frozen=True, kw_only=True, eq=False)
class ForceOptions:
    """How the forces between the arms are relaxed, and when they stop the object."""

    stiffness: Annotated[
        Any, Doc("Kp of the joint servos [N·m/rad or N/m]; one number, or one per joint (nv,); it must be given")
    ] = None
    payload: Annotated[
        Payload | None,
        Doc("what the drives carry by feed-forward, shared so that grips take as little torque as can be; or nothing"),
    ] = None
    directions: Annotated[
        Any,
        Doc("1 where an arm minds forces, 0 where it keeps its place, in its tool's axes (N, 6); 1 by default"),
    ] = None
    palms: Annotated[
        tuple[Grip, ...] | None, Doc("open palms in place of grips: they mind what presses, tilts and turns them")
    ] = None
    squeeze: Annotated[float, Doc("normal force with which palms press [N]; it must be given for palms")] = 0.0
    most_squeeze: Annotated[
        float, Doc("palms press harder where their friction runs out, up to this [N]; not at all by default")
    ] = 0.0
    softness_doubt: Annotated[float, Doc("largest assumed softness of the servos, as a multiple of the real one")] = 1.5
    relax_time: Annotated[float, Doc("time T in which a force relaxes [s]")] = 0.06
    drift_time: Annotated[float, Doc("time in which the drift along the path is learned [s]")] = 0.1
    delay: Annotated[float, Doc("age of the wrenches when they arrive [s]")] = 0.01
    filter_time: Annotated[float, Doc("time constant of the filter on wrenches [s]; give kd/kp of the servos")] = 0.02
    dead_band: Annotated[float, Doc("internal force that is left alone [N]")] = 1.0
    speed: Annotated[float, Doc("largest speed of a grasp [m/s]")] = 0.02
    spin: Annotated[float, Doc("largest angular speed of a grasp [rad/s]")] = 0.05
    ramp_time: Annotated[float, Doc("time in which a grasp reaches that speed [s]")] = 0.1
    reach: Annotated[float, Doc("largest distance of a grasp from its place [m]")] = 0.01
    turn: Annotated[float, Doc("largest angle of a grasp from its place [rad]")] = 0.02
    sensors: Annotated[
        Mapping[str, WristSensor],
        Doc("how the wrist sensors are known to read, by arm; readings are corrected by it"),
    ] = field(default_factory=dict)
    check_time: Annotated[float, Doc("time at rest in which the sensors are compared with the servos [s]")] = 0.2
    presses: Annotated[
        bool,
        Doc("arms press each other at the start, to find wrong sensors; or sensors are compared with servos at rest"),
    ] = True
    sensor_tolerance: Annotated[float, Doc("accepted difference of a sensor from its servos' estimate [N]")] = 10.0
    move_below: Annotated[float, Doc("internal force below which the object begins to move [N]")] = 5.0
    slow_from: Annotated[float, Doc("internal force from which on the object moves more slowly [N]")] = 20.0
    hold_from: Annotated[float, Doc("internal force at which the object rests [N]")] = 50.0
    contact_limit: Annotated[
        float | None,
        Doc(
            "force on the object beside its payload's weight and inertia from which on it is held [N]; by default a "
            "fifth of the weight and at least 25 N where grips hold a payload that is told; inf for none"
        ),
    ] = None
    silent_time: Annotated[
        float,
        Doc(
            "time without a new wrench after which the object is held [s]; longer for sensors that lose some at random"
        ),
    ] = 0.05

    def minded(self, arms: int) -> Array:
        """The directions that each of ``arms`` minds (N, 6): :attr:`directions`, or those of the palms.

        Raises:
            InvalidInputError: another number of arms.
        """
        if self.palms is not None:
            if len(self.palms) != arms:
                raise InvalidInputError(f"{len(self.palms)} palms for {arms} arms", "ForceOptions", "Give one per arm.")
            return np.array([[*np.round(np.abs(palm.normal)), 1.0, 1.0, 1.0] for palm in self.palms])
        if self.directions is None:
            return np.ones((arms, 6))
        given = as_vector(np.ravel(as_floats(self.directions)), 6 * arms, "ForceOptions: directions").reshape(arms, 6)
        if not np.isin(given, (0.0, 1.0)).all():
            raise InvalidInputError(
                "other directions than 0 and 1", "ForceOptions", "Give 1 for arms that mind forces."
            )
        return given

    def __post_init__(self) -> None:
        keep_scalars(self, "squeeze", "most_squeeze", open_low=False)
        if self.palms is not None:
            object.__setattr__(self, "palms", as_tuple(self.palms, "ForceOptions: palms", "Give one Grip per arm."))
            keep_scalars(self, "squeeze")
            if 0.0 < self.most_squeeze < self.squeeze:
                raise InvalidInputError(
                    f"most_squeeze is {self.most_squeeze:g} N, squeeze {self.squeeze:g} N", "ForceOptions", "Raise it."
                )
            for palm in self.palms:
                if not isinstance(palm, Grip) or palm.kind != "palm" or np.abs(palm.normal).max() < 1.0 - 1e-9:
                    raise InvalidInputError(
                        "no palm along an axis of its tool", "ForceOptions: palms", 'Give Grip(kind="palm", …).'
                    )
            if self.directions is not None:
                raise InvalidInputError(
                    "palms and directions", "ForceOptions", "Palms mind forces along their normals, and moments."
                )
        elif self.squeeze or self.most_squeeze:
            raise InvalidInputError("a squeeze without palms", "ForceOptions: palms", "Give one Grip per arm.")
        keep_scalars(self, "softness_doubt", "relax_time", "drift_time", "speed", "spin", "ramp_time", "reach", "turn")
        keep_scalars(self, "sensor_tolerance", "move_below", "slow_from", "hold_from", "silent_time")
        keep_scalars(self, "delay", "filter_time", "dead_band", "check_time", open_low=False)
        require(self.sensors, Mapping, "ForceOptions: sensors", "Give a WristSensor by arm.")
        for name, sensor in self.sensors.items():
            require(sensor, WristSensor, f"ForceOptions: sensors['{name}']", "Give a coopqp.forces.WristSensor.")
        require(self.presses, bool, "ForceOptions: presses", "Give true or false.")
        if self.contact_limit is not None:
            if self.contact_limit != np.inf:
                keep_scalars(self, "contact_limit")
            if self.payload is None and self.contact_limit < np.inf:
                raise InvalidInputError(
                    "a contact_limit without a payload", "ForceOptions", "Say what the arms carry: payload=Payload(…)."
                )
        if self.payload is not None:
            require(self.payload, Payload, "ForceOptions: payload", "Give a coopqp.planning.Payload.")
        if not self.slow_from < self.hold_from:
            raise InvalidInputError(
                f"slow_from is {self.slow_from:g} N, hold_from {self.hold_from:g} N", "ForceOptions", "Slow down first."
            )
