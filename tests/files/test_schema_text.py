"""The schema as text: every key once with its type, its default and its meaning, in lines of a page's width."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import pytest
from pydantic import ValidationError

from coopqp.checks import Doc
from coopqp.files.cellfile import json_schema, schema_text
from coopqp.files.cellfile.describe import MAX_MEMBERS
from coopqp.files.cellfile.strict import build_options, shown_default, table_of
from coopqp.scenarios import ROBOTS

TEXT = schema_text()
LINES = TEXT.splitlines()
#: The titles of tables, with the lines below each.
TABLES = {block.splitlines()[0]: block for block in TEXT.split("\n\n")}


@pytest.mark.parametrize(
    ("key", "kind", "words"),
    [
        ("name*", "text", "name of the run"),
        ("arms*", "list of tables", "one table per arm; the first is the leader"),
        ("signals_s", "table of numbers", "when signals of phases come by themselves, after the start of"),
        ("steps", "whole number", "number of steps of an unslowed run"),
        ("settle_s", "number", "time that the run continues after the end (default 0)"),
        ("geometry", "true or false", "read the shapes, for pictures (default true)"),
        ("package_dirs", "list of texts", "folders that resolve package://, besides those above the URDF"),
        ("velocity_deg_per_s", "number or list of numbers", "largest speed"),
        ("matrix", "rows of numbers", "rows of the homogeneous matrix [m], in place of the other keys"),
        ("ignored", "list of pairs", "pairs that may touch"),
        ("solver_settings", "table of values", "settings of the solver of that name"),
        ("positions_deg", "table of lists", "position of every joint, by arm; of joints that arms share by"),
        ("robot", "name", "name of a robot: `coopqp schema --robots`"),
        ("robot", '"lift2" | "rail2"', "name of a robot that comes along"),
        ("preview", "table or false", "settings of the path preview; false for no preview"),
        ("stall_samples", "whole number or false", "number of samples in which an arm moves less than stall_share"),
        ("time_law", '"quintic" | "linear"', "time law of every segment (default quintic)"),
        ("angle_deg", "number", "largest angle (default 1.146)"),
    ],
)
def test_a_key_has_its_type_and_meaning(key: str, kind: str, words: str) -> None:
    assert f"  {key:<26}{kind:<28}{words}".rstrip() in [line.rstrip() for line in LINES]


def test_tables_follow_their_keys_with_their_kinds_and_their_first_words() -> None:
    for title in (
        "A coopqp cell file: TOML, or YAML with the same keys. Keys with * are required. Units are in the names:",
        "A cell, its grasp, its path, and the controller, plant and output of a run.",
        "[[arms]]  One arm: its model, its tool frame, the placement of its base, its limits.",
        "[arms.base]  A placement: a position with an orientation, or a 4x4 matrix.",
        '[grasp]  kind = "latched"  The grasp follows from the tools at the start and the first pose of the path.',
        '[path]  kind = "hold"  The object rests at one pose.',
        '[plant]  kind = "kinematic"  Joints that follow their commands exactly.',
        '[phases.arms.path]  kind = "timed"  A path with its speed profile, as `coopqp plan` writes it.',
        '[drivers]  kind = "sim"  Settings of a simulated robot and of its link.',
        "[collision.margins]  Another margin for a pair.",
    ):
        assert title in TABLES, title
    assert sum("A placement: a position" in title for title in TABLES) == 1
    assert "\n  kind " not in TABLES['[path]  kind = "hold"  The object rests at one pose.']
    tagged = [title for title in TABLES if " kind = " in title]
    assert all(title.startswith("[") for title in TABLES if title not in list(TABLES)[:2])
    assert len(tagged) > 20


def test_required_keys_are_marked_and_no_others() -> None:
    schema = json_schema()
    top = TABLES["A cell, its grasp, its path, and the controller, plant and output of a run."]
    marked = set(re.findall(r"^  (\w+)\*", top, re.M))
    assert marked == set(schema["required"]) == {"name", "arms", "grasp"}
    assert set(re.findall(r"^  (\w+)", top, re.M)) == set(schema["properties"])


def test_long_meanings_go_on_below_themselves() -> None:
    begun = LINES.index(next(line for line in LINES if line.startswith("  phases ")))
    assert LINES[begun].endswith("a program, in place of a path: in its phases arms let go,")
    assert LINES[begun + 1] == " " * 56 + "travel, work or open the part"
    assert max(len(line) for line in LINES if line.startswith(" " * 56)) <= 118


def test_few_names_are_listed_and_many_are_not() -> None:
    listed = max(line.count('" | "') + 1 for line in LINES)
    assert 6 <= listed <= MAX_MEMBERS < len(ROBOTS)


# -- tables of options -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Inner:
    """Inner settings."""

    gain: Annotated[float, Doc("a gain")] = 1.5


@dataclass(frozen=True)
class Options:
    """Settings of a test.

    No file says this.
    """

    size: Annotated[float, Doc("a size, None for the default")] = 0.1234567
    number: Annotated[int, Doc("a number")] = 3
    on: Annotated[bool, Doc("a switch")] = False
    word: Annotated[str, Doc("a word")] = "plain"
    place: Annotated[str, Doc("a place; has to be given")] = ""
    law: Annotated[Literal["a", "b"], Doc("a law")] = "a"
    row: Annotated[tuple[float, ...], Doc("a row")] = (1.0, 2.5)
    three: Annotated[tuple[float, float, float], Doc("three")] = (1.0, 2.0, 3.0)
    most: Annotated[float | None, Doc("the most, or None")] = 2.0
    inner: Annotated[Inner | None, Doc("inner settings, or None")] = Inner()
    either: Annotated[float | str | None, Doc("no file has two types")] = None
    call: Annotated[Callable[[], None] | None, Doc("no file has a function")] = None


TABLE: Any = table_of(Options, "OptionsTable", first={"kind": (Literal["test"], ...)})


def made(**given: Any) -> Options:
    options = build_options(Options, TABLE.model_validate({"kind": "test", **given}))
    assert isinstance(options, Options)
    return options


def test_a_table_of_options_has_the_fields_that_a_file_can_express() -> None:
    assert list(TABLE.model_fields) == [
        "kind", "size", "number", "on", "word", "place", "law", "row", "three", "most", "inner",
    ]  # fmt: skip
    said = {name: field.description for name, field in TABLE.model_fields.items()}
    assert said["size"] == "a size, false for the default (default 0.1235)"
    assert said["place"] == "a place; has to be given"
    assert "(default )" not in TEXT
    assert said["on"] == "a switch (default false)"
    assert said["row"] == "a row (default [1.0, 2.5])"
    assert said["most"] == "the most, or false (default 2)"
    assert TABLE.__doc__ == "Settings of a test."


def test_options_of_a_file_are_those_it_gives_and_the_defaults() -> None:
    assert made() == Options()
    given = {"size": 2.0, "number": 4, "on": True, "word": "w", "law": "b", "row": [1.0], "three": [0.0, 0.0, 1.0]}
    options = made(**given, most=5.0, inner={"gain": 3.0})
    assert options == Options(2.0, 4, True, "w", "", "b", (1.0,), (0.0, 0.0, 1.0), 5.0, Inner(3.0))
    assert made(inner={}).inner == Inner()
    assert (made(most=False).most, made(inner=False).inner) == (None, None)
    assert made(on=False).on is False


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("size", "1"), ("size", True), ("size", 2e12), ("size", -2e12), ("size", 1e-31), ("size", False),
        ("number", 1.5), ("number", True), ("on", 1), ("word", ""), ("word", "w" * 101), ("word", 3), ("law", "c"),
        ("row", []), ("row", ["a"]), ("three", [1.0, 2.0]), ("three", [1.0] * 4), ("most", True), ("most", "x"),
        ("inner", True), ("inner", {"gian": 1.0}), ("either", 1.0), ("call", "f"), ("kind", "other"),
    ],
)  # fmt: skip
def test_a_wrong_option_is_refused_by_its_name(key: str, value: Any) -> None:
    with pytest.raises(ValidationError, match=key):
        made(**{key: value})


def test_defaults_are_shown_as_a_file_writes_them() -> None:
    shown = [shown_default(value) for value in (True, 0.1234567, 20.0, (1.0, 2.0), "auto", 3)]
    assert shown == ["true", "0.1235", "20", "[1.0, 2.0]", "auto", "3"]
