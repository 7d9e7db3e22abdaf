"""Error messages of a cell file: each names a problem and its place."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from datetime import date, time
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
    own = [p for p in problems if p["type"] in _OWN]
    if own:
        return str(own[0]["msg"])
    wanted = [_KINDS[p["type"]] for p in problems if p["type"] in _KINDS]
    first = problems[0]
    if wanted:
        off = ["false"] if any(_expects_false(p) for p in problems) else []
        return f"give {' or '.join(dict.fromkeys([*wanted, *off]))}, not {_shown(first['input'])}"
    if all(map(_expects_false, problems)):
        return f"give false, not {_shown(first['input'])}"
    return _single(next(p for p in problems if not _expects_false(p)))


def _single(problem: Any) -> str:
    kind, context = problem["type"], problem.get("ctx", {})
    if kind == "missing":
        return "is missing"
    if kind == "union_tag_not_found":
        return "kind is missing"
    if kind == "union_tag_invalid":
        return _unknown(context["tag"], re.findall(r"'([^']*)'", context["expected_tags"]))
    if kind == "literal_error":
        return _unknown(problem["input"], re.findall(r"'([^']*)'", context["expected"]))
    if kind in ("too_short", "too_long"):
        bound = context.get("min_length", context.get("max_length"))
        return (
            f"give {'at least' if kind == 'too_short' else 'at most'} {bound} entries, not {context['actual_length']}"
        )
    if kind in ("string_too_short", "string_too_long"):
        wanted = str(problem["msg"]).removeprefix("String should have ")
        return f"give text of {wanted}, not {_shown(problem['input'])}"
    text = str(problem["msg"]).removeprefix("Input should be ").removeprefix("a valid ")
    return f"must be {text[:1].lower()}{text[1:]}, not {_shown(problem['input'])}"


def _unknown(given: Any, known: Sequence[str]) -> str:
    near = nearest(str(given), known)
    hint = f"did you mean '{near[0]}'? " if near else ""
    return f"there is no {_shown(given)}; {hint}known: {listed(known)}"


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
    """A value in the notation of a file, at most 60 characters."""
    return shortened(_notation(value))


def _notation(value: Any, depth: int = 0) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if value is None:
        return "null"
    if isinstance(value, (date, time)):  # a datetime is a date, too
        return value.isoformat()
    if isinstance(value, (list, dict)) and depth > 3:
        return "…"
    if isinstance(value, list):
        return f"[{', '.join(_notation(entry, depth + 1) for entry in value[:60])}]"
    if isinstance(value, dict):
        entries = list(value.items())[:60]
        return "{" + ", ".join(f"{key} = {_notation(entry, depth + 1)}" for key, entry in entries) + "}"
    return shown(value)


#: Words of programs, and their words in a file.
_WORDS: tuple[tuple[str, str | Callable[[re.Match[str]], str]], ...] = (
    (r"'([^']*)': (-?[\d.]+)(?=[,}])", r'"\1" = \2'),
    (r"locked_joints=\{(.*?)\}", r"locked_joints_rad = { \1 }"),
    (r"locked_joints\['([^']*)'\]", r"locked_joints '\1'"),
    (r"geometry=False", "geometry = false"),
    (r"Give velocity_limits \[[^]]*\] and acceleration_limits", "Give them in limits"),
    (r"lower_limits and upper_limits", "lower_deg and upper_deg in limits"),
    (r"\b(velocity|acceleration|lower|upper)_limits\b", r"limits.\1"),
    (r"Remove the floating base, set T_world_base", "Remove the floating base, set base"),
    (r"or read its URDF with Arm\.from_urdf, which can lock it", "or give its urdf, whose joint can be locked"),
    (r"T_world_base", "base"),
    (r"\bArm\.name\b", "arms: name"),
    (r"\bJointLimits\b", "limits"),
    (r"Or give both as arms of one robot: coopqp\.Robot", "Or give both as arms of one robot: [[robots]]"),
    (r"\bRobotCell\b", "arms"),
    (r"\b(QP|PseudoInverse|IndependentQP)Options\b", "controller"),
    (r"\b(QP|PseudoInverse|IndependentQP)Controller: dt\b", "dt_s"),
    (r"\b(Supervision|Preview|Posture)Options\b", lambda found: f"controller.{found[1].lower()}"),
    (r"\bTolerances\b", "verdict"),
    (r"\bRankWeights\b", "controller.weights"),
    (r"\bPhysicsOptions\b", "plant"),
    (r"\b(Ldp|Daqp|Osqp|Proxqp|Generic|Solver)Settings\b", "controller.solver_settings"),
    (r"\bCommonError(\.\w+)?\b", "controller.common_error"),
    (r"\b(Line|Waypoint|Hold)Path(\.\w+)?\b", "path"),
    (r"\bGrasp\.triangle\b", "grasp"),
    (r"\breset: q\b", "start"),
    (r"lower the margin \(margins\)", "lower the margin (collision.margins)"),
    (r"\binside=\[…\]", "collision.inside"),
    (r"\bignored=(?=\[\[)", "collision.ignored = "),
)


def in_words_of_the_file(text: str) -> str:
    """A message of the library with the keys of a file in place of arguments and classes."""
    for pattern, words in _WORDS:
        text = re.sub(pattern, words, text)
    return printable(text)
