"""Settings of the relaxation of forces between the arms."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

from coopqp.checks import Doc, documented, keep_scalars, require
from coopqp.errors import InvalidInputError
from coopqp.planning.payload import Payload


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
    softness_doubt: Annotated[float, Doc("how many times as soft as they are the servos may be assumed")] = 1.5
    relax_time: Annotated[float, Doc("time T in which a force relaxes [s]")] = 0.06
    drift_time: Annotated[float, Doc("time in which the drift along the path is learned [s]")] = 0.1
    delay: Annotated[float, Doc("age of the wrenches when they arrive [s]")] = 0.01
    filter_time: Annotated[float, Doc("time constant of the filter on wrenches, that of the servos (kd/kp) [s]")] = 0.02
    dead_band: Annotated[float, Doc("internal force that is left alone [N]")] = 1.0
    speed: Annotated[float, Doc("largest speed of a grasp [m/s]")] = 0.02
    spin: Annotated[float, Doc("largest angular speed of a grasp [rad/s]")] = 0.05
    ramp_time: Annotated[float, Doc("time in which a grasp reaches that speed [s]")] = 0.1
    reach: Annotated[float, Doc("largest distance of a grasp from its place [m]")] = 0.01
    turn: Annotated[float, Doc("largest angle of a grasp from its place [rad]")] = 0.02
    check_time: Annotated[float, Doc("time at rest in which the sensors are compared with the servos [s]")] = 0.2
    sensor_tolerance: Annotated[float, Doc("accepted difference of a sensor from what its servos say [N]")] = 10.0
    move_below: Annotated[float, Doc("internal force below which the object begins to move [N]")] = 5.0
    slow_from: Annotated[float, Doc("internal force from which on the object moves more slowly [N]")] = 20.0
    hold_from: Annotated[float, Doc("internal force at which the object rests [N]")] = 50.0
    silent_time: Annotated[float, Doc("time without a new wrench after which the object is held [s]")] = 0.05

    def __post_init__(self) -> None:
        keep_scalars(self, "softness_doubt", "relax_time", "speed", "spin", "ramp_time", "reach", "turn")
        keep_scalars(self, "sensor_tolerance", "move_below", "slow_from", "hold_from", "silent_time")
        keep_scalars(self, "delay", "filter_time", "dead_band", "check_time", open_low=False)
        if self.payload is not None:
            require(self.payload, Payload, "ForceOptions: payload", "Give a coopqp.planning.Payload.")
        if not self.slow_from < self.hold_from:
            raise InvalidInputError(
                f"slow_from is {self.slow_from:g} N, hold_from {self.hold_from:g} N", "ForceOptions", "Slow down first."
            )
