"""The cell file of a calibration: the file of the run, with the bases and the grips that close the chain."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pinocchio as pin
from pydantic import ValidationError

from coopqp.files.cellfile import CellFileError
from coopqp.files.cellfile.build import read
from coopqp.files.cellfile.explain import explain
from coopqp.files.cellfile.paths import resolve
from coopqp.files.cellfile.schema import CellFile
from coopqp.files.cellfile.write import relative, toml_lines
from coopqp.forces.calibration import Calibration


def settings_of(metadata: Mapping[str, Any], given: Path | None) -> tuple[CellFile, Path | None]:
    """The cell file of a recording, and the folder of its paths; None where these are those of the arms' models.

    Args:
        metadata: of the recording.
        given: the cell file, if the recording is not one of a cell file.

    Raises:
        CellFileError: it does not exist, or is no cell file.
    """
    if given is not None:
        return read(given), given.parent
    tables = metadata.get("settings")
    if not isinstance(tables, Mapping):
        raise CellFileError(
            "the recording is not one of a cell file, so there is none to correct. Give it with --cell."
        )
    try:
        return CellFile.model_validate(tables), None
    except ValidationError as error:
        raise CellFileError(f"the recording's cell file is damaged: {explain(error)}") from error


def calibrated_text(
    settings: CellFile, calibration: Calibration, *, sources: list[str], folder: Path | None, into: Path
) -> str:
    """The corrected cell file in TOML. Its numbers read back bit for bit; its start is corrected when it is read.

    Args:
        settings: the cell file of the run.
        calibration: what was found.
        sources: file of each arm's model, for paths whose folder is not known.
        folder: folder of that file, or None.
        into: folder of the new file.

    Raises:
        CellFileError: the file has other arms than the calibration.
    """
    cell = calibration.cell
    if tuple(arm.name for arm in settings.arms) != cell.arm_names:
        raise CellFileError(f"the cell file has other arms than the recording: {', '.join(cell.arm_names)} are needed.")
    tables = settings.model_dump(exclude_none=True, exclude_unset=True)
    for table, given, arm, source in zip(tables["arms"], settings.arms, cell.arms, sources, strict=True):
        table["base"] = {"matrix": _matrix(arm.T_world_base)}
        where = f"arm '{arm.name}'"
        dirs = [] if folder is None else [resolve(d, folder, f"{where}: package_dirs") for d in given.package_dirs]
        for key in ("urdf", "mjcf"):
            if key in table:
                file = Path(source) if folder is None else resolve(table[key], folder, where, package_dirs=dirs)
                table[key] = relative(file, into)
        if dirs:
            table["package_dirs"] = [relative(d, into) for d in dirs]
    tools = zip(cell.arm_names, calibration.grasp.T_object_tool, strict=True)
    tables["grasp"] = {"kind": "tools", "tools": {name: {"matrix": _matrix(X)} for name, X in tools}}
    if tables.get("start", {}).get("inverse_kinematics") is False:
        tables["start"]["inverse_kinematics"] = True  # the old start does not fit the corrected bases
    before, after = 1e3 * calibration.before[:, 0].max(), 1e3 * calibration.after[:, 0].max()
    head = [
        f"# Bases and grips calibrated by coopqp from {len(calibration.samples)} configurations of a gripped run:",
        f"# the arms part by {after:.3g} mm instead of {before:.3g} mm. The base and the grip of "
        f"{cell.arm_names[0]} are the reference.",
        *(f"# not determined, kept: {name}" for name in calibration.undetermined),
    ]
    order = sorted(tables, key=lambda key: key == "path")
    return "\n".join([*head, *toml_lines({key: tables[key] for key in order})]) + "\n"


def _matrix(T: pin.SE3) -> list[list[float]]:
    rows: list[list[float]] = T.homogeneous.tolist()
    return rows
