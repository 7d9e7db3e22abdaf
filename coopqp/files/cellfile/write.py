"""Cell files as text: plain tables in TOML, and the paths in them for another folder."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any


def relative(path: Path, into: Path) -> str:
    """A path in a file of the folder ``into``."""
    try:
        return Path(os.path.relpath(path.absolute(), into.absolute())).as_posix()
    except ValueError:  # on another drive
        return path.absolute().as_posix()


def toml_lines(tables: Mapping[str, Any], place: str = "") -> Iterator[str]:
    """TOML: the keys of a table, then the tables inside it."""
    inner = {}
    for key, value in tables.items():
        if isinstance(value, Mapping) or (isinstance(value, list) and value and isinstance(value[0], Mapping)):
            inner[key] = value
        else:
            yield f"{_key(key)} = {_value(value)}"
    for key, value in inner.items():
        name = f"{place}.{_key(key)}" if place else _key(key)
        for table in value if isinstance(value, list) else [value]:
            yield ""
            yield f"[[{name}]]" if isinstance(value, list) else f"[{name}]"
            yield from toml_lines(table, name)


def _key(key: str) -> str:
    plain = key.isascii() and key.replace("_", "").replace("-", "").isalnum()
    return key if plain else json.dumps(key)


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return repr(value)  # the shortest text that reads back to the same number; inf and nan are TOML, too
    if isinstance(value, int):
        return str(value)
    if isinstance(value, (list, tuple)):
        texts = [_value(item) for item in value]
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
