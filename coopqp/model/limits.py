"""What can bind a step: the limits, by name."""

from __future__ import annotations

import enum
from dataclasses import dataclass


class LimitKind(enum.Enum):
    """Which limit of a joint binds."""

    POSITION = "position"
    VELOCITY = "velocity"
    ACCELERATION = "acceleration"
    SINGULARITY = "singularity"
    REACH = "reach"
    PATH_END = "path end"
    OUT_OF_STEP = "out of step"
    CONSTRAINT = "constraint"


@dataclass(frozen=True, slots=True)
class BindingLimit:
    """A limit that the step runs against.

    Attributes:
        arm: name of the arm; empty where the limit is the path's.
        joint: name of the joint, without the arm's prefix; empty where the limit is the whole arm's.
        kind: which limit.
        name: of the user's constraint; empty for other kinds.
    """

    arm: str
    joint: str
    kind: LimitKind
    name: str = ""

    def __str__(self) -> str:
        if self.kind is LimitKind.CONSTRAINT:
            return f"constraint {self.name}"
        if not self.arm:
            return str(self.kind.value)  # the path's own
        joint = f" joint {self.joint}" if self.joint else ""
        return f"arm {self.arm}{joint}: {self.kind.value}"
