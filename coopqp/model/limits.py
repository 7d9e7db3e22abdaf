"""Names of the limits that can bind a step."""

from __future__ import annotations

import enum
from dataclasses import dataclass


class LimitKind(enum.Enum):
    """Kind of a binding limit."""

    POSITION = "position"
    VELOCITY = "velocity"
    ACCELERATION = "acceleration"
    SINGULARITY = "singularity"
    REACH = "reach"
    PATH_END = "path end"
    OUT_OF_STEP = "out of step"


@dataclass(frozen=True, slots=True)
class BindingLimit:
    """A limit that binds in a step.

    Attributes:
        arm: name of the arm; empty for a limit of the path.
        joint: name of the joint without the arm's prefix; empty for a limit of the whole arm.
        kind: kind of the limit.
    """

    arm: str
    joint: str
    kind: LimitKind

    def __str__(self) -> str:
        if not self.arm:
            return self.kind.value  # a limit of the path
        joint = f" joint {self.joint}" if self.joint else ""
        return f"arm {self.arm}{joint}: {self.kind.value}"
