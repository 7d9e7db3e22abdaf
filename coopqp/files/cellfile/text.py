"""Parsing of a cell file into plain tables. The file name selects TOML or YAML. Nothing is executed."""

from __future__ import annotations

import io
import sys
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError, YAMLError
from ruamel.yaml.events import AliasEvent, CollectionEndEvent, CollectionStartEvent

from coopqp.files.cellfile.error import YAML_SUFFIXES, CellFileError
from coopqp.reading import check_depth, read_file

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

#: Largest accepted file [bytes]. YAML has a smaller limit: its reader takes fifteen times as long.
MAX_FILE_BYTES, MAX_YAML_BYTES = 1_000_000, 100_000
#: Largest accepted nesting depth.
_MAX_DEPTH = 50


def read_tables(file: Path) -> Any:
    """Parse a file into plain data; a YAML suffix selects YAML, any other TOML.

    Raises:
        CellFileError: the file is missing, too large, neither TOML nor YAML, or YAML with aliases.
    """
    is_yaml = file.suffix in YAML_SUFFIXES
    limit = MAX_YAML_BYTES if is_yaml else MAX_FILE_BYTES
    try:
        text = read_file(file, limit).decode("utf-8-sig")  # Windows editors begin files with a mark
        tables = _read_yaml(text) if is_yaml else tomllib.loads(text)
        check_depth(tables, _MAX_DEPTH)
        return tables
    except OSError as error:
        raise CellFileError(f"cannot read {error.filename}: {error.strerror}. Check the path.") from error
    except MarkedYAMLError as error:
        line = f", line {error.problem_mark.line + 1}" if error.problem_mark else ""
        raise CellFileError(f"{file}{line} is not YAML: {error.problem}.") from error
    except (ValueError, RecursionError, YAMLError) as error:  # also bad encoding, too many digits
        raise CellFileError(f"{file} is not {'YAML' if is_yaml else 'TOML'}: {error}.") from error


def _read_yaml(text: str) -> Any:
    """Parse YAML 1.2 with unique keys. Aliases are refused: a few nested ones can expand beyond the memory."""
    reader, depth = YAML(typ="safe", pure=True), 0
    for event in reader.parse(io.StringIO(text)):
        if isinstance(event, AliasEvent):
            raise ValueError(f"line {event.start_mark.line + 1} has the alias *{event.anchor}, which is not read")
        depth += isinstance(event, CollectionStartEvent) - isinstance(event, CollectionEndEvent)
        if depth > _MAX_DEPTH:
            raise ValueError(f"line {event.start_mark.line + 1} is nested more than {_MAX_DEPTH} deep")
    return reader.load(text)
