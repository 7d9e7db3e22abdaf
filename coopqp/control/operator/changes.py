"""Changes of an object's motion that an operator asks for: each waits until it is admissible, and the last one wins."""

from __future__ import annotations

import abc
from dataclasses import dataclass, replace
from typing import Any, final

import numpy as np
import pinocchio as pin

from coopqp.checks import as_scalar
from coopqp.control.operator.hands import HAND_SILENCE
from coopqp.control.operator.way import Way
from coopqp.core._core import SAME_CLOCK
from coopqp.errors import InvalidInputError
from coopqp.paths.guarded import GuardedPath
from coopqp.paths.moving_grasps import grasp_at
from coopqp.paths.path import ObjectPath
from coopqp.paths.section import Section
from coopqp.paths.servo import ServoPath
from coopqp.paths.shifted import ShiftedPath, clock_after
from coopqp.spatial import Array

#: A jog command leads so far ahead [s], by no larger angle [rad]; it is renewed or ends long before.
JOG_AHEAD, LARGEST_TURN = 1.0, 3.0
#: Speed and spin on the way back to the path [m/s, rad/s].
RETURN_SPEED, RETURN_SPIN = 0.25, 0.5
#: Shifts of a program at most: each makes its steps a little longer.
MOST_SHIFTS = 50
#: Speed and spin of a target that streams [m/s, rad/s].
TARGET_SPEED, TARGET_SPIN = 0.4, 1.0


def on_program(path: ObjectPath, clock: float, where: str) -> float:
    """A clock on a program that has an end [s].

    Raises:
        InvalidInputError: it is not on it, or the program has none.
    """
    duration = GuardedPath(path).duration
    if isinstance(path, ServoPath) or not duration < float("inf"):
        raise InvalidInputError(f"a {type(path).__name__} has no end", where, "Follow a path that has one.")
    return as_scalar(clock, where, open_low=False, high=duration)


class Change(abc.ABC):
    """A change of the motion. :meth:`attempt` is called in each step until it says that it is made.

    It is given the controller's :class:`~coopqp.control.operator.operator.Operator`, which stands above its changes.
    """

    #: The call that asks for it.
    call = ""
    #: What the object waits for, as the end of a sentence.
    waits = ""
    #: Whether the object is led by hand for it.
    by_hand = False
    #: How long the command holds without another one [s].
    holds_for = np.inf

    def check(self, program: ObjectPath, clock: float) -> None:  # noqa: B027 - most can be made anywhere
        """Refuse what the object cannot do at a clock of a program [s].

        It is asked where the call comes and, as other calls may come ahead, again where it takes effect.

        Raises:
            InvalidInputError: it cannot.
        """

    @abc.abstractmethod
    def attempt(self, operator: Any) -> bool:
        """Make the change if it is admissible now."""


@final
@dataclass(frozen=True, eq=False)
class Target(Change):
    """Another target of a program that is a :class:`coopqp.ServoPath`."""

    goal: pin.SE3
    call, waits = "retarget", "the object brakes before it goes over to its new target"

    def check(self, program: ObjectPath, clock: float) -> None:
        """See :class:`Change`."""
        if not isinstance(program, ServoPath):
            what = f"the path is a {type(program).__name__}"
            raise InvalidInputError(what, "retarget", "Build the controller with a ServoPath.")

    def attempt(self, operator: Any) -> bool:
        """See :class:`Change`."""
        path = operator.way.path
        assert isinstance(path, ServoPath)
        return operator.retarget(path, self.goal)


@final
@dataclass(frozen=True, eq=False)
class Travel(Change):
    """To a clock of the program, in either direction, and rest there; ``to`` None: on to the end of the program.

    Attributes:
        to: the clock [s].
        back: it may not lie ahead.
    """

    to: float | None
    back: bool = False
    waits = "the object brakes before it goes the other way"

    @property
    def call(self) -> str:  # type: ignore[override]
        """See :class:`Change`."""
        return "reverse" if self.back else "forward" if self.to is None else "run_to"

    def check(self, program: ObjectPath, clock: float) -> None:
        """See :class:`Change`."""
        if self.to is None:
            return
        on_program(program, self.to, "reverse: to" if self.back else "run_to: clock")
        if self.back and self.to > clock:
            what = f"{self.to:g} s lies ahead"
            raise InvalidInputError(what, "reverse: to", "Give an earlier clock, or call run_to.")

    def attempt(self, operator: Any) -> bool:
        """See :class:`Change`."""
        way, clock, rests = operator.way, operator.clock, operator.rests
        program = way.program
        if self.to is None:
            if way.whole:
                return True
            return operator.take(*operator.onward(program, clock)) if rests or way.sense > 0 else False
        if abs(self.to - clock) <= SAME_CLOCK:
            if rests:
                operator.rest_at(clock)
            return rests
        sense = 1 if self.to > clock else -1
        if not rests and sense != way.sense:
            return False
        elbows = operator.way_back() if sense < 0 else None
        to = self.to
        if sense > 0:  # no further than to a shut gate
            shut = [at for at, name in program.gates if name not in operator.opened and at > clock + SAME_CLOCK]
            to = min([to, *shut])
        section = Section(program, clock, to, elbows=elbows, keeps_clear=True if elbows is not None else None)
        return operator.take(Way.along(section), 0.0)


@final
@dataclass(frozen=True, eq=False)
class Shift(Change):
    """The program from here on goes over to a shifted one, over a length of path [m]."""

    shift: pin.SE3
    over: float
    call, waits = "shift_path", "the object brakes before its path is shifted"

    def check(self, program: ObjectPath, clock: float) -> None:
        """See :class:`Change`."""
        if isinstance(program, ServoPath):
            raise InvalidInputError("the path is a ServoPath", "shift_path", "Move its target: retarget.")
        if clock >= GuardedPath(program).duration:
            raise InvalidInputError("the object is at the end of its path", "shift_path", "Shift it before.")
        shifts = 0
        while isinstance(program, ShiftedPath):
            program, shifts = program.path, shifts + 1
        if shifts >= MOST_SHIFTS:
            what = f"the program has been shifted {shifts} times on its way"
            raise InvalidInputError(what, "shift_path", "Follow a path that is where the object is: follow.")

    def attempt(self, operator: Any) -> bool:
        """See :class:`Change`."""
        way, clock = operator.way, operator.clock
        program, shift = way.program, self.shift
        end = clock_after(program, clock, self.over)
        if not end > clock:  # nothing is ahead
            return True
        while isinstance(program, ShiftedPath) and program.begin >= clock:  # of that one nothing lies behind
            shift = shift * program.shift
            program = program.path
        shifted = ShiftedPath(program, shift, begin=clock, end=end)
        if way.sense < 0:  # what lies behind stays
            section = way.path
            assert isinstance(section, Section)
            return operator.take(replace(way, program=shifted), operator.loop_clock, same=True)
        if way.whole:
            return operator.take(*operator.onward(shifted, clock))
        assert isinstance(way.path, Section)
        return operator.take(Way.along(Section(shifted, clock, way.path.end)), 0.0)


@final
@dataclass(frozen=True, eq=False)
class Jog(Change):
    """Move the object with a twist (6,) [m/s, rad/s] about its origin, in the axes of a frame; zeros: stop.

    Attributes:
        twist: as given.
        arm: number of the arm in whose tool's axes it is; −1 in the world's, −2 in the object's.
        holds_for: how long it holds [s].
    """

    twist: Array
    arm: int = -1
    holds_for: float = 0.1
    call, by_hand = "jog", True
    waits = "the object comes to rest before the operator leads it"

    def attempt(self, operator: Any) -> bool:
        """See :class:`Change`."""
        if not operator.lead():
            return False
        if operator.expired:
            return True
        path = operator.way.path
        assert isinstance(path, ServoPath)
        here = path.pose(operator.loop_clock)
        R = np.eye(3) if self.arm == -1 else here.rotation
        if self.arm >= 0:
            held = grasp_at(operator.grasp, operator.way.program, operator.clock)
            R = R @ held.T_object_tool[self.arm].rotation
        v, w = R @ self.twist[:3], R @ self.twist[3:]
        if operator.jogs_on(np.concatenate([v, w])):
            return True
        path.speed, path.spin = (float(np.linalg.norm(x)) or 1.0 for x in (v, w))
        ahead = min(JOG_AHEAD, LARGEST_TURN / path.spin)
        goal = pin.SE3(pin.exp3(ahead * w) @ here.rotation, here.translation + ahead * v)
        taken = operator.retarget(path, goal)
        if taken:
            operator.jogged = np.concatenate([v, w])
        return taken


@final
@dataclass(frozen=True, eq=False)
class Follow(Change):
    """Go where the hand leads that is engaged."""

    holds_for = HAND_SILENCE
    call, by_hand = "engage", True
    waits = "the object comes to rest before the operator leads it"

    def attempt(self, operator: Any) -> bool:
        """See :class:`Change`."""
        if not operator.lead():
            return False
        clutch, path = operator.clutch, operator.way.path
        if operator.expired or clutch is None:
            return True
        assert isinstance(path, ServoPath)
        operator.clutch, goal = clutch.goal(path.pose(operator.loop_clock))
        path.speed, path.spin = TARGET_SPEED, TARGET_SPIN
        return operator.retarget(path, goal)


@final
@dataclass(frozen=True, eq=False)
class Return(Change):
    """Back to the program on a straight way; then it goes on where it was."""

    call, by_hand = "return_to_path", True
    waits = "the object brakes before it goes back to its path"

    def attempt(self, operator: Any) -> bool:
        """See :class:`Change`."""
        way = operator.way
        if way.sense != 0:
            return True
        path = way.path
        assert isinstance(path, ServoPath)
        path.speed, path.spin = RETURN_SPEED, RETURN_SPIN
        operator.returns = operator.retarget(path, way.program.pose(way.origin))
        return operator.returns
