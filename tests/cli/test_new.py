"""`coopqp new`: from robots that nobody has placed to a cell file that `coopqp check` certifies, with its picture."""

from __future__ import annotations

import math
import re
import shutil
from pathlib import Path

import pytest
from written_urdfs import urdf

from coopqp import load_cell_file
from coopqp.cli import main as cli
from coopqp.files.cellfile.text import read_tables
from coopqp.scenarios import robot_arm, robot_path


@pytest.fixture(autouse=True)
def _in_an_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.mark.slow
def test_two_arms_by_name_give_a_certified_file_with_a_start_and_a_picture(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["new", "pair", "--arm", "rx90l", "--arm", "arm7", "--out", "made"]) == 0
    out = capsys.readouterr().out
    assert "CERTIFIED" in out
    assert "arm arm7: arm7, tool frame tool (also there: link_7)" in out
    assert {file.name for file in Path("made").iterdir()} == {"pair.toml", "pair.png"}
    assert cli.main(["check", "made/pair.toml", "--quiet"]) == 0
    tables = read_tables(Path("made/pair.toml"))
    assert [arm["robot"] for arm in tables["arms"]] == ["rx90l", "arm7"]
    assert set(tables["start"]["positions_deg"]) == {"rx90l", "arm7"}
    scenario = load_cell_file("made/pair.toml").scenario
    assert scenario.object_size == tuple(tables["object"]["size_m"])


@pytest.mark.slow
def test_the_same_question_has_the_same_answer() -> None:
    texts = []
    for folder in ("a", "b"):
        assert cli.main(["new", "pair", "--arm", "arm6c", "--arm", "arm6c", "--out", folder, "--quiet"]) == 0
        texts.append(Path(folder, "pair.toml").read_bytes())
    assert texts[0] == texts[1]


@pytest.mark.slow
def test_what_is_given_stands_in_the_file() -> None:
    given = ["--object", "0.5", "0.2", "0.04", "--mass", "3", "--move", "0.02", "0", "0.1", "--turn", "5"]
    assert cli.main(["new", "given", "--arm", "arm6c", "--arm", "arm7", *given, "--duration", "4", "--quiet"]) == 0
    tables = read_tables(Path("given.toml"))
    assert tables["object"] == {"size_m": [0.5, 0.2, 0.04], "mass_kg": 3}
    assert tables["path"]["displacement"] == {"translation_m": [0.02, 0, 0.1], "rotation_vector_deg": [0, 0, 5]}
    assert tables["path"]["duration_s"] == 4


@pytest.mark.slow
def test_files_of_ones_own_are_named_relative_to_the_cell(capsys: pytest.CaptureFixture[str]) -> None:
    """A gantry whose three sliders hang from above, beside an arm of which only the file is known."""
    Path("robots").mkdir()
    Path("robots/gantry.urdf").write_text(urdf("gantry"), encoding="utf-8")
    shutil.copyfile(robot_path("irb1600"), "robots/mine.urdf")
    arms = ["--arm", "robots/gantry.urdf", "--arm", "robots/mine.urdf:link_6"]
    assert cli.main(["new", "own", *arms, "--out", "cells"]) == 0
    tables = read_tables(Path("cells/own.toml"))
    assert [arm["urdf"] for arm in tables["arms"]] == ["../robots/gantry.urdf", "../robots/mine.urdf"]
    assert [arm["tool_frame"] for arm in tables["arms"]] == ["tool", "link_6"]
    assert "[2, 2, 2, 300, 300, 300]" in Path("cells/own.toml").read_text(encoding="utf-8"), "sliders have other limits"
    assert cli.main(["run", "cells/own.toml", "--quiet"]) == 0


@pytest.mark.slow
def test_an_arm_whose_meshes_cannot_be_read_is_drafted_without_shapes(capsys: pytest.CaptureFixture[str]) -> None:
    """Nothing keeps a distance from it, which the check says."""
    mesh = '<collision><geometry><mesh filename="package://nowhere/link.stl"/></geometry></collision></link>'
    text = urdf("gantry").replace("</link>", mesh)
    assert text.count(mesh) > 3
    Path("gantry.urdf").write_text(text, encoding="utf-8")
    assert cli.main(["new", "own", "--arm", "gantry.urdf", "--arm", "gantry.urdf"]) == 0
    assert [arm["geometry"] for arm in read_tables(Path("own.toml"))["arms"]] == [False, False]
    assert "read without its shapes" in capsys.readouterr().err
    assert cli.main(["check", "own.toml"]) == 0
    assert "arm gantry_1 has no shapes: nothing keeps a distance from it" in capsys.readouterr().out


@pytest.mark.slow
def test_names_of_a_strangers_file_stay_names() -> None:
    """A name with a line break is no line of the cell file, nor one with letters that TOML's plain keys lack a key."""
    evil = "x&#10;[output]&#10;folder = &quot;/tmp&quot;"
    text = robot_path("arm6c").read_text(encoding="utf-8").replace("link_6", evil)
    Path("ärm.urdf").write_text(text, encoding="utf-8")
    assert cli.main(["new", "own", "--arm", "ärm.urdf", "--arm", "ärm.urdf", "--quiet"]) == 0
    tables = read_tables(Path("own.toml"))
    assert set(tables) == {"name", "arms", "grasp", "path", "object", "start", "collision"}
    assert set(tables["grasp"]["tools"]) == {"ärm_1", "ärm_2"} == set(tables["start"]["positions_deg"])


@pytest.mark.slow
def test_three_arms_stand_around_a_plate() -> None:
    assert cli.main(["new", "three", *["--arm", "rx90l"] * 3, "--quiet"]) == 0
    assert cli.main(["run", "three.toml", "--quiet"]) == 0


@pytest.mark.slow
def test_without_arms_the_command_asks(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    answers = iter(["arm6c arm7", "asked", "0.5 0.1", "0.5 0.1 0.05", "", "0 0 0.1", "", "much", "2"])
    questions: list[str] = []
    monkeypatch.setattr("sys.stdin.isatty", lambda: True)
    monkeypatch.setattr("builtins.input", lambda question: questions.append(question) or next(answers))
    assert cli.main(["new"]) == 0
    assert questions[1] == "name of the cell [my_cell]: "
    assert questions[4] == "mass of the object in kg [2]: "
    assert capsys.readouterr().err.count("not understood") == 2
    tables = read_tables(Path("asked.toml"))
    assert tables["object"] == {"size_m": [0.5, 0.1, 0.05], "mass_kg": 2}
    assert tables["path"]["duration_s"] == 2


@pytest.mark.parametrize(
    ("arguments", "status", "says"),
    [
        ([], 2, "which arms? Give --arm twice or more"),
        (["--arm", "arm7"], 2, "two or more arms"),
        (["--arm", "arm7", "--arm", "amr7"], 2, "Did you mean 'arm7'?"),
        (["--arm", "arm7", "--arm", "none.urdf"], 2, "no file or robot named 'none.urdf'"),
        (["--arm", "arm7", "--arm", "arm7:hand"], 2, "has no frame 'hand'"),
        (["--arm", "arm7", "--arm", "arm7", "--object", "0.5", "-1", "0.1"], 2, "--object"),
        (["--arm", "arm7", "--arm", "arm7", "--move", "0", "0", "3"], 3, "a shorter path"),
    ],
)
def test_what_cannot_be_made_is_said_and_nothing_is_written(
    arguments: list[str], status: int, says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["new", *arguments]) == status
    assert says in capsys.readouterr().err
    assert list(Path().iterdir()) == []


def two_armed(velocity: str = "1") -> str:
    """A URDF of a body with two arms of six joints."""
    joints = "".join(
        f'<link name="{s}{i + 1}"/><joint name="{s}_{i}" type="revolute"><parent link="{f"{s}{i}" if i else "body"}"/>'
        f'<child link="{s}{i + 1}"/><origin xyz="0.1 {0.3 * (s == "l")} 0.2"/><axis xyz="{i % 2} {1 - i % 2} 0"/>'
        f'<limit lower="-2" upper="2" velocity="{velocity}" effort="1"/></joint>'
        for s in "lr"
        for i in range(6)
    )
    return f'<robot name="two"><link name="body"/>{joints}</robot>'


def test_two_arms_of_one_robot_are_not_two_robots(capsys: pytest.CaptureFixture[str]) -> None:
    Path("two.urdf").write_text(two_armed(), encoding="utf-8")
    assert cli.main(["new", "--arm", "two.urdf:l6", "--arm", "two.urdf:r6"]) == 2
    said = capsys.readouterr().err
    assert "l6 and r6 are tools of two arms of one robot, two.urdf" in said
    assert "[[robots]]" in said
    assert [path.name for path in Path().iterdir()] == ["two.urdf"]


@pytest.mark.slow
def test_speeds_that_a_file_does_not_tell_are_given(capsys: pytest.CaptureFixture[str]) -> None:
    text = robot_path("rx90l").read_text(encoding="utf-8")
    Path("mine.urdf").write_text(re.sub('velocity="[^"]*"', 'velocity="0"', text, count=1), encoding="utf-8")
    arms = ["--arm", "mine.urdf:flange", "--arm", "arm7"]
    assert cli.main(["new", *arms]) == 2
    assert "its file tells no speed of joint 'joint_1' (velocity=\"0\"). Give" in capsys.readouterr().err
    assert cli.main(["new", *arms, "--speed", "90", "--quiet"]) == 0
    limits = read_tables(Path("my_cell.toml"))["arms"][0]["limits"]
    assert limits["velocity_deg_per_s"][0] == 90
    speeds = load_cell_file("my_cell.toml").scenario.cell.arms[0].limits.velocity
    known = robot_arm("rx90l").limits.velocity
    assert speeds.tolist() == pytest.approx([math.pi / 2, *known[1:]], abs=1e-5)


@pytest.mark.slow
def test_an_earlier_file_stays_unless_it_is_forced(capsys: pytest.CaptureFixture[str]) -> None:
    Path("my_cell.toml").write_text("mine", encoding="utf-8")
    assert cli.main(["new", "--arm", "arm6c", "--arm", "arm6c"]) == 2
    assert Path("my_cell.toml").read_text(encoding="utf-8") == "mine"
    assert "my_cell.toml" in capsys.readouterr().err
    assert cli.main(["new", "--arm", "arm6c", "--arm", "arm6c", "--force", "--quiet"]) == 0
