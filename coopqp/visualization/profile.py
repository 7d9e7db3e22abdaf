"""The speed profile of a timed path, coloured by the joint that binds."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from coopqp.model.limits import LimitKind
from coopqp.paths.timed import TimedPath
from coopqp.visualization.style import INK, label, legend_beside, new_figure, save_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Colours of the joints that bind longest (Okabe and Ito); the others are grey.
_COLOURS = ("#0072b2", "#e69f00", "#009e73", "#d55e00", "#cc79a7", "#56b4e9", "#f0e442", "#7f5539")
_LEAST_SHARE = 0.01  # of the duration: what binds for less is not in the legend by name
_OTHERS = "#b8bcc4"
#: Hatches of the kinds of limits, from the one that binds longest on.
_HATCHES = ("", "////", "xxxx", "....")


def profile_figure(path: TimedPath) -> Figure:
    """Speed of the object over time; the area below it has the colour of the joint whose limit binds.

    Raises:
        MissingExtraError: matplotlib is missing.
    """
    figure = new_figure(8.0, 4.2, layout="constrained")
    from matplotlib.patches import Patch

    profile = path.profile
    clocks, speeds = profile.clocks, np.sqrt(profile.squares)
    spans = np.diff(clocks)
    times: dict[tuple[str, str], float] = {}
    kinds: dict[LimitKind, float] = {}
    for limit, span in zip(profile.binding, spans.tolist(), strict=True):
        if limit is not None:
            times[limit.arm, limit.joint] = times.get((limit.arm, limit.joint), 0.0) + span
            kinds[limit.kind] = kinds.get(limit.kind, 0.0) + span
    hatches = dict(zip(sorted(kinds, key=lambda kind: -kinds[kind]), _HATCHES, strict=False))
    ranked = sorted(times, key=lambda joint: -times[joint])
    long = [joint for joint in ranked if times[joint] >= _LEAST_SHARE * path.duration]
    colours = dict(zip(long, _COLOURS, strict=False))
    axes = figure.subplots()
    begin = 0
    for i in range(1, len(spans) + 1):
        if i < len(spans) and profile.binding[i] == profile.binding[begin]:
            continue
        limit, part = profile.binding[begin], slice(begin, i + 1)
        colour = _OTHERS if limit is None else colours.get((limit.arm, limit.joint), _OTHERS)
        hatch = "" if limit is None else hatches[limit.kind]
        axes.fill_between(clocks[part], speeds[part], facecolor=colour, hatch=hatch, edgecolor="white", linewidth=0.2)
        begin = i
    axes.plot(clocks, speeds, color=INK, linewidth=1.2)
    axes.set_xlim(0.0, path.duration)
    axes.set_ylim(0.0, 1.08 * float(speeds.max()))
    axes.set_xlabel("time [s]")
    axes.set_ylabel("speed along the path [m/s]")
    axes.set_title(f"{path.duration:.3f} s from rest to rest: the joint that sets the speed", loc="left", color=INK)
    handles = [
        Patch(facecolor=colours[joint], label=label(f"{joint[0]}: {joint[1]} ({times[joint]:.2f} s)"))
        for joint in colours
    ]
    rest = sum(times[joint] for joint in ranked[len(colours) :])
    if rest >= _LEAST_SHARE * path.duration:
        count = len(ranked) - len(colours)
        handles.append(Patch(facecolor=_OTHERS, label=f"{count} other joint{'s' * (count > 1)} ({rest:.2f} s)"))
    handles += [
        Patch(facecolor="white", edgecolor=INK, hatch=hatch, label=f"by its {kind.value} limit")
        for kind, hatch in hatches.items()
        if kinds[kind] >= _LEAST_SHARE * path.duration
    ]
    legend_beside(axes, handles=handles)
    return figure


def write_speed_profile(path: TimedPath, file: str | Path, *, dpi: int = 200) -> Path:
    """Draw :func:`profile_figure` into a ``.png``, ``.pdf`` or ``.svg`` file.

    Raises:
        InvalidInputError: another kind of file.
        OutputError: it cannot be written.
        MissingExtraError: matplotlib is missing.
    """
    return save_figure(profile_figure(path), file, dpi=dpi)
