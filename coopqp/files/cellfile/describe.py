"""The schema of a cell file as readable text, from its JSON schema."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from typing import Any

from coopqp.files.cellfile.schema import CellFile
from coopqp.files.cellfile.strict import shown_default

_WIDTH = 118
#: Largest number of listed names.
MAX_MEMBERS = 8
_WORDS = {"number": "number", "integer": "whole number", "boolean": "true or false", "string": "text"}

Node = dict[str, Any]


def describe_schema() -> str:
    """Every key with its type, unit, default and meaning."""
    lines = [
        "A coopqp cell file: TOML, or YAML with the same keys. Keys with * are required. Units are in the names:",
        "_m metres, _mm millimetres, _deg degrees, _rad radians, _s seconds, _kg kilograms. Prismatic joints use",
        "metres (m/s, m/s²) under the keys of either angle unit. Paths are relative to the file.",
    ]
    schema = CellFile.model_json_schema()
    lines += _table("", schema, schema["$defs"])
    return "\n".join(lines) + "\n"


def _table(path: str, table: Node, tables: dict[str, Node], kind: str = "") -> Iterator[str]:
    """The lines of a table's keys, then of the tables inside it."""
    head = f"[{path}]" if path and not path.endswith("]]") else path
    yield ""
    title = f'{head}  kind = "{kind}"' if kind else head
    yield f"{title}  {_first_line(table)}".strip()
    inner: list[tuple[str, str, str]] = []
    for key, node in table["properties"].items():
        if key == "kind" and kind:
            continue
        place = f"{path.strip('[]')}.{key}" if path else key
        nested = [reference.rpartition("/")[2] for reference in _references(node)]
        repeated = any(choice.get("type") == "array" for choice in _choices(node))
        for name in nested:
            tag = tables[name]["properties"].get("kind", {}).get("const", "") if len(nested) > 1 else ""
            inner.append((f"[[{place}]]" if repeated and not path else place, name, tag))
        yield from _key(key, node, required=key in table.get("required", ()))
    for place, name, tag in inner:
        if name != "PlacementTable" or place == "arms.base":  # print the placement table only once
            yield from _table(place, tables[name], tables, tag)


def _key(key: str, node: Node, *, required: bool) -> Iterator[str]:
    text, default = node.get("description", "").strip(), node.get("default")
    if isinstance(default, (int, float, str)):
        text += f" (default {shown_default(default)})"
    left = f"  {key}{'*' if required else ''}"
    body = textwrap.wrap(text, _WIDTH - 56) or [""]
    head = f"{left:<27} {_word(node):<27} "
    if len(head) > 56:
        yield head.rstrip()
        head = " " * 56
    yield f"{head}{body[0]}".rstrip()
    yield from (" " * 56 + line for line in body[1:])


def _first_line(table: Node) -> str:
    return table.get("description", "").strip().split("\n", 1)[0].replace("``", "")


def _choices(node: Node) -> list[Node]:
    """The alternatives of a type, without null and false."""
    choices = node.get("anyOf") or node.get("oneOf")
    if choices is None:
        return [] if node.get("type") == "null" or node.get("const") is False else [node]
    return [plain for choice in choices for plain in _choices(choice)]


def _references(node: Node) -> Iterator[str]:
    """The tables in a type."""
    if "$ref" in node:
        yield node["$ref"]
    for choice in (*node.get("anyOf", ()), *node.get("oneOf", ()), node.get("items"), node.get("additionalProperties")):
        if isinstance(choice, dict):
            yield from _references(choice)


def _word(node: Node) -> str:
    """A type in words."""
    words = list(dict.fromkeys(map(_one_word, _choices(node))))
    text = "table" if "table" in words else " or ".join(words)
    return text + (" or false" if any(choice.get("const") is False for choice in node.get("anyOf", ())) else "")


def _one_word(node: Node) -> str:
    if "$ref" in node:
        return "table"
    members = [node["const"]] if "const" in node else node.get("enum")
    if members:
        return " | ".join(f'"{member}"' for member in members) if len(members) <= MAX_MEMBERS else "name"
    kind = node.get("type")
    if kind == "array":
        inner = _word(node["items"])
        return {"list of numbers": "rows of numbers", "list of texts": "list of pairs"}.get(inner, f"list of {inner}s")
    if kind == "object":
        inner = _word(node["additionalProperties"])
        values = "lists" if inner.startswith("list") else "values" if " or " in inner else f"{inner}s"
        return f"table of {values}"
    return _WORDS[str(kind)]
