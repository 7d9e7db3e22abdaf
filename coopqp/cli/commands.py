"""Subcommands for single runs: ``coopqp run``, ``schema``, ``view``, ``report`` and ``export``."""

from __future__ import annotations

import argparse
import contextlib
import functools
import json
import sys
import webbrowser
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from coopqp.cli.planning import add_plan
from coopqp.cli.terminal import (
    BOLD,
    GREEN,
    RED,
    Reporter,
    add_command,
    print_hints,
    print_table,
    print_written,
    reporter,
    say,
    styled,
)
from coopqp.errors import CoopqpError, TooCloseError, UnreachableError, cause_of, printable
from coopqp.output import check_bag, check_new, numbered, write_files

if TYPE_CHECKING:
    from coopqp.simulation.evaluation.assessment import Finding
    from coopqp.simulation.recording.recording import Recording
    from coopqp.simulation.simulate import ProgressCallback
    from coopqp.visualization.viewer import LiveViewer

_OK, _FAILED = 0, 4
_RUN_HELP = "a recording (.npz), a cell file (.toml, .yaml) or the name of a scenario"


# -- coopqp run ----------------------------------------------------------------------------------------------------


def _add_run(commands: Any) -> None:
    parser = add_command(
        commands,
        "run",
        _run_run,
        force="an earlier run in the folder",
        help="run a cell file (TOML or YAML) or a scenario",
        description="Run a scenario or a cell file, print its figures and verdict, and write what is asked for.",
        epilog="`coopqp schema` prints every key of a cell file. Exit status: 0 if the run finished and every check of "
        "its verdict holds (tolerances: table [verdict] of the file), 4 if not; 3 if an arm does not reach its grasp "
        "or cannot follow the path, or bodies start too close; 2 for bad input, 130 for Ctrl-C. With status 4 the "
        "last lines say why, where and since when.",
    )
    parser.add_argument("cell", type=Path, metavar="CELL", help="the cell file, TOML or YAML; or a scenario's name")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder of what is written: any folder (out/NAME)")
    for product, text in (
        ("report", "the report (HTML)"),
        ("plots", "the pictures (PNG)"),
        ("page", "the run in 3D (HTML)"),
        ("csv", "the table (CSV)"),
        ("bag", "the ROS 2 bag (MCAP)"),
    ):
        parser.add_argument(f"--{product}", action="store_true", help=f"also write {text}")
    parser.add_argument("--view", action="store_true", help="then show the run in the browser")
    parser.add_argument(
        "--replay",
        type=Path,
        metavar="RECORDING",
        help="make a recorded run's operator calls again, and compare",
    )


def _run_run(arguments: argparse.Namespace) -> int:
    from coopqp.cli import runs
    from coopqp.scenarios import SCENARIOS
    from coopqp.simulation.evaluation.assessment import evaluate, run_figures, why
    from coopqp.simulation.evaluation.metrics import read_run
    from coopqp.simulation.events import differs_from, events_of, operating
    from coopqp.simulation.recording.recording import Recording

    wanted, asked, place, notes = {"recording"}, None, str(arguments.cell), list[str]()
    run: Any = functools.partial(runs.obtain_run, place)
    if place not in SCENARIOS or arguments.cell.is_file():
        from coopqp.files.cellfile import load_cell_file, require_readers

        require_readers()
        from coopqp.files.cellfile.hints import grip_hints, load_hints

        try:
            task = load_cell_file(arguments.cell)
        except CoopqpError as error:
            if cause_of(error, UnreachableError):
                _draw_refused(arguments)
            raise
        if not arguments.quiet:
            print_hints([*load_hints(task), *grip_hints(task)])
        output = task.settings.output
        wanted, asked = {product for product in runs.PRODUCTS if getattr(output, product)}, output.folder
        place, run, notes = task.scenario.name, task.run, task.scenario.cell.notes()
    products = [product for product in runs.PRODUCTS if product in wanted or getattr(arguments, product, False)]
    if arguments.view:
        from coopqp.visualization.viewer import require_viser

        require_viser()
    again = None
    if arguments.replay is not None:
        again = Recording.load(arguments.replay)
        more = {} if "longest" not in again.metadata else {k: again.metadata[k] for k in ("settle", "longest")}
        operate = operating(events_of(again), again.metadata.get("begun"))
        begun = again.metadata.get("begun")
        run = functools.partial(runs.obtain_run, str(arguments.cell), operate=operate, begun=begun, **more)
    folder = runs.output_folder(place, asked, products, out=arguments.out, force=arguments.force)
    with reporter(quiet=arguments.quiet) as report:
        for note in notes:
            report.note(note)
        try:
            recording = run(progress=_progress(report, place))
        except CoopqpError as error:
            if arguments.cell.is_file() and cause_of(error, TooCloseError):
                _draw_refused(arguments)
            raise
        files = runs.write_products(recording, folder, products, tell=report.note, force=arguments.force)
    cell = recording.cell(shapes=False)
    readings = read_run(cell, recording)
    findings = evaluate(cell, recording, readings)
    if not arguments.quiet:
        _print_run(run_figures(cell, recording, readings), findings)
    print_written(files, apart=True, quiet=arguments.quiet)
    causes = why(findings)
    if again is not None:
        step = differs_from(again, recording)
        if step is not None:
            say("failed:", f"the run differs from {arguments.replay} from step {step} on")
            return _FAILED
        if not arguments.quiet:
            print("the run is the recorded one bit for bit")
    if causes:
        for line in causes:
            say("failed:", line)
        _offer(recording)
    if arguments.view:
        _serve(recording, quiet=arguments.quiet)
    return _FAILED if causes else _OK


#: Picture of a cell that is refused.
_REFUSED = "reach.png"


def _draw_refused(arguments: argparse.Namespace) -> None:
    """Draw a cell that cannot hold its object: the arms, their reach, and who is short."""
    from coopqp.cli.check import glance_at
    from coopqp.cli.runs import free_folder
    from coopqp.files.cellfile.build import read
    from coopqp.visualization.cell_overview import glance_figure
    from coopqp.visualization.style import figure_bytes, require_matplotlib

    try:
        require_matplotlib()
        settings = read(arguments.cell)
        folder = free_folder(
            settings.name, settings.output.folder, [_REFUSED], out=arguments.out, force=arguments.force
        )
        with reporter(quiet=arguments.quiet) as report:
            found, _ = glance_at(str(arguments.cell), report)
            report.note("drawing the cell")
            files = write_files({folder / _REFUSED: figure_bytes(glance_figure(found), dpi=110)})
    except CoopqpError as error:  # the refusal itself is told by the caller
        say("no picture:", error)
        return
    print_written(files, quiet=arguments.quiet)
    sys.stdout.flush()


def _offer(recording: Recording) -> None:
    """Offer the lines of a cell file for pairs that overlap at the start."""
    from coopqp.collision.pairs import ignored_line

    settings = recording.metadata.get("settings")
    left_out = recording.metadata.get("clearance", {}).get("left_out")
    if left_out and settings:
        ignored = settings.get("collision", {}).get("ignored", [])
        print(
            "coopqp: is the object too large, or off its place? Where links touch by design, the file says so:",
            *("[collision]", "avoid = false", ignored_line([*ignored, *left_out])),
            sep="\n  ",
            file=sys.stderr,
            flush=True,
        )


def _progress(report: Reporter, name: str) -> ProgressCallback:
    return lambda done, planned: report.step(name, done, planned)


def _print_run(figures: Mapping[str, str], findings: Sequence[Finding]) -> None:
    """Print the figures as a table and the verdict as lines."""
    print_table(list(figures.items()), numeric=(False, False), head=False)
    print()
    for finding in findings:
        mark = styled("yes", GREEN) if finding.holds else styled("NO ", BOLD, RED)
        print(f"{mark}  {finding.question} {printable(finding.answer)}")


# -- coopqp schema -------------------------------------------------------------------------------------------------


def _add_schema(commands: Any) -> None:
    parser = commands.add_parser(
        "schema", help="print every key of a cell file", description="Print every key of a cell file."
    )
    parser.add_argument("--json", action="store_true", help="print the JSON Schema, for editors")
    parser.add_argument("--robots", action="store_true", help="print the robots that `robot` can name")
    parser.add_argument(
        "--example",
        nargs="?",
        const="paper_lift",
        metavar="NAME",
        help="print a cell file that comes with coopqp (paper_lift): `coopqp examples` lists them",
    )
    parser.set_defaults(run=_run_schema)


def _run_schema(arguments: argparse.Namespace) -> int:
    from coopqp.files import cellfile

    if arguments.robots:
        from coopqp.scenarios import robot_table

        print(robot_table(), end="")
    elif arguments.example:
        print(cellfile.example_path(arguments.example).read_text(encoding="utf-8"), end="")
    elif arguments.json:
        print(json.dumps(cellfile.json_schema(), indent=1))
    else:
        print(cellfile.schema_text(), end="")
    return _OK


# -- coopqp view ---------------------------------------------------------------------------------------------------


def _add_view(commands: Any) -> None:
    parser = add_command(
        commands,
        "view",
        _run_view,
        force="an earlier page",
        help="show a cell or a run in the browser",
        description="Show a recording in 3D, in the browser, with play, pause and scrub. Of a cell file or a scenario "
        "show the start, the path, the reach of the arms and the result of `coopqp check`, with a button that runs it. "
        "Or write what is shown as one HTML file.",
    )
    parser.add_argument("what", metavar="WHAT", help=_RUN_HELP)
    parser.add_argument("--run", dest="run_it", action="store_true", help="run a cell at once, and show its run")
    parser.add_argument("--html", type=Path, metavar="FILE", help="write one page that opens offline, and end")
    parser.add_argument("--port", type=int, default=8080, metavar="N", help="port (8080; 0 for any that is free)")
    parser.add_argument("--no-open", action="store_true", help="do not open the browser")
    parser.add_argument("--sticks", action="store_true", help="draw the arms as sticks, without their shapes")
    _add_meshes(parser)


def _run_view(arguments: argparse.Namespace) -> int:
    from coopqp.visualization.viewer import export_html, require_viser

    require_viser()
    check_new(arguments.html, force=arguments.force)
    if not arguments.run_it and _is_cell(arguments.what):
        return _view_cell(arguments)
    recording = _obtain(arguments.what, quiet=arguments.quiet, meshes=arguments.meshes)
    if arguments.html is None:
        browser = not arguments.no_open
        _serve(recording, port=arguments.port, sticks=arguments.sticks, browser=browser, quiet=arguments.quiet)
        return _OK
    with reporter(quiet=arguments.quiet) as report:
        page = export_html(
            recording,
            arguments.html,
            sticks=arguments.sticks,
            progress=lambda done, total: report.step("the pictures of the page", done, total),
        )
    print_written([page], quiet=arguments.quiet)
    return _OK


def _is_cell(what: str) -> bool:
    """Whether a name is a cell file or a scenario; else it is a recording, or nothing."""
    from coopqp.files.cellfile.error import TOML_SUFFIX, YAML_SUFFIXES
    from coopqp.scenarios import SCENARIOS

    return Path(what).suffix in (TOML_SUFFIX, *YAML_SUFFIXES) or what in SCENARIOS


def _view_cell(arguments: argparse.Namespace) -> int:
    """Show a cell before it runs, or write it as a page."""
    from coopqp.cli.check import glance_at
    from coopqp.cli.runs import obtain_run
    from coopqp.visualization.cell_viewer import CellViewer, export_glance

    with reporter(quiet=arguments.quiet) as report:
        found, more = glance_at(arguments.what, report)
    if arguments.html is not None:
        page = export_glance(found, arguments.html, more=more, sticks=arguments.sticks)
        print_written([page], quiet=arguments.quiet)
        return _OK
    viewer = CellViewer(
        found, functools.partial(obtain_run, arguments.what), more=more, port=arguments.port, sticks=arguments.sticks
    )
    _keep_serving(viewer, "the cell", browser=not arguments.no_open, quiet=arguments.quiet)
    return _OK


def _add_meshes(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--meshes", action="store_true", help="open the mesh files that a recording names (not a stranger's)"
    )


def _obtain(what: str, *, quiet: bool, meshes: bool | None) -> Recording:
    """The run; ``meshes`` is None where no shapes are drawn."""
    from coopqp.cli.runs import obtain_run
    from coopqp.simulation.recording.scene import named_meshes

    with reporter(quiet=quiet) as report:
        recording = obtain_run(what, progress=_progress(report, what), meshes=bool(meshes))
        named = 0 if recording.meshes or meshes is None else len(named_meshes(recording.metadata))
        if named:
            report.note(f"{named} mesh files that the recording names stay closed; --meshes opens them")
    return recording


def _serve(
    recording: Recording, *, port: int = 8080, sticks: bool = False, browser: bool = True, quiet: bool = False
) -> None:
    """Show a run until Ctrl-C."""
    from coopqp.visualization.viewer import LiveViewer

    _keep_serving(LiveViewer(recording, port=port, sticks=sticks), "the run", browser=browser, quiet=quiet)


def _keep_serving(opened: LiveViewer, what: str, *, browser: bool, quiet: bool) -> None:
    with opened as viewer:
        if not quiet:
            print(f"{viewer.url} shows {what}; Ctrl-C ends it", flush=True)
        if browser:
            webbrowser.open(viewer.url)
        with contextlib.suppress(KeyboardInterrupt):
            viewer.run()


# -- coopqp report -------------------------------------------------------------------------------------------------


def _add_report(commands: Any) -> None:
    parser = add_command(
        commands,
        "report",
        _run_report,
        force="an earlier report",
        help="write the report of a run (HTML)",
        description="Write the report of a run: one page with verdict, figures, plots and settings that opens offline.",
    )
    parser.add_argument("what", metavar="RUN", help=_RUN_HELP)
    parser.add_argument("--out", type=Path, metavar="FILE", help="the page (NAME_report.html, beside a recording)")
    parser.add_argument("--scene", action="store_true", help="with the 3D scene that plays (extra viewer)")
    _add_meshes(parser)
    for name, unit, text in (
        ("chain-mm", "MM", "chain error (0.1)"),
        ("chain-deg", "DEG", "chain error (0.1)"),
        ("object-mm", "MM", "object off its path (1)"),
        ("object-deg", "DEG", "object off its path (0.5)"),
    ):
        parser.add_argument(f"--{name}", type=float, metavar=unit, help=f"tolerance: {text}")
    parser.epilog = "Without these options the tolerances of the run's cell file hold."


def _run_report(arguments: argparse.Namespace) -> int:
    from coopqp.simulation.evaluation.assessment import Tolerances
    from coopqp.visualization.report import write_report
    from coopqp.visualization.style import require_matplotlib
    from coopqp.visualization.viewer import require_viser

    require_matplotlib()
    if arguments.scene:
        require_viser()
    asked = {name: getattr(arguments, name) for name in ("chain_mm", "chain_deg", "object_mm", "object_deg")}
    asked = {name: value for name, value in asked.items() if value is not None}
    Tolerances(**asked)  # bad ones are refused before the run
    source = Path(arguments.what)
    name = f"{source.stem}_report.html"
    page = arguments.out or (source.with_name(name) if source.suffix == ".npz" else Path(name))
    if arguments.out is None and not arguments.force:
        page = numbered(page, Path.exists, suffix=page.suffix)
    check_new(page, force=arguments.force)
    recording = _obtain(arguments.what, quiet=arguments.quiet, meshes=arguments.meshes)
    with reporter(quiet=arguments.quiet) as report:
        tolerances = replace(Tolerances.of(recording), **asked)
        write_report(recording, page, tolerances=tolerances, scene=arguments.scene, progress=report.note)
    print_written([page], quiet=arguments.quiet)
    return _OK


# -- coopqp export -------------------------------------------------------------------------------------------------


def _add_export(commands: Any) -> None:
    parser = add_command(
        commands,
        "export",
        _run_export,
        force="an existing table or recording",
        help="write a run as CSV, ROS 2 bag or recording",
        description="Write a run as a CSV table, a ROS 2 bag (MCAP) or a recording.",
    )
    parser.add_argument("what", metavar="RUN", help=_RUN_HELP)
    parser.add_argument("--csv", type=Path, metavar="FILE", help="a table, one row per sample; - for stdout")
    parser.add_argument("--bag", type=Path, metavar="DIR", help="a bag of joint states and trajectories; a new folder")
    parser.add_argument("--npz", type=Path, metavar="FILE", help="a recording, to be shown and reported later")


def _run_export(arguments: argparse.Namespace) -> int:
    from coopqp.cli.runs import save_recording
    from coopqp.files.export import csv_parts, require_rosbags, write_bag, write_csv

    if arguments.bag is not None:
        require_rosbags()
        check_bag(arguments.bag)
    to_stdout = arguments.csv == Path("-")
    if arguments.csv is None and arguments.bag is None and arguments.npz is None:
        raise CoopqpError("nothing to write: give --csv, --bag or --npz.")
    check_new(None if to_stdout else arguments.csv, arguments.npz, force=arguments.force)
    recording = _obtain(arguments.what, quiet=arguments.quiet, meshes=None)
    files = []
    if arguments.npz is not None:
        files.append(save_recording(recording, arguments.npz))
    if to_stdout:
        sys.stdout.writelines(csv_parts(recording))
    elif arguments.csv is not None:
        files.append(write_csv(recording, arguments.csv))
    if arguments.bag is not None:
        files.append(write_bag(recording, arguments.bag))
    print_written(files, quiet=arguments.quiet or to_stdout)
    return _OK


COMMANDS = (_add_run, add_plan, _add_schema, _add_view, _add_report, _add_export)
