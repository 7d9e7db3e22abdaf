"""Units of the settings that a study varies, for its figure."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel

from coopqp.checks import meanings
from coopqp.scenarios import SCENARIOS
from coopqp.studies.study import Study

#: Ends of keys that are units: ``duration_s``, ``velocity_deg_per_s``.
_UNITS, _PER = ("s", "m", "mm", "rad", "deg", "kg"), {"s": "s", "s2": "s²"}


def name_and_unit(study: Study, key: str) -> tuple[str, str]:
    """A dotted key without its unit, and the unit; empty if it has none.

    The unit is the end of the key (``duration_s``), or stands in square brackets where the schema of the file, the
    options or the scenario defines the number.
    """
    number = key.rpartition(".")[2]
    entry = f".{number}" if number.isdigit() else ""  # of a list
    *name, last = key.removesuffix(entry).split("_")
    per = ""
    if len(name) > 2 and name[-1] == "per" and last in _PER:
        per = f"/{_PER[last]}"
        *name, last, _ = name
    if name and last in _UNITS:
        return "_".join(name) + entry, last + per
    return key, _unit_in_words(study, key)


def _unit_in_words(study: Study, key: str) -> str:
    """The unit that the meaning of a key tells; empty if it tells none."""
    table, _, rest = key.partition(".")
    if study.scenario and table == "scenario":
        return _bracketed(meanings(SCENARIOS[study.scenario]).get(rest, ""))
    settings, disturbances = study.settings(study.row(0).values)
    place: Any = disturbances if table == "disturbances" else settings
    *parts, last = (rest if table == "disturbances" else key).split(".")
    for part in parts:
        if isinstance(place, list):
            place = place[int(part)] if part.isdigit() else next(p for p in place if p.name == part)
        else:
            place = place.get(part) if isinstance(place, Mapping) else getattr(place, part, None)
    field = type(place).model_fields.get(last) if isinstance(place, BaseModel) else None
    return _bracketed((field and field.description) or "")


def _bracketed(text: str) -> str:
    """The text between the first square brackets; empty without brackets."""
    return text.partition("[")[2].partition("]")[0]
