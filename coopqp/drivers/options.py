"""Settings of the control loop."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from coopqp.checks import Doc, as_scalar, documented, keep_scalars
from coopqp.drivers.process import as_priority
from coopqp.errors import InvalidInputError

#: Longest accepted period [s].
LONGEST_PERIOD = 0.020
#: Longest accepted time without a heartbeat [s].
LONGEST_HEARTBEAT = 0.2


@documented
@dataclass(frozen=True, kw_only=True)
class LoopOptions:
    """Settings of a :class:`coopqp.drivers.ControlLoop`."""

    period: Annotated[float | None, Doc("time between two commands [s]; None for the controller's dt")] = None
    lead: Annotated[float | None, Doc("how long before it holds a command is sent [s]; None for three periods")] = None
    patience: Annotated[
        float | None,
        Doc("age at which a state counts as missing [s]; None for two periods of the robot, and 5 ms at least"),
    ] = None
    gone_after: Annotated[float, Doc("age of the last state at which a robot counts as gone, and the run ends [s]")] = (
        0.1
    )
    ramp_time: Annotated[float, Doc("time in which the speed rises from a tenth at the start [s]")] = 0.1
    resume_time: Annotated[
        float,
        Doc("the same after a pause or a stop, where the object has to get up speed in the middle of its path [s]"),
    ] = 1.0
    addition: Annotated[
        float, Doc("share of the joints' limits for the correction that puts the tools, not the joints, together")
    ] = 0.05
    deviation_time: Annotated[
        float,
        Doc(
            "time constant of the low pass on what the controller sees of how far arms are off their way [s]; a rigid "
            "grip makes the others' deviation of a disturbance of one arm"
        ),
    ] = 0.4
    learning_time: Annotated[
        float, Doc("time of motion in which lags that no driver tells are learnt [s]; 0 for never")
    ] = 0.3
    learning_addition: Annotated[float, Doc("share of the joints' limits for what is learnt, until it rests")] = 0.2
    start_tolerance: Annotated[
        float, Doc("largest distance of a first command from where a joint's servo is [rad or m]")
    ] = 5e-3
    end_tolerance_m: Annotated[
        float, Doc("a run has finished where each tool is measured this near to where it is sent at the end [m]")
    ] = 5e-3
    end_tolerance_rad: Annotated[float, Doc("the same for its turn [rad]")] = 0.0175
    connect_time: Annotated[float, Doc("longest wait for the first states of all robots [s]")] = 2.0
    rest_time: Annotated[float, Doc("how long states are averaged before the start [s]")] = 0.1
    give_up_after: Annotated[
        float, Doc("the run ends when the controller held or was blocked for this time [s]; a pause does not count")
    ] = 1.0
    heartbeat: Annotated[
        float | None,
        Doc("dead man's switch: the arms brake when nobody called beat() for this time [s], 0.2 at most; None without"),
    ] = None

    realtime: Annotated[
        int | None, Doc("priority of the FIFO scheduler that the loop's thread asks for, 1 to 99; None for none")
    ] = None
    lock_memory: Annotated[bool, Doc("ask that the process's memory is never swapped out")] = False
    core: Annotated[int | None, Doc("the only core that the loop's thread asks for; None for any")] = None

    def __post_init__(self) -> None:
        as_priority(self.realtime, "LoopOptions: realtime")
        if self.period is not None:
            keep_scalars(self, "period")
        if self.lead is not None:
            object.__setattr__(self, "lead", as_scalar(self.lead, "LoopOptions: lead", open_low=False, high=1.0))
        if self.patience is not None:
            keep_scalars(self, "patience")
        keep_scalars(
            self,
            "gone_after",
            "start_tolerance",
            "end_tolerance_m",
            "end_tolerance_rad",
            "connect_time",
            "give_up_after",
        )
        keep_scalars(self, "ramp_time", "resume_time", "learning_time", "rest_time", "deviation_time", open_low=False)
        keep_scalars(self, "addition", "learning_addition", high=0.5, open_low=False)
        if self.heartbeat is not None:
            keep_scalars(self, "heartbeat", high=LONGEST_HEARTBEAT)
        if self.period is not None and self.period > LONGEST_PERIOD:
            raise InvalidInputError(
                f"period is {self.period:g} s", "LoopOptions", f"Give at most {LONGEST_PERIOD:g} s."
            )
