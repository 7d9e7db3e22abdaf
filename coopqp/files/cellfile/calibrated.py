"""The cell file of a calibration: the file of the run, with the bases and the grips that close the chain."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pinocchio as pin
from pydantic import ValidationError

from coopqp.files.cellfile.build import read
from coopqp.files.cellfile.error import CellFileError
from coopqp.files.cellfile.explain import explain
from coopqp.files.cellfile.renamed import renewed
from coopqp.files.cellfile.schema import CellFile
from coopqp.files.cellfile.write import file_text, move_files, relative
from coopqp.forces.calibration import Calibration


def settings_of(metadata: Mapping[str, Any], given: Path | None) -> tuple[CellFile, Path | None]:
    """The cell file of a recording, and its folder; None for a file whose folder the recording does not know.

    Args:
        metadata: metadata of the recording.
        given: the cell file, for a recording that has none.

    Raises:
        CellFileError: the file does not exist or is no cell file, or there is none.
    """
    if given is not None:
        return read(given), given.parent
    tables = metadata.get("settings")
    if not isinstance(tables, Mapping):
        raise CellFileError(
            "the recording is not one of a cell file, so there is none to correct. Give it with --cell."
        )
    try:
        return CellFile.model_validate(renewed(tables, "the recording")), None
    except ValidationError as error:
        raise CellFileError(f"the recording's cell file is damaged: {explain(error)}") from error


def calibrated_text(
    settings: CellFile, calibration: Calibration, *, sources: list[str], folder: Path | None, into: Path
) -> str:
    """The corrected cell file in TOML. Its numbers read back bit for bit; its start is corrected when it is read.

    Args:
        settings: the cell file of the run.
        calibration: the bases and grips that were found.
        sources: file of each arm's model, for paths whose folder is not known.
        folder: folder of the run's file, or None.
        into: folder of the new file.

    Raises:
        CellFileError: the file has other arms than the calibration.
    """
    cell = calibration.cell
    if tuple(arm.name for arm in settings.arms) != cell.arm_names:
        raise CellFileError(f"the cell file has other arms than the recording: {', '.join(cell.arm_names)} are needed.")
    tables = settings.model_dump(exclude_none=True, exclude_unset=True)
    for table, arm, source in zip(tables["arms"], cell.arms, sources, strict=True):
        table["base"] = {"matrix": _matrix(arm.T_world_base)}
        if folder is None:
            table |= {key: relative(Path(source), into) for key in ("urdf", "mjcf") if key in table}
    if folder is not None:
        move_files(tables["arms"], settings.arms, folder, into)
    tools = zip(cell.arm_names, calibration.grasp.T_object_tool, strict=True)
    tables["grasp"] = {"kind": "tools", "tools": {name: {"matrix": _matrix(X)} for name, X in tools}}
    if tables.get("start", {}).get("inverse_kinematics") is False:
        tables["start"]["inverse_kinematics"] = True  # the old start does not fit the corrected bases
    same = [found.arm for found in calibration.corrections if not found.significant]
    before, after = 1e3 * calibration.before[:, 0].max(), 1e3 * calibration.after[:, 0].max()
    head = [
        f"Bases and grips calibrated by coopqp from {len(calibration.samples)} configurations of a gripped run:",
        f"the arms part by {after:.3g} mm instead of {before:.3g} mm. The base and the grip of "
        f"{cell.arm_names[0]} are the reference.",
        *(f"kept, its correction is no more than its uncertainty: {arm}" for arm in same),
        *(f"not determined, kept: {name}" for name in calibration.undetermined),
    ]
    return file_text(head, tables)


def _matrix(T: pin.SE3) -> list[list[float]]:
    return T.homogeneous.tolist()
