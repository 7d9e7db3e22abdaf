"""Error messages of a cell file: each names a problem and its place."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from typing import Any

from pydantic import ValidationError

from coopqp.errors import listed, nearest, printable, shortened, shown

#: Largest number of problems in one message.
MAX_PROBLEMS = 5
#: Where unions of the schema stand, the outer ones first; ``*`` is any key. Pydantic adds their tag to a place; the tag
#: is not a key of the file.
_UNIONS = tuple(
    tuple(place.split("."))
    for place in (
        "grasp", "path", "controller", "plant", "drivers.*", "phases.*.path", "phases.*.arms.*", "phases.*.arms.*.path",
    )
)  # fmt: skip
_KINDS = {
    "float_type": "a number",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "bool_type": "true or false",
    "string_type": "text",
    "list_type": "a list",
    "dict_type": "a table",
    "model_type": "a table",
    "model_attributes_type": "a table",
}
_TYPES = tuple(f"{form}{kind}" for form in ("", "constrained-") for kind in ("float", "int", "bool", "str"))
_OWN = ("unknown_key", "cell_file")


def explain(error: ValidationError) -> str:
    """The problems with their places, at most :data:`MAX_PROBLEMS`."""
    by_place: dict[str, list[Any]] = {}
    for problem in error.errors(include_url=False):
        by_place.setdefault(_place(problem["loc"]), []).append(problem)
    # For a union, pydantic reports one problem per member: also that a table with a mistake is not "false".
    for place in [place for place, problems in by_place.items() if all(map(_expects_false, problems))]:
        if any(other.startswith((f"{place}.", f"{place}[")) for other in by_place):
            del by_place[place]
    texts = [f"{place}: {_words(problems)}" for place, problems in by_place.items()]
    more = len(texts) - MAX_PROBLEMS
    return "; ".join(texts[:MAX_PROBLEMS]) + (f"; and {more} more" if more > 0 else "") + "."


def _words(problems: Sequence[Any]) -> str:
    own = next((p for p in problems if p["type"] in _OWN), None)
    if own is not None:
        return str(own["msg"])
    others = [p for p in problems if not _expects_false(p)]
    wanted = [_KINDS[p["type"]] for p in others if p["type"] in _KINDS]
    if others and not wanted:
        return _single(others[0])
    wanted += ["false"] * (len(others) < len(problems))
    return f"give {' or '.join(dict.fromkeys(wanted))}, not {_shown(problems[0]['input'])}"


def _single(problem: Any) -> str:
    kind, context, said = problem["type"], problem.get("ctx", {}), str(problem["msg"])
    if kind in ("missing", "union_tag_not_found"):
        return "is missing" if kind == "missing" else "kind is missing"
    if kind in ("union_tag_invalid", "literal_error"):
        given, known = context.get("tag", problem["input"]), context.get("expected_tags") or context["expected"]
        known = re.findall(r"'([^']*)'", known)
        near = nearest(str(given), known)
        hint = f"did you mean '{near[0]}'? " if near else ""
        return f"there is no {_shown(given)}; {hint}known: {listed(known)}"
    _, should, wanted = said.partition("should have ")
    if should:
        wanted = f"give {wanted.replace('items after validation', 'entries')}"
    else:
        text = said.removeprefix("Input should be ").removeprefix("a valid ")
        wanted = f"must be {text[:1].lower()}{text[1:]}"
    return wanted if ", not " in wanted else f"{wanted}, not {_shown(problem['input'])}"


def _expects_false(problem: Any) -> bool:
    return bool(problem["type"] == "literal_error" and problem["ctx"]["expected"] == "False")


def _place(location: Sequence[int | str]) -> str:
    """Convert pydantic's location to ``arms[0].base.xyz_m``, without the names of types."""
    parts = list(location)
    for union in _UNIONS:
        if len(parts) > len(union) and all(key in ("*", part) for key, part in zip(union, parts, strict=False)):
            del parts[len(union)]
    place = ""
    for part in parts:
        if isinstance(part, int):
            place += f"[{part}]"
        elif re.fullmatch(r"[A-Za-z0-9_ -]+", part) and part not in _TYPES and "Table" not in part:
            place += f".{part}" if place else part
    return place or "the file"


def _shown(value: Any) -> str:
    """A value in the notation of a file, at most 60 characters; of what holds text only what it is."""
    if isinstance(value, (str, int, float)) and not isinstance(value, bool):
        return shown(value)
    text = json.dumps(value, default=str)
    if isinstance(value, (dict, list)) and '"' in text:
        return "a table" if isinstance(value, dict) else "a list with text"
    return shortened(text.strip('"'))


#: Names of programs, and their keys in a file.
_KEYS = {
    **dict.fromkeys(("QPOptions", "PseudoInverseOptions", "IndependentQPOptions"), "controller"),
    **dict.fromkeys((f"{kind}Controller: dt" for kind in ("QP", "PseudoInverse", "IndependentQP")), "dt_s"),
    **{f"{kind}Options": f"controller.{kind.lower()}" for kind in ("Supervision", "Preview", "Posture")},
    **{f"{kind}Settings": "controller.solver_settings" for kind in ("Ldp", "Daqp", "Osqp", "Proxqp", "Generic")},
    **{f"{kind}_limits": f"limits.{kind}" for kind in ("velocity", "acceleration", "lower", "upper")},
    **dict.fromkeys(("LinePath", "LinePath.displaced", "WaypointPath", "HoldPath"), "path"),
    "RankWeights": "controller.weights", "CommonError": "controller.common_error", "PhysicsOptions": "plant",
    "Tolerances": "verdict", "Grasp.triangle": "grasp", "reset: q": "start", "RobotCell": "arms",
    "Arm.name": "arms: name", "JointLimits": "limits", "T_world_base": "base",
    "of one robot: coopqp.Robot": "of one robot: [[robots]]",
    "read its URDF with Arm.from_urdf, which can lock it": "give its urdf, whose joint can be locked",
    "locked_joints=": "locked_joints_rad = ", "geometry=False": "geometry = false", "ignored=": "collision.ignored = ",
    "inside=[…]": "collision.inside", "lower the margin (margins)": "lower the margin (collision.margins)",
}  # fmt: skip
_NAMES = re.compile("|".join(rf"\b{re.escape(name)}(?!\w)" for name in sorted(_KEYS, key=len, reverse=True)))


def in_words_of_the_file(text: str) -> str:
    """A message of the library with the keys of a file in place of arguments and classes."""
    text = re.sub(r"'([^']*)': (-?[\d.]+)(?=[,}])", r'"\1" = \2', text)  # to be copied into the file
    return printable(_NAMES.sub(lambda found: _KEYS[found[0]], text))
