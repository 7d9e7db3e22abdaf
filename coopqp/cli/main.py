"""The command ``coopqp``. Each subcommand has one function that adds its parser and one that runs it."""

from __future__ import annotations

import argparse
import io
import os
import platform
import sys
import warnings
from collections.abc import Callable, Sequence
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from coopqp.cli import calibrate, check, drive, examples, jog, new, route, sensors, studies
from coopqp.cli.commands import COMMANDS
from coopqp.cli.terminal import add_command, print_hints, print_table, print_written, reporter, say
from coopqp.errors import CoopqpError, MissingExtraError, UndecidedError, UnreachableError, cause_of
from coopqp.output import check_below, check_folder, check_new, check_unused, numbered
from coopqp.version import __version__

if TYPE_CHECKING:
    from coopqp.cli.demo import DemoRun

#: Exit statuses.
OK, BAD_INPUT, IMPOSSIBLE, UNDECIDED, INTERRUPTED = 0, 2, 3, 4, 130


class UsageError(CoopqpError):
    """The command line is invalid."""


class _Parser(argparse.ArgumentParser):
    """A parser that raises its errors. Like all other errors they are printed in one line."""

    def error(self, message: str) -> NoReturn:
        raise UsageError(f"{message} (see {self.prog} --help)")


class _Version(argparse.Action):
    """Prints the versions of coopqp and of what it stands on, and the solver."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any, **__: Any) -> NoReturn:
        from coopqp.solvers.choice import default_solver

        print(f"coopqp {__version__}")
        print(f"solver {default_solver()}")
        versions = {"python": platform.python_version(), **{name: metadata.version(name) for name in _SHOWN}}
        print(", ".join(f"{name} {version}" for name, version in versions.items()))
        parser.exit()


#: Packages whose versions are shown.
_SHOWN = ("pin", "numpy", "scipy", "qpsolvers", "daqp", "osqp", "proxsuite")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line.

    Returns:
        0 if it is done; 2 after bad input; 3 if it is impossible: the arms do not reach their grasps, cannot follow the
        path or start too close to something; 4 after a run that did not finish or whose verdict has a check that does
        not hold, after a check or computation that is not decided, and after a study with rows that failed or were
        lost; 130 after an interrupt, what there was being written.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # one that cannot write σ shows it as \u03c3
            stream.reconfigure(errors="backslashreplace")
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _show_warning
            return _main(argv)
    except KeyboardInterrupt:
        print("coopqp: interrupted", file=sys.stderr)
        return INTERRUPTED


def _show_warning(message: Any, category: type[Warning], *where: Any, **more: Any) -> None:
    """One line, as errors are printed; where in the code a warning came from is no news to a user."""
    say("warning:", message)


def _ask_about_units(arguments: argparse.Namespace) -> None:
    """Print questions about numbers of a cell file that look like another unit, before it is built and may fail."""
    from coopqp.files.cellfile import require_readers
    from coopqp.files.cellfile.error import TOML_SUFFIX, YAML_SUFFIXES

    file = Path(str(getattr(arguments, "cell", getattr(arguments, "what", ""))))
    if file.suffix not in (TOML_SUFFIX, *YAML_SUFFIXES) or getattr(arguments, "quiet", False):
        return
    require_readers()
    from coopqp.files.cellfile.hints import unit_hints

    print_hints(unit_hints(file))


def _status_of(error: CoopqpError) -> int:
    """Exit status of a command that an error ended."""
    if cause_of(error, UndecidedError):
        return UNDECIDED
    return IMPOSSIBLE if cause_of(error, UnreachableError) else BAD_INPUT


def _main(argv: Sequence[str] | None) -> int:
    parser = _Parser(prog="coopqp", description="QP-based cooperative control of several arms that hold one object.")
    parser.add_argument("--version", action=_Version, nargs=0, help="print the versions, and end")
    commands = parser.add_subparsers(title="commands", dest="command", metavar="COMMAND", required=True)
    for add in _COMMANDS:
        add(commands)
    try:
        arguments = parser.parse_args(argv)
        _ask_about_units(arguments)
        run: Callable[[argparse.Namespace], int] = arguments.run
        status = run(arguments)
        sys.stdout.flush()
    except CoopqpError as error:
        say("error:", error)
        return _status_of(error)
    except BrokenPipeError:  # the reader has closed the pipe, as in `coopqp demo | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return OK
    return status


# -- coopqp demo ---------------------------------------------------------------------------------------------------


def _add_demo(commands: Any) -> None:
    parser = add_command(
        commands,
        "demo",
        _run_demo,
        force="what is there",
        help="run the paper's three-arm lift by every method",
        description="Run the paper's three-arm lift by the pseudo-inverse and its variants and by the QP, and draw it.",
    )
    parser.add_argument(
        "--steps", nargs="+", type=_count, default=[40, 400, 1000], metavar="N", help="numbers of steps (40 400 1000)"
    )
    parser.add_argument(
        "--solver", default="auto", metavar="NAME", help="QP solver (auto: the one that controllers use)"
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder (out/demo; a used one gets a number)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the figures of every run as JSON")


def _run_demo(arguments: argparse.Namespace) -> int:
    from coopqp.cli import demo
    from coopqp.scenarios import paper_lift
    from coopqp.visualization.style import require_matplotlib

    steps = demo.check_demo(arguments.steps, arguments.solver)
    missing = ""
    try:
        require_matplotlib()
    except MissingExtraError as error:
        missing = str(error)
    folder = arguments.out or Path("out/demo")
    if arguments.out is None and not arguments.force:
        folder = numbered(folder, lambda place: any((place / name).exists() for name in demo.PICTURES))
    if arguments.out is None:
        check_below(folder)
    check_unused((folder / name for name in demo.PICTURES), force=arguments.force)
    check_folder(folder)
    if arguments.json is not None:
        check_new(arguments.json, force=arguments.force)
    total = len(demo.METHODS) * sum(steps)
    with reporter(total, quiet=arguments.quiet) as report:
        scenario = paper_lift()

        def progress(method: str, planned: int, done: int) -> None:
            report.step(f"{method}, N = {planned}", done, planned)

        runs = demo.run_demo(scenario, steps=steps, solver=arguments.solver, progress=progress)
        if not missing:
            report.note("drawing the pictures")
        files = demo.write_demo(scenario, runs, None if missing else folder, json_file=arguments.json)
    if not arguments.quiet:
        _print_table(runs)
        print_written(files, apart=True)
    if missing:
        say("no pictures:", missing)
    return OK


_MODULES = (examples, new, check, route, calibrate, sensors, jog, drive, studies)
_COMMANDS = (_add_demo, *COMMANDS, *(add for module in _MODULES for add in module.COMMANDS))


def _count(text: str) -> int:
    """Parse an integer ≥ 1 for argparse."""
    try:
        value = int(text)
    except ValueError:
        value = 0
    if value < 1:
        raise argparse.ArgumentTypeError(f"'{text}' is not a whole number ≥ 1")
    return value


def _print_table(runs: Sequence[DemoRun]) -> None:
    records = [run.record() for run in runs]
    lines = [list(records[0]), *([_cell(value) for value in record.values()] for record in records)]
    numeric = [not isinstance(value, str) for value in records[0].values()]
    print_table(lines, numeric=numeric)


def _cell(value: Any) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)
