"""The start of a cell file: what is given is corrected, and it is told where that is far."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
from places import CELL_FILES

from coopqp import load_cell_file
from coopqp.errors import StartWarning
from coopqp.files import CellFileError
from coopqp.scenarios import Scenario

PAPER = (CELL_FILES / "paper_lift.toml").read_text(encoding="utf-8")
BEFORE, AFTER = PAPER[: PAPER.index("[start]")], PAPER[PAPER.index("[object]") :]


def started(folder: Path, paper: Scenario, joint: int, by: float, more: str = "") -> Scenario:
    """The paper's cell, with one joint of its start [rad] moved."""
    q = paper.q_start.copy()
    q[joint] += by
    given = "\n".join(f"positions_rad.{name} = {q[own].tolist()}" for name, own in paper.cell.blocks.items())
    file = folder / "cell.toml"
    file.write_text(f"{BEFORE}[start]\n{given}\n{more}\n{AFTER}", encoding="utf-8")
    return load_cell_file(file).scenario


def test_a_start_near_the_grasp_is_corrected_in_silence(paper: Scenario, tmp_path: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error", StartWarning)
        for joint, by in ((7, 0.3), (11, -0.34), (0, 0.0)):
            found = started(tmp_path, paper, joint, by)
            np.testing.assert_allclose(found.q_start, paper.q_start, atol=1e-8)


@pytest.mark.parametrize(("joint", "name"), [(11, "slave_1 takes hold with joint_6"), (5, "master takes hold with")])
def test_a_start_far_from_the_grasp_is_told_by_joint(joint: int, name: str, paper: Scenario, tmp_path: Path) -> None:
    with pytest.warns(StartWarning, match=f"arm {name}.* from the positions that are given") as told:
        found = started(tmp_path, paper, joint, 0.37)
    np.testing.assert_allclose(found.q_start, paper.q_start, atol=1e-8)
    assert "21" in str(told[0].message)  # 0.37 rad are 21.2 degrees


def test_a_start_that_is_not_to_be_corrected_stays(paper: Scenario, tmp_path: Path) -> None:
    found = started(tmp_path, paper, 0, 0.0, "inverse_kinematics = false")
    np.testing.assert_array_equal(found.q_start, paper.q_start)


def test_the_first_arm_without_positions_is_named(paper: Scenario, tmp_path: Path) -> None:
    file = tmp_path / "cell.toml"
    own = paper.q_start[paper.cell.blocks["master"]].tolist()
    file.write_text(f"{BEFORE}[start]\npositions_rad.master = {own}\n{AFTER}", encoding="utf-8")
    with pytest.raises(CellFileError, match=r"start\.positions_rad: arm 'slave_1' is missing"):
        load_cell_file(file)


@pytest.mark.parametrize(("dt", "settle", "fits"), [(3.1e-6, 0, True), (2.9e-6, 0, False), (3.1e-6, 3, False)])
def test_a_run_of_too_many_steps_is_refused(dt: float, settle: int, fits: bool, tmp_path: Path) -> None:
    """At most ten million: ten times the path's 3 s, and the time after its end."""
    file = tmp_path / "cell.toml"
    file.write_text(PAPER.replace("steps = 400", f"dt_s = {dt}\nsettle_s = {settle}"), encoding="utf-8")
    if fits:
        assert load_cell_file(file).scenario.dt == dt
        return
    with pytest.raises(CellFileError, match=r"a run of up to 30 s .* is too long; raise dt_s or lower longest_s"):
        load_cell_file(file)
