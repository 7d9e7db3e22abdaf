"""The control loop: robots read, the controller stepped as far as the slowest arm needs it, every arm sent its command.

It is no safety function. The robots' own safety controllers stay in charge.
"""

from __future__ import annotations

import math
import threading
import warnings
from collections import Counter
from collections.abc import Callable, Mapping
from typing import Any, final

import numpy as np
import pinocchio as pin

from coopqp.checks import as_options
from coopqp.collision.clearance import Clearance
from coopqp.control.interface import ControlStep, Status
from coopqp.drivers.calls import LoopCalls
from coopqp.drivers.contained import name_of
from coopqp.drivers.driver import STANDS, Bodies, Command, Condition, DriverError, LoopRecorder, RobotDriver
from coopqp.drivers.motion import SharedMotion
from coopqp.drivers.options import LoopOptions
from coopqp.drivers.process import keeps_scheduler, prepare_process
from coopqp.drivers.report import LoopReport, largest_apart
from coopqp.drivers.robots import refusals, robots_of, turned
from coopqp.drivers.start import begin, connect, stand, tell_targets, unready
from coopqp.drivers.timing import LoopTime, MonotonicTime
from coopqp.drivers.watch import RobotWatch
from coopqp.errors import InvalidInputError
from coopqp.model.cell import slides
from coopqp.model.state import CellState
from coopqp.spatial import Array, as_placement

#: All arms rest this long before a stop counts [s].
_SETTLED = 0.1
#: The object has arrived where all joints are this near to the end [rad or m].
_ARRIVED = 1e-4
#: At the end of the path the arms are brought to rest from this speed [rad/s or m/s].
_SLOW_END = 1e-3
#: A robot whose states leap by more than this share of its speed limits is none; by more than the second, it may be.
_LEAPS, _MAY_LEAP = 1.0, 0.05
#: The run ends where the arms stand for this time on a way that goes on, and less than this of it was gone [s].
_STANDSTILL, _GONE = 5.0, 1e-3
#: The run ends where a robot that seems to have stopped moved on so often of late.
_MOVED_ON = 3.0
#: A joint that hangs further than this off its commands at rest is named where the object does not go on [rad or m].
_HANGS = 5e-4
#: Every how many periods the distance of the arms is looked at.
_LOOK = 10


_ANOTHER = "does another robot tell joints of the same names?"


@final
class ControlLoop(LoopCalls):
    """Drives robots with a controller. Each run begins with a reset of the controller where the robots stand.

    The calls of an operator (pause, resume, override, stop, reverse, jog and more) and :meth:`beat` may come from any
    thread; they take effect between two periods. What a caller, a recorder or a page raises ends no run: the report
    says it once, and commands go on. Where a driver or ``bodies`` raise, what they would have said is missing. It is no
    safety function.

    Args:
        controller: a QPController or ForceController.
        drivers: a driver by the name of its arm, or of its robot where that has several arms: joints that arms share
            are their robot's.
        options: settings, or a dictionary of them.
        bodies: told to the controller's :class:`coopqp.Clearance`, moved on by their twists to the present time; one
            that is older than ``LoopOptions.gone_after`` is not told, and the controller holds by its own patience.
        recorder: gets every period.
        time: the clock; the machine's by default.

    Attributes:
        robots: the robots, with their joints.
        watches: what is read of each.
        shows: called with the controller's last step in each period, as a page is.
        period, lead: of the loop [s].

    Raises:
        InvalidInputError: drivers that do not fit the cell, or bad settings.
    """

    def __init__(
        self,
        controller: Any,
        drivers: Mapping[str, RobotDriver],
        options: LoopOptions | Mapping[str, Any] | None = None,
        *,
        bodies: Bodies | None = None,
        recorder: LoopRecorder | None = None,
        time: LoopTime | None = None,
    ) -> None:
        super().__init__()
        for method in ("reset", "step", "pause", "resume", "set_override"):
            if not callable(getattr(controller, method, None)):
                raise InvalidInputError(
                    f"a {type(controller).__name__} has no {method}()",
                    "ControlLoop: controller",
                    "Give a QPController.",
                )
        self.controller, self.cell = controller, controller.cell
        self.options = as_options(LoopOptions, options, "ControlLoop: options")
        self.robots = robots_of(self.cell, drivers)
        self.period = controller.dt if self.options.period is None else self.options.period
        self.lead = 3.0 * self.period if self.options.lead is None else self.options.lead
        self._recorder, self._bodies = recorder, bodies
        self.shows: list[Callable[[ControlStep], object]] = []
        self._clearances = [c for c in getattr(controller, "constraints", ()) if isinstance(c, Clearance)]
        if bodies is not None and not self._clearances:
            raise InvalidInputError(
                "bodies without a Clearance", "ControlLoop: bodies", "Give the controller one with moving bodies."
            )
        self._time = MonotonicTime() if time is None else time
        self.watches = tuple(RobotWatch(robot, self.options.patience) for robot in self.robots)
        self._wrenches = bool(getattr(controller, "needs_wrenches", False))
        self._lock = threading.Lock()
        self._beaten = -math.inf
        self._ending = ""
        self._failed = False
        self._motion: SharedMotion | None = None
        self._standing, self._stopped_robot = False, ""
        self._step: ControlStep | None = None

    # -- operators' calls ------------------------------------------------------------------------------------------

    @property
    def stands(self) -> bool:
        """Whether the arms stand after a stop of one of them, and wait for :meth:`resume`."""
        return self._standing

    @property
    def stopped_robot(self) -> str:
        """The robot behind which the arms stood last; empty before the first stop."""
        return self._stopped_robot

    @property
    def last_step(self) -> ControlStep | None:
        """The controller's last step; None before the first."""
        return self._step

    def beat(self) -> None:
        """Say that the operator is there: the heartbeat of ``LoopOptions.heartbeat``."""
        self._beaten = self._time.now()

    def stop_drivers(self) -> None:
        """Stop every robot by its driver at once; nothing is sent again. For a second interrupt and after errors."""
        for robot in self.robots:
            try:
                robot.driver.stop()
            except Exception as error:
                warnings.warn(f"driver '{robot.name}' failed to stop: {error}", RuntimeWarning, stacklevel=2)

    def _go_on(self) -> None:
        if any(watch.condition() in STANDS for watch in self.watches):
            return
        self.controller.resume()
        self._ramp, self._ramp_time, self._standing = self._now, self.options.resume_time, False
        if self._motion is not None:
            self._motion.law.restart()

    def _end(self, reason: str, *, failed: bool) -> None:
        if not self._ending:
            self._ending, self._failed = reason, failed

    # -- before the motion -----------------------------------------------------------------------------------------

    def refused(self) -> list[str]:
        """Connect, wait for the states of all robots, and say why the cell would not be driven, a sentence each.

        Raises:
            DriverError: a robot cannot be reached, or tells no state.
        """
        o, time = self.options, self._time
        connect(self.watches, time, longest=o.connect_time, period=self.period)
        self._stand = stand(
            self.cell, self.watches, time, rest_time=o.rest_time, period=self.period, tolerance=o.start_tolerance
        )
        return [
            *refusals(self.controller, self.robots, period=self.period, tells_target=tell_targets(self.watches)),
            *unready(self.cell, self.watches, wrenches=self._wrenches),
        ]

    def _start(self) -> None:
        """Reset the controller where the robots stand."""
        said = self.refused()
        if said:
            raise DriverError("not driven: " + " ".join(said))
        o = self.options
        first = self._last_q = begin(self.controller, self.watches, *self._stand, tolerance=o.start_tolerance)
        self._motion = SharedMotion(
            self.cell, self.robots, first, clock=0.0, command_period=self.controller.dt, period=self.period,
            lead=self.lead, options=o,
        )  # fmt: skip

    # -- the run ---------------------------------------------------------------------------------------------------

    def run(self) -> LoopReport:
        """Drive the robots until the object is at the end of its path, or something ends the run.

        Raises:
            DriverError: a robot cannot be reached, or the cell is not driven as it is; nothing has moved.
            InvalidInputError: the arms do not hold the object where they stand.
            RuntimeError: a second run at the same time.
        """
        if not self._lock.acquire(blocking=False):
            raise RuntimeError("this loop runs")
        try:
            self._ending, self._failed = "", False
            self.refused_calls.clear()
            self.outside.failures.clear()
            o = self.options
            with keeps_scheduler():
                self._process = prepare_process(realtime=o.realtime, lock_memory=o.lock_memory, core=o.core)
                self._start()
                return self._run()
        except BaseException:
            self.stop_drivers()
            raise
        finally:
            self._lock.release()

    def _run(self) -> LoopReport:
        motion, time, h = self._motion, self._time, self.period
        assert motion is not None
        self._step = None
        self._seen = np.zeros(self.cell.nv)
        self._off, self._measured = np.zeros(self.cell.nv), np.full(self.cell.nv, np.nan)
        self._statuses: Counter[str] = Counter()
        self._finish, self._still, self._settled, self._short, self._stops = math.inf, 0.0, 0.0, 0.0, 0
        self._arrived = math.nan
        self._missing: Counter[str] = Counter()
        self._stalls, self._rest = 0, 0.0
        self._stop_reasons: list[str] = []
        self._looks: list[Array] = []
        self._looked = 0
        self._force, self._slowest, self._standing = math.nan, 1.0, False
        self._moved = self._rested = False
        self._now = self._ramp = began = time.now()
        self._gone = began, 0.0, 0
        self._ramp_time = self.options.ramp_time
        self._beaten = max(self._beaten, began)
        deadline, periods, missed, late = began, 0, 0, []
        while True:
            time.sleep_until(deadline)
            self._now = now = time.now()
            late.append(now - deadline)
            stood = now > deadline + max(self.lead - h, h)  # beyond the time for which the last commands hold
            if stood and now > deadline + self.options.give_up_after:
                self._end(f"the loop stood for {now - deadline:.2f} s, and its robots with it", failed=True)
            if now > deadline + h:  # no catching up
                left_out = int((now - deadline) / h)
                missed += left_out
                deadline += left_out * h
            self._period(now, deadline, stood)
            periods += 1
            deadline += h
            if self._over():
                break
        self._drain()
        self.stop_drivers()
        ended = now if math.isnan(self._arrived) else self._arrived
        return self._report(ended - began, periods, missed, np.array(late))

    def _period(self, now: float, deadline: float, stood: bool) -> None:
        motion = self._motion
        assert motion is not None
        if stood:
            motion.halt()
            self._stalls += 1
            self._ramp, self._ramp_time = now, max(self.options.ramp_time, self._ramp + self._ramp_time - now)
        self._drain()
        self._end_silence()
        if self.options.heartbeat is not None and now - self._beaten > self.options.heartbeat:
            self._end("the operator's heartbeat stopped", failed=True)
        said = self._look(now)
        braking = bool(self._ending)
        self._move_bodies(now)
        while motion.needs_command():
            self._advance()
        ramp = 1.0 if self._ramp_time == 0.0 else (now - self._ramp) / self._ramp_time
        ramp = 0.1 + 0.9 * min(ramp, 1.0)
        sent = motion.step(
            deadline, most=ramp, said=np.zeros_like(said) if self._standing else said, stand=braking or stood
        )
        self._slowest = min(self._slowest, motion.law.rate)
        if motion.law.hangs and np.abs(motion.sag).max() > self.options.start_tolerance:
            most = f"at most {1e3 * self.options.start_tolerance:g} are followed"
            self._end(f"the arms wait: {self._hanging(motion.sag)} ({most})", failed=True)
        before = motion.before
        for watch in self.watches:
            joints = watch.robot.joints
            velocity = (sent[joints] - before[joints]) / self.period
            command = Command(sent[joints], velocity, deadline + self.lead - watch.offset)
            name = f"driver '{watch.robot.name}'"
            if not self.outside.call(name, watch.robot.driver.send, command):
                self._end(
                    f"robot '{watch.robot.name}' was not sent its command: {self.outside.failures[name]}", failed=True
                )
        if self._step is not None:
            self._tell(self._step, sent, motion.way.clock(motion.play_out.parameter))
        if motion.law.stopped and not braking and not self._standing:
            self._settled = self._settled + self.period if motion.rests() else 0.0
            if self._settled >= _SETTLED:
                self._seat()
        else:
            self._settled = 0.0
        self._end_standstill(now)
        self._still = self._still + self.period if self._holds() else 0.0
        if self._still > self.options.give_up_after and self._step is not None:
            hanging = self._hanging(self._measured - motion.sent) if self._step.status is Status.HOLDING else ""
            self._end(" ".join([self._step.explain(), hanging]).strip(), failed=True)

    def _hanging(self, away: Array) -> str:
        """The joint that hangs furthest off its commands at rest, of all (nv,) [rad or m]; empty where none does."""
        far = np.abs(turned(self.cell, np.where(np.isfinite(away), away, 0.0)))
        j = int(np.argmax(far))
        if far[j] < _HANGS:
            return ""
        unit = "mm" if slides(self.cell)[j] else "mrad"
        return (
            f"joint {self.cell.joint_names[j]} hangs {1e3 * far[j]:.1f} {unit} off its commands: look at its load and "
            "the gains of its servo"
        )

    def _tell(self, step: ControlStep, sent: Array, clock: float) -> None:
        """Tell the recorder and all of :attr:`shows` what a period did."""
        recorder, outside = self._recorder, self.outside
        if recorder is not None:
            name = f"recorder {type(recorder).__name__}"
            outside.call(name, recorder.take, self._now, self._measured, sent, step, clock)
        for show in self.shows:
            outside.call(name_of(show), show, step)

    def _end_standstill(self, now: float) -> None:
        """End a run in which robots' states leap, or whose arms wait for one of them and do not go on."""
        motion = self._motion
        assert motion is not None
        k = int(np.argmax(motion.leaps))
        if motion.leaps[k] > _LEAPS:
            name = self.robots[k].name
            self._end(f"the states of robot '{name}' leap faster than it can move: {_ANOTHER}", failed=True)
        k = int(np.argmax(motion.law.moved_on))
        if motion.law.moved_on[k] > _MOVED_ON:
            self._end(
                f"robot '{self.robots[k].name}' seems to stop again and again, and moves on: its states come late, or "
                "its driver's lag and delay are not the true ones",
                failed=True,
            )
        if self._ending or self._standing or abs(motion.shared.sigma - self._gone[1]) > _GONE:
            self._gone = now, motion.shared.sigma, self._stalls
        elif now - self._gone[0] > _STANDSTILL and self._stalls > self._gone[2]:
            stalls = self._stalls - self._gone[2]
            self._end(
                f"the arms stood for {_STANDSTILL:g} s, as the loop stood {stalls} times until its commands had run "
                "out: leave it more of the machine",
                failed=True,
            )
        elif now - self._gone[0] > _STANDSTILL:
            behind = self.robots[motion.law.slowest].name
            leaps = motion.leaps[motion.law.slowest] > _MAY_LEAP
            why = f"; its states leap from place to place: {_ANOTHER}" if leaps else ""
            self._end(
                f"the arms stood for {_STANDSTILL:g} s, as robot '{behind}' is not where it is sent{why}", failed=True
            )

    def _holds(self) -> bool:
        """Whether the controller does not go on by itself; behind a robot that stopped it is not asked."""
        motion, step = self._motion, self._step
        assert motion is not None
        waits = motion.law.stopped and not self._standing
        return step is not None and not waits and step.status in (Status.HOLDING, Status.FAULT, Status.BLOCKED)

    def _look(self, now: float) -> Array:
        """Read all robots; say which of them have stopped (robots,)."""
        motion = self._motion
        assert motion is not None
        said = np.zeros(len(self.robots), dtype=bool)
        for k, watch in enumerate(self.watches):
            watch.read(self._time)
            joints = watch.robot.joints
            condition = watch.condition()
            said[k] = condition in STANDS
            if condition is Condition.FAULT:
                self._end(f"robot '{watch.robot.name}' says fault", failed=True)
            if watch.account(now, self.period):
                motion.lose(k)
                self._missing[watch.robot.name] += 1
                self._off[joints] = self._measured[joints] = np.nan
                if trouble := watch.trouble(now, self.options.gone_after):
                    self._end(trouble, failed=True)
                continue
            assert watch.state is not None
            q, moment = watch.aligned(now)
            self._measured[joints] = q
            if watch.fresh or np.isnan(self._off[joints]).any():
                self._off[joints] = motion.watch(k, watch.state, watch.moment, q, moment)
        self._looked += 1
        if self._looked % _LOOK == 0:
            self._looks.append(self._measured.copy())
        return said

    def _move_bodies(self, now: float) -> None:
        if self._bodies is not None:
            self.outside.call(f"bodies {type(self._bodies).__name__}", self._take_bodies, self._bodies, now)

    def _take_bodies(self, bodies: Bodies, now: float) -> None:
        for name, T_world_body, twist, stamp in bodies.read():
            age = now - stamp
            if not 0.0 <= age <= self.options.gone_after:
                continue
            T, v = as_placement(T_world_body, f"bodies: {name}"), np.asarray(twist, dtype=float)
            moved = pin.SE3(pin.exp3(v[3:] * age) @ T.rotation, T.translation + v[:3] * age)
            for clearance in self._clearances:
                clearance.move(name, moved, v)

    def _advance(self) -> None:
        """The controller's next command becomes the next point of the way."""
        motion, cell = self._motion, self.cell
        assert motion is not None
        x = motion.way.last
        missing = np.isnan(self._off)
        share = self.controller.dt / (self.options.deviation_time + self.controller.dt)
        # Behind an arm that stands there is nothing to correct.
        off = np.where(missing | self._standing, 0.0, self._off)
        self._seen += (1.0 if self._standing else share) * (off - self._seen)
        measured = cell.configuration_of(np.where(missing, np.nan, x + self._seen))
        if self._wrenches:
            step = self.controller.step(measured, wrenches=self._felt())
        else:
            step = self.controller.step(measured)
        self._step = step
        self._statuses[step.status.value] += 1
        positions = cell.positions(step.q_next)
        moves = turned(cell, positions - self._last_q)
        resting = bool(np.abs(moves).max() < _SLOW_END * self.controller.dt)
        if self._rested and not resting:  # in the middle of the path
            self._ramp, self._ramp_time = self._now, self.options.resume_time
        self._moved = self._moved or not resting
        self._rested = self._moved and resting
        motion.way.append(x + moves, step.clock_next)
        self._last_q = positions
        if not step.finished:  # an operator may lead the object away from the end again
            self._finish, self._arrived = math.inf, math.nan
        elif not math.isfinite(self._finish):
            self._finish = motion.way.head

    def _felt(self) -> Array:
        """The wrench of each arm on the object (N, 6); NaN where it is missing or old."""
        wrenches = np.full((len(self.cell), 6), np.nan)
        for watch in self.watches:
            for arm in () if watch.missing(self._now) else watch.robot.arms:
                own = watch.wrench(arm)
                if own is not None:
                    wrenches[self.cell.index(arm)] = own
        sizes = np.linalg.norm(wrenches[:, :3], axis=1)
        if np.isfinite(sizes).any():
            self._force = max(float(np.nanmax(sizes)), 0.0 if math.isnan(self._force) else self._force)
        return wrenches

    def _seat(self) -> None:
        """All stand where the slowest stands: the controller begins again there, paused."""
        motion = self._motion
        assert motion is not None
        watch = self.watches[motion.law.slowest]
        clock, self._stopped_robot = motion.clock(), watch.robot.name
        says = f"says {watch.condition().value}" if watch.condition() in STANDS else "does not say that it stands"
        self._stop_reasons.append(
            f"robot '{watch.robot.name}' did not follow its commands at {clock:.2f} s of the path, and {says}"
        )
        q = self.cell.configuration_of(motion.shared.point)
        self.controller.pause()
        self.controller.reset(q, clock=clock)
        self._last_q = self.cell.positions(q)
        motion.restart()
        self._settled, self._finish, self._arrived = 0.0, math.inf, math.nan
        self._stops += 1
        self._standing = True

    def _over(self) -> bool:
        motion = self._motion
        assert motion is not None
        if self._ending:
            self._rest = self._rest + self.period if motion.speed() < 1e-6 else 0.0
            return self._rest > motion.settling
        if not math.isfinite(self._finish):
            return False
        added = bool(np.abs(motion.play_out.addition.short).max() < _ARRIVED)
        if math.isnan(self._arrived) and added:
            rest = motion.way.value(motion.way.head) - motion.way.value(motion.play_out.parameter)
            if np.abs(rest).max() < _ARRIVED:
                self._arrived = self._now
        if motion.play_out.parameter >= self._finish and motion.speed() < _SLOW_END and added:
            short = self._short_of_end()
            self._short = self._short + self.period if short else 0.0
            if not short:
                self._end("the object is at the end of its path", failed=False)
            elif self._short > self.options.give_up_after:
                self._end(short, failed=True)
        else:
            self._short = 0.0
        return False

    def _short_of_end(self) -> str:
        """Why the object is not at the end of its path, by the last step and by what is measured; empty if it is."""
        step, motion, o = self._step, self._motion, self.options
        assert step is not None
        assert motion is not None
        if step.status is Status.OFF_PATH:
            return step.explain()
        if np.isnan(self._measured).any():
            return "where the arms stand at the end of the path is not known"
        stands, wanted = (CellState(self.cell, self.cell.configuration_of(x)) for x in (self._measured, motion.sent))
        for k, arm in enumerate(self.cell.arm_names):
            away = wanted.T_world_tool[k].actInv(stands.T_world_tool[k])
            far, turned_by = (float(np.linalg.norm(part)) for part in (away.translation, pin.log3(away.rotation)))
            if far > o.end_tolerance_m or turned_by > o.end_tolerance_rad:
                hanging = self._hanging(self._measured - motion.sent)
                return (
                    f"the path is at its end, but the tool of arm {arm} stands {1e3 * far:.1f} mm and "
                    f"{np.rad2deg(turned_by):.2f}° from where it is sent, as measured" + (hanging and f"; {hanging}")
                )
        return ""

    @property
    def _tools_move(self) -> bool:
        """Whether tools move on the object along the path: the looks do not say where they were."""
        return bool(self.controller.path.grasps is not None and self.controller.path.grasps.moves)

    def _report(self, time: float, periods: int, missed: int, late: Array) -> LoopReport:
        motion = self._motion
        assert motion is not None
        names = [robot.name for robot in self.robots]
        return LoopReport(
            finished=not self._failed,
            reason=self._ending,
            time=time,
            lost_time=dict(zip(names, motion.law.lost.tolist(), strict=True)),
            slowest_rate=self._slowest,
            stops=self._stops,
            stop_reasons=tuple(self._stop_reasons),
            stalls=self._stalls,
            periods=periods,
            late=int((late > 0.5 * self.period).sum()),
            missed=missed,
            lateness=(float(np.median(late)), float(np.percentile(late, 99.0)), float(late.max())),
            lost={watch.robot.name: watch.lost for watch in self.watches},
            missing={name: self._missing[name] for name in names},
            lags=dict(zip(names, motion.lag.tolist(), strict=True)),
            commands=periods,
            guarded=motion.play_out.addition.cut,
            velocity=motion.velocity_share,
            acceleration=motion.acceleration_share,
            apart=largest_apart(self.cell, self.controller.grasp, [] if self._tools_move else self._looks),
            largest_force=self._force,
            statuses=dict(self._statuses),
            process=self._process,
            refused_calls=tuple(self.refused_calls),
            failures=tuple(self.outside.failures.values()),
        )
