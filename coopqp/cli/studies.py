"""The subcommands ``coopqp sweep``, many runs, and ``coopqp place``, where bases may stand."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from coopqp.cli.terminal import add_command, print_table, print_written, reporter, say
from coopqp.errors import printable
from coopqp.output import check_folder, check_unused, json_bytes, write_files

if TYPE_CHECKING:
    from coopqp.studies import CellPlaced, PlaceStudy, Sweep

_OK, _NOWHERE, _ROWS_FAILED = 0, 3, 4
#: File of the picture.
_PICTURE = "runs.png"
#: Largest number of printed reasons.
_MOST_REASONS = 5


def _add_sweep(commands: Any) -> None:
    parser = add_command(
        commands,
        "sweep",
        _run_sweep,
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


def _run_sweep(arguments: argparse.Namespace) -> int:
    from coopqp.checks import as_count
    from coopqp.errors import MissingExtraError, OutputError
    from coopqp.files.cellfile import require_readers
    from coopqp.studies import Cluster, EngineError, Local, load_study, sweep
    from coopqp.visualization.style import figure_bytes, require_matplotlib

    require_readers()
    missing = ""
    try:
        require_matplotlib()
    except MissingExtraError as error:
        missing = str(error)
    chunk = None if arguments.chunk is None else as_count(arguments.chunk, "--chunk")
    study = load_study(arguments.study)
    engine = Local(arguments.workers) if arguments.cluster is None else Cluster(arguments.cluster)
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
            say("error:", error)
            return _ROWS_FAILED
        files = list(made.files)
        if not missing:
            from coopqp.visualization.sweeps import sweep_figure

            report.note("drawing the picture")
            files += write_files({arguments.out / _PICTURE: figure_bytes(sweep_figure(made), dpi=110)})
    if not arguments.quiet:
        _print(made, files)
    if missing:
        say("no picture:", missing)
    return _OK if made.complete else _ROWS_FAILED


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
    print_written(files, apart=True)


# -- coopqp place --------------------------------------------------------------------------------------------------

#: Files in the folder.
_MAP, _RECORD, _MAP_PICTURE = "map.csv", "place.json", "map.png"


def _add_place(commands: Any) -> None:
    parser = add_command(
        commands,
        "place",
        _run_place,
        force="what is there",
        help="map or search places of the bases of a cell",
        description="Evaluate places of the bases: whether each arm follows the path, its σ_min, joint margins and "
        "least time by speed limits alone, and the distances of bodies. One or two axes are mapped, more are searched.",
        epilog="Exit status: 0 with a best placement; 3 if there is none, or if the cell as built (now) is impossible; "
        "2 for a bad study.",
    )
    parser.add_argument("study", type=Path, metavar="STUDY", help="the study file, TOML or YAML")
    written = f"also write {_RECORD}, and for a map {_MAP} and {_MAP_PICTURE}"
    parser.add_argument("--out", type=Path, metavar="DIR", help=written)


def _run_place(arguments: argparse.Namespace) -> int:
    from coopqp.files.cellfile import require_readers
    from coopqp.studies import load_place_study

    require_readers()
    folder: Path | None = arguments.out
    if folder is not None:
        from coopqp.visualization.style import require_matplotlib

        require_matplotlib()
        check_unused((folder / name for name in (_MAP, _RECORD, _MAP_PICTURE)), force=arguments.force)
        check_folder(folder)
    study = load_place_study(arguments.study)
    with reporter(quiet=arguments.quiet, remaining=True) as report:

        def progress(done: int, total: int) -> None:
            report.count(study.name, done, total)

        placed = study.map(progress) if len(study.axes) <= 2 else ()
        best = max(placed, key=lambda p: p.rank) if placed else study.search(progress)
        best = study.at(best.values, quick=False)
        now = study.now
        remedies = () if now is None else study.placer.remedies(now)
        files = [] if folder is None else _write_place(study, placed, best, now, remedies, folder)
    if not arguments.quiet:
        _print_place(best, now, remedies, files)
    wrong = now is not None and not now.feasible
    if now is not None and wrong:
        say(f"as built the cell is impossible: {_at(now)}: {now.why}")
    if not best.feasible:
        say(f"no placement is possible; nearest to it: {_at(best)}: {best.why}")
    return _NOWHERE if wrong or not best.feasible else _OK


def _write_place(
    study: PlaceStudy,
    placed: tuple[CellPlaced, ...],
    best: CellPlaced,
    now: CellPlaced | None,
    remedies: tuple[str, ...],
    folder: Path,
) -> list[Path]:

    record = {
        "name": study.name,
        "best": best.record(),
        "now": None if now is None else now.record(),
        "remedies": list(remedies),
    }
    contents = {folder / _RECORD: json_bytes(record)}
    if placed:
        from coopqp.studies.table import csv_bytes
        from coopqp.visualization.placements import placement_figure
        from coopqp.visualization.style import figure_bytes

        rows = [_row(one) for one in placed]
        contents[folder / _MAP] = csv_bytes(list(rows[0]), rows)
        figure = placement_figure(study.name, placed, units=study.units, now=now, best=best)
        contents[folder / _MAP_PICTURE] = figure_bytes(figure, dpi=110)
    return write_files(contents)


def _row(placed: CellPlaced) -> dict[str, Any]:
    row: dict[str, Any] = {**placed.values, "feasible": placed.feasible, "score": placed.score, "time_s": placed.time_s}
    row["clearance_mm"] = 1e3 * placed.clearance
    for arm in placed.arms:
        row |= {
            f"{arm.arm}.reach": arm.reach,
            f"{arm.arm}.sigma_min": arm.sigma_min,
            f"{arm.arm}.margin": arm.margin,
            f"{arm.arm}.time_s": arm.time_s,
        }
    return row


def _at(placed: CellPlaced) -> str:
    return ", ".join(f"{name} = {value:.4g}" for name, value in placed.values.items())


def _print_place(best: CellPlaced, now: CellPlaced | None, remedies: tuple[str, ...], files: list[Path]) -> None:
    for title, placed in (("as built", now), ("best" if best.feasible else "nearest", best)):
        if placed is not None:
            score = f"{placed.score:.3f} of good" if placed.feasible else "impossible"
            print(f"{title}: {_at(placed)}: {score}")
            print(*(f"  {printable(line)}" for line in placed.explain().splitlines()), sep="\n")
    for text in remedies:
        print(printable(text))
    print_written(files, apart=True)


COMMANDS = (_add_sweep, _add_place)
