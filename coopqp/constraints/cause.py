"""Why a step is not TRACKING, as one word for programs; the sentence is the step's reason."""

from __future__ import annotations

import enum

from coopqp.model.limits import BindingLimit, LimitKind


class Cause(enum.Enum):
    """Why the status of a step is not TRACKING. The arms, the joint and the number stand in its reason and limits."""

    LIMIT = "limit"  #: a limit of the joints, the reach, the loads or the rate's rise; a constraint of the user's
    SINGULARITY = "singularity"  #: an arm is near a singularity
    CLEARANCE = "clearance"  #: two bodies come too close
    TRACKING = "tracking"  #: an arm is measured elsewhere than it is commanded
    COMMANDED_CHAIN = "commanded chain"  #: the commands lead two arms apart
    SENSOR = "sensor"  #: a sensor is silent or wrong, or still to be compared
    CONTACT = "contact"  #: the object touches something
    INPUT = "input"  #: a length of a step, a measurement, a path or a constraint that cannot be used
    SOLVER = "solver"  #: the QP has no usable answer
    DRIVER = "driver"  #: a robot's driver or controller
    OPERATOR = "operator"  #: a pause, an override, or a target that has moved
    GATE = "gate"  #: the object waits for a signal


_OF_KIND = {
    LimitKind.SINGULARITY: Cause.SINGULARITY,
    LimitKind.COLLISION: Cause.CLEARANCE,
    LimitKind.OUT_OF_STEP: Cause.TRACKING,
    LimitKind.OVERRIDE: Cause.OPERATOR,
    LimitKind.PATH_JUMP: Cause.INPUT,
}


def cause_of_limits(binding: tuple[BindingLimit, ...]) -> Cause | None:
    """The cause that binding limits stand for, None without any; what is more than a plain limit comes first."""
    causes = [_OF_KIND.get(limit.kind, Cause.LIMIT) for limit in binding]
    return next((cause for cause in causes if cause is not Cause.LIMIT), Cause.LIMIT if causes else None)
