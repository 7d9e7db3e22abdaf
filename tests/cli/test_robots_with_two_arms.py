"""From the URDF of a robot and two tool frames to a certified run: the remedies of messages, applied as they are."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path

import pytest
from marks import slow_but_first

from coopqp.cli.main import main
from coopqp.scenarios import robot_data_path, robot_path

CELL = """
name = "two"
dt_s = 0.02
[[robots]]
name = "body"
urdf = "{urdf}"
geometry = false
[[arms]]
name = "left"
of = "body"
tool_frame = "{left}"
[[arms]]
name = "right"
of = "body"
tool_frame = "{right}"
[grasp]
kind = "tools"
tools.left = {{ xyz_m = [0.0, {half}, 0.0], rpy_deg = [90, 0, 0] }}
tools.right = {{ xyz_m = [0.0, -{half}, 0.0], rpy_deg = [-90, 0, 0] }}
[path]
kind = "line"
start = {{ xyz_m = [{x}, 0.0, {z}] }}
displacement = {{ translation_m = [0.0, 0.0, 0.1] }}
duration_s = 4.0
"""


#: The robot, its tool frames, x and z of the start, and half the length of the bar [m].
ROBOTS = (
    ("lift2", "left_tool", "right_tool", 0.55, 0.8, 0.3),
    ("rail2", "left_tool", "right_tool", 0.0, 0.45, 0.15),
    ("tiago_pro_description/robots/tiago_pro.urdf", "arm_left_7_link", "arm_right_7_link", 0.6, 0.6, 0.25),
    ("pr2_description/urdf/pr2.urdf", "l_wrist_roll_link", "r_wrist_roll_link", 0.6, 0.7, 0.2),
)


@pytest.mark.parametrize("case", slow_but_first(ROBOTS))
def test_a_robot_with_two_arms_takes_few_edits(
    case: tuple[str, str, str, float, float, float],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    robot, left, right, x, z, half = case
    if "/" in robot:
        if importlib.util.find_spec("cmeel") is None:
            pytest.skip("the extra robots is not installed")
        try:
            urdf = robot_data_path(robot)
        except ImportError:
            pytest.skip("the extra robots is not installed")
    else:
        urdf = robot_path(robot)
    text = CELL.format(urdf=urdf.as_posix(), left=left, right=right, half=half, x=x, z=z)
    for _ in range(4):  # the first try, and three edits
        Path("cell.toml").write_text(text, encoding="utf-8")
        status = main(["check", "cell.toml"])
        said = capsys.readouterr()
        if status == 0:
            break
        lock = re.search(r"locked_joints_rad = \{.*?\}", said.err)
        assert lock is not None, said.err
        text = text.replace("geometry = false\n", f"geometry = false\n{lock[0]}\n")
    assert status == 0
    assert said.out.startswith("CERTIFIED")
    assert "joints that arms share: body/" in said.out
    assert main(["run", "cell.toml", "--quiet"]) == 0
