"""The subcommand ``coopqp drive``: a cell file on robots. It is no safety function."""

from __future__ import annotations

import argparse
import contextlib
import math
import select
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from coopqp.cli.terminal import add_command, print_table, print_written, say
from coopqp.errors import InvalidInputError, printable

if TYPE_CHECKING:
    from coopqp.drivers.driver import RobotDriver
    from coopqp.drivers.loop import ControlLoop
    from coopqp.drivers.report import LoopReport
    from coopqp.files.cellfile.build import CellRun
    from coopqp.visualization.jog.link import PageLink

_OK, _REFUSED, _FAILED = 0, 3, 4
#: How often it is looked whether the arms wait for something [s].
_LOOKS_EVERY = 0.1
#: How long states are read before a dry run [s].
_READING = 2.0
#: How far the arms may part when one stalls, on enabled robots [m].
_STALL = 0.005


def add_drive(commands: Any) -> None:
    """Add the parser of ``coopqp drive``."""
    parser = add_command(
        commands,
        "drive",
        run_drive,
        force="FILE of --record",
        help="drive robots along the path of a cell file",
        description="Drive the robots of a cell file, table [drivers], along its path. Without --enable nothing is "
        "sent: it reads their states for two seconds, runs the path in simulation in real time, and says what would be "
        "refused. It is no safety function: the robots' own safety controllers stay in charge.",
        epilog="Exit status: 0 if the run finished, on the robots or in simulation; 4 if it did not; 3 if the cell is "
        "refused; 2 for bad input; 130 for Ctrl-C and 143 for SIGTERM, which brake all arms together. A second one "
        "stops every driver at once.",
    )
    parser.add_argument("cell", type=Path, metavar="CELL", help="cell file (.toml or .yaml)")
    parser.add_argument("--driver", choices=("sim", "engine"), help="this for every robot, in place of the file's")
    parser.add_argument(
        "--enable",
        nargs="?",
        const="",
        metavar="NAME",
        help="move the robots; NAME is the cell's, or is asked for",
    )
    parser.add_argument(
        "--speed", type=float, default=0.1, metavar="SHARE", help="share of the path's speed, up to 1 (0.1)"
    )
    parser.add_argument(
        "--record",
        type=Path,
        metavar="FILE",
        help="also write the run: a recording, whose "
        "name ends in .npz; without an ending a ROS 2 bag (MCAP), while it goes on",
    )


def run_drive(arguments: argparse.Namespace) -> int:
    """Run ``coopqp drive``."""
    from coopqp.checks import as_scalar
    from coopqp.files.cellfile import load_cell_file, require_readers
    from coopqp.output import check_new

    require_readers()
    speed = as_scalar(arguments.speed, "--speed", high=1.0)
    if arguments.record is not None:
        if arguments.enable is None:
            raise InvalidInputError("nothing is driven without --enable", "--record", "Give both, or neither.")
        if arguments.record.suffix not in (".npz", ""):
            raise InvalidInputError(
                f"'{arguments.record}' does not end in .npz", "--record", "Give another name, for a bag one without."
            )
        if arguments.record.suffix:
            check_new(arguments.record, force=arguments.force)
    run = load_cell_file(arguments.cell)
    if run.controller_kind != "qp":
        raise InvalidInputError(f"the controller is '{run.controller_kind}'", "drive", 'Give kind = "qp".')
    if arguments.enable is not None:
        return drive_enabled(run, arguments, speed)
    with _drivers(run, arguments.driver) as drivers:
        return _dry_run(run, drivers, speed)


@contextlib.contextmanager
def _drivers(run: CellRun, kind: str | None) -> Iterator[dict[str, RobotDriver]]:
    from coopqp.drivers.ros2_domain import require_cyclone

    if run.settings.ros2 is not None:
        require_cyclone()  # before any robot is reached
    drivers = run.drivers(kind)
    try:
        yield drivers
    finally:
        close_drivers(drivers)


def close_drivers(drivers: dict[str, RobotDriver]) -> None:
    """Close the drivers that can be closed."""
    for driver in drivers.values():
        close = getattr(driver, "close", None)
        if close is not None:
            close()


def ask_for_name(name: str, given: str) -> None:
    """The cell's name has to be given, so that no other cell is moved."""
    if not given:
        if not sys.stdin.isatty():
            raise InvalidInputError("nobody can be asked for the cell's name", "--enable", f"Give --enable '{name}'.")
        given = input(f"The robots will move. Type the cell's name ({printable(name)}) to enable them: ")
    if given.strip() != name:
        raise InvalidInputError(f"the cell's name is '{name}', not '{given}'", "--enable", "Give its name.")


# -- without --enable --------------------------------------------------------------------------------------------------


def _dry_run(run: CellRun, drivers: dict[str, RobotDriver], speed: float) -> int:
    from coopqp.drivers.loop import ControlLoop

    run = run.led()  # as coopqp run does
    loop = ControlLoop(run.controller(), drivers)
    refused = loop.refused()
    _print_states(run, loop)
    refused += _far_from_start(run, loop)
    for line in refused:
        say("refused:", line)
    if refused:
        print("nothing was sent; the cell would be refused")
        return _REFUSED
    report = _in_simulation(run, loop, speed)
    print("in simulation, in real time: " + "\n  ".join(report.lines()))
    if not report.finished:
        say("failed:", f"in simulation the run did not finish: {report.reason}")
    print("nothing was sent; nothing would be refused" + ("" if report.finished else ", but the run would not finish"))
    return _OK if report.finished else _FAILED


def _print_states(run: CellRun, loop: ControlLoop) -> None:
    """Rate, age and offset of the states of two seconds, and how far each arm is from the start."""
    import time

    import numpy as np

    from coopqp.drivers.robots import turned
    from coopqp.drivers.timing import MonotonicTime
    from coopqp.model.cell import slides

    cell = run.scenario.cell
    start, sliding = cell.positions(run.scenario.q_start), np.array(slides(cell))
    units = [("mrad", ~sliding), *([("mm", sliding)] if sliding.any() else [])]
    ages: dict[str, list[float]] = {watch.robot.name: [] for watch in loop.watches}
    first = {watch.robot.name: watch.received for watch in loop.watches}
    began = time.monotonic()
    clock = MonotonicTime()
    while time.monotonic() < began + _READING:
        for watch in loop.watches:
            watch.read(clock)
            ages[watch.robot.name].append(watch.age(clock.now()))
        time.sleep(loop.period)
    far = [f"from the start [{unit}]" for unit, _ in units]
    lines = [["robot", "states [1/s]", "age [ms]", "offset [s]", "lag [ms]", *far, "says"]]
    for watch in loop.watches:
        name, driver = watch.robot.name, watch.robot.driver
        rate = (watch.received - first[name]) / (time.monotonic() - began)
        joints = watch.robot.joints
        away = np.abs(turned(cell, watch.positions() - start[joints], joints))
        furthest = [f"{1e3 * away[of[joints]].max():.1f}" if of[joints].any() else "-" for _, of in units]
        lag = "not told" if driver.lag is None else f"{1e3 * driver.lag:.0f}"
        lines.append(
            [name, f"{rate:.0f}", f"{1e3 * float(np.median(ages[name])):.1f}", f"{watch.offset:.3f}", lag,
             *furthest, watch.condition().value]
        )  # fmt: skip
    print_table(lines, numeric=[False, *[True] * (4 + len(units)), False])


def _far_from_start(run: CellRun, loop: ControlLoop) -> list[str]:
    """Why the controller would not begin where the robots stand."""
    import numpy as np

    from coopqp.errors import CoopqpError

    cell = run.scenario.cell
    x = np.zeros(cell.nv)
    for watch in loop.watches:
        x[watch.robot.joints] = watch.positions()
    try:
        run.controller().reset(cell.configuration_of(x))
    except CoopqpError as error:
        return [str(error)]
    return []


def _in_simulation(run: CellRun, loop: ControlLoop, speed: float) -> LoopReport:
    """Run the path on robots simulated in this process, in real time."""
    from coopqp.drivers.loop import ControlLoop
    from coopqp.drivers.simulated import SimulatedRobot
    from coopqp.drivers.timing import MonotonicTime

    clock, robots = MonotonicTime(), {}
    for watch in loop.watches:
        driver = watch.robot.driver
        robots[watch.robot.name] = SimulatedRobot(
            driver.joint_names, watch.positions(), time=clock, period=driver.period, lag=driver.lag or 0.0,
            delay=driver.delay,
        )  # fmt: skip
    controller: Any = run.controller()
    controller.set_override(speed)
    return ControlLoop(controller, robots, time=clock).run()


# -- with --enable -----------------------------------------------------------------------------------------------------


def drive_enabled(
    run: CellRun,
    arguments: argparse.Namespace,
    speed: float,
    *,
    lead: Callable[[ControlLoop], PageLink] | None = None,
) -> int:
    """Move the robots of a cell, after asking for its name; ``lead`` opens a page that leads the loop."""
    ask_for_name(run.scenario.name, arguments.enable)
    with _drivers(run, arguments.driver) as drivers:
        return _drive(run, drivers, speed, arguments, lead)


def _drive(
    run: CellRun,
    drivers: dict[str, RobotDriver],
    speed: float,
    arguments: argparse.Namespace,
    lead: Callable[[ControlLoop], PageLink] | None,
) -> int:
    from coopqp.drivers.bag_recorder import BagRecorder
    from coopqp.drivers.loop import ControlLoop
    from coopqp.drivers.options import LoopOptions
    from coopqp.drivers.process import BESIDE_PAGE
    from coopqp.drivers.recorder import MemoryRecorder
    from coopqp.drivers.ros2_board import Ros2Board, Ros2BoardOptions
    from coopqp.files.cellfile.strict import build_options

    run = run.led()
    controller, slower = _bounded(run)
    controller.set_override(speed)
    recorder: MemoryRecorder | BagRecorder | None = None
    if arguments.record is not None and arguments.record.suffix:
        recorder = MemoryRecorder(controller)
    elif arguments.record is not None:
        recorder = BagRecorder(run.scenario.cell.joint_names, arguments.record)
    table = run.settings.ros2
    plain = lead is None and table is None
    options = LoopOptions(ramp_time=2.0, realtime=None if lead is None else BESIDE_PAGE)
    loop = ControlLoop(controller, drivers, options, recorder=recorder)
    with contextlib.ExitStack() as ending:
        if isinstance(recorder, BagRecorder):
            ending.callback(recorder.close)
        refused = loop.refused()
        if refused:
            for line in refused:
                say("refused:", line)
            return _REFUSED
        if lead is not None:
            link = lead(loop)
            ending.callback(link.close)
            loop.shows.append(link.observe)
        if table is not None:
            board = Ros2Board(loop, run.scenario.name, build_options(Ros2BoardOptions, table))
            ending.callback(board.close)
            loop.shows.append(board.observe)
        seen = ending.enter_context(interrupts(loop))
        ending.enter_context(_waits_told(loop, led=not plain))
        if not arguments.quiet:
            print(slower, flush=True)
        report = loop.run()
    if not arguments.quiet:
        print("\n".join(report.lines()))
    if isinstance(recorder, BagRecorder):
        missing, why = recorder.close()
        if missing:
            say("recording:", f"{missing} periods are missing: {why}")
        print_written([arguments.record], quiet=arguments.quiet)
    elif recorder is not None and not recorder.steps:
        say("recording:", "no step was made, and nothing is written")
    elif recorder is not None:
        arguments.record.parent.mkdir(parents=True, exist_ok=True)
        recorder.recording({"scenario": run.scenario.name}).save(arguments.record)
        print_written([arguments.record], quiet=arguments.quiet)
    if seen:
        return 128 + seen[0]
    if not report.finished:
        say("failed:", report.reason)
    return _OK if report.finished else _FAILED


def _bounded(run: CellRun) -> tuple[Any, str]:
    """The controller with a bound of how far the arms may part in a stall; and how much longer its run takes."""
    from coopqp.collision.clearance import Clearance
    from coopqp.control.monitoring.stall_bound import StallBound
    from coopqp.control.qp import QPController
    from coopqp.simulation.simulate import simulate

    s = run.scenario
    scene = [Clearance(run.scene)] if run.avoids and run.scene is not None else []

    def made(*bounds: Any) -> QPController:
        return QPController(s.cell, s.grasp, s.path, dt=s.dt, options=run.options, constraints=[*scene, *bounds])

    if not all(math.isfinite(a) for a in s.cell.limits.acceleration):
        return made(), ""  # it is refused
    bound = StallBound(_STALL, dt=s.dt)
    stall = f"a stall parts the arms by {1e3 * _STALL:.0f} mm at most"
    free, kept = (simulate(c, q_start=s.q_start) for c in (made(), made(bound)))
    if not (free.finished and kept.finished):  # as at a gate that nobody opens here
        return made(bound), stall
    return made(bound), (
        f"so that {stall}, the path takes {kept.time[-1]:.2f} s at full speed in place of {free.time[-1]:.2f} s"
    )


@contextlib.contextmanager
def _waits_told(loop: ControlLoop, *, led: bool) -> Iterator[None]:
    """Say what the arms wait for. After a stop, without a page or topics, Enter goes on; without a terminal it ends."""
    from coopqp.control.interface import Status

    over = threading.Event()

    def after_stop() -> None:
        stop = f"robot '{loop.stopped_robot}' has stopped, and all arms stand"
        if led:
            say(f"{stop}: they go on after resume")
        elif sys.stdin.isatty():
            say(f"{stop}: Enter goes on, Ctrl-C ends")
            while loop.stands and not over.wait(_LOOKS_EVERY):
                if select.select([sys.stdin], [], [], 0.0)[0]:
                    sys.stdin.readline()
                    loop.resume()
        else:
            loop.stop(f"{stop}; without a page, topics or a terminal nobody can resume")

    def look() -> None:
        said, stood = set[str](), False
        while not over.wait(_LOOKS_EVERY):
            step = loop.last_step
            if step is not None and step.status is Status.WAITING and step.reason not in said:
                say(step.reason)
                said.add(step.reason)
            if loop.stands and not stood:
                after_stop()
            stood = loop.stands

    threading.Thread(target=look, daemon=True).start()
    try:
        yield
    finally:
        over.set()


@contextlib.contextmanager
def interrupts(loop: ControlLoop) -> Iterator[list[int]]:
    """Ctrl-C and SIGTERM brake all arms together; a second one stops every driver at once. The signals seen."""
    seen: list[int] = []

    def handle(number: int, frame: Any) -> None:
        seen.append(number)
        if len(seen) == 1:
            loop.stop("interrupted")
            return
        loop.stop_drivers()
        raise KeyboardInterrupt

    before = {number: signal.signal(number, handle) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield seen
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


COMMANDS = (add_drive,)
