"""The panel of a run as HTML: small pieces, of which some change with the moment. Live and recorded show the same.

The live viewer sends the pieces that change again; a page holds the moments of its pictures and fills them in itself
(``panel.js``).
"""

from __future__ import annotations

import html
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from coopqp.control.interface import Status
from coopqp.visualization.run_panel import Curve, Joint, Moment, RunPanel
from coopqp.visualization.style import COLOURS, STATUS_COLOURS

#: Dashes of the lines of a plot, for readers who cannot tell its colours apart.
_DASHES = ("none", "6 3", "2 2", "8 2 2 2")
#: Height and width of a plot in its own units.
_WIDE, _HIGH = 300.0, 100.0
#: Decimals of the places of a page's moments, which are in hundredths.
_MOST_SPANS = 400


def panel_style(panel: RunPanel, *, until: float) -> str:
    """The style sheet, with the statuses as a band on the slider, which ends at a time [s]."""
    stops = []
    for status, start, end in _spans(panel):
        a, b = 100.0 * start / until, 100.0 * end / until
        stops.append(f"{STATUS_COLOURS[status]} {a:.2f}% {b:.2f}%")
    stops.append(f"rgba(128, 128, 128, .25) {100.0 * panel.end / until:.2f}% 100%")
    sheet = Path(__file__).with_name("panel.css").read_text(encoding="utf-8")
    return f"<style>\n{sheet}:root {{ --coopqp-statuses: linear-gradient(to right, {', '.join(stops)}); }}\n</style>"


def cursor_style(panel: RunPanel, moment: Moment) -> str:
    """Where the line through all plots stands."""
    return f"<style>:root {{ --coopqp-at: {_share(panel, moment):.5f}; }}</style>"


def head_piece(moment: Moment) -> str:
    """Status and time, and the sentence that says why. Changes."""
    key = f'<i class="coopqp-key" data-slot="colour" style="background: {STATUS_COLOURS[moment.status]}"></i>'
    return _piece(
        f'<p>{key}<b data-slot="status">{_text(moment.status.value)}</b> '
        f'<span data-slot="clock">{_text(moment.clock)}</span></p>'
        f'<p class="coopqp-why" data-slot="why">{_text(moment.why)}</p>',
        "coopqp-head",
    )


def band_piece(panel: RunPanel) -> str:
    """The statuses over time, and their names."""
    rects = []
    for status, start, end in _spans(panel):
        x, wide = _WIDE * start / panel.end, _WIDE * (end - start) / panel.end
        rects.append(f'<rect x="{x:.2f}" width="{wide:.2f}" height="{_HIGH:g}" fill="{STATUS_COLOURS[status]}"/>')
    found = [status for status in Status if any(status is one for one, _, _ in panel.statuses)]
    keys = "".join(f"<li>{_key(STATUS_COLOURS[status])}{_text(status.value)}</li>" for status in found)
    names = ", ".join(status.value for status in found)
    return _piece(
        f'<div class="coopqp-plot coopqp-band">{_svg("".join(rects), f"statuses over time: {names}")}</div>'
        f'<ul class="coopqp-keys">{keys}</ul>'
    )


def curve_piece(curve: Curve, value: str) -> str:
    """Name and value of a curve. Changes."""
    return _piece(f'<p class="coopqp-name">{_text(curve.title)}<b data-slot="value">{_text(value)}</b></p>')


def plot_piece(panel: RunPanel, curve: Curve, *, last: bool = False) -> str:
    """The plot of a curve; the last one has the ends of the time below it."""
    top, bottom = curve.top, curve.bottom
    x = _WIDE * np.clip(curve.time / panel.end, 0.0, 1.0)
    drawn, single = [], curve.values.shape[1] == 1
    for k, values in enumerate(curve.values.T):
        y = _HIGH * (top - np.clip(np.nan_to_num(values), bottom, top)) / (top - bottom)
        points = "L".join(f"{a:.1f} {b:.1f}" for a, b in zip(x, y, strict=True))
        look = "" if single else f' style="stroke: {_colour(k)}; stroke-dasharray: {_DASHES[k % len(_DASHES)]}"'
        drawn.append(f'<path d="M{points}"{look}/>')
    labels = [f'<small style="top: 0">largest {_text(curve.largest_text)}</small>']
    if curve.bound is not None and bottom <= curve.bound <= top:
        y = _HIGH * (top - curve.bound) / (top - bottom)
        drawn.append(f'<line x1="0" x2="{_WIDE:g}" y1="{y:.1f}" y2="{y:.1f}"/>')
        labels.append(f'<small style="top: {min(max(y, 18.0), 72.0):.0f}%; right: auto; left: 3px">'
                      f"{_text(curve.bound_name)} {_number(curve.bound)} {_text(curve.unit)}</small>")  # fmt: skip
    keys = "" if single else _line_keys(curve.names)
    ends = f'<p class="coopqp-ends"><span>0 s</span><span>{panel.end:.3g} s</span></p>' if last else ""
    picture = _svg("".join(drawn), f"{curve.title} over time, largest {curve.largest_text}")
    return _piece(f'<div class="coopqp-plot">{picture}{"".join(labels)}</div>{keys}{ends}')


def joints_piece(panel: RunPanel, moment: Moment) -> str:
    """A bar for each joint between its limits. Changes."""
    figures, j = [], 0
    for arm, joints in panel.arms:
        bars = "".join(_bar(joint, moment, j + k) for k, joint in enumerate(joints))
        figures.append(f"<figure><figcaption>{_text(_spaced(arm))}</figcaption>"
                       f'<div class="coopqp-bars">{bars}</div></figure>')  # fmt: skip
        j += len(joints)
    title = '<p class="coopqp-title">joints between their limits</p>'
    return _piece(f'{title}<div class="coopqp-joints">{"".join(figures)}</div>')


def panel_page(panel: RunPanel, moments: Sequence[Moment], *, until: float) -> str:
    """The panel of a page that plays: pieces, the moments of its pictures, and the program that fills them in.

    Args:
        panel: the run.
        moments: of the pictures, evenly spaced in time.
        until: time at the slider's end [s].
    """
    first = moments[0]
    pieces = [head_piece(first), band_piece(panel)]
    for k, (curve, value) in enumerate(zip(panel.curves, first.values, strict=True)):
        pieces += [curve_piece(curve, value), plot_piece(panel, curve, last=k == len(panel.curves) - 1)]
    pieces.append(joints_piece(panel, first))
    why = list(dict.fromkeys(moment.why for moment in moments))
    numbers = {text: i for i, text in enumerate(why)}
    data = {
        "end": panel.end,
        "why": why,
        "statuses": [[status.value, STATUS_COLOURS[status]] for status in Status],
        "moments": [
            {
                "at": round(_share(panel, moment), 5),
                "clock": moment.clock,
                "status": moment.status.code,
                "why": numbers[moment.why],
                "values": moment.values,
                "joints": [0 if np.isnan(place) else round(100.0 * place) for place in moment.joints],
                "bound": moment.bound,
            }
            for moment in moments
        ],
    }
    held = json.dumps(data, ensure_ascii=False, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    program = Path(__file__).with_name("panel.js").read_text(encoding="utf-8")
    return (
        f"{panel_style(panel, until=until)}"
        f'<aside id="coopqp-panel" class="coopqp-panel" aria-label="the run over time">{"".join(pieces)}</aside>'
        f'<p id="coopqp-line">{_text(first.why)}</p>'
        '<button id="coopqp-toggle" type="button" aria-controls="coopqp-panel">plots</button>'
        f'<script type="application/json" id="coopqp-moments">{held}</script><script>\n{program}</script>'
    )


def _spans(panel: RunPanel) -> list[tuple[Status, float, float]]:
    """The spans of the statuses; of very many the longest."""
    if len(panel.statuses) <= _MOST_SPANS:
        return list(panel.statuses)
    longest = sorted(panel.statuses, key=lambda span: span[1] - span[2])[:_MOST_SPANS]
    return sorted(longest, key=lambda span: span[1])


def _bar(joint: Joint, moment: Moment, j: int) -> str:
    place = moment.joints[j]
    kinds = "coopqp-bar" + ("" if joint.limited else " coopqp-free") + (" coopqp-bound" if j in moment.bound else "")
    shown = 0.0 if np.isnan(place) else place
    title = _text(_spaced(joint.name) + ("" if joint.limited else ": no position limits"))
    return f'<div class="{kinds}" title="{title}" style="--p: {shown:.3f}"><i></i></div>'


def _line_keys(names: Sequence[str]) -> str:
    items = []
    for k, name in enumerate(names):
        dash = f'stroke="{_colour(k)}" stroke-width="2.5" stroke-dasharray="{_DASHES[k % len(_DASHES)]}"'
        line = f'<svg width="22" height="8" aria-hidden="true"><path d="M0 4H22" {dash}/></svg>'
        items.append(f"<li>{line} {_text(name)}</li>")
    return f'<ul class="coopqp-keys">{"".join(items)}</ul>'


def _share(panel: RunPanel, moment: Moment) -> float:
    return min(max(moment.time / panel.end, 0.0), 1.0)


def _svg(content: str, label: str) -> str:
    box = f'viewBox="0 0 {_WIDE:g} {_HIGH:g}" preserveAspectRatio="none"'
    return f'<svg {box} role="img" aria-label="{_text(label)}">{content}</svg>'


def _piece(content: str, kind: str = "") -> str:
    return f'<div class="coopqp-piece {kind}">{content}</div>'


def _key(colour: str) -> str:
    return f'<i class="coopqp-key" style="background: {colour}"></i>'


def _colour(k: int) -> str:
    return COLOURS[k % len(COLOURS)]


def _number(value: float) -> str:
    return f"{value:.3g}"


def _spaced(name: str) -> str:
    return name.replace("_", " ")


def _text(value: str) -> str:
    return html.escape(value)
