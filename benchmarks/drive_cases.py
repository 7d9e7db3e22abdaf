"""Cases of ``drive.py``: runs of the control loop on simulated robots, on time that nothing waits for."""

from __future__ import annotations

import threading
import time
import warnings
from collections import deque
from collections.abc import Iterator
from typing import Any

import common  # noqa: F401  # first: it limits BLAS to one thread
import numpy as np
from drive_runs import CELL, DT, LIFT, SENT, Event, Row, drive, halt, kill, limit, release, resume, time_of
from drive_shared import beside_a_lift, shared_joints

from coopqp import QPController
from coopqp.control import StallBound
from coopqp.drivers import ControlLoop, ManualTime, SimulatedRobot
from coopqp.drivers.command_spline import CommandSpline
from coopqp.drivers.limited_clock import LimitedClock
from coopqp.drivers.play_out import PlayOut
from coopqp.errors import BusyError, StiffnessWarning
from coopqp.model.state import CellState

LAGS, NONE = (0.007, 0.032, 0.047), (0.0, 0.0, 0.0)
#: When an arm is limited or stops, and when it is let go [s].
SLOW_FROM, SLOW_TO, STOP_FROM, STOP_TO, RESUMED = 0.75, 2.25, 1.4, 3.4, 3.6


def _stop(k: int, deceleration: float = np.inf) -> list[Event]:
    return [(STOP_FROM, halt(k, deceleration)), (STOP_TO, release(k)), (RESUMED, resume)]


def lags() -> Iterator[Row]:
    """Servos with different lags."""
    for name, given, told, longest, furthest in (
        ("lags 7, 32, 47 ms told", LAGS, True, 3.1, 0.3),
        ("lags 7, 32, 47 ms learnt", LAGS, False, 3.2, 0.5),
        ("lags 4, 120, 32 ms learnt", (0.004, 0.120, 0.032), False, 3.5, 2.0),
    ):
        run = drive(given, told=told)
        yield Row(f"{name}: time", time_of(run), longest, "s")
        yield Row(f"{name}: apart", 1e3 * float(run.apart().max()), furthest, "mm")


def _peaks() -> list[float]:
    """Largest speed of each arm in a free run, the norm of its joints' velocities [rad/s]."""
    q = drive(NONE).q
    return [float(np.linalg.norm(np.diff(q[:, own], axis=0), axis=1).max()) / DT for own in CELL.v_slices]


def half_speed() -> Iterator[Row]:
    """One arm at 50 % of its largest speed for 1.5 s, each of three."""
    peaks = _peaks()
    for name, given, longest, furthest in (("", NONE, 3.9, 2.5), (", lags 7, 32, 47 ms", LAGS, 4.0, 2.5)):
        runs = [
            drive(given, events=[(SLOW_FROM, limit(k, 0.5 * peak)), (SLOW_TO, limit(k, None))])
            for k, peak in enumerate(peaks)
        ]
        yield Row(f"one arm at 50 %, free{name}: time", max(time_of(run) for run in runs), longest, "s")
        apart = max(float(run.apart().max()) for run in runs)
        yield Row(f"one arm at 50 %, free{name}: apart", 1e3 * apart, furthest, "mm")
    for k, peak in enumerate(peaks):
        run = drive(NONE, gripped=True, events=[(SLOW_FROM, limit(k, 0.5 * peak)), (SLOW_TO, limit(k, None))])
        force = run.force() if run.report.finished else np.nan
        yield Row(f"{CELL.arm_names[k]} at 50 %, gripped: force with the load's share", force, 200.0, "N")


def stops_gripped() -> Iterator[Row]:
    """A gripped arm stops for 2 s and goes on; 98 N of a force are the load's share."""
    share = drive(NONE, gripped=True).forces[-1]
    bound, tight = StallBound(0.005, dt=DT), StallBound(0.003, dt=DT)
    settings: tuple[tuple[str, tuple[float, ...], list[StallBound], float, float], ...] = (
        ("", NONE, [], np.inf, 1100.0),
        (", lags 7, 32, 47 ms", LAGS, [], np.inf, 1100.0),
        (", StallBound(0.005)", NONE, [bound], np.inf, 500.0),
        (", StallBound(0.005), braking at 40 rad/s²", NONE, [bound], 40.0, 500.0),
        (", StallBound(0.003)", NONE, [tight], np.inf, 500.0),
    )
    for name, given, more, deceleration, most in settings:
        for k in range(3):
            run = drive(given, gripped=True, events=_stop(k, deceleration), constraints=more)
            peak = run.force() if run.report.finished else np.nan
            case = f"{CELL.arm_names[k]} stops for 2 s, gripped{name}"
            yield Row(f"{case}: peak with the load's share", peak, most, "N")
            later = (run.force_time > STOP_FROM + 1.0) & (run.force_time < STOP_TO)
            yield Row(f"{case}: stays after 1 s", float(np.abs(run.forces[later] - share).max()), 20.0, "N")


def stops_free() -> Iterator[Row]:
    """An arm that holds nothing stops for 2 s and goes on."""
    free = drive(NONE)
    at = int(np.searchsorted(free.time, STOP_FROM))
    speed = np.abs(free.sent[at + 1] - free.sent[at]) / DT
    state, moves = CellState(CELL, CELL.configuration_of(free.q[at])), (free.q[at + 1] - free.q[at]) / DT
    v = max(float(np.linalg.norm(state.jacobian(k)[:3] @ moves[own])) for k, own in enumerate(CELL.v_slices))
    braking = 0.5 * v * float((speed / CELL.limits.acceleration).max())
    for name, given, more in (("", NONE, 0.0), (", lags 7, 32, 47 ms", LAGS, v * max(LAGS))):
        runs = [drive(given, events=_stop(k)) for k in range(3)]
        apart = max(float(run.apart().max()) for run in runs)
        yield Row(f"an arm stops for 2 s, free{name}: apart", 1e3 * apart, 1e3 * (braking + more + 0.001), "mm")
        settled = 0.0
        for run in runs:
            times = run.time[::5]
            settled = max(settled, float(run.apart()[(times >= STOP_FROM + 0.5) & (times < STOP_TO)].max()))
            if not run.report.finished:
                settled = np.nan
        yield Row(f"an arm stops for 2 s, free{name}: apart after 0.5 s", 1e3 * settled, 0.3, "mm")


def killed() -> Iterator[Row]:
    """A robot is silent from one moment to the next."""

    held, rest = [], []
    for k in range(3):
        run = drive(NONE, events=[(STOP_FROM, kill(k))])
        held.append(float(run.time[np.argmax(run.holding)]) - STOP_FROM)
        speed = np.abs(np.diff(run.sent, axis=0)).max(axis=1) / DT
        at = int(np.searchsorted(run.time, STOP_FROM))
        moving = run.time[1:][speed > 1e-3]
        braking = float((np.abs(run.sent[at] - run.sent[at - 1]) / DT / CELL.limits.acceleration).max())
        rest.append(float(moving[-1]) + DT - STOP_FROM - braking)
    yield Row("a robot is killed: HOLDING after", 1e3 * max(held), 15.0, "ms")
    yield Row("a robot is killed: below 1e-3 rad/s, beyond the braking time", 1e3 * max(rest), 20.0, "ms")
    apart = [
        float(drive(NONE, events=[(STOP_FROM, kill(k))], constraints=[StallBound(0.005, dt=DT)]).apart().max())
        for k in range(3)
    ]
    yield Row("a robot is killed: apart with StallBound(0.005)", 1e3 * max(apart), 5.0, "mm")


def hostile(runs: int = 100) -> Iterator[Row]:
    """Rates that jump, lags, delays, limits of 0.8 to 40 rad/s²; and all runs so far."""
    worst = -np.inf
    for seed in range(runs):
        worst = max(worst, _hostile(np.random.default_rng(seed)))
    sent = np.array(SENT) - 1.0
    yield Row(f"velocity and acceleration sent over the limits, {runs} hostile runs", worst, 1e-6, "1")
    yield Row(f"velocity and acceleration sent over the limits, {len(sent)} runs above", float(sent.max()), 1e-6, "1")


def _hostile(rng: np.random.Generator, joints: int = 6, number: int = 600) -> float:
    velocity, acceleration = rng.uniform(0.2, 2.0, joints), rng.uniform(0.8, 40.0, joints)
    x, speed = np.zeros(joints), np.zeros(joints)
    spline = CommandSpline(x, clock=0.0, period=DT)
    limits = {"velocity": velocity, "acceleration": acceleration, "period": DT}
    clock = LimitedClock(spline, **limits)  # type: ignore[arg-type]
    lag, delay = rng.uniform(0.005, 0.15, joints), rng.uniform(0.0, 29.0, joints) * DT
    play_out = PlayOut(x, lag=lag, delay=delay, **limits)  # type: ignore[arg-type]
    goal, wanted, sent, commands = speed, 1.0, [x, x], 0
    for i in range(number):
        if i % int(rng.integers(1, 60)) == 0:
            wanted = float(rng.uniform(-1.0, 1.0))
        while spline.head < clock.sigma + 1.001 * DT:
            if commands % 40 == 0:
                goal = rng.uniform(-1.0, 1.0, joints) * velocity
            commands += 1
            speed = speed + np.clip(goal - speed, -acceleration * DT, acceleration * DT)
            x = x + speed * DT
            spline.append(x, 0.0)
        sent.append(play_out.step(clock.step(wanted), clock.sigma, spline, lag, 0.05))
    steps = np.diff(np.array(sent), axis=0)
    fastest = (np.abs(steps) / (velocity * DT)).max()
    hardest = (np.abs(np.diff(steps, axis=0)) / (acceleration * DT**2)).max()
    return float(max(fastest, hardest)) - 1.0


def operators(calls: int = 100_000) -> Iterator[Row]:
    """Another thread calls pause all the time while the loop runs."""
    begun, done, periods, busy = threading.Event(), threading.Event(), [0], [0]
    asked: deque[int] = deque()
    waits: list[int] = []

    class Counting:
        """A controller that notes when an operator's call is made, and whether a step is refused."""

        def __init__(self, inner: QPController) -> None:
            self._inner = inner

        def __getattr__(self, name: str) -> Any:
            return getattr(self._inner, name)

        def step(self, q: Any) -> Any:
            try:
                return self._inner.step(q)
            except BusyError:
                busy[0] += 1
                raise

        def pause(self) -> None:
            waits.append(periods[0] - asked.popleft())
            self._inner.pause()

    clock = ManualTime()
    x = CELL.positions(LIFT.q_start)
    robots = {
        name: SimulatedRobot([j.partition("/")[2] for j in CELL.joint_names[own]], x[own], time=clock)
        for name, own in zip(CELL.arm_names, CELL.v_slices, strict=True)
    }

    class Recorder:
        def take(self, *given: Any) -> None:
            periods[0] += 1
            begun.set()
            if done.is_set():
                loop.stop("all calls are made")

    controller = Counting(QPController(CELL, LIFT.grasp, LIFT.path, dt=DT))
    loop = ControlLoop(controller, robots, recorder=Recorder(), time=clock)

    def call() -> None:
        begun.wait()
        for i in range(calls):
            asked.append(periods[0])
            loop.pause()
            if not i % 10:
                time.sleep(0.0)  # let the loop run
        done.set()

    thread = threading.Thread(target=call)
    thread.start()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", StiffnessWarning)
        loop.run()
    thread.join()
    case = f"{calls} calls of pause by another thread"
    yield Row(f"{case}: BusyError in the loop", float(busy[0]), 0.0, "1")
    yield Row(f"{case}: made after", float(max(waits)) if len(waits) == calls else np.nan, 2.0, "periods")


QUICK = (lags, half_speed, stops_gripped, stops_free, killed, shared_joints, hostile, operators)
#: Of simulated robots, too, and left out with ``--quick``: a minute.
LONGER = (beside_a_lift,)
