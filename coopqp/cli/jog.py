"""The subcommand ``coopqp jog``: an operator leads a cell, on a page in the browser or by a script."""

from __future__ import annotations

import argparse
import contextlib
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from coopqp.cli.runs import Task
    from coopqp.drivers.loop import ControlLoop
    from coopqp.drivers.real_time import RealTimeRun
    from coopqp.simulation.recording.recording import Recording
    from coopqp.visualization.jog.link import PageLink

from coopqp.cli.terminal import add_command, print_written, reporter, say

_OK, _FAILED = 0, 4
#: Port of the page.
_PORT = 8080
#: Speed override with which robots begin, as of ``coopqp drive``.
_SPEED = 0.1
#: How long a run goes on after the last call at least, and at most beside the path's duration [s].
_AFTER, _LONGEST_AFTER = 1.0, 5.0


def add_jog(commands: Any) -> None:
    """Add the parser of ``coopqp jog``."""
    parser = add_command(
        commands,
        "jog",
        run_jog,
        force="an earlier recording",
        help="lead a cell by hand, in the browser or by a script",
        description="Run a cell file or a scenario in simulation, in real time, and lead it on a page in the browser: "
        "gizmo, keys and game pad, override, Pause, Run, Back, Step, Return, Reset. The page answers this machine "
        "alone; the first one that is opened leads, others watch; closed or frozen, it is a pause. With --enable it "
        "leads the robots of a cell file, table [drivers]; it is no safety function. With --script the calls come from "
        "a text, without a page and not in real time: a line of it is a time in seconds, a call and its numbers: "
        "pause, resume, forward, step_to_mark, return_to_path, set_override SHARE, reverse [CLOCK], run_to CLOCK, "
        "shift_path X Y Z, signal NAME, and jog VX VY VZ WX WY WZ [FRAME] [for SECONDS]. A # begins a comment.",
        epilog="Ctrl-C ends the page. Exit status: 0 if limits, chain and path were kept (with --script or --record), "
        "4 if not; with --enable as of `coopqp drive`; 2 for bad input. Whether the object arrives is the operator's "
        "affair. `coopqp run CELL --replay RECORDING` repeats a run in simulation.",
    )
    parser.add_argument("cell", metavar="CELL", help="the cell file, TOML or YAML; or a scenario's name")
    parser.add_argument("--script", type=Path, metavar="FILE", help="the calls, in place of a page")
    parser.add_argument("--port", type=int, metavar="N", help="port of the page (8080; 0: any)")
    parser.add_argument("--sticks", action="store_true", help="draw the arms as sticks instead of their shapes")
    parser.add_argument("--record", type=Path, metavar="FILE", help="also write the recording (.npz)")
    parser.add_argument("--driver", choices=("sim",), help="with --enable: this driver for every robot, not the file's")
    parser.add_argument(
        "--enable",
        nargs="?",
        const="",
        metavar="NAME",
        help="move the robots of the file's drivers; NAME is the cell's, or is asked for",
    )


def run_jog(arguments: argparse.Namespace) -> int:
    """Run ``coopqp jog``."""
    from coopqp.errors import InvalidInputError
    from coopqp.output import check_new

    record: Path | None = arguments.record
    if record is not None and record.suffix != ".npz":
        raise InvalidInputError(f"{record}", "--record", "Give a name that ends in .npz.")
    if arguments.script is not None and arguments.port is not None:
        raise InvalidInputError("a script opens no page", "--port", "Leave it out, or --script.")
    if arguments.enable is None and arguments.driver is not None:
        raise InvalidInputError("nothing is driven without --enable", "--driver", "Give both, or neither.")
    if arguments.enable is not None and arguments.script is not None:
        raise InvalidInputError("a script leads in simulation", "--enable", "Leave one of them out.")
    check_new(record, force=arguments.force)
    if arguments.enable is not None:
        return _on_robots(arguments)
    run = _on_page(arguments) if arguments.script is None else _by_script(arguments)
    return _OK if run is None else _judged(run, arguments)


def _judged(run: Recording, arguments: argparse.Namespace) -> int:
    """Print what happened and whether limits, chain and path were kept, and write the recording."""
    from coopqp.simulation.evaluation.assessment import ARRIVALS, evaluate
    from coopqp.simulation.evaluation.metrics import read_run

    if not arguments.quiet:
        for note in run.notes:
            step, _, text = note.partition(": ")
            print(f"{run.time[int(step)]:8.3f} s, clock {run.clock[int(step)]:.3f} s: {text}")
    cell = run.cell(shapes=False)
    findings = [f for f in evaluate(cell, run, read_run(cell, run)) if f.question not in ARRIVALS]
    for finding in findings:
        if not finding.holds or not arguments.quiet:
            print(f"{'yes' if finding.holds else 'NO '}  {finding.question} {finding.answer}")
    if arguments.record is not None:
        print_written([run.save(arguments.record)], quiet=arguments.quiet)
    return _OK if all(finding.holds for finding in findings) else _FAILED


def _by_script(arguments: argparse.Namespace) -> Recording:
    from coopqp.cli.runs import obtain_run
    from coopqp.scenarios import SCENARIOS
    from coopqp.simulation.events import operating, read_script

    if arguments.cell in SCENARIOS:
        scenario = SCENARIOS[arguments.cell]()
    else:
        from coopqp.files.cellfile import load_cell_file, require_readers

        require_readers()
        scenario = load_cell_file(Path(arguments.cell)).scenario
    events = read_script(arguments.script, scenario.dt)
    last = scenario.dt * max((event.step for event in events), default=0)
    with reporter(quiet=arguments.quiet) as report:
        return obtain_run(
            arguments.cell,
            progress=lambda done, planned: report.step(scenario.name, done, planned),
            operate=operating(events),
            settle=last + _AFTER,
            longest=last + scenario.path.duration + _LONGEST_AFTER,
        )


def _on_page(arguments: argparse.Namespace) -> Recording | None:
    """Serve the page until Ctrl-C; what was recorded."""
    from coopqp.cli.runs import obtain_task
    from coopqp.drivers.process import BESIDE_PAGE
    from coopqp.drivers.real_time import RealTimeRun
    from coopqp.visualization.viewer import require_viser

    require_viser()
    task = obtain_task(arguments.cell)
    records = arguments.record is not None
    run = RealTimeRun(task.controller(), task.q_start, task.plant(), records=records, realtime=BESIDE_PAGE)
    with _interrupts(run):
        link = _linked(run, task, arguments)
        try:
            run.run(link.observe)
        finally:
            link.close()
    if not arguments.quiet:
        p50, p99, most = (1e6 * late for late in run.lateness())
        print(f"{run.steps} steps, late p50 {p50:.0f}, p99 {p99:.0f}, largest {most:.0f} µs; {run.missed} left out")
        print(f"real-time scheduler: {run.scheduler}; the page drew {link.shown} of {link.told} moments")
    for failure in run.outside.failures.values():
        say("failed:", failure)
    if not records:
        return None
    return task.finished(run.recording(dict(task.metadata)))


def _on_robots(arguments: argparse.Namespace) -> int:
    """Serve the page for robots until the object arrives, something ends the run, or Ctrl-C."""
    from coopqp.cli.drive import drive_enabled
    from coopqp.cli.runs import task_of
    from coopqp.drivers.led_loop import LedLoop
    from coopqp.files.cellfile import load_cell_file, require_readers
    from coopqp.visualization.viewer import require_viser

    require_viser()
    require_readers()
    run = load_cell_file(Path(arguments.cell)).led()
    task = task_of(run)

    def lead(loop: ControlLoop) -> PageLink:
        return _linked(LedLoop(loop), task, arguments)

    return drive_enabled(run, arguments, _SPEED, lead=lead)


def _linked(run: Any, task: Task, arguments: argparse.Namespace) -> PageLink:
    """The page of a run; its address is printed."""
    from coopqp.visualization.jog.link import PageLink

    port = _PORT if arguments.port is None else arguments.port
    link = PageLink(run, task.at_start(), port=port, sticks=arguments.sticks)
    if not arguments.quiet:
        print(f"{link.url} leads {task.name}; press Run there, Ctrl-C here to end", flush=True)
    return link


@contextlib.contextmanager
def _interrupts(run: RealTimeRun) -> Iterator[None]:
    """Ctrl-C ends the run between two steps; a second one at once."""

    def handle(number: int, frame: Any) -> None:
        run.stop()
        signal.signal(signal.SIGINT, signal.default_int_handler)

    before = [(number, signal.signal(number, handle)) for number in (signal.SIGINT, signal.SIGTERM)]
    try:
        yield
    finally:
        for number, old in before:
            signal.signal(number, old)


COMMANDS = (add_jog,)
