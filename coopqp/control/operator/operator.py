"""The operator of a controller: which way along the program the object goes, and what it waits for."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, final

import numpy as np
import pinocchio as pin

from coopqp.constraints.cause import Cause
from coopqp.control.interface import ControlStep, Status, amend
from coopqp.control.operator.changes import Change, Follow, Target, Travel
from coopqp.control.operator.hands import Clutch, Gear
from coopqp.control.operator.trail import Trail
from coopqp.control.operator.way import Way
from coopqp.control.options import QPOptions
from coopqp.core._core import MOST_TRAVELS, RATE_ROUNDING, RATE_TOLERANCE, SAME_CLOCK, STILL_OBJECT
from coopqp.errors import said
from coopqp.model.cell import RobotCell
from coopqp.model.chain import Chain
from coopqp.model.grasp import Grasp
from coopqp.model.limits import LimitKind
from coopqp.paths.elbows import Elbows
from coopqp.paths.guarded import GuardedPath
from coopqp.paths.path import ObjectPath
from coopqp.paths.section import Section
from coopqp.paths.servo import ServoPath
from coopqp.spatial import Array

#: Calls that are remembered until they are read: a recorder reads them in every step, and without one nobody does.
_MOST_EVENTS = 100
#: Name of an event: a call that could not be made in its step.
REFUSED = "refused"
#: Length of the way to a gate at which the object is already [s].
_GATE_WAY = 1e-3
#: The same jog command takes no new way while its old one is straight for so long [s]; twists are the same that differ
#: by less than this share.
_JOGS_ON, _SAME_TWIST = 0.5, 1e-9
#: Steps from one attempt to make a change along the program to the next, at most, while the object moves.
_WIDEST_GAP = 8
#: Steps between two looks at most.
_MOST_BETWEEN = 1000
#: Attributes that calls and steps change, beside the trail.
_VARYING = (
    "way", "wanted", "then", "_override", "paused", "age", "holds_for", "returns", "gear", "clutch", "_left", "_brakes",
    "opened", "jogged", "_late", "_run_time", "_goes_on", "_tries_in", "_gap",
    "looked",
)  # fmt: skip
_STOPPED = (Status.HOLDING, Status.FAULT)


@final
class Operator:
    """Holds what an operator has asked for, and makes each change as soon as it is admissible.

    Args:
        cell, grasp: the arms, and how they hold the object.
        loop: what makes the steps; it follows :attr:`way`.
        program: the object's path.
        dt: nominal length of a step [s].
        options: of the controller.

    Attributes:
        way: what the loop follows.
        wanted: the change that waits; None without one. The object brakes until it is made.
        then: what follows once the object is back on its path.
        override, paused: as asked for along the program.
        age, holds_for: time since the last command by hand, and how long that one holds [s].
        returns: the object is on its way back to the program.
        gear: the belt that the program's clock follows; None without one.
        jogged: twist in world axes (6,) with which a jog command leads the object; None if none does.
        clutch: the hand that leads the object; None if none is engaged.
        trail: what redundant arms travelled; None if there are none.
        opened: signals that have come since the start; their gates stay open.
        looked: another path was looked at since the last step.
    """

    def __init__(
        self, cell: RobotCell, grasp: Grasp, loop: Any, program: ObjectPath, *, dt: float, options: QPOptions
    ) -> None:
        self._cell, self.grasp, self._loop, self._dt = cell, grasp, loop, dt
        self._accelerates = bool(np.isfinite(cell.limits.acceleration).any())
        self.opened: frozenset[str] = frozenset()
        #: Time since the start of the run, while signals are to come by themselves [s].
        self._run_time = 0.0
        #: A gate has opened: the object goes on along the program as soon as that keeps its rate.
        self._goes_on = False
        self.way = self.onward(program, 0.0)[0]
        self.wanted: Change | None = None
        self.then: Change | None = None
        self._override, self.paused = 1.0, False
        self.age, self.holds_for = math.inf, 0.0
        self.returns = False
        self.gear: Gear | None = None
        self.clutch: Clutch | None = None
        self._left: tuple[Way, float] | None = None
        self._brakes = False
        self.jogged: Array | None = None
        self._late = False
        #: Steps until the next attempt to make a change that waits, and from one to the next.
        self._tries_in = self._gap = 1
        self.looked = False
        self._longest_dt = dt * options.supervision.dt_range[1]
        redundant = Chain(cell, grasp).redundancy > 0
        self.trail: Trail | None = Trail(cell, dt=dt) if redundant else None
        self._events: deque[tuple[str, Any, float]] = deque(maxlen=_MOST_EVENTS)

    # -- where the object is ---------------------------------------------------------------------------------------

    @property
    def loop_clock(self) -> float:
        """The clock of what is followed [s]."""
        clock: float = self._loop.clock
        return clock

    @property
    def clock(self) -> float:
        """The program's clock [s]."""
        clock = self.way.clock_of(self.loop_clock)
        path = self.way.path
        if self.way.sense != 0 and not self.way.whole and self.loop_clock >= path.duration:
            clock = path.end  # type: ignore[attr-defined]
        return clock

    @property
    def rests(self) -> bool:
        """Whether the object rests, and its joints may."""
        return not self._moves and bool(self._loop.may_rest())

    @property
    def _moves(self) -> bool:
        """Whether the object moves, or a tool on it."""
        rate = self._loop.rate
        motion = GuardedPath(self.way.path).motion(self.loop_clock) if rate > 0.0 else None
        return motion is not None and bool(np.abs(rate * motion).max() > STILL_OBJECT)

    @property
    def expired(self) -> bool:
        """Whether no command by hand holds."""
        return not self.age < self.holds_for

    @property
    def quiet(self) -> bool:
        """Whether steps need nothing from here, or only :meth:`look`."""
        calm = self.wanted is None and self.way.sense != 0 and self.gear is None
        return calm and not self._goes_on and not self._signals_to_come and not self._ended

    @property
    def _ended(self) -> bool:
        """Whether the end of a section is reached."""
        way = self.way
        return not way.whole and self.loop_clock >= way.path.duration

    # -- gates -----------------------------------------------------------------------------------------------------

    def onward(self, program: ObjectPath, clock: float) -> tuple[Way, float]:
        """The way on from a clock of a program [s], to the next gate that is shut or to the end; and the clock on it.

        At a shut gate it is the way to that gate.
        """
        shut = [at for at, name in program.gates if name not in self.opened and at >= clock - SAME_CLOCK]
        if not shut or shut[0] >= program.duration - SAME_CLOCK:
            return Way.of(program), clock
        begin = max(min(clock, shut[0] - _GATE_WAY), 0.0)
        return Way.along(Section(program, begin, shut[0])), min(clock, shut[0]) - begin

    @property
    def waits_for(self) -> str | None:
        """The signal that the object waits for, at rest at its gate; None if it waits for none."""
        way = self.way
        if way.sense <= 0 or way.whole or self.loop_clock < way.path.duration:
            return None
        return self._gate_at(way.path.end)  # type: ignore[attr-defined]

    def _gate_at(self, clock: float) -> str | None:
        """The shut gate at a clock of the program [s]."""
        for at, name in self.way.program.gates:
            if abs(at - clock) <= SAME_CLOCK and name not in self.opened:
                return name
        return None

    def signal(self, name: str) -> None:
        """A signal has come: its gates are open from now on."""
        if name in self.opened:
            return
        self.opened |= {name}
        way = self.way
        self._goes_on = way.sense > 0 and not way.whole

    @property
    def _signals_to_come(self) -> bool:
        """Whether signals come by themselves later."""
        return any(name not in self.opened for name in self.way.program.signals)

    def _tell_signals(self, dt: float) -> None:
        """Give the signals that are due, and go on through a gate that has opened."""
        if self._signals_to_come:
            self._run_time += dt
            for name, at in self.way.program.signals.items():
                if at <= self._run_time:
                    self.signal(name)
        if self._goes_on and self.wanted is None:
            way = self.way
            if way.sense <= 0 or way.whole:
                self._goes_on = False
            else:
                ahead, clock = self.onward(way.program, self.clock)
                self._goes_on = not self.take(ahead, clock)

    @property
    def override(self) -> float:
        """The largest rate σ that is asked for; forces may lower it in the loop."""
        return self._override if self._brakes else float(self._loop.override[0])

    @override.setter
    def override(self, share: float) -> None:
        self._override = share
        self._loop.set_override(0.0 if self._brakes else share, paused=self._loop.override[1])

    # -- what is asked for -----------------------------------------------------------------------------------------

    def restart(self, program: ObjectPath, clock: float = 0.0) -> float:
        """Follow the whole program from a clock [s] on, up to its first gate; forget all changes.

        Returns:
            The clock on the way.
        """
        self.opened, self._run_time, self._goes_on = frozenset(), 0.0, False
        self.wanted, self.then, self.returns, self._left = None, None, False, None
        self.way, begin = self.onward(program, clock)
        self.gear = self.clutch = None
        self._late, self.jogged = False, None
        self.age = math.inf
        self._loop.steps_until_poll = 1
        self._let_go()
        return begin

    def begin_trail(self) -> None:
        """The run begins here."""
        if self.trail is not None:
            self.trail.begin(self.clock, self._loop.positions)
            self._keep_travels(anew=True)

    def _keep_travels(self, *, anew: bool = False) -> None:
        """Let the loop keep what is travelled along the program."""
        if self.trail is not None:
            self._loop.keep_travels(self.trail.stride if self.way.sense > 0 else 0, anew=anew)

    def _note_travels(self) -> None:
        """Put what the loop has kept on the trail."""
        if self.trail is not None and self.way.sense > 0:
            for clock, rate, x, velocity in self._loop.travels():
                self.trail.note(self.way.clock_of(clock), x, velocity, rate)
            self._keep_travels()

    def way_back(self) -> Elbows | None:
        """The motion of redundant arms back from here; None without them, or where nothing was travelled."""
        self._note_travels()
        return None if self.trail is None else self.trail.back(self.clock)

    def ask(self, change: Change) -> None:
        """Make a change now, or as soon as it is admissible; it takes the place of one that waits.

        Raises:
            InvalidInputError: it cannot be made where the object is now; the one that waits goes on to wait.
        """
        change.check(self.way.program, self.clock)
        waits = self._brakes and self.wanted is not None and self.wanted.by_hand and change.by_hand
        self.returns = False
        if not isinstance(change, Follow):
            self.clutch = None
        if change.by_hand:
            self.age, self.holds_for = 0.0, change.holds_for
        else:
            if isinstance(change, Travel):
                self.paused = False
            if self.way.sense == 0:  # first the way back
                self.then, self.wanted, self.age = change, None, math.inf
                self._let_go()
                return
        self.wanted, self._late, self._tries_in, self._gap = change, False, 1, 1
        if waits:  # the next step makes an attempt from where the last one has failed
            self.rein()
        else:
            self.attempt()

    def attempt(self) -> None:
        """Make the change that waits, if it is admissible now; else brake for it."""
        wanted = self.wanted
        assert wanted is not None
        braked = self._brakes
        self._let_go()
        if not isinstance(wanted, Target) and self._loop.status in _STOPPED:
            return
        try:
            made = wanted.attempt(self)
        except BaseException:
            self.wanted = None
            raise
        if made:
            if self.wanted is wanted:
                self.wanted = None
            self.rein()
        elif self._late and not braked:
            return  # the next step tries another rate, from here
        elif self._accelerates or not isinstance(wanted, Target) or not self._moves:
            self._override, self._brakes = self.override, True
            self.rein()

    def _let_go(self) -> None:
        """Brake no more."""
        override, self._brakes = self.override, False
        self.override = override
        self.rein()

    def rein(self) -> None:
        """Tell the loop how fast it may go."""
        paused = self.expired if self.way.sense == 0 else self.paused
        self._loop.set_override(0.0 if self._brakes else self.override, paused=paused)

    def take_gear(self, position: float, speed: float) -> None:
        """A measured position of the belt [s of the program], and its speed where it is the first one."""
        self.gear = Gear(position, speed) if self.gear is None else self.gear.measured(position)

    def geared(self) -> float | None:
        """The path speed σ that the belt asks for; None without one, on the way back and by hand."""
        return None if self.gear is None or self.way.sense <= 0 else self.gear.share(self.clock)

    def engage(self, hand: pin.SE3) -> None:
        """Let the object follow a hand from its present pose on."""
        self.clutch = Clutch(hand)
        self.ask(Follow())

    def hand_at(self, hand: pin.SE3) -> None:
        """Another pose of the hand; nothing if none is engaged any more."""
        if self.clutch is not None:
            self.clutch = self.clutch.measured(hand, self.age)
            self.ask(Follow())

    def release(self) -> None:
        """Follow no hand any more."""
        self.clutch = None
        self.stop()

    def pause(self, paused: bool) -> None:
        """Rest on the program, or go on along it; a command by hand ends with a pause."""
        self.paused = paused
        if paused:
            self.stop()
        self.rein()

    def stop(self) -> None:
        """End a command by hand, or a way back: the object brakes."""
        self.age, self.returns = math.inf, False
        if self.wanted is not None and self.wanted.by_hand and self.way.sense == 0:
            self.wanted = None
            self._let_go()
        self.rein()

    # -- what changes do -------------------------------------------------------------------------------------------

    def jogs_on(self, twist: Array) -> bool:
        """Whether the object goes with a twist in world axes (6,), and goes on so for long enough."""
        path, was = self.way.path, self.jogged
        if was is None or self._loop.rate == 0.0:
            return False
        assert isinstance(path, ServoPath)
        if path.straight_for(self.loop_clock) < _JOGS_ON:
            return False
        return bool(np.abs(twist - was).max() <= _SAME_TWIST * np.abs(was).max())

    def retarget(self, path: ServoPath, goal: pin.SE3) -> bool:
        """Take the way to a target if that is admissible now: at the full rate, the next time at the present one."""
        self.looked = True
        loop, full = self._loop, 0.0 if self._loop.override[1] else self.override
        now, late = loop.rate, self._late
        rate = min(now, full) if late else full
        taken = bool(loop.retarget(path, goal, rate))
        self._late = not taken and not late and 0.0 < now < full
        if taken:
            self.jogged = None
        return taken

    def take(self, way: Way, clock: float, *, same: bool = False) -> bool:
        """Follow another way from a clock of it on, if the first step along it keeps the object's rate.

        Args:
            way: the way; it goes through the object's pose at ``clock`` with the object's present twist, or it rests.
            clock: of the way's path [s].
            same: only the program changes, not the path.
        """
        loop, old, rests = self._loop, self.way, self.rests
        self.looked = True
        self._note_travels()
        rate, memory, taken = loop.rate, loop.memory(), False
        try:
            if same:
                loop.follow(way.path, way)
                loop.restore(memory)
                self.way = way
                taken = True
            elif rests:
                self._follow(way, clock, self._first_rate(way, clock))
                taken = True
            else:
                kept_so_far, _ = loop.try_step()
                loop.restore(memory)
                self._follow(way, clock, rate)
                fresh = loop.memory()
                kept, smooth = loop.try_step()
                taken = kept >= kept_so_far - RATE_TOLERANCE and smooth
                if taken:
                    loop.restore(fresh)
        finally:
            if not taken:
                loop.follow(old.path, old)
                loop.restore(memory)
                self.way = old
                self._loop.steps_until_poll = 1
        return taken

    def _first_rate(self, way: Way, clock: float) -> float:
        """The rate that a path begins with from rest: full where the path itself begins at rest."""
        motion = GuardedPath(way.path).motion(clock)
        override, paused = self._loop.override
        return 0.0 if paused or motion is None or np.any(motion) else float(override)

    def _follow(self, way: Way, clock: float, rate: float) -> None:
        self._note_travels()
        if way.sense > 0 and self.way.sense < 0 and self.trail is not None:
            self.trail.cut(self.clock, self._loop.positions)
        self.way = way
        self._loop.steps_until_poll = 1
        self._keep_travels()
        self.jogged = None
        self._loop.follow(way.path, way)
        self._loop.start_path(clock, rate)

    def rest_at(self, clock: float) -> None:
        """Rest on the program at a clock [s], paused."""
        self.paused = True
        self._loop.set_override(self.override, paused=True)
        self._follow(*self.onward(self.way.program, clock), 0.0)

    def lead(self) -> bool:
        """Be led by hand: from rest."""
        way = self.way
        if way.sense == 0:
            return True
        if not self.rests:
            return False
        clock, at = self.clock, self.loop_clock
        path = ServoPath(way.path.pose(at))
        path.grasps = None if way.path.grasps is None else way.path.grasps.still(at)
        self._left = way, at
        self._loop.set_override(self.override, paused=True)
        self._follow(Way(path, way.program, clock, 0), 0.0, 0.0)
        self.rein()
        return True

    # -- steps -----------------------------------------------------------------------------------------------------

    def before(self, dt: float) -> None:
        """What comes ahead of a step of a length [s], where one is not quiet.

        A change that cannot be made any more, as where a user's path fails, is given up: an event says so.
        """
        wanted = self.wanted or self.then
        self.make("a call" if wanted is None else wanted.call, lambda: self._before(dt))
        self.looked = False

    def _before(self, dt: float) -> None:
        way = self.way
        if self.gear is not None:
            self.gear = self.gear.later(dt)
        if way.sense == 0 or (self.wanted is not None and self.wanted.by_hand):
            was = self.expired
            self.age += dt
            if self.expired and not was:
                self.rein()
        if self.returns and self._back_on_path():
            return
        self._tell_signals(dt)
        way = self.way
        waits = self.waits_for is not None or self._goes_on
        if self._ended and self.wanted is None and not waits:
            self.rest_at(self.clock)
        if self.wanted is not None and self._tries_now():
            self.attempt()

    def _tries_now(self) -> bool:
        """Whether a change that waits is attempted in this step: each look at another path costs more than a step."""
        if self.looked:  # from here, but at another rate
            return self._late
        if self.wanted is None or self.wanted.by_hand or isinstance(self.wanted, Target):
            return True
        self._tries_in -= 1
        if self._tries_in > 0 and not self.rests:
            return False
        self._gap = self._tries_in = min(2 * self._gap, _WIDEST_GAP)
        return True

    def _back_on_path(self) -> bool:
        """Go on along the program where the object is back on it."""
        path, left = self.way.path, self._left
        assert isinstance(path, ServoPath)
        assert left is not None
        if path.next_breakpoint(self.loop_clock) < path.duration or not self.rests:
            return False
        self.returns, self._left = False, None
        way, clock = left
        then, self.then = self.then, None
        self.way = way
        self._loop.steps_until_poll = 1
        self._keep_travels()
        self.rein()
        self._loop.follow(way.path, way)
        self._loop.start_path(clock, 0.0)
        if then is not None:
            self.ask(then)
        return True

    def look(self, step: ControlStep) -> None:
        """Note the trail, and say where the end of a section is reached. The next look is due before it can be."""
        way, loop, trail = self.way, self._loop, self.trail
        self._note_travels()
        left = math.inf if way.whole or way.sense == 0 else way.path.duration - loop.clock
        most = _MOST_BETWEEN if trail is None else min(_MOST_BETWEEN, MOST_TRAVELS * trail.stride)
        loop.steps_until_poll = max(1, min(most, int(min(left, 1e6) / self._longest_dt)))
        if left > 0.0:
            return
        if self.waits_for is not None:
            self._say_waiting(step)
            return
        rate = min(step.rate, self._rate_of(step))  # the loop takes the last step of a path for one at the full rate
        if step.status is Status.TRACKING and rate < 1.0 - RATE_ROUNDING:
            reason = "; ".join(filter(None, (step.reason, "the object comes to rest where it was told to")))
            amend(step, status=Status.SLOWED, rate=rate, cause=Cause.OPERATOR, reason=reason)
        elif rate < step.rate:
            amend(step, rate=rate)

    def _rate_of(self, step: ControlStep) -> float:
        """σ of a step that may end at the end of a section, which cuts it short."""
        return min(self._loop.rate, abs(step.clock_next - step.clock) / step.dt)

    def tell(self, step: ControlStep) -> None:
        """Say in a step that the object slows for a change, and no limit does it."""
        wanted, gate = self.wanted, self.waits_for
        if wanted is None and gate is not None:
            self._say_waiting(step)
        elif wanted is not None and step.status in (Status.SLOWED, Status.PAUSED) and not self.paused:
            binding = tuple(b for b in step.binding if b.kind is not LimitKind.OVERRIDE)
            reason = "; ".join(filter(None, (step.reason, wanted.waits)))
            amend(step, status=Status.SLOWED, cause=Cause.OPERATOR, binding=binding, reason=reason)
        elif self.gear is not None and self.gear.silent and step.status in (Status.SLOWED, Status.PAUSED):
            amend(step, reason="; ".join(filter(None, (step.reason, "no position comes from the belt"))))
        elif step.status is Status.JOGGING:
            why = "the object brakes before it goes the new way" if wanted is not None else self._by_hand()
            binding = tuple(b for b in step.binding if b.kind is not LimitKind.OVERRIDE)
            cause = self.way.cause(Status.PAUSED, None, binding)
            amend(step, cause=cause, binding=binding, reason="; ".join(filter(None, (step.reason, why))))

    def _say_waiting(self, step: ControlStep) -> None:
        """Say in a step that the object rests at a gate, and for what signal it waits."""
        if step.status in (Status.TRACKING, Status.SLOWED, Status.BLOCKED):
            reason = "; ".join(filter(None, (step.reason, f"it waits for the signal '{self.waits_for}'")))
            rate = self._rate_of(step)
            amend(step, status=Status.WAITING, rate=rate, cause=Cause.OPERATOR, binding=(), reason=reason)

    def _by_hand(self) -> str:
        if self.returns:
            return "it goes back to its path"
        if not self.expired:
            return ""
        return "no command holds; return_to_path() leads it back"

    # -- events and copies -----------------------------------------------------------------------------------------

    def make(self, name: str, call: Callable[[], object]) -> None:
        """Make a call in a step, where nobody waits for an error: what it raises is an event."""
        try:
            call()
        except Exception as error:
            self.note(REFUSED, f"{name}: {said(error)}", self.clock)

    def note(self, call: str, value: Any, clock: float) -> None:
        """Remember a call at a clock of the program [s], for recordings."""
        self._events.append((call, value, clock))

    def take_events(self) -> list[tuple[str, Any, float]]:
        """The calls since the last time: name, value and the program's clock at each [s]."""
        return [self._events.popleft() for _ in range(len(self._events))]

    def memory(self) -> dict[str, Any]:
        """All that a copy needs; the way may be copied deeply."""
        self._note_travels()
        trail = None if self.trail is None else self.trail.copy()
        return {name: getattr(self, name) for name in _VARYING} | {"trail": trail}

    def restore(self, memory: Mapping[str, Any]) -> None:
        """Go on from what :meth:`memory` returned; the loop follows the way."""
        vars(self).update(memory)
        if self.trail is not None:
            self.trail = self.trail.copy()
        self._loop.follow(self.way.path, self.way)
