"""``coopqp plan`` for a cell file with phases: each of them as fast as the limits allow."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from coopqp.cli.check import not_checked
from coopqp.cli.terminal import print_table, print_written
from coopqp.errors import UndecidedError, UnreachableError, printable
from coopqp.output import write_files

if TYPE_CHECKING:
    from coopqp.files.cellfile.build import CellRun
    from coopqp.programs.program import Program

_OK = 0


def run_program(run: CellRun, arguments: argparse.Namespace, share: float, folder: Path) -> int:
    """Plan the program of a cell file, and write ``plan.toml``. It has a speed for each phase, and so no picture.

    Raises:
        CellFileError: an option that only paths take.
        UnreachableError, UndecidedError: the arms cannot follow the timed program, bodies come too close, or that is
            not decided.
    """
    from coopqp.files.cellfile import CellFileError
    from coopqp.files.cellfile.paths import folder_of
    from coopqp.files.cellfile.write import planned_program_text
    from coopqp.paths.certificate import PathVerdict
    from coopqp.planning.check import check_path
    from coopqp.planning.program_timing import time_program
    from coopqp.programs.program import Program

    for option, given in (
        ("--blend-mm", arguments.blend_mm != 0.0 or arguments.blend_deg is not None),
        ("--torques", arguments.torques),
        ("--jerk", arguments.jerk is not None),
        ("--starts", arguments.starts != 1),
    ):
        if given:
            raise CellFileError(f"{arguments.cell}: {option} is for files with a path; phases are timed without it.")
    task, program = run.scenario, run.scenario.path
    assert isinstance(program, Program)
    made = time_program(task.cell, task.grasp, program, q_start=task.q_start, share=share)
    optimum = made if share == 1.0 else time_program(task.cell, task.grasp, program, q_start=task.q_start)
    why = not_checked(task.cell, made) if run.settings.collision is not None else ""
    scene = run.scene if run.settings.collision is not None and not why else None
    check = check_path(task.cell, task.grasp, made, q_start=task.q_start, scene=scene)
    if not check.feasible:
        lost = check.verdict is PathVerdict.INFEASIBLE
        raise (UnreachableError if lost else UndecidedError)(check.explain())
    text = planned_program_text(run, made, folder=folder_of(arguments.cell), into=folder)
    files = write_files({folder / "plan.toml": text.encode()})
    if not arguments.quiet:
        _print(made, optimum.duration, program.duration)
        print()
        for line in (check.verdict.value, *check.explain().splitlines(), *why.splitlines()):
            print(printable(line))
        print_written(files, apart=True)
    return _OK


def _print(made: Program, optimum: float, given: float) -> None:
    total = made.duration
    rows = [
        ("time", f"{total:.3f} s"),
        ("shortest at the full limits, phase by phase", f"{optimum:.3f} s ({total / optimum:.3f} × as long)"),
        ("time of the file's program", f"{given:.3f} s ({100.0 * total / given:.0f} %)"),
        *((f"phase: {span.name}", f"{span.end - span.start:.3f} s") for span in made.spans),
    ]
    print_table([(printable(a), b) for a, b in rows], numeric=(False, False), head=False)
