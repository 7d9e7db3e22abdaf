"""The subcommand ``coopqp plan``: a start and the fastest way, as a cell file that ``coopqp run`` takes."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from coopqp.cli.planned_program import run_program
from coopqp.cli.terminal import add_command, print_table, print_written, reporter, say
from coopqp.errors import CoopqpError, UndecidedError, UnreachableError, cause_of, printable
from coopqp.output import check_folder, check_unused, write_files

if TYPE_CHECKING:
    from coopqp.collision.scene import CollisionScene
    from coopqp.files.cellfile.build import CellRun
    from coopqp.planning import Plan
    from coopqp.spatial import Array

_OK, _INFEASIBLE, _UNDECIDED = 0, 3, 4
#: Files in the folder.
_FILES = ("plan.toml", "speed.png")
#: Largest number of printed limits.
_MOST_LIMITS = 8


def add_plan(commands: Any) -> None:
    """Add the parser of ``coopqp plan``."""
    parser = add_command(
        commands,
        "plan",
        run_plan,
        force="an earlier plan in the folder",
        help="time-optimal motion along the path of a cell file",
        description="Find a start and the time-optimal motion along the path of a cell file under the joints' velocity "
        "and acceleration limits, from rest to rest. Write it as a cell file that `coopqp run` takes as it is, and "
        "draw the speed profile. With a collision scene the plan is checked as by `coopqp check` before it is written.",
        epilog="Exit status: 0 with a plan; 2 for bad input; 3 where an arm has no start or cannot follow the path, or "
        "bodies come too close; 4 where that is not decided, or the computation fails. The time law of the file's path "
        "is ignored. Of a program each phase is timed; it has no picture.",
    )
    parser.add_argument("cell", type=Path, metavar="CELL", help="the cell file, TOML or YAML")
    parser.add_argument("--out", type=Path, metavar="DIR", required=True, help="folder of plan.toml and speed.png")
    parser.add_argument("--share", type=float, default=None, metavar="S", help="share of the limits to use (0.98)")
    parser.add_argument(
        "--blend-mm", type=float, default=0.0, metavar="MM", help="round corners off within this distance (0: rest)"
    )
    parser.add_argument("--blend-deg", type=float, metavar="DEG", help="and within this angle (--blend-mm over 0.3 m)")
    parser.add_argument(
        "--torques", action="store_true", help="keep the torques within the models' limits, with the file's object"
    )
    parser.add_argument("--jerk", type=float, metavar="DEG", help="largest jerk of the joints [°/s³]; takes seconds")
    parser.add_argument(
        "--starts", type=int, default=1, metavar="N", help="compare N starts of each arm by time (file without start)"
    )


def run_plan(arguments: argparse.Namespace) -> int:
    """Run ``coopqp plan``. Nothing is written unless there is a plan."""
    try:
        return _run(arguments)
    except UndecidedError as error:
        say("no plan:", error)
        return _UNDECIDED
    except CoopqpError as error:
        if not cause_of(error, UnreachableError):
            raise
        say("no plan:", error)
        return _INFEASIBLE


def _run(arguments: argparse.Namespace) -> int:
    from coopqp.checks import as_scalar

    for name, most in (("share", 1.0), ("jerk", math.inf)):
        if getattr(arguments, name) is not None:
            as_scalar(getattr(arguments, name), f"--{name}", high=most)
    from coopqp.files.cellfile import load_cell_file, require_readers
    from coopqp.planning.parametrise import require_toppra
    from coopqp.planning.timing import SHARE
    from coopqp.programs.program import Program
    from coopqp.visualization.profile import profile_figure
    from coopqp.visualization.style import figure_bytes, require_matplotlib

    require_toppra()
    require_matplotlib()
    require_readers()
    from coopqp.files.cellfile.paths import folder_of
    from coopqp.files.cellfile.write import planned_text

    folder: Path = arguments.out
    check_unused((folder / name for name in _FILES), force=arguments.force)
    check_folder(folder)
    with reporter(quiet=arguments.quiet) as report:
        report.note("reading the cell file")
        run = load_cell_file(arguments.cell)
        _check_accelerations(run, arguments.cell)
        _check_starts(run, arguments.cell, arguments.starts)
        for note in run.scenario.cell.notes():
            report.note(note)
        report.note("planning")
        q_start = run.scenario.q_start if arguments.starts == 1 else None
        share = SHARE if arguments.share is None else arguments.share
        scene = run.scene if run.settings.collision is not None else None
        if isinstance(run.scenario.path, Program):
            return run_program(run, arguments, share, folder)
        made = _plan(run, arguments, share, q_start, scene)
        optimum = _plan(run, arguments, 1.0, made.q_start, None).path.duration
        report.note("drawing the speed profile")
        picture = figure_bytes(profile_figure(made.path))
        text = planned_text(run, made, folder=folder_of(arguments.cell), into=folder)
        files = write_files({folder / "plan.toml": text.encode(), folder / "speed.png": picture})
    if not arguments.quiet:
        _print(made, optimum, run.scenario.path.duration)
        if made.check is not None:
            print()
            for line in (made.check.verdict.value, *made.check.explain().splitlines()):
                print(printable(line))
        print_written(files, apart=True)
    return _OK


def _check_accelerations(run: CellRun, file: Path) -> None:
    """Every joint has an acceleration limit, or all arms without one are named in the words of the file."""
    import numpy as np

    from coopqp.files.cellfile import CellFileError

    cell = run.scenario.cell
    limited = np.isfinite(cell.limits.acceleration)
    bare = [name for name, joints in cell.blocks.items() if not limited[joints].all()]
    if bare:
        raise CellFileError(
            f"{file}: a plan needs acceleration limits: {'arm' if len(bare) == 1 else 'arms'} {', '.join(bare)} "
            f"{'has' if len(bare) == 1 else 'have'} none. Add to [[arms]] the limits of the robot, as in "
            "limits = { acceleration_deg_per_s2 = 300 }."
        )


def _check_starts(run: CellRun, file: Path, count: int) -> None:
    """Starts are compared where the file leaves the choice."""
    from coopqp.files.cellfile import CellFileError

    if count == 1:
        return
    settings = run.settings
    for table, given in (("start", not settings.start.is_auto), ("collision", settings.collision is not None)):
        if given:
            raise CellFileError(f"{file}: --starts is for files without a table '{table}': leave one of both out.")


def _plan(
    run: CellRun, arguments: argparse.Namespace, share: float, q_start: Array | None, scene: CollisionScene | None
) -> Plan:
    """The plan from a start (nq,), or from the fastest of those that are compared."""
    from coopqp.planning import plan
    from coopqp.simulation.engine import box_payload

    task = run.scenario
    angle = None if arguments.blend_deg is None else math.radians(arguments.blend_deg)
    return plan(
        task.cell,
        task.grasp,
        task.path,
        q_start=q_start,
        starts=arguments.starts if q_start is None else 1,
        blend=1e-3 * arguments.blend_mm,
        blend_angle=angle,
        payload=box_payload(task) if arguments.torques else None,
        jerk=None if arguments.jerk is None else _jerks(run, arguments.jerk),
        share=share,
        scene=scene,
    )


def _jerks(run: CellRun, degrees: float) -> list[float]:
    """Jerk limits of the joints [rad/s³]; for sliding joints the number is in m/s³, as in a cell file."""
    from coopqp.model.cell import slides

    return [degrees if slide else math.radians(degrees) for slide in slides(run.scenario.cell)]


def _print(made: Plan, optimum: float, given: float) -> None:
    total = made.path.duration
    rows = [
        ("time", f"{total:.3f} s"),
        ("shortest at the full limits", f"{optimum:.3f} s ({total / optimum:.3f} × as long)"),
        ("time of the file's path", f"{given:.3f} s ({100.0 * total / given:.0f} %)"),
    ]
    times = made.binding_times()
    rows += [
        (f"binds: {name}", f"{span:.3f} s ({100.0 * span / total:.0f} %)")
        for name, span in list(times.items())[:_MOST_LIMITS]
    ]
    if len(times) > _MOST_LIMITS:
        rest = sum(list(times.values())[_MOST_LIMITS:])
        rows.append((f"binds: {len(times) - _MOST_LIMITS} others", f"{rest:.3f} s ({100.0 * rest / total:.0f} %)"))
    print_table([(printable(a), b) for a, b in rows], numeric=(False, False), head=False)
