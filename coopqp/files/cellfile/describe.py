"""The schema of a cell file as readable text."""

from __future__ import annotations

import textwrap
import types
import typing
from collections.abc import Iterator
from typing import Any, Literal, Union

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from coopqp.files.cellfile.schema import CellFile
from coopqp.files.cellfile.strict import shown_default

_WIDTH = 118
#: Largest number of listed names.
MAX_MEMBERS = 8
_WORDS = {float: "number", int: "whole number", bool: "true or false", str: "text"}


def describe_schema() -> str:
    """Every key with its type, unit, default and meaning."""
    lines = [
        "A coopqp cell file: TOML, or YAML with the same keys. Keys with * are required. Units are in the names:",
        "_m metres, _mm millimetres, _deg degrees, _rad radians, _s seconds, _kg kilograms. Prismatic joints use",
        "metres (m/s, m/s²) under the keys of either angle unit. Paths are relative to the file.",
    ]
    lines += _table("", CellFile)
    return "\n".join(lines) + "\n"


def _table(path: str, table: type[BaseModel], kind: str = "") -> Iterator[str]:
    """The lines of a table's keys, then of the tables inside it."""
    head = f"[{path}]" if path and not path.endswith("]]") else path
    yield ""
    title = f"{head}{f'  kind = {kind!r}' if kind else ''}".replace("'", '"')
    yield f"{title}  {_first_line(table)}".strip()
    inner: list[tuple[str, type[BaseModel], str]] = []
    for key, field in table.model_fields.items():
        if key == "kind" and kind:
            continue
        place = f"{path.strip('[]')}.{key}" if path else key
        nested = _tables(field.annotation)
        repeated = typing.get_origin(_plain(field.annotation)) is list
        for member in nested:
            tag = _tag(member) if len(nested) > 1 else ""
            inner.append((f"[[{place}]]" if repeated and not path else place, member, tag))
        yield from _key(key, field)
    for place, member, tag in inner:
        if member.__name__ != "PlacementTable" or place == "arms.base":  # print the placement table only once
            yield from _table(place, member, tag)


def _key(key: str, field: FieldInfo) -> Iterator[str]:
    text = (field.description or "").strip()
    default = field.get_default()
    if not field.is_required() and isinstance(default, (int, float, str)):
        text += f" (default {shown_default(default)})"
    left = f"  {key}{'*' if field.is_required() else ''}"
    body = textwrap.wrap(text, _WIDTH - 56) or [""]
    head = f"{left:<27} {_word(field.annotation):<27} "
    if len(head) > 56:
        yield head.rstrip()
        head = " " * 56
    yield f"{head}{body[0]}".rstrip()
    yield from (" " * 56 + line for line in body[1:])


def _first_line(table: type[BaseModel]) -> str:
    return (table.__doc__ or "").strip().split("\n", 1)[0].replace("``", "")


def _tag(table: type[BaseModel]) -> str:
    kinds = typing.get_args(table.model_fields["kind"].annotation) if "kind" in table.model_fields else ()
    return str(kinds[0]) if len(kinds) == 1 else ""


def _plain(kind: Any) -> Any:
    """A type without constraints, and without None or false as alternatives."""
    if typing.get_origin(kind) is typing.Annotated:
        return _plain(typing.get_args(kind)[0])
    if typing.get_origin(kind) in (Union, types.UnionType):
        members = [m for m in typing.get_args(kind) if m is not type(None) and m != Literal[False]]
        if len(members) == 1:
            return _plain(members[0])
    return kind


def _is_table(kind: Any) -> bool:
    """Whether a type is the class of a table. Python 3.10 takes ``list[…]`` for a class, too."""
    return typing.get_origin(kind) is None and isinstance(kind, type) and issubclass(kind, BaseModel)


def _tables(kind: Any) -> list[type[BaseModel]]:
    """The table classes in a type."""
    if _is_table(kind):
        return [kind]
    return [table for member in typing.get_args(kind) for table in _tables(member)]


def _word(kind: Any) -> str:
    """A type in words."""
    off = " or false" if Literal[False] in typing.get_args(kind) else ""
    plain = _plain(kind)
    origin, members = typing.get_origin(plain), typing.get_args(plain)
    if origin is Literal:
        text = " | ".join(f'"{member}"' for member in members) if len(members) <= MAX_MEMBERS else "name"
    elif origin is list:
        inner = _word(members[0])
        text = {"list of numbers": "rows of numbers", "list of texts": "list of pairs"}.get(inner, f"list of {inner}s")
    elif origin is dict:
        inner = _word(members[1])
        text = (
            "table of lists" if inner.startswith("list") else f"table of {'values' if ' or ' in inner else inner + 's'}"
        )
    elif origin in (Union, types.UnionType):
        named = [member for member in members if member is not type(None) and member != Literal[False]]
        words = list(dict.fromkeys(map(_word, named)))
        text = " or ".join(words) if "table" not in words else "table"
    elif _is_table(plain):
        text = "table"
    else:
        text = _WORDS.get(plain, str(plain))
    return text + off
