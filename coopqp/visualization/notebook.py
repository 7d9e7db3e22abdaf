"""Objects as HTML for notebooks: a cell, a scenario, a step, a recording.

The HTML is small and complete in itself: no links, no scripts, names escaped. A picture of arms with shapes needs
Matplotlib; without it there is the table alone. Arms of many triangles are drawn by their simpler collision shapes, or
not at all.
"""

from __future__ import annotations

import base64
import html
import importlib.util
import io
import itertools
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from coopqp.control.interface import ControlStep, Status
from coopqp.errors import printable
from coopqp.model.cell import RobotCell
from coopqp.paths.moving_grasps import grasp_at
from coopqp.paths.scenario import Scenario
from coopqp.simulation.evaluation.assessment import worst_status
from coopqp.simulation.recording.recording import Recording
from coopqp.simulation.recording.scene import read_object
from coopqp.spatial import Array
from coopqp.visualization.renderer import View, box_solid, cell_solids, render
from coopqp.visualization.style import COLOURS, FAINT, INK
from coopqp.visualization.timeline import BANDS, bound_limits, limit_name, marked_spans

#: Width of a picture [px], largest number of triangles that are drawn, of table rows and of points of a curve.
WIDTH, MOST_TRIANGLES, MOST_ROWS, MOST_POINTS = 480, 60_000, 12, 300
_OBJECT = (0.30, 0.52, 0.75)
_GOOD, _BAD = "#166534", "#b00020"


def html_of(thing: object) -> str | None:
    """The HTML of an object; None if it has none, or if its data do not allow it. Raises nothing."""
    for kind, make in _MAKERS.items():
        if isinstance(thing, kind):
            try:
                return f'<div style="font: 13px/1.5 system-ui, sans-serif; max-width: 46em">{make(thing)}</div>'
            except Exception:  # a notebook then shows the plain text
                return None
    return None


def _cell(cell: RobotCell) -> str:
    low, high = cell.limits.lower, cell.limits.upper
    middle = np.where(np.isfinite(low) & np.isfinite(high), 0.5 * (low + high), 0.0)
    return f"<b>RobotCell</b>, {_count(len(cell), 'arm')}, {_count(cell.nv, 'joint')}" + _arms(
        cell, cell.configuration(middle)
    )


def _scenario(task: Scenario) -> str:
    head = f"<b>{_text(task.name)}</b>: a path of {task.path.duration:.4g} s, in steps of {1e3 * task.dt:.4g} ms"
    box = box_solid(task.object_size, task.path.pose(0.0) * task.T_object_body, _OBJECT)
    return head + _arms(task.cell, task.q_start, [box])


def _arms(cell: RobotCell, q: Array, more: Sequence[Any] = ()) -> str:
    """A picture of the arms at a configuration, and a table of them."""
    rows = [
        (
            arm.name,
            str(arm.model.nv),
            arm.tool_frame,
            ", ".join(f"{round(x, 6) + 0.0:.4g}" for x in arm.T_world_base.translation),
            arm.source.replace("\\", "/").rsplit("/", 1)[-1],
        )
        for arm in cell.arms
    ]
    return _picture(cell, q, more) + _table(("arm", "joints", "tool frame", "base [m]", "model"), rows)


def _step(step: ControlStep) -> str:
    cell = step.cell
    share = np.abs(step.velocity) / cell.limits.velocity
    rows = []
    for name, own in cell.blocks.items():
        j = own.start + int(share[own].argmax())
        said = f"{100.0 * share[j]:.2f} %" if np.isfinite(cell.limits.velocity[own]).any() else "no limit"
        rows.append((name, said, cell.joint_names[j].split("/", 1)[1]))
    good = step.status not in (Status.BLOCKED, Status.OFF_PATH, Status.HOLDING, Status.FAULT)
    head = (
        f'<b style="color: {_GOOD if good else _BAD}">{_text(step.status.value)}</b>, '
        f"σ = {100.0 * step.rate:.3g} %, clock {step.clock:.4g} → {step.clock_next:.4g} s<br>{_text(step.explain())}"
    )
    size, body = read_object({}, np.array([T.homogeneous for T in step.grasp.T_object_tool]))
    carried = grasp_at(step.grasp, step.path, step.clock).carried(step.state)[0] * body
    box = box_solid((float(size[0]), float(size[1]), float(size[2])), carried, _OBJECT)
    return head + _picture(cell, step.q, [box]) + _table(("arm", "speed, of its limit", "joint"), rows)


def _recording(run: Recording) -> str:
    arms = ", ".join(_text(arm) for arm in run.metadata.get("arms", [])[:MOST_ROWS])
    status = worst_status(run)
    head = (
        f"<b>{_text(run.metadata.get('scenario') or 'Recording')}</b>: {_text(run.metadata.get('controller', ''))}, "
        f"{_count(run.n_steps, 'step')}, {float(run.time[-1]):.4g} s, "
        f'<b style="color: {_GOOD if run.finished else _BAD}">{"finished" if run.finished else "not finished"}</b>, '
        f"worst status {_text(status)}{f'<br>arms: {arms}' if arms else ''}"
    )
    total = max(float(run.time[-1]), 1e-12)
    bound = [
        (limit_name(b.limit), f"{b.spans[0][0]:.3f}", f"{100.0 * b.seconds / total:.1f} %") for b in bound_limits(run)
    ]
    table = _table(("limit that bound", "first [s]", "of the run"), bound) if bound else "<br>no limit bound"
    return head + _rate(run) + table


def _rate(run: Recording) -> str:
    """The rate over time in front of the statuses, as SVG."""
    width, height, n = float(WIDTH), 90.0, run.n_steps
    if not n:
        return ""
    end = max(float(run.time[-1]), 1e-12)
    x, y = width * run.time[:-1] / end, height - 6.0 - (height - 14.0) * np.clip(run.rate, 0.0, 1.0)
    bands = []
    for status, i, j in itertools.islice(marked_spans(run), MOST_POINTS):
        wide = width * float(run.time[j] - run.time[i]) / end
        place = f'x="{x[i]:.1f}" y="0" width="{wide:.1f}" height="{height:g}"'
        bands.append(f'<rect {place} fill="{BANDS[status]}"><title>{status.value}</title></rect>')
    # The lowest rate of each of the drawn intervals, so that no short stop is lost.
    parts = np.array_split(np.arange(n), min(n, MOST_POINTS))
    points = " ".join(f"{x[p[0]]:.1f},{float(np.nanmax(y[p])):.1f}" for p in parts) + f" {width:g},{y[-1]:.1f}"
    return (
        f'<br><svg width="{width:g}" height="{height + 18:g}" role="img" aria-label="rate over time" '
        f'style="max-width: 100%">{"".join(bands)}<line x1="0" x2="{width:g}" y1="{height - 6:g}" y2="{height - 6:g}" '
        f'stroke="{FAINT}"/><polyline points="{points}" fill="none" stroke="{COLOURS[0]}" stroke-width="2"/>'
        f'<text x="0" y="{height + 13:g}" font-size="11" fill="{INK}">rate σ from 0 to 100 %, over {end:.4g} s</text>'
        "</svg>"
    )


def _picture(cell: RobotCell, q: Array, more: Sequence[Any]) -> str:
    """The arms at a configuration (nq,), with further solids; empty without shapes or Matplotlib."""
    shapes = next((s for s in (cell.visual_model(), cell.collision_model()) if 0 < _size(s) <= MOST_TRIANGLES), None)
    if shapes is None or importlib.util.find_spec("matplotlib") is None:
        return ""
    from matplotlib.image import imsave

    solids = [*cell_solids(cell, [q], shapes=shapes)[0], *more]
    view = View.around([solids], azimuth=125.0, elevation=22.0)
    stream = io.BytesIO()
    imsave(stream, render([solids], view, width=WIDTH)[0], format="png")
    data = base64.b64encode(stream.getvalue()).decode()
    return f'<br><img alt="the arms" width="{WIDTH}" style="max-width: 100%" src="data:image/png;base64,{data}">'


def _size(shapes: Any) -> int:
    """Number of triangles, about."""
    return sum(int(getattr(shape.geometry, "num_tris", 100)) for shape in shapes.geometryObjects)


def _table(head: Iterable[str], rows: Sequence[Sequence[str]]) -> str:
    style = 'style="text-align: left; padding: 1px 12px 1px 0; border: 0; background: none"'
    lines = ["".join(f"<th {style}>{_text(text)}</th>" for text in head)]
    lines += ["".join(f"<td {style}>{_text(text)}</td>" for text in row) for row in rows[:MOST_ROWS]]
    more = f"<br>and {len(rows) - MOST_ROWS} more" if len(rows) > MOST_ROWS else ""
    return f'<table style="border: 0">{"".join(f"<tr>{line}</tr>" for line in lines)}</table>{more}'


def _count(number: int, word: str) -> str:
    return f"{number} {word}{'s' * (number != 1)}"


def _text(value: Any) -> str:
    return html.escape(printable(str(value))[:2000])


_MAKERS: dict[type, Callable[[Any], str]] = {
    RobotCell: _cell,
    Scenario: _scenario,
    ControlStep: _step,
    Recording: _recording,
}
