"""Questions about units: asked from where a number looks like another unit, and not before."""

from __future__ import annotations

from pathlib import Path

import pytest
from places import CELL_FILES

from coopqp import load_cell_file
from coopqp.files.cellfile.hints import load_hints, unit_hints

RADIANS, MILLIMETRES = "are these radians? Then the key is {}.", "are these millimetres? It is in metres."


@pytest.fixture
def asked(tmp_path: Path) -> Path:
    return tmp_path / "asked.toml"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("base.xyz_m = [0, 50.0, 0]", f"base.xyz_m is [0, 50, 0]: {MILLIMETRES}"),
        ("base.xyz_m = [-49.9, 0, 0]", None),
        ("path.displacement.translation_m = [0, 0, -150]", MILLIMETRES),
        ("grasp.alpha_m = 20", f"grasp.alpha_m is 20: {MILLIMETRES}"),
        ("grasp.beta_m = 19.9", None),
        ("object.size_m = [30, 0.01, 1]", MILLIMETRES),
        ("collision.obstacles = [{ size_m = [100, 100, 4.9] }]", None),
        ("collision.obstacles = [{ size_m = [100, 100, 5] }]", "collision.obstacles[0].size_m is [100, 100, 5]"),
        ("collision.obstacles = [{ radius_m = 30 }]", MILLIMETRES),
        ("other_m = 1000", None),
        ("arms = [{}, { base = { xyz_m = [1, 60, 2] } }]", "arms[1].base.xyz_m is [1, 60, 2]"),
        ("dt_s = 0.1", None),
        ("dt_s = 0.11", "dt_s is 0.11: are these milliseconds? A step is rarely longer than 0.1 s."),
        ("steps = 30\npath.duration_s = 3.0", None),
        (
            "steps = 29\npath.durations_s = [1.0, 2.0]",
            "steps is 29: a step then takes 0.103 s. Steps are rarely longer",
        ),
        ("steps = 0\npath.duration_s = 3.0", None),
        ("steps = true\npath.duration_s = 3.0", None),
        ("steps = 1\npath.duration_s = true", None),
        ("base.rpy_deg = [0, 0, 3.1416]", RADIANS.format("base.rpy_rad")),
        ("base.rpy_deg = [0, 0, -1.0472]", RADIANS.format("base.rpy_rad")),
        ("base.rpy_deg = [0, 0, 6.283]", RADIANS.format("base.rpy_rad")),
        ("base.rpy_deg = [0, 0, 3.1]", None),
        ("base.rpy_rad = [0, 0, 3.1416]", None),
        ("start.positions_deg.a = [0.5, -0.25, 6.2]", RADIANS.format("start.positions_rad.a")),
        ("start.positions_deg.a = [0.5, -0.25, 6.3]", None),
        ("start.positions_deg.a = [0.5, -0.25, 1]", None),
        ("start.positions_deg.a = [0, 0, 0]", None),
        ("base.rpy_deg = [0.5, -0.25, 1.1]", None),
        ("phases = [{ arms.a.positions_deg = [[0.1, 0.2, 0.3]] }]", "phases[0].arms.a.positions_deg[0] is [0.1, 0.2"),
        ("start.positions_deg.a = [0.5, 1.5, 2.5, 0.5, 1.5, 2.5, 0.1, 0.2]", "[0.5, 1.5, 2.5, 0.5, 1.5, 2.5, 0.1]:"),
        ("dt_s = 1e301", None),
    ],
)
def test_a_unit_is_asked_about_from_its_bound_on(text: str, said: str | None, asked: Path) -> None:
    asked.write_text(text, encoding="utf-8")
    found = unit_hints(asked)
    assert len(found) == (said is not None)
    assert said is None or said in found[0]


def test_a_few_questions_are_asked_and_it_is_said_that_there_are_more(asked: Path) -> None:
    for count in (5, 6, 7, 20):
        asked.write_text("".join(f"[[arms]]\nbase.xyz_m = [{500 + i}, 0, 0]\n" for i in range(count)), encoding="utf-8")
        found = unit_hints(asked)
        assert [hint.partition(".")[0] for hint in found[:6]] == [f"arms[{i}]" for i in range(min(count, 6))]
        assert found[6:] == (["and there are more"] if count > 6 else [])
    asked.write_text("[", encoding="utf-8")
    assert unit_hints(asked) == []


def test_a_mass_that_the_arms_cannot_hold_is_asked_about(asked: Path) -> None:
    """Only where the file says it."""
    text = (CELL_FILES / "bar.toml").read_text(encoding="utf-8")
    head = text[: text.index("[object]")]
    for mass, asks in ((None, False), (1.0, False), (2e5, True)):
        size = "" if mass is None else f"mass_kg = {mass}\n"
        asked.write_text(f"{head}[object]\nsize_m = [0.6, 0.1, 0.1]\n{size}", encoding="utf-8")
        found = load_hints(load_cell_file(asked))
        assert bool(found) == asks
    (said,) = found
    assert said.startswith("object.mass_kg is 200000: at the start ")
    assert said.removeprefix("object.mass_kg is 200000: at the start ").partition(" ")[0] == "the"
    assert said.endswith(" Is it in kilograms?")
