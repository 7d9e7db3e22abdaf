"""The subcommand ``coopqp check``: can the arms follow the path, before anything moves?"""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from coopqp.cli.route import GLANCE
from coopqp.cli.terminal import Reporter, add_command, print_table, print_written, reporter, say
from coopqp.errors import UnknownNameError, UnreachableError, printable
from coopqp.output import check_new, json_bytes, write_files

if TYPE_CHECKING:
    from coopqp.collision.scene import CollisionScene
    from coopqp.model.cell import RobotCell
    from coopqp.model.grasp import Grasp
    from coopqp.model.shapes import Body
    from coopqp.paths.path import ObjectPath
    from coopqp.planning import PathCheck
    from coopqp.spatial import Array
    from coopqp.visualization.cell_overview import Glance

#: Exit status of each verdict.
EXIT_STATUS = {"CERTIFIED": 0, "SAMPLED": 0, "UNDECIDED": 4, "INFEASIBLE": 3}
#: File of the picture.
_PICTURE = "check.png"


def _add_check(commands: Any) -> None:
    parser = add_command(
        commands,
        "check",
        _run_check,
        force="what is there",
        help="prove before the motion that the arms can follow the path",
        description="Prove or disprove that the arms can follow the path inside their position limits, away from "
        "singularities and, with a collision scene, with all margins kept; from the start of the cell or from any "
        "start. Nothing moves.",
        epilog="Exit status: 0 if the arms follow the path (certified: proved at every point; or sampled: at samples, "
        "where there is no proof), 3 if an arm cannot or has no start, 4 if some interval is not decided, 2 for bad "
        "input.",
    )
    parser.add_argument("cell", metavar="CELL", help="a cell file (.toml, .yaml) or the name of a scenario")
    parser.add_argument("--remedies", action="store_true", help="search remedies: branch, roll, path, base")
    parser.add_argument("--any-start", action="store_true", help="check every branch, not only the start of the cell")
    parser.add_argument("--branches", action="store_true", help="also print the table of branches of each arm")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the answer as JSON")
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help=f"also draw margins and σ_min along the path: DIR/{_PICTURE}"
    )


def _run_check(arguments: argparse.Namespace) -> int:
    from coopqp.planning.remedies import with_remedies
    from coopqp.visualization.style import require_matplotlib

    picture = None if arguments.out is None else arguments.out / _PICTURE
    if picture is not None:
        require_matplotlib()
    check_new(arguments.json, picture, force=arguments.force)
    with reporter(quiet=arguments.quiet) as report:
        task = _task(arguments.cell)
        check = _look(task, report, any_start=arguments.any_start)
        if arguments.remedies and not check.feasible:
            report.note("looking for remedies")
            check = with_remedies(check, progress=lambda kind, done, total: report.count(kind, done, total))
        offer = "" if arguments.quiet else _way_round(task, check, report)
        files = _write(check, arguments.json, picture)
    unjudged = _unjudged(task, check)
    if not arguments.quiet:
        _print(check, unjudged, branches=arguments.branches)
        if offer:
            print(offer)
        print_written(files, apart=True)
    if arguments.quiet and not check.feasible:
        say(check.explain().splitlines()[0])
    elif arguments.quiet and task.scene is not None and unjudged:
        say(unjudged)  # what asks for distances gets none: who reads the exit status alone has to know
    return EXIT_STATUS[check.verdict.value]


def not_checked(cell: RobotCell, path: ObjectPath) -> str:
    """Why a check leaves the bodies of a cell file out, as a sentence; empty where it does not."""
    from coopqp.planning.tools_on_object import why_no_scene

    why = why_no_scene(cell, path)
    return why and f"distances: not checked, since {why}; a run measures them"


def _unjudged(task: _Task, check: PathCheck) -> str:
    """Where distances play no part: why, or the links and the object that overlap at the start; empty if none do."""
    from coopqp.collision.pairs import ignored_line, pairs_said
    from coopqp.simulation.evaluation.closeness import overlaps

    if task.scene is not None and (why := not_checked(task.cell, task.path)):
        return why
    if check.scene is not None or check.q_start is None:
        return ""
    found = overlaps(check.cell, check.grasp, task.box, check.q_start)
    if not found:
        return ""
    return (
        f"distances: not judged, since no table [collision] asks for it; but {pairs_said(found)} overlap at the "
        "start. Is the object too large, or off its place? Where links touch by design, the file says so:\n"
        f"  [collision]\n  {ignored_line(found)}"
    )


def _way_round(task: _Task, check: PathCheck, report: Reporter) -> str:
    """Where bodies block the path and a short search finds a way round them: what to do; else empty."""
    from coopqp.errors import CoopqpError
    from coopqp.planning import PathVerdict, find_path

    blocked = check.clearance is not None and check.clearance.verdict is PathVerdict.INFEASIBLE
    if not blocked or task.scene is None or not math.isfinite(task.path.duration) or check.phases:
        return ""  # phases have ways of their own
    report.note("looking for a way round")
    ends = task.path.pose(0.0), task.path.pose(task.path.duration)
    try:
        route = find_path(task.cell, task.grasp, *ends, task.scene, q_start=check.q_start, time_limit=GLANCE)
    except CoopqpError:
        return ""
    command = f"coopqp route {printable(task.file)}" if task.file else "coopqp.find_path"
    return f"a way round exists, of {route.length:.2f} m: {command}" if route.found else ""


class _Task(NamedTuple):
    """What is checked: a cell file or a scenario."""

    name: str
    cell: RobotCell
    grasp: Grasp
    path: ObjectPath
    q_start: Array | None
    scene: CollisionScene | None
    box: Body
    note: str  # a remark on the start
    file: str  # the cell file; empty for a scenario


def _task(name: str) -> _Task:
    """The task of a cell file or of a scenario."""
    from coopqp.collision.scene import CollisionScene
    from coopqp.files.cellfile import load_cell_task
    from coopqp.files.cellfile.error import TOML_SUFFIX, YAML_SUFFIXES
    from coopqp.model.shapes import Body, Box
    from coopqp.scenarios import SCENARIOS

    if Path(name).suffix in (TOML_SUFFIX, *YAML_SUFFIXES):
        task = load_cell_task(name)
        q_start, note = None, ""
        try:
            q_start = task.exact_start()
        except UnreachableError as error:
            note = f"from the start of the file {error} Any start is judged."
        return _Task(task.name, task.cell, task.grasp, task.path, q_start, task.scene, task.box, note, name)
    if name not in SCENARIOS:
        raise UnknownNameError("cell file (.toml, .yaml) or scenario", name, SCENARIOS)
    s = SCENARIOS[name]()
    scene = CollisionScene.of(s) if s.obstacles else None
    box = Body("object", Box(s.object_size), s.T_object_body)
    return _Task(s.name, s.cell, s.grasp, s.path, s.q_start, scene, box, "", "")


def _look(task: _Task, report: Reporter, *, any_start: bool = False) -> PathCheck:
    from coopqp.planning import check_path

    if task.note:
        report.note(task.note)
    report.note("looking at the arms along the path")
    q_start, scene = None if any_start else task.q_start, task.scene
    if scene is not None and not_checked(task.cell, task.path):
        scene = None  # :func:`_unjudged` says why
    return check_path(task.cell, task.grasp, task.path, q_start=q_start, scene=scene)


def glance_at(name: str, report: Reporter) -> tuple[Glance, str]:
    """A cell file or a scenario at a glance; and where distances play no part, why or what overlaps at the start."""
    from coopqp.visualization.cell_overview import glance

    task = _task(name)
    check = _look(task, report)
    return glance(task.name, check, task.box, task.scene), _unjudged(task, check)


def _write(check: PathCheck, record: Path | None, picture: Path | None) -> list[Path]:

    contents: dict[Path, bytes] = {}
    if record is not None:
        contents[record] = json_bytes(check.record())
    if picture is not None:
        from coopqp.visualization.check_plots import check_figure
        from coopqp.visualization.style import figure_bytes

        contents[picture] = figure_bytes(check_figure(check), dpi=110)
    return write_files(contents)


def _print(check: PathCheck, unjudged: str, *, branches: bool) -> None:
    print(printable(check.verdict.value))
    for line in [*check.explain().splitlines(), *unjudged.splitlines()]:
        print(printable(line))
    if branches:
        for arm in check.arms:
            print(f"\narm {printable(arm.arm)}; * is judged")
            rows = arm.table()
            print_table(rows, numeric=[False, False, False, True, False])


COMMANDS = (_add_check,)
