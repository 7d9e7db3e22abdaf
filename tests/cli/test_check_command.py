"""``coopqp check``: its words, exit codes and files."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from cells import one_arm_file
from matplotlib.image import imread

from coopqp import check_path
from coopqp.cli import main as cli
from coopqp.scenarios import at_limit, dual_arm7, mixed_cell, paper_lift
from coopqp.visualization.check_plots import check_figure

LINE = """kind = "line"
start = {{ xyz_m = [{x}, 0.1, 0.6], rpy_deg = [0, 120, 0] }}
displacement = {{ translation_m = [0, {y}, 0.1] }}"""


def cell_file(folder: Path, *, x: float = 0.7, y: float = 0.2, **others: str) -> str:
    return one_arm_file(folder, LINE.format(x=x, y=y), **others)


@pytest.mark.slow
def test_certified_writes_json_and_picture(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    record, folder = tmp_path / "a" / "check.json", tmp_path / "b"
    arguments = ["check", cell_file(tmp_path), "--branches", "--json", str(record), "--out", str(folder)]
    assert cli.main(arguments) == 0
    said = capsys.readouterr().out
    assert said.startswith("CERTIFIED\nThe arms can follow the whole path: this is proved at every point of it.\n")
    assert "branch  verdict" in said
    assert said.splitlines()[-2:] == [f"  {record}", f"  {folder / 'check.png'}"]
    answer = json.loads(record.read_text(encoding="utf-8"))
    assert list(answer) == ["verdict", "intervals", "arms", "clearance", "remedies", "no_remedy", "q_start"]
    assert (answer["verdict"], answer["intervals"], answer["remedies"]) == ("CERTIFIED", [], [])
    assert answer["arms"][0]["chosen"] == 0
    assert len(answer["arms"][0]["branches"]) == 8
    assert len(answer["q_start"]) == 6
    assert imread(folder / "check.png").shape[1] >= 700

    assert cli.main(arguments) == 2
    assert "check.json exists. Replace it with --force" in capsys.readouterr().err
    assert cli.main([*arguments, "--force", "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")


def test_the_exit_status_is_the_verdict(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["check", "at_limit", "--quiet"]) == 3
    assert capsys.readouterr().err == "coopqp: The arms cannot follow the path from this start.\n"
    assert cli.main(["check", "at_singularity", "--remedies"]) == 4
    said = capsys.readouterr().out
    assert said.startswith("UNDECIDED\nIt is not decided whether the arms can follow the path: 1.2")
    assert "remedy: start arm arm_1 in another branch (certified)." in said
    assert cli.main(["check", "at_singularity", "--any-start", "--branches"]) == 0
    said = capsys.readouterr().out
    open_ = said.partition("arm arm_2; * is judged")[0].count("undecided")
    assert f" branches follow the path, {open_} are not decided; least margin" in said.splitlines()[2]
    assert cli.main(["check", "scara_pair"]) == 0
    assert capsys.readouterr().out.startswith("SAMPLED\n")
    assert cli.main(["check", cell_file(tmp_path, x=5.0)]) == 3
    said = capsys.readouterr().out
    assert "arm a does not reach its grasp at the start of the path" in said
    assert cli.main(["check", cell_file(tmp_path, y=2.0), "--quiet"]) == 3


def test_bad_input_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    start = "start = {{ positions_deg = {{ a = [0, 0, 90, 0, 60, 0] }}, inverse_kinematics = {ik} }}"
    off = cell_file(tmp_path, start=start.format(ik="false"))
    for arguments, says in (
        (["check", "nothing"], "no cell file (.toml, .yaml) or scenario named 'nothing'"),
        (["check", str(tmp_path / "no.toml")], "no.toml"),
        (["check", off], "arm 'a' is "),
        (["check", "paper_lift", "--json", str(tmp_path)], "it is a folder"),
        (["check"], "CELL"),
    ):
        assert cli.main(arguments) == 2
        error = capsys.readouterr().err
        assert error.splitlines()[-1].startswith("coopqp: error: ")
        assert says in error
    assert cli.main(["check", cell_file(tmp_path, start=start.format(ik="true")), "--quiet"]) in (0, 3)
    unreachable = cell_file(tmp_path, start=start.format(ik="true"), x=5.0)
    assert cli.main(["check", unreachable]) == 3
    assert "does not reach its grasp" in capsys.readouterr().err


def test_a_latched_grasp_is_judged_at_its_start(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    start = "start = { positions_deg = { a = [10, 20, 90, 0, 40, 0] } }"
    assert cli.main(["check", cell_file(tmp_path, start=start, grasp="latched", y=0.05)]) == 0
    assert "arm a follows the path" in capsys.readouterr().out


@pytest.mark.slow
def test_the_picture_shows_each_joint_and_what_is_proved() -> None:
    task = paper_lift()
    figure = check_figure(check_path(task.cell, task.grasp, task.path, q_start=task.q_start))
    axes = figure.axes
    assert len(axes) == 9
    for panel in axes[:3]:
        assert len(panel.lines) == 7  # six joints and the limit
        assert panel.get_title().endswith(": certified")
        assert panel.get_xlim() == (0.0, 3.0)
    for below in axes[6:]:
        assert [text.get_text() for text in below.get_legend().get_texts()] == [f"joint {j}" for j in range(1, 7)]
    task = dual_arm7()
    joints = check_figure(check_path(task.cell, task.grasp, task.path, q_start=task.q_start)).axes[0].lines
    assert len(joints) == 8
    task = at_limit()
    panel = check_figure(check_path(task.cell, task.grasp, task.path, q_start=task.q_start)).axes[0]
    assert min(float(np.min(line.get_ydata())) for line in panel.lines) < -10.0
    assert panel.get_ylim()[0] < 0.0
    assert " ".join(panel.get_title().split()) == "master: infeasible after 0.60 s"


def test_a_joint_without_limits_has_no_margin_in_the_picture() -> None:
    task = mixed_cell()
    check = check_path(task.cell, task.grasp, task.path, q_start=task.q_start)
    with np.errstate(all="raise"):
        panel = check_figure(check).axes[2]
    chosen = check.arms[2].chosen
    assert chosen is not None
    assert len(panel.lines) == np.isfinite(chosen.margins).sum() + 1 == 6
