"""The subcommand ``coopqp jog``: an operator's calls, from a script."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from coopqp.cli.terminal import add_command, print_written, reporter

_OK, _FAILED = 0, 4
#: How long a run goes on after the last call at least, and at most beside the path's duration [s].
_AFTER, _LONGEST_AFTER = 1.0, 5.0


def add_jog(commands: Any) -> None:
    """Add the parser of ``coopqp jog``."""
    parser = add_command(
        commands,
        "jog",
        run_jog,
        force="an earlier recording",
        help="run a cell with an operator's calls from a script",
        description="Run a cell file or a scenario in simulation, and make an operator's calls at the times that a "
        "script says. A line of it is a time in seconds, a call and its numbers: pause, resume, forward, step_to_mark, "
        "return_to_path, set_override SHARE, reverse [CLOCK], run_to CLOCK, shift_path X Y Z, and jog VX VY VZ WX WY "
        "WZ [FRAME] [for SECONDS]. A # begins a comment.",
        epilog="Exit status: 0 if limits, chain and path were kept, 4 if not; 2 for bad input. Whether the object "
        "arrives is the script's affair. `coopqp run CELL --replay RECORDING` repeats the run.",
    )
    parser.add_argument("cell", metavar="CELL", help="the cell file, TOML or YAML; or a scenario's name")
    parser.add_argument("--script", type=Path, required=True, metavar="FILE", help="the calls")
    parser.add_argument("--record", type=Path, metavar="FILE", help="also write the recording (.npz)")


def run_jog(arguments: argparse.Namespace) -> int:
    """Run ``coopqp jog``."""
    from coopqp.cli.runs import obtain_run
    from coopqp.errors import InvalidInputError
    from coopqp.output import check_new
    from coopqp.scenarios import SCENARIOS
    from coopqp.simulation.evaluation.assessment import evaluate
    from coopqp.simulation.evaluation.readings import read_run
    from coopqp.simulation.events import operating, read_script

    record: Path | None = arguments.record
    if record is not None and record.suffix != ".npz":
        raise InvalidInputError(f"{record}", "--record", "Give a name that ends in .npz.")
    check_new(record, force=arguments.force)
    if arguments.cell in SCENARIOS:
        scenario = SCENARIOS[arguments.cell]()
    else:
        from coopqp.files.cellfile import load_cell_file, require_readers

        require_readers()
        scenario = load_cell_file(Path(arguments.cell)).scenario
    events = read_script(arguments.script, scenario.dt)
    last = scenario.dt * max((event.step for event in events), default=0)
    with reporter(quiet=arguments.quiet) as report:
        run = obtain_run(
            arguments.cell,
            progress=lambda done, planned: report.step(scenario.name, done, planned),
            operate=operating(events),
            settle=last + _AFTER,
            longest=last + scenario.path.duration + _LONGEST_AFTER,
        )
    if not arguments.quiet:
        for note in run.notes:
            step, _, text = note.partition(": ")
            print(f"{run.time[int(step)]:8.3f} s, clock {run.clock[int(step)]:.3f} s: {text}")
    cell = run.cell(shapes=False)
    findings = evaluate(cell, run, read_run(cell, run))[1:]  # all but whether it arrived
    for finding in findings:
        if not finding.holds or not arguments.quiet:
            print(f"{'yes' if finding.holds else 'NO '}  {finding.question} {finding.answer}")
    if record is not None:
        print_written([run.save(record)], quiet=arguments.quiet)
    return _OK if all(finding.holds for finding in findings) else _FAILED


COMMANDS = (add_jog,)
