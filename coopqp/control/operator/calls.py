"""The calls of an operator, the same on every controller that takes them."""

from __future__ import annotations

import abc
from collections.abc import Callable
from typing import Any

from coopqp.checks import ArrayLike, as_scalar, as_vector
from coopqp.control.operator.changes import Change, Jog, Return, Shift, Target, Travel, on_program
from coopqp.control.operator.operator import Operator
from coopqp.errors import UnknownNameError
from coopqp.paths.guarded import GuardedPath
from coopqp.spatial import Placement, as_placement

#: Time that a jog command holds [s].
DEADMAN = 0.1


class OperatorCalls(abc.ABC):
    """Pause, signals, new targets; reverse, step, jog, return and shift.

    Each is a change that waits until it is admissible: the object brakes on its present way until then, at rest at the
    latest, and the reason of the steps says so. The last one wins. A bad value changes nothing. In HOLDING and FAULT a
    change is kept, and nothing moves; ``reset`` discards it. From another thread than the one that steps, a call takes
    effect in the next step; of several that decide the same (pause or resume, the override, the way to go, a twist)
    the last one does. What cannot be done any more by then is refused: an event of the recording says so.
    """

    @property
    @abc.abstractmethod
    def _commanded(self) -> Any:
        """The QPController that makes the changes; controllers stand above their calls."""

    def _asked(self, name: str, value: Any, change: Change) -> None:
        controller = self._commanded
        change.check(controller.path, controller.program_clock)
        controller.operate(name, value, lambda operator: self._takes(operator, change), started=True)

    def _takes(self, operator: Operator, change: Change) -> None:
        """Take a change, in the thread that steps."""
        operator.ask(change)

    def pause(self) -> None:
        """Bring the object to rest on its path, until :meth:`resume`; a reset or another path changes nothing.

        At rest the status is PAUSED. Errors are still corrected, and arms go on to relax the forces between them; the
        arms' null-space motion stops.
        """
        self._commanded.operate("pause", None, lambda operator: operator.pause(True))

    def resume(self) -> None:
        """Go on after :meth:`pause`, up to the override.

        A :class:`coopqp.ForceController` also goes on after the object has touched something: half a second after the
        last push.
        """
        self._commanded.operate("resume", None, self._ending_hold(lambda operator: operator.pause(False)))

    def _ending_hold(self, act: Callable[[Operator], None]) -> Callable[[Operator], None]:
        """A call that ends a hold by forces, where there are any."""
        return act

    def signal(self, name: str) -> None:
        """A signal has come, such as "gripper closed": a program's gates that wait for it are open from now on.

        In time the object goes through without slowing down; late it goes on from where it is. Until the signal comes
        it rests at the gate, and the status is WAITING. A reset shuts all gates.

        Raises:
            UnknownNameError: no gate of the program waits for it.
        """
        controller = self._commanded

        def check() -> None:
            names = {gate for _, gate in controller.path.gates}
            if name not in names:
                raise UnknownNameError("signal", name, sorted(names))

        def signal(operator: Operator) -> None:
            check()
            operator.signal(name)

        check()
        controller.operate("signal", name, signal)

    def retarget(self, T_world_object: Placement) -> None:
        """Move the target of a :class:`coopqp.ServoPath`.

        The object goes over from its present motion, without a jump of its velocity, as fast as the joints can. Where
        the look-ahead does not allow that, it brakes on its present way and goes over as soon as it may,
        at rest at the latest. The last target wins.

        Raises:
            InvalidInputError: the path is no ServoPath, or the pose is not one; the old target stays.
        """
        change, controller = Target(as_placement(T_world_object, "retarget")), self._commanded
        change.check(controller.path, controller.program_clock)

        def act(operator: Operator) -> None:
            if controller.started:
                self._takes(operator, change)
            else:
                change.check(controller.path, 0.0)
                controller.path.set_target(change.goal, clock=0.0, rate=0.0)

        controller.operate("retarget", change.goal.homogeneous.tolist(), act)

    def reverse(self, to: float = 0.0) -> None:
        """Go back along the program to a clock [s], and rest there, PAUSED.

        The step's clock falls meanwhile. Redundant arms go back through the configurations that they came through.
        :meth:`forward` or ``resume()`` then lead on along the program.

        Raises:
            InvalidInputError: a clock that is not on the program or lies ahead, a program without an end, or no reset.
        """
        self._asked("reverse", to, Travel(self._on_program(to, "reverse: to"), back=True))

    def forward(self) -> None:
        """Go on along the program to its end, also from PAUSED.

        Raises:
            InvalidInputError: before the first reset.
        """
        self._asked("forward", None, Travel(None))

    def run_to(self, clock: float) -> None:
        """Go along the program to a clock [s], in either direction, and rest there, PAUSED.

        Raises:
            InvalidInputError: a clock that is not on the program, a program without an end, or no reset.
        """
        clock = self._on_program(clock, "run_to: clock")
        self._asked("run_to", clock, Travel(clock))

    def step_to_mark(self) -> None:
        """Go on to the next mark of the program, and rest there, PAUSED. Marks are its breakpoints and its end.

        Raises:
            InvalidInputError: a program without an end, or before the first reset.
        """
        controller = self._commanded
        now = self._on_program(controller.program_clock, "step_to_mark")
        mark = min(float(GuardedPath(controller.path).path.next_breakpoint(now)), controller.path.duration)
        self._asked("run_to", mark, Travel(mark))

    def shift_path(self, T_world_shift: Placement, *, over: float = 0.1) -> None:
        """Lead the program over to ``T_world_shift`` times itself, over a length of path [m] from here on.

        A turn of 1 rad counts as 0.3 m. What lies behind stays. Near the end of the program the shift comes in over
        what is left of it.

        Raises:
            InvalidInputError: no placement, a length that is not positive, no reset, or the program is at its end or
                was shifted 50 times.
        """
        shift = as_placement(T_world_shift, "shift_path: T_world_shift")
        over = as_scalar(over, "shift_path: over")
        self._asked("shift_path", [shift.homogeneous.tolist(), over], Shift(shift, over))

    def jog(self, twist: ArrayLike, *, frame: str = "object", deadman_s: float = DEADMAN) -> None:
        """Move the object by hand with a twist; the command holds for a moment, then the object brakes.

        From a program the object first comes to rest on it. While it is led the status is JOGGING, the program's clock
        stands, and limits, singularities and obstacles slow it and stop it, by name. :meth:`return_to_path` leads back.

        Args:
            twist: of the object, about its origin (6,) [m/s, rad/s]; zeros stop it.
            frame: whose axes: ``"world"``, ``"object"``, or the name of an arm for its tool's.
            deadman_s: how long the command holds [s]. Repeat it more often than that.

        Raises:
            InvalidInputError: no six finite numbers, or before the first reset.
            UnknownNameError: another frame.
        """
        values = as_vector(twist, 6, "jog: twist")
        holds = as_scalar(deadman_s, "jog: deadman_s", high=1.0)
        names = self._commanded.cell.arm_names
        frames = {"world": -1, "object": -2, **{name: k for k, name in enumerate(names)}}
        if not isinstance(frame, str) or frame not in frames:
            raise UnknownNameError("frame", str(frame), frames)
        if not values.any():
            holds = 1e-9
        self._asked("jog", [values.tolist(), frame, holds], Jog(values, frames[frame], holds))

    def return_to_path(self) -> None:
        """Lead the object back to where it left its program, on a straight way; then the program goes on by itself.

        Where it is paused it rests there. Where the way is not free the object stops, and the step says what is
        between.

        Raises:
            InvalidInputError: before the first reset.
        """
        self._asked("return_to_path", None, Return())

    def gear(self, position: float, *, speed: float = 1.0) -> None:
        """Let the program's clock follow a belt: call it in each period with the belt's position.

        The path speed σ is the belt's speed plus 20/s times the lag, from 0 to 1; the belt is filtered with a time
        constant of 20 ms. When no position has come for 0.1 s the object pauses. ``set_override`` ends it.

        Args:
            position: of the belt, in seconds of the program.
            speed: of the belt, as long as it has not been measured twice [seconds of the program per second].

        Raises:
            InvalidInputError: no finite number, a speed that is negative, or before the first reset.
        """
        position = float(as_vector([position], 1, "gear: position")[0])
        speed = as_scalar(speed, "gear: speed", open_low=False)
        self._commanded.operate("gear", [position, speed], lambda o: o.take_gear(position, speed), started=True)

    def engage(self, T_world_hand: Placement) -> None:
        """Let the object follow a hand: a tracker, a game pad, a policy. It moves as the hand moves from now on.

        As with :meth:`jog`, the object first comes to rest where it follows its program, and the status is JOGGING.

        Raises:
            InvalidInputError: no placement, or before the first reset.
        """
        hand = as_placement(T_world_hand, "engage: T_world_hand")
        self._commanded.operate("engage", hand.homogeneous.tolist(), lambda o: o.engage(hand), started=True)

    def target(self, T_world_hand: Placement) -> None:
        """Where the hand is now; give it 10 to 50 times a second.

        It is filtered with a time constant of 40 ms. When no pose has come for 0.25 s the object pauses. Nothing
        happens if no hand is engaged.

        Raises:
            InvalidInputError: no placement, or before the first reset.
        """
        hand = as_placement(T_world_hand, "target: T_world_hand")
        self._commanded.operate("target", hand.homogeneous.tolist(), lambda o: o.hand_at(hand), started=True)

    def release(self) -> None:
        """Let the object follow no hand any more: it brakes, and rests until :meth:`return_to_path` or another call.

        Raises:
            InvalidInputError: before the first reset.
        """
        self._commanded.operate("release", None, lambda o: o.release(), started=True)

    def _on_program(self, clock: float, where: str) -> float:
        return on_program(self._commanded.path, clock, where)
