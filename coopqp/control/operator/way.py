"""What a loop follows, and where on the program that is."""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace
from typing import final

from coopqp.constraints.cause import Cause, cause_of_limits
from coopqp.control.interface import Status
from coopqp.model.limits import BindingLimit
from coopqp.paths.path import ObjectPath
from coopqp.paths.section import Section
from coopqp.paths.servo import ServoPath


@final
@dataclass(frozen=True, eq=False)
class Way:
    """A path that is followed as a part of a program: the program's clock is ``origin + sense · clock``.

    Attributes:
        path: what is followed.
        program: the object's program.
        origin: the program's clock where the followed path begins [s].
        sense: 1 along the program, −1 back along it, 0 away from it, by hand.
    """

    path: ObjectPath
    program: ObjectPath
    origin: float = 0.0
    sense: int = 1

    @staticmethod
    def of(program: ObjectPath) -> Way:
        """The whole program."""
        return Way(program, program)

    @staticmethod
    def along(section: Section) -> Way:
        """A section of a program."""
        return Way(section, section.path, section.begin, section.sense)

    def clock_of(self, clock: float) -> float:
        """The program's clock at one of the followed path [s]."""
        return self.origin + self.sense * clock

    def apart(self) -> Way:
        """The same way, whose targets move apart from this one's."""
        path = copy.deepcopy(self.path) if isinstance(self.path, ServoPath) else self.path
        return replace(self, path=path, program=path if self.whole else self.program)

    @property
    def whole(self) -> bool:
        """Whether it is the whole program."""
        return self.path is self.program

    def status(self, status: Status) -> Status:
        """How a status along the followed path is called: what moves by hand is JOGGING, also where it stops."""
        return Status.JOGGING if self.sense == 0 and status in _BY_HAND else status

    def cause(self, status: Status, cause: Cause | None, binding: tuple[BindingLimit, ...]) -> Cause | None:
        """The cause of a step with a status along the followed path."""
        if self.sense == 0 and status in _BY_HAND:
            return cause_of_limits(binding) or Cause.OPERATOR
        return cause


_BY_HAND = (Status.TRACKING, Status.SLOWED, Status.BLOCKED, Status.PAUSED)
