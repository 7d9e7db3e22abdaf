"""Cell files as text: plain tables in TOML, and the paths in them for another folder."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from coopqp.files.cellfile.paths import resolve
from coopqp.files.cellfile.schema import ArmTable


def relative(path: Path, into: Path) -> str:
    """A path in a file of the folder ``into``."""
    try:
        return Path(os.path.relpath(path.absolute(), into.absolute())).as_posix()
    except ValueError:  # on another drive
        return path.absolute().as_posix()


def move_files(tables: list[dict[str, Any]], arms: Sequence[ArmTable], folder: Path, into: Path) -> None:
    """Rewrite the paths of the tables ``arms`` of a cell file for another folder.

    Args:
        tables: the tables that are written.
        arms: the same tables, as they were read.
        folder: folder of the file that was read.
        into: folder of the file that is written.

    Raises:
        CoopqpError: a path leads nowhere.
    """
    for table, arm in zip(tables, arms, strict=True):
        where = f"arm '{arm.name}'"
        dirs = [resolve(d, folder, f"{where}: package_dirs") for d in arm.package_dirs]
        for key in ("urdf", "mjcf"):
            if key in table:
                table[key] = relative(resolve(table[key], folder, f"{where}: {key}", package_dirs=dirs), into)
        if dirs:
            table["package_dirs"] = [relative(d, into) for d in dirs]


def file_text(head: Sequence[str], tables: Mapping[str, Any]) -> str:
    """A cell file in TOML: comment lines, then its tables. The path comes last: its entries are long."""
    order = sorted(tables, key=lambda key: key == "path")
    return "\n".join([*(f"# {line}" for line in head), *toml_lines({key: tables[key] for key in order})]) + "\n"


def toml_lines(tables: Mapping[str, Any], place: str = "") -> Iterator[str]:
    """TOML: the keys of a table, then the tables inside it."""
    inner = {}
    for key, value in tables.items():
        if isinstance(value, Mapping) or (isinstance(value, list) and value and isinstance(value[0], Mapping)):
            inner[key] = value
        else:
            yield f"{toml_key(key)} = {toml_value(value)}"
    for key, value in inner.items():
        name = f"{place}.{toml_key(key)}" if place else toml_key(key)
        for table in value if isinstance(value, list) else [value]:
            yield ""
            yield f"[[{name}]]" if isinstance(value, list) else f"[{name}]"
            yield from toml_lines(table, name)


def toml_key(key: str) -> str:
    """A key in TOML, in quotes where it needs them."""
    plain = key.isascii() and key.replace("_", "").replace("-", "").isalnum()
    return key if plain else json.dumps(key)


def toml_value(value: Any) -> str:
    """A value in TOML."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return repr(value)  # the shortest text that reads back to the same number; inf and nan are TOML, too
    if isinstance(value, int):
        return str(value)
    if isinstance(value, (list, tuple)):
        texts = [toml_value(item) for item in value]
        if sum(map(len, texts)) < 100:
            return f"[{', '.join(texts)}]"
        return "[\n" + "".join(f"  {text},\n" for text in _rows(texts)) + "]"
    return json.dumps(str(value), ensure_ascii=False)


def _rows(texts: list[str]) -> Iterator[str]:
    """Texts put together to lines of some length."""
    row = ""
    for text in texts:
        if row and len(row) + len(text) > 110:
            yield row
            row = text
        else:
            row = f"{row}, {text}" if row else text
    yield row
