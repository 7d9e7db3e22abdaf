"""Marks in the scene of a run: the line between the nearest bodies with its length, and the forces of the arms."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from coopqp.model.cell import RobotCell
from coopqp.simulation.evaluation import metrics
from coopqp.simulation.recording.recording import Recording
from coopqp.simulation.recording.scene import SceneError
from coopqp.spatial import Array
from coopqp.visualization.run_panel import nearest_pairs

_FORCE = (0, 122, 90)
#: Length of the longest force arrow, as a share of the scene; forces below the first have no arrow, none is larger than
#: the second [N].
_LONGEST_ARROW, _LEAST_FORCE, _MOST_FORCE = 0.16, 1e-3, 1e9


class NearestLine:
    """The line between the two bodies that are nearest to each other, and its length in mm.

    Args:
        scene: of viser.
        metadata: of the recording.
        colour: of the line.

    Raises:
        SceneError: the entry ``clearance`` of the metadata is damaged.
    """

    def __init__(self, scene: Any, metadata: Mapping[str, Any], colour: tuple[int, int, int]) -> None:
        self._pairs = _nearest(metadata)
        if self._pairs is None:
            return
        points = self._pairs[1][:1]
        self._line = scene.add_line_segments("/nearest", points, colors=colour, thickness=3.0, thickness_units="screen")
        self._label = scene.add_label("/nearest/distance", "", anchor="bottom-left")

    def show(self, time: float) -> None:
        """Show the pair at a time [s]."""
        if self._pairs is None:
            return
        times, points, distances = self._pairs
        i = int(np.abs(times - time).argmin())
        self._line.points = points[i : i + 1]
        self._label.position = points[i].mean(axis=0)
        self._label.text = f"{1e3 * distances[i]:.3g} mm"


class ForceArrows:
    """An arrow for the force of each arm on the object, from its tool, and its size in N.

    Args:
        scene: of viser.
        cell, recording: the run; without wrenches there are no arrows.
        size: of the scene [m].
    """

    def __init__(self, scene: Any, cell: RobotCell, recording: Recording, size: float) -> None:
        self._cell, self._run, self._forces = cell, recording, None
        if not has_forces(recording):
            return
        wrenches = np.asarray(recording.wrenches)[:, :, :3]
        self._forces = np.clip(np.nan_to_num(wrenches), -_MOST_FORCE, _MOST_FORCE)  # in the axes of the tools
        largest = max(float(np.linalg.norm(self._forces, axis=2).max(initial=0.0)), _LEAST_FORCE)
        self._metres_per_newton = _LONGEST_ARROW * size / largest
        self._arrows = scene.add_arrows(
            "/forces", np.zeros((len(cell), 2, 3), dtype=np.float32), colors=_FORCE,
            shaft_radius=0.004 * size, head_radius=0.009 * size, head_length=0.022 * size,
        )  # fmt: skip
        self._labels = [scene.add_label(f"/forces/{name}", "", anchor="bottom-center") for name in cell.arm_names]

    def show(self, sample: int) -> None:
        """Show the forces after the step that ends at a sample."""
        if self._forces is None:
            return
        ends, tools = [], metrics.tool_placements(self._cell, [self._run.q[sample]])[0]
        for force, tool, label in zip(self._forces[max(sample - 1, 0)], tools, self._labels, strict=True):
            size = float(np.linalg.norm(force))
            along = tool.rotation @ force if size > _LEAST_FORCE else np.array([0.0, 0.0, _LEAST_FORCE])
            tip = tool.translation + self._metres_per_newton * along
            ends.append((tool.translation, tip))
            label.position, label.text = tip, f"{size:.3g} N"
        self._arrows.points = np.array(ends, dtype=np.float32)


def has_forces(recording: Recording) -> bool:
    """Whether the wrenches of the arms were recorded."""
    return recording.wrenches is not None and recording.n_steps > 0


def _nearest(metadata: Mapping[str, Any]) -> tuple[Array, Array, Array] | None:
    """Times (T,) [s], nearest points (T, 2, 3) [m] and distances (T,) [m] of a recording; None if it has none."""
    entry = metadata.get("clearance")
    if not isinstance(entry, Mapping) or "points_m" not in entry:
        return None
    try:
        times, points = (np.array(entry[key], dtype=float) for key in ("times_s", "points_m"))
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise SceneError(f"the recording's nearest points are damaged ({error}).") from error
    if not times.size or times.ndim != 1 or points.shape != (len(times), 2, 3) or not np.isfinite(points).all():
        raise SceneError("the recording's nearest points are damaged.")
    found = nearest_pairs(metadata)
    distances = found[1] if found is not None and len(found[1]) == len(times) else np.ptp(points, axis=1).max(axis=1)
    return times, points.astype(np.float32), distances
