"""Tables with checked keys and types, and tables built from the options dataclasses."""

from __future__ import annotations

import dataclasses
import types
import typing
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal, Union

from annotated_types import Ge, Le, Len
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, create_model, model_validator
from pydantic_core import PydanticCustomError

from coopqp.checks import meanings
from coopqp.errors import nearest, shortened

#: Largest accepted length of a list of numbers.
MAX_LIST = 10_000


class Table(BaseModel):
    """A table of a cell file. Unknown keys and wrong types are errors; nothing is converted."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)
    #: Keys that are no more, and what to do instead.
    removed: ClassVar[Mapping[str, str]] = {}

    @model_validator(mode="before")
    @classmethod
    def _known_keys(cls, data: Any) -> Any:
        if isinstance(data, Mapping):
            unknown = [str(key) for key in data if key not in cls.model_fields]
            gone = next((key for key in unknown if key in cls.removed), None)
            if gone is not None:
                remedy = cls.removed[gone].removesuffix(".")
                raise problem(f"{gone} is no longer a key; {remedy[:1].lower()}{remedy[1:]}")
            if unknown:
                near = nearest(unknown[0], cls.model_fields)
                hint = f"did you mean '{near[0]}'? " if near else ""
                raise PydanticCustomError(
                    "unknown_key",
                    "unknown key '{key}'; {hint}known: {known}",
                    {"key": shortened(unknown[0]), "hint": hint, "known": ", ".join(cls.model_fields)},
                )
        return data


def problem(text: str) -> PydanticCustomError:
    """An error of a value, in words."""
    return PydanticCustomError("cell_file", "{text}", {"text": text})


#: Largest accepted number of an option, and the smallest one that is not 0; longest text.
MAX_NUMBER, MIN_NUMBER, MAX_TEXT = 1e12, 1e-30, 100


def _not_tiny(value: float) -> float:
    if 0.0 < abs(value) < MIN_NUMBER:
        raise problem(f"must be 0 or at least {MIN_NUMBER:g}, not {value}")
    return value


Number = Annotated[float, Ge(-MAX_NUMBER), Le(MAX_NUMBER), AfterValidator(_not_tiny)]
Numbers = Annotated[list[Number], Len(1, MAX_LIST)]


def table_of(
    options: type,
    name: str,
    *,
    replaced: Mapping[str, Any] | None = None,
    first: Mapping[str, tuple[Any, Any]] | None = None,
) -> type[Table]:
    """Build a table with the fields of an options dataclass: their types, defaults and documentation.

    In a file ``false`` stands for None. Fields of types that a file cannot express are left out.

    Args:
        options: the dataclass.
        name: name of the table's class.
        replaced: types that replace the types of fields.
        first: additional fields before the others, as (type, default).
    """
    hints = typing.get_type_hints(options)
    texts = meanings(options)
    fields: dict[str, Any] = dict(first or {})
    for item in dataclasses.fields(options):
        kind = (replaced or {}).get(item.name) or _file_type(hints[item.name], f"{name}_{item.name}")
        if kind is not None:
            fields[item.name] = (kind | None, Field(None, description=_meaning(texts[item.name], item)))
    table = create_model(name, __base__=Table, __doc__=(options.__doc__ or "").split("\n", 1)[0], **fields)
    table.removed = getattr(options, "removed", {})
    return table


def build_options(options: type, values: BaseModel, **replaced: Any) -> Any:
    """Build the options dataclass from a table of :func:`table_of`. Missing keys keep their defaults."""
    hints = typing.get_type_hints(options)
    arguments: dict[str, Any] = {}
    for item in dataclasses.fields(options):
        value = replaced.get(item.name, getattr(values, item.name, None))
        if value is None:
            continue
        nested = _nested(hints[item.name])
        if value is False and (hints[item.name] is Any or type(None) in typing.get_args(hints[item.name])):
            arguments[item.name] = None
        elif nested is not None and isinstance(value, BaseModel):
            arguments[item.name] = build_options(nested, value)
        else:
            arguments[item.name] = tuple(value) if typing.get_origin(hints[item.name]) is tuple else value
    return options(**arguments)


def _meaning(text: str, item: dataclasses.Field[Any]) -> str:
    """The meaning of an option in a file, where false stands for None, with its default."""
    text = text.replace("None", "false")
    default = item.default
    if default is None or default is dataclasses.MISSING or default == "":
        return text
    return f"{text} (default {shown_default(default)})".strip()


def shown_default(value: Any) -> str:
    """A default value in the notation of a file."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return f"{value:.4g}"
    return str(list(value)) if isinstance(value, tuple) else str(value)


def _nested(hint: Any) -> type | None:
    """The dataclass in a type hint, or None."""
    for kind in (hint, *typing.get_args(hint)):
        if isinstance(kind, type) and dataclasses.is_dataclass(kind):
            return kind
    return None


def _file_type(hint: Any, name: str) -> Any:
    """The type of a file's value for a type hint; None if a file cannot express it."""
    if hint is float:
        return Number
    if hint is str:
        return Annotated[str, Len(1, MAX_TEXT)]
    if hint in (int, bool):
        return hint
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin is Literal:
        return hint
    if origin is tuple and arguments == (float, ...):
        return Numbers
    if origin is tuple and set(arguments) == {float}:
        return Annotated[list[Number], Len(len(arguments), len(arguments))]
    if origin in (Union, types.UnionType) and type(None) in arguments:
        inner = [_file_type(kind, name) for kind in arguments if kind is not type(None)]
        return None if len(inner) != 1 or inner[0] is None else inner[0] | Literal[False]
    if isinstance(hint, type) and dataclasses.is_dataclass(hint):
        return table_of(hint, name)
    return None
