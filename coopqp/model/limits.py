"""Names of the limits that can bind a step."""

from __future__ import annotations

import enum
from dataclasses import dataclass, field


class LimitKind(enum.Enum):
    """Kind of a binding limit."""

    POSITION = "position"
    VELOCITY = "velocity"
    ACCELERATION = "acceleration"
    SINGULARITY = "singularity"
    REACH = "reach"
    PATH_END = "path end"
    OUT_OF_STEP = "out of step"
    CONSTRAINT = "constraint"
    OVERRIDE = "override"
    PATH_JUMP = "path jump"
    TORQUE = "torque"
    JERK = "jerk"
    COLLISION = "collision"
    WRIST = "wrist wrench"
    GRIP_FORCE = "force of the grip"
    GRIP_TORQUE = "torque of the grip"
    FRICTION = "friction"
    TILT = "tilt on the pad"
    SQUEEZE = "squeeze"
    INTERNAL_FORCE = "internal force"
    INTERNAL_TORQUE = "internal torque"


@dataclass(frozen=True, slots=True)
class BindingLimit:
    """A limit that binds in a step.

    Attributes:
        arm: name of the arm; empty for a limit of the path.
        joint: name of the joint without the arm's prefix; empty for a limit of the whole arm.
        kind: kind of the limit.
        name: name of the user's constraint; empty for other kinds.
        between: names of two bodies that come too close; empty for other kinds.
        distance: between these bodies as the step begins, where it is known [m].
    """

    arm: str
    joint: str
    kind: LimitKind
    name: str = ""
    between: tuple[str, str] | tuple[()] = ()
    distance: float | None = field(default=None, compare=False)

    def __str__(self) -> str:
        if self.kind is LimitKind.CONSTRAINT:
            return f"constraint {self.name}"
        if self.kind is LimitKind.COLLISION:
            apart = "" if self.distance is None else f": {1e3 * self.distance:.1f} mm"
            return f"{' and '.join(self.between)}{apart}"
        if not self.arm:
            return str(self.kind.value)  # the path's own
        joint = f" joint {self.joint}" if self.joint else ""
        return f"arm {self.arm}{joint}: {self.kind.value}"
