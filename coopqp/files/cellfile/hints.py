"""Questions about numbers of a cell file that look like another unit. A file is read as it says all the same."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from coopqp.errors import CoopqpError
from coopqp.files.cellfile.build import CellRun
from coopqp.files.cellfile.text import read_tables
from coopqp.forces.load_sharing import LoadShare
from coopqp.simulation.engine import box_payload

#: Parts of π that are written in radians; a number this near to one of them is taken for it [share].
_PARTS = tuple(math.pi * part for part in (0.25, 1 / 3, 0.5, 2 / 3, 0.75, 1.0, 1.5, 2.0))
_NEAR = 1e-3
#: Positions and sizes from here on may be millimetres [m]; a step from here on may be milliseconds [s].
_FAR, _LARGE, _SLOW = 50.0, 20.0, 0.1
#: An internal force that binds nothing [N].
_ANY = 1e9
#: Largest number of questions about one file.
MOST = 6
_SIZES = {"size_m", "radius_m", "length_m", "alpha_m", "beta_m"}
_PLACES = {"xyz_m", "translation_m"}


def unit_hints(file: Path) -> list[str]:
    """Questions about the units of a file, at most :data:`MOST`; none if it cannot be read."""
    try:
        data = read_tables(file)
    except CoopqpError:  # whoever reads it says so
        return []
    found = list(itertools.islice(_questions(data), MOST + 1))
    return [*found[:MOST], "and there are more"] if len(found) > MOST else found


def load_hints(run: CellRun) -> list[str]:
    """Whether the arms can hold the object's weight at the start, where the file says how heavy it is."""
    if "mass_kg" not in run.settings.object.model_fields_set:
        return []
    s = run.scenario
    try:
        shared = LoadShare(s.cell, s.grasp, box_payload(s), internal_force=_ANY).share(s.q_start)
    except CoopqpError:  # nothing is known of the arms' masses or torques
        return []
    if shared.feasible:
        return []
    return [f"object.mass_kg is {s.object_mass:g}: at the start {_small(shared.explain())} Is it in kilograms?"]


def grip_hints(run: CellRun) -> list[str]:
    """Whether an arm that stops would drag the others along unseen: they hold one object, and are measured."""
    table = run.settings.plant
    gripped = table.kind == "physics" and table.servo in (None, "position") and len(run.scenario.cell) > 1
    if run.controller_kind != "qp" or not gripped or run.stiffness is not None:
        return []
    return [
        "the arms hold one object, and the file does not tell their servos' stiffness: an arm that stops drags the "
        "others along, and is seen late. The key is stiffness_nm_per_rad, in each of [[arms]]."
    ]


def _small(text: str) -> str:
    return text[:1].lower() + text[1:]


def _questions(data: Any) -> Iterator[str]:
    for place, key, numbers in _numbers(data, ""):
        digits = ", ".join(f"{x:g}" for x in numbers[:7])
        shown = f"[{digits}]" if len(numbers) > 1 else digits
        most = max(map(abs, numbers))
        if "_deg" in key or "_deg." in place:
            part = next((x for x in numbers for p in _PARTS if abs(abs(x) - p) < _NEAR * p), None)
            turns = "positions_deg" in place and most <= 2.0 * math.pi
            if part is not None or (turns and sum(x != round(x) for x in numbers) > 2):
                yield f"{place} is {shown}: are these radians? Then the key is {place.replace('_deg', '_rad')}."
        elif _is_long(place, key, numbers):
            yield f"{place} is {shown}: are these millimetres? It is in metres."
        elif place == "dt_s" and most > _SLOW:
            yield f"dt_s is {shown}: are these milliseconds? A step is rarely longer than {_SLOW:g} s."
    steps, span = data.get("steps"), _duration(data.get("path"))
    if _is_number(steps) and steps > 0 and span / steps > _SLOW:
        yield f"steps is {steps}: a step then takes {span / steps:.3g} s. Steps are rarely longer than {_SLOW:g} s."


def _is_long(place: str, key: str, numbers: list[float]) -> bool:
    """Whether lengths may be millimetres; a floor is long and wide, but not high."""
    most, least = max(map(abs, numbers)), min(map(abs, numbers))
    if key in _PLACES:
        return most >= _FAR
    return key in _SIZES and most >= _LARGE and (least >= 5.0 or not place.startswith("collision"))


def _duration(path: Any) -> float:
    """Duration of a path [s]; 0 if the file does not say it."""
    if not isinstance(path, Mapping):
        return 0.0
    parts = path.get("durations_s", path.get("duration_s"))
    parts = parts if isinstance(parts, list) else [parts]
    return float(sum(part for part in parts if _is_number(part)))


def _numbers(value: Any, place: str) -> Iterator[tuple[str, str, list[float]]]:
    """Numbers and lists of numbers of a file: their place, their key, and themselves."""
    if isinstance(value, Mapping):
        for key, inner in value.items():
            yield from _numbers(inner, f"{place}.{key}" if place else str(key))
    elif isinstance(value, list) and not (value and all(map(_is_number, value))):
        for i, inner in enumerate(value):
            yield from _numbers(inner, f"{place}[{i}]")
    else:
        numbers = value if isinstance(value, list) else [value]
        if all(map(_is_number, numbers)):
            yield place, re.sub(r"\[\d+\]$", "", place).rpartition(".")[2], [float(x) for x in numbers]


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) < 1e300
