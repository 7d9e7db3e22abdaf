"""Calibration from recordings: only runs in which the arms held one object count."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from coopqp.checks import require
from coopqp.errors import InvalidInputError
from coopqp.forces.calibration import Calibration, CalibrationError, CalibrationOptions, calibrate
from coopqp.model.cell import RobotCell
from coopqp.simulation.recording.recording import Recording
from coopqp.simulation.recording.scene import describe_cell, read_cell


def calibrate_runs(
    recordings: Sequence[Recording],
    *,
    cell: RobotCell | None = None,
    gripped: bool | None = None,
    options: CalibrationOptions | Mapping[str, Any] | None = None,
) -> Calibration:
    """Base placements and grips from recordings of gripped runs, all with the same cell and grasp.

    A recording carries its cell, and whether the arms held one object: the physics plant knows it, and a plant of
    yours says it with an attribute ``gripped``.

    Args:
        recordings: the runs.
        cell: the cell of the runs, for a result with its shapes and inertias; by default the cell that the recordings
            describe, which has joints only.
        gripped: True if you know that the arms held one object in recordings that do not say so.
        options: as in :func:`coopqp.forces.calibrate`.

    Raises:
        InvalidInputError: no recordings, or another cell than theirs.
        SceneError: a recording does not describe its cell.
        CalibrationError: the arms did not hold one object, the recordings differ in their cell or grasp, or the chain
            is not closed.
    """
    runs = list(recordings)
    if not runs:
        raise InvalidInputError("no recordings", "calibrate_runs", "Give one or more.")
    for i, run in enumerate(runs):
        require(run, Recording, f"calibrate_runs: recordings[{i}]", "Give a Recording.")
        _check_gripped(run, gripped, i)
    recorded = read_cell(runs[0].metadata, shapes=False)
    kinematics = _kinematics(recorded)
    for i, run in enumerate(runs[1:], start=1):
        if _kinematics(read_cell(run.metadata, shapes=False)) != kinematics:
            raise CalibrationError(f"recording {i} was made with another cell than the first. Calibrate them apart.")
        if not np.allclose(run.T_object_tool, runs[0].T_object_tool, rtol=0.0, atol=1e-9):
            raise CalibrationError(f"recording {i} was made with another grasp than the first. Calibrate them apart.")
    if cell is not None and not _alike(_kinematics(cell), kinematics):
        raise InvalidInputError("other arms than the recordings'", "calibrate_runs: cell", "Give the cell of the runs.")
    return calibrate(cell or recorded, runs[0].grasp, np.concatenate([run.q for run in runs]), options=options)


def _check_gripped(run: Recording, gripped: bool | None, i: int) -> None:
    if run.metadata.get("phases"):
        raise CalibrationError(
            f"recording {i} is of a program, whose arms let go or move on the object. Record a run with fixed grasps."
        )
    entry = run.metadata.get("gripped")
    if entry is False:
        raise CalibrationError(
            f"recording {i}: the arms held no object ({run.metadata.get('plant', 'its plant')}); joints that just "
            "follow their commands say nothing of bases and grips. Record a run in which they hold one rigid object."
        )
    if entry is None and not gripped:
        raise CalibrationError(
            f"recording {i} does not say whether the arms held one object. If they did, say so (gripped=True, or the "
            "option --gripped)."
        )


def _kinematics(cell: RobotCell) -> list[dict[str, Any]]:
    """Parts of a cell that a calibration depends on: joints, tools and bases."""
    parts = ("name", "base", "tool", "joints")
    return [{part: arm[part] for part in parts} for arm in describe_cell(cell)["arms"]]


def _alike(a: Any, b: Any) -> bool:
    """Equal, numbers up to rounding."""
    if isinstance(a, Mapping) and isinstance(b, Mapping):
        return a.keys() == b.keys() and all(_alike(a[key], b[key]) for key in a)
    if isinstance(a, (list, tuple)) and isinstance(b, (list, tuple)):
        return len(a) == len(b) and all(_alike(x, y) for x, y in zip(a, b, strict=True))
    if isinstance(a, float) and isinstance(b, float):
        return abs(a - b) <= 1e-9
    return bool(a == b)
