"""Thresholds of the supervision."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from coopqp.checks import Doc, as_count, as_scalar, as_vector, documented, keep_scalars
from coopqp.errors import InvalidInputError

#: Samples that are kept at most, to see an arm stall in.
_MOST_SAMPLES = 10_000


@documented
@dataclass(frozen=True, kw_only=True)
class SupervisionOptions:
    """Thresholds of the supervision; None turns a part of it off.

    The defaults keep arms within a millimetre of each other when one of them lags by 10 ms at 0.25 m/s.
    """

    slow_from: Annotated[
        float | None,
        Doc(
            "distance of an arm from the others at the grasps, beyond its commanded distance, at which "
            "the object begins to slow [m]; the noise floor is added"
        ),
    ] = 0.00025
    hold_from: Annotated[float, Doc("distance, measured in the same way, at which the object is held [m]")] = 0.00075
    let_in: Annotated[
        float,
        Doc(
            "slow drift of the arms apart that is tolerated, as misplaced bases cause it [m]; with 0 every drift counts"
        ),
    ] = 0.003
    noise_margin: Annotated[
        float, Doc("noise floor, in root mean squares of the noise that is seen in the measurements")
    ] = 4.0
    recovery_time: Annotated[float, Doc("time in which a slowed object is let go again from rest [s]")] = 0.1
    fault_from: Annotated[
        float, Doc("distance at which the controller latches a fault, in two samples in a row [m]")
    ] = 0.02
    apart_from: Annotated[
        float | None,
        Doc(
            "distance of an arm's view of the object from the others', as commanded, at which the arms hold [m]; they "
            "go on below half of it"
        ),
    ] = 2e-4
    stall_samples: Annotated[
        int | None,
        Doc(
            "number of samples in which an arm moves less than stall_share of its command, while another "
            "follows its own, until it has stalled (once a joint is 0.5 mrad or 0.5 mm from its command); an arm that "
            "turned round or began to move within 20 ms before may just be late"
        ),
    ] = 4
    stall_share: Annotated[
        float, Doc("share of its command below which an arm may have stalled: see stall_samples")
    ] = 0.2
    silent_time: Annotated[
        float,
        Doc("time in which no arm is seen to follow its command until all have stopped, or measurements are stale [s]"),
    ] = 0.03
    filter_time: Annotated[float, Doc("time constant of the filter on the distances [s]")] = 0.002
    dt_range: Annotated[tuple[float, float], Doc("accepted length of a step, as multiples of the nominal one")] = (
        0.1,
        5.0,
    )
    joint_jump: Annotated[
        float, Doc("distance of a measured joint from its command beyond which it is not believed [rad or m]")
    ] = 0.3
    stiffness: Annotated[
        float | tuple[float, ...] | None,
        Doc(
            "Kp of the joint servos, one number or one per joint [N·m/rad or N/m]. With it the force at "
            "each grasp is read from the servos' deflection, which shows what a rigid grip hides from the "
            "distances; None does without"
        ),
    ] = None
    force_limit: Annotated[
        float,
        Doc(
            "force at a grasp, by the servos, at which the object is held [N], and from half of it on where it would "
            "come to it within 25 ms at its pace; it goes on below half of it. It has to be more than what noise, the "
            "share of the load and inertia make of it"
        ),
    ] = 300.0
    servo_delay: Annotated[
        float, Doc("age of measurements against commands, and lag of the servos [s]: motion within it is no force")
    ] = 0.0

    def __post_init__(self) -> None:
        keep_scalars(self, "hold_from", "fault_from", "silent_time", "joint_jump", "force_limit")
        keep_scalars(self, "servo_delay", open_low=False)
        if self.stiffness is not None:
            object.__setattr__(self, "stiffness", _as_stiffness(self.stiffness))
        keep_scalars(self, "stall_share", high=1.0)
        keep_scalars(self, "filter_time", "noise_margin", "recovery_time", "let_in", open_low=False)
        low, high = as_vector(self.dt_range, 2, "SupervisionOptions: dt_range")
        low = as_scalar(low, "SupervisionOptions: dt_range[0]", high=1.0)
        high = as_scalar(high, "SupervisionOptions: dt_range[1]", low=1.0, open_low=False)
        object.__setattr__(self, "dt_range", (low, high))
        if self.apart_from is not None:
            keep_scalars(self, "apart_from")
        if self.slow_from is not None:
            keep_scalars(self, "slow_from", high=self.hold_from)
        if self.stall_samples is not None:
            samples = as_count(self.stall_samples, "SupervisionOptions: stall_samples")
            if samples > _MOST_SAMPLES:
                raise InvalidInputError(
                    f"stall_samples is {samples}", "SupervisionOptions", f"Give at most {_MOST_SAMPLES}."
                )
            object.__setattr__(self, "stall_samples", samples)


def _as_stiffness(value: Any) -> float | tuple[float, ...]:
    """One number or a tuple of them, each finite and > 0; an array is taken too."""
    where = "SupervisionOptions: stiffness"
    try:
        many = np.ndim(value) > 0
    except ValueError:  # rows of several lengths
        many = True
    if not many:
        return as_scalar(value, where)
    return tuple(as_scalar(x, f"{where}[{i}]") for i, x in enumerate(value))
