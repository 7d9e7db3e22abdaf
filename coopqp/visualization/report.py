"""A report of a run on one offline page: verdict, figures, plots, settings, notes."""

from __future__ import annotations

import base64
import html
from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

from coopqp.checks import require
from coopqp.model.cell import RobotCell
from coopqp.output import check_file, write_files
from coopqp.simulation.evaluation.assessment import Finding, Tolerances, evaluate, run_figures, why
from coopqp.simulation.evaluation.metrics import Readings, read_run
from coopqp.simulation.evaluation.wrenches import read_loads
from coopqp.simulation.recording.recording import Recording
from coopqp.simulation.recording.scene import named_meshes, read_object
from coopqp.visualization import plots
from coopqp.visualization.joints import joint_figure
from coopqp.visualization.loads import run_loads_figure
from coopqp.visualization.style import figure_bytes, require_matplotlib
from coopqp.visualization.timeline import bound_limits, limit_name, timeline_figure
from coopqp.visualization.viewer import require_viser, run_page

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Largest SVG drawing [bytes]; a larger one becomes a PNG picture.
MAX_SVG_BYTES = 400_000
#: Largest numbers of listed notes, limits and settings.
MAX_NOTES, MAX_LIMITS, MAX_SETTINGS = 1000, 40, 400
#: Largest number of listed values of one setting.
MAX_VALUES = 40
#: Number of visible notes; further notes are folded.
OPEN_NOTES = 15
_HIDDEN = ("scene", "path", "binding", "object", "settings", "notes", "load")


def report_html(
    recording: Recording,
    *,
    cell: RobotCell | None = None,
    tolerances: Tolerances | None = None,
    scene: bool = False,
    progress: Callable[[str], None] | None = None,
) -> str:
    """The report as one HTML document without links to anything else.

    Args:
        recording: the run.
        cell: cell of the run; by default read from the recording.
        tolerances: accepted errors of the verdict; by default the tolerances of the recording's cell file.
        scene: in place of the pictures of the motion the 3D scene that plays, as :func:`export_html` writes it, with
            its plots beside; needs the extra ``viewer``.
        progress: called with a text for each stage.

    Raises:
        SceneError: no cell is given and the recording does not describe one.
        MissingExtraError: Matplotlib, or for the scene viser is not installed.
    """
    require_matplotlib()
    if scene:
        require_viser()
    require(recording, Recording, "report: recording", "Give a Recording, as simulate() returns it.")
    tell = progress or (lambda _: None)
    tell("measuring the run")
    cell = recording.cell() if cell is None else cell
    readings = read_run(cell, recording)
    findings = evaluate(cell, recording, readings, tolerances=tolerances)
    title, made = _title(recording)
    figures = _figures(cell, recording, readings)
    tell("drawing the plots")
    over_time = _picture(
        timeline_figure(recording, readings, tolerances=tolerances), "errors, rate and limits over time"
    )
    del readings  # of a long run they are large
    motion = _scene(recording, tell) if scene else _motion(cell, recording)
    body = [
        f"<h1>{_text(title)}</h1><p class=sub>{_text(made)}</p>",
        _verdict(findings),
        _section("Figures", figures),
        _section("Over time", over_time),
        *_forces(cell, recording),
        _section("Joints against their limits", _picture(joint_figure(cell, recording), "joints over time")),
        _section("The motion", motion),
        _section("Limits that bound", _limits(recording)),
        _section("Settings", _settings(recording)),
        _section("Notes of the run", _notes(recording)),
        f"<footer>coopqp {_text(metadata.version('coopqp'))}</footer>",
    ]
    style = Path(__file__).with_suffix(".css").read_text(encoding="utf-8")
    return (
        "<!doctype html>\n<html lang=en><head><meta charset=utf-8>"
        '<meta name=viewport content="width=device-width, initial-scale=1">'
        f"<title>{_text(title)}: report</title><style>\n{style}</style></head>\n<body>\n"
        + "\n".join(part for part in body if part)
        + "\n</body></html>\n"
    )


def write_report(
    recording: Recording,
    path: str | Path,
    *,
    cell: RobotCell | None = None,
    tolerances: Tolerances | None = None,
    scene: bool = False,
    progress: Callable[[str], None] | None = None,
) -> Path:
    """Write :func:`report_html` to a file, atomically. Same arguments and errors; also raises OutputError."""
    file = Path(path)
    check_file(file)
    text = report_html(recording, cell=cell, tolerances=tolerances, scene=scene, progress=progress)
    write_files({file: text.encode()})
    return file


def _title(recording: Recording) -> tuple[str, str]:
    data = recording.metadata
    name = str(data.get("scenario") or "A run").replace("_", " ")
    arms = [str(arm) for arm in data.get("arms", [])]
    who = f"{data.get('controller', 'unknown controller')}; arms: {', '.join(arms) or 'unknown'}"
    return name, who


def _verdict(findings: Sequence[Finding]) -> str:
    failed = sum(not f.holds for f in findings)
    word = "Everything held." if not failed else f"{failed} of {len(findings)} did not hold."
    rows = "".join(
        f"<tr><td class='mark {'yes' if f.holds else 'no'}'>{'yes' if f.holds else 'NO'}</td>"
        f"<td>{_text(f.question)}</td><td>{_text(f.answer)}</td></tr>"
        for f in findings
    )
    causes = "".join(f"<li>{_text(line)}</li>" for line in why(findings))
    return f"<p class='verdict {'bad' if failed else 'good'}'>{word}</p><table>{rows}</table>" + (
        f"<ol class=why>{causes}</ol>" if causes else ""
    )


def _figures(cell: RobotCell, recording: Recording, readings: Readings) -> str:
    cards = run_figures(cell, recording, readings).items()
    return "<dl>" + "".join(f"<div><dt>{_text(k)}</dt><dd>{_text(v)}</dd></div>" for k, v in cards) + "</dl>"


def _forces(cell: RobotCell, recording: Recording) -> tuple[str, ...]:
    """Torques and internal forces, of a run that was recorded with them."""
    loads = read_loads(cell, recording)
    if loads is None:
        return ()
    picture = _picture(run_loads_figure(cell, loads), "joint torques and internal forces over time")
    return (_section("Torques and internal forces", picture),)


def _motion(cell: RobotCell, recording: Recording) -> str:
    visual = cell.visual_model()
    if not visual.ngeoms:
        named = 0 if recording.meshes else len(named_meshes(recording.metadata))
        closed = f" {named} mesh files that the recording names stayed closed; --meshes opens them." if named else ""
        return f"<p>The arms have no shapes to draw.{closed}</p>"
    size, body = read_object(recording.metadata, recording.T_object_tool)
    figure = plots.motion_figure(
        cell, recording, object_size=(size[0], size[1], size[2]), T_object_body=body, pixels=500
    )
    return _picture(figure, "the arms and the object at four times", kind="png", dpi=100)


def _scene(recording: Recording, tell: Callable[[str], None]) -> str:
    """The page that plays the motion, inside this one."""
    tell("drawing the scene")
    return (
        f'<iframe title="the motion in 3D, with play, pause and scrub" srcdoc="{_text(run_page(recording))}"></iframe>'
    )


def _limits(recording: Recording) -> str:
    bound = bound_limits(recording)
    if not bound:
        return "<p>None.</p>"
    total = max(float(recording.time[-1]), 1e-12)
    rows = "".join(
        f"<tr><td>{_text(limit_name(b.limit))}</td><td class=n>{b.spans[0][0]:.3f}</td><td class=n>{b.spans[-1][1]:.3f}"
        f"</td><td class=n>{len(b.spans)}</td><td class=n>{100.0 * b.seconds / total:.1f} %</td></tr>"
        for b in bound[:MAX_LIMITS]
    )
    more = f"<p>and {len(bound) - MAX_LIMITS} more</p>" if len(bound) > MAX_LIMITS else ""
    head = "<th class=n>first [s]</th><th class=n>last [s]</th><th class=n>times</th><th class=n>of the run</th>"
    return f"<table><tr><th>limit</th>{head}</tr>{rows}</table>{more}"


def _settings(recording: Recording) -> str:
    data = recording.metadata
    shown = {key: value for key, value in data.items() if key not in _HIDDEN}
    if isinstance(data.get("settings"), Mapping):
        shown |= {f"settings.{key}": value for key, value in data["settings"].items()}
    rows = list(_flat("", shown))
    cells = "".join(
        f"<tr><td class=key>{_text(k)}</td><td class=value>{_text(v)}</td></tr>" for k, v in rows[:MAX_SETTINGS]
    )
    more = f"<p>and {len(rows) - MAX_SETTINGS} more</p>" if len(rows) > MAX_SETTINGS else ""
    return f"<table>{cells}</table>{more}"


def _flat(prefix: str, value: Any) -> Iterable[tuple[str, str]]:
    """Nested settings as (key, value) lines."""
    if isinstance(value, Mapping):
        for key, inner in value.items():
            yield from _flat(f"{prefix}.{key}" if prefix else str(key), inner)
    elif isinstance(value, list) and value and isinstance(value[0], Mapping):
        for i, inner in enumerate(value):
            yield from _flat(f"{prefix}[{i}]", inner)
    else:
        yield prefix, _listed(value) if isinstance(value, list) else str(value)


def _listed(values: list[Any]) -> str:
    """Names, all of them; of longer measurements their number: the page draws them."""
    if len(values) > MAX_VALUES and not isinstance(values[0], str):
        return f"{len(values)} values"
    return ", ".join(map(str, values))


def _notes(recording: Recording) -> str:
    if not recording.notes:
        return "<p>None: the object followed its path at full rate, and no limit bound.</p>"
    items = []
    for note in recording.notes[:MAX_NOTES]:
        step, _, text = note.partition(": ")
        known = step.isdigit() and int(step) < len(recording.time)
        when = f"{float(recording.time[int(step)]):.3f} s" if known else ""
        items.append(f"<li><b>{when}</b>{_text(text if known else note)}</li>")
    shown, folded = "".join(items[:OPEN_NOTES]), "".join(items[OPEN_NOTES:])
    more = f"<p>and {len(recording.notes) - MAX_NOTES} more</p>" if len(recording.notes) > MAX_NOTES else ""
    if folded:
        folded = f"<details><summary>{len(items) - OPEN_NOTES} more</summary><ol>{folded}</ol></details>"
    return f"<ol>{shown}</ol>{folded}{more}"


def _picture(figure: Figure, description: str, *, kind: str = "svg", dpi: int = 110) -> str:
    """A figure as an image in the page: SVG, or PNG if the SVG is large."""
    data = figure_bytes(figure, kind=kind, dpi=dpi)
    if kind == "svg" and len(data) > MAX_SVG_BYTES:
        kind, data = "png", figure_bytes(figure, kind="png", dpi=dpi)
    mime = "image/svg+xml" if kind == "svg" else "image/png"
    return f'<img alt="{_text(description)}" src="data:{mime};base64,{base64.b64encode(data).decode()}">'


def _section(title: str, content: str) -> str:
    return f"<h2>{title}</h2>\n{content}"


def _text(value: Any) -> str:
    return html.escape(str(value))
