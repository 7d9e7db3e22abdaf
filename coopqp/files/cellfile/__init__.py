"""Cell files: a cell and its task in TOML or YAML. Use :func:`load_cell_file`, then :meth:`CellRun.run`.

Reading a file executes nothing: every name in it is looked up in a fixed table.
"""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from coopqp.checks import require
from coopqp.errors import MissingExtraError, UnknownNameError
from coopqp.files.cellfile.error import CellFileError

if TYPE_CHECKING:
    from coopqp.files.cellfile.build import CellRun, CellTask

__all__ = [
    "CELLS",
    "CellFileError",
    "example_path",
    "json_schema",
    "load_cell_file",
    "load_cell_task",
    "schema_text",
]

_SHIPPED = Path(__file__).parents[2] / "scenarios" / "cells"
#: Stems of the cell files that come with coopqp.
CELLS = tuple(sorted(file.stem for file in _SHIPPED.glob("*.toml")))


def example_path(name: str) -> Path:
    """Path of a cell file that comes with coopqp, one of :data:`CELLS`.

    Raises:
        UnknownNameError: no such file.
    """
    if name not in CELLS:
        raise UnknownNameError("cell file", name, CELLS)
    return _SHIPPED / f"{name}.toml"


def load_cell_file(path: str | Path) -> CellRun:
    """Read a cell file and build its cell, task and controller settings.

    Raises:
        CellFileError: the file is missing, too large, neither TOML nor YAML, or breaks the schema; or the cell cannot
            be built (a missing model, a pose out of reach, …). The message names the problem and its place.
        MissingExtraError: the extra ``files`` is not installed.
    """
    require_readers()
    require(path, (str, Path), "load_cell_file: path", "Give the name of a file.")
    from coopqp.files.cellfile.build import load

    return load(Path(path))


def load_cell_task(path: str | Path) -> CellTask:
    """Read a cell file and build its cell, grasp and path. No start is searched.

    Raises:
        CellFileError, MissingExtraError: as :func:`load_cell_file`.
    """
    require_readers()
    from coopqp.files.cellfile.build import load_task

    return load_task(Path(path))


def schema_text() -> str:
    """Every key of a cell file with its type, unit, default and meaning, as readable text."""
    require_readers()
    from coopqp.files.cellfile.describe import describe_schema

    return describe_schema()


def json_schema() -> dict[str, Any]:
    """The JSON Schema of a cell file, for editors."""
    require_readers()
    from coopqp.files.cellfile.schema import CellFile

    return CellFile.model_json_schema()


def require_readers() -> None:
    """Raise MissingExtraError unless cell files can be read."""
    for module, package in (("pydantic", "pydantic"), ("ruamel", "ruamel.yaml")):
        if find_spec(module) is None:
            raise MissingExtraError("files", package)
