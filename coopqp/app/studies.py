"""The subcommand ``coopqp sweep``: a study of many runs."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from coopqp.app.terminal import print_table, reporter
from coopqp.errors import CoopqpError, printable

if TYPE_CHECKING:
    from coopqp.studies import Engine, Sweep

_OK, _ROWS_FAILED = 0, 4
#: File of the picture.
_PICTURE = "runs.png"
#: Reasons that are printed.
_MOST_REASONS = 5


def _add_sweep(commands: Any) -> None:
    parser = commands.add_parser(
        "sweep",
        help="run a study: thousands of runs over settings and disturbances",
        description="Run every row of a study file on the cores of this machine or on a Dask cluster, and write one "
        "table. The table is the same, bit for bit, wherever its rows are run.",
        epilog="Exit status: 0 if every row is there; 4 if rows failed or were lost (column `outcome`), or if workers "
        "or disk could not go on (then --resume); 2 for a bad study; 130 for Ctrl-C (then --resume).",
    )
    parser.add_argument("study", type=Path, metavar="STUDY", help="the study file, TOML or YAML")
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--workers", type=int, metavar="N", help="worker processes on this machine (one per core)")
    where.add_argument("--cluster", metavar="ADDRESS", help="scheduler of a Dask cluster, as tcp://host:8786")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder of the study")
    parser.add_argument("--resume", action="store_true", help="go on with the study that was interrupted in the folder")
    parser.add_argument("--chunk", type=int, metavar="ROWS", help="rows that are sent together (as many as pay)")
    parser.add_argument("--quiet", action="store_true", help="print errors only")
    parser.set_defaults(run=_run_sweep)


def _run_sweep(arguments: argparse.Namespace) -> int:
    from coopqp.checks import as_count
    from coopqp.errors import MissingExtraError
    from coopqp.files.cellfile import require_readers
    from coopqp.look.style import figure_bytes, require_matplotlib
    from coopqp.output import OutputError, write_files
    from coopqp.studies import EngineError, load_study, sweep

    require_readers()
    missing = ""
    try:
        require_matplotlib()
    except MissingExtraError as error:
        missing = str(error)
    chunk = None if arguments.chunk is None else as_count(arguments.chunk, "--chunk")
    study = load_study(arguments.study)
    engine = _engine(arguments)
    began = False
    with reporter(quiet=arguments.quiet, remaining=True) as report:

        def progress(done: int, total: int) -> None:
            nonlocal began
            began = True
            report.count(study.name, done, total)

        try:
            made = sweep(study, engine, arguments.out, resume=arguments.resume, chunk=chunk, progress=progress)
        except (EngineError, OutputError) as error:
            if not began:
                raise
            return _say(error)
        files = list(made.files)
        if not missing:
            from coopqp.look.sweeps import sweep_figure

            report.note("drawing the picture")
            files += write_files({arguments.out / _PICTURE: figure_bytes(sweep_figure(made), dpi=110)})
    if not arguments.quiet:
        _print(made, files)
    if missing:
        print(f"coopqp: no picture: {missing}", file=sys.stderr)
    return _OK if made.complete else _ROWS_FAILED


def _engine(arguments: argparse.Namespace) -> Engine:
    from coopqp.studies import Cluster, Local

    return Local(arguments.workers) if arguments.cluster is None else Cluster(arguments.cluster)


def _say(error: CoopqpError) -> int:
    print("coopqp: error:", printable(" ".join(str(error).split())), file=sys.stderr)
    return _ROWS_FAILED


def _print(made: Sweep, files: list[Path]) -> None:
    lines = [(outcome, str(count)) for outcome, count in sorted(made.outcomes.items())]
    print_table([("rows", str(len(made.rows))), *lines], numeric=(False, True), head=False)
    reasons: dict[str, int] = {}
    for row in made.rows:
        if row["outcome"] != "ok":
            text = f"{row['outcome']}: {row['reason']}"
            reasons[text] = reasons.get(text, 0) + 1
    for text, count in sorted(reasons.items(), key=lambda item: -item[1])[:_MOST_REASONS]:
        print(printable(f"{count} {text}"))
    print("\nwritten:", *(printable(str(file)) for file in files), sep="\n  ")


COMMANDS = (_add_sweep,)
