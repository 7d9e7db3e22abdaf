"""What a study file may say: numbers and their bounds, ranges, defaults, and what its digest depends on."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from coopqp.scenarios import SCENARIOS
from coopqp.studies import Study, StudyError, load_study
from coopqp.studies.row import build_row
from coopqp.studies.study import CaseTable, RangeTable, ScenarioFile, StudyFile, versions
from coopqp.studies.table import FIGURES

LIFT: dict[str, Any] = {"name": "s", "scenario": "paper_lift"}


def load(folder: Path, text: str, head: str = 'scenario = "paper_lift"') -> Study:
    file = folder / "study.toml"
    file.write_text(f'name = "s"\n{head}\n{text}', encoding="utf-8")
    return load_study(file)


@pytest.mark.parametrize(
    ("key", "least", "most"),
    [("seed", 0, 2**63), ("draws", 1, 1_000_000), ("repeats", 1, 1_000_000)],
)
def test_counts_have_bounds(key: str, least: int, most: int) -> None:
    for value in (least, most):
        assert getattr(StudyFile.model_validate({**LIFT, key: value}), key) == value
    refused: tuple[float, ...] = (least - 1, most + 1, 1.5)
    for wrong in refused:
        with pytest.raises(ValidationError, match=key):
            StudyFile.model_validate({**LIFT, key: wrong})


def test_a_study_that_says_nothing_is_one_run(tmp_path: Path) -> None:
    study = load(tmp_path, "")
    assert len(study) == 1
    assert (study.seed, study.draws, study.repeats, study.timeout_s) == (0, 1, 1, 600.0)
    assert study.figures == ("chain_mm", "object_mm", "time_s")
    assert (study.varied, study.cases, study.axes) == ((), (), ())
    assert repr(study) == "Study(s: 1 rows over nothing)"
    settings = ScenarioFile()
    assert (settings.controller.kind, settings.plant.kind) == ("qp", "kinematic")
    assert (settings.dt_s, settings.steps, settings.settle_s, settings.longest_s) == (None, None, 0.0, None)
    varied = load(tmp_path, "cases = [{ name = 'a', set = {} }]\naxes.scenario.h = [3.5, 3.6]\ndraws = 3")
    assert repr(varied) == "Study(s: 6 rows over case, scenario.h)"


@pytest.mark.parametrize(
    ("given", "values"),
    [
        ({"low": 1, "high": 3, "number": 3}, [1.0, 2.0, 3.0]),
        ({"low": 3.0, "high": -1.0, "number": 5}, [3.0, 2.0, 1.0, 0.0, -1.0]),
        ({"low": 0.0, "high": 0.0, "number": 1}, [0.0]),
        ({"low": 1.0, "high": 100.0, "number": 3, "log": True}, [1.0, 10.0, 100.0]),
        ({"low": -8.0, "high": -1.0, "number": 4, "log": True}, [-8.0, -4.0, -2.0, -1.0]),
        ({"low": 2.0, "high": 5.0, "number": 1}, [2.0]),
    ],
)
def test_a_range_has_equal_distances_or_equal_ratios(given: Any, values: list[float]) -> None:
    np.testing.assert_allclose(RangeTable.model_validate(given).values(), values, rtol=1e-12)


@pytest.mark.parametrize(("low", "high"), [(0.0, 1.0), (1.0, 0.0), (-1.0, 2.0), (0.0, 0.0)])
def test_numbers_of_two_signs_have_no_ratio(low: float, high: float) -> None:
    with pytest.raises(ValidationError, match=rf"one sign, not {low:g} and {high:g}: 0 has no ratio"):
        RangeTable(low=low, high=high, number=2, log=True)
    assert RangeTable(low=low, high=high, number=2).values() == [low, high]


def test_an_axis_has_one_value_to_ten_thousand(tmp_path: Path) -> None:
    assert len(RangeTable(low=0.0, high=1.0, number=10_000).values()) == 10_000
    for number in (0, 10_001):
        with pytest.raises(ValidationError, match="number"):
            RangeTable(low=0.0, high=1.0, number=number)
    many = ", ".join(["3.6"] * 10_001)
    for values in (f"[{many}]", "[]", "3.6", '"3.6"'):
        with pytest.raises(StudyError, match=r"axes: scenario\.h: give a list of 1 to 10000 values, or \{ low, high"):
            load(tmp_path, f"axes.scenario.h = {values}")


def test_a_table_is_a_range_only_with_both_ends(tmp_path: Path) -> None:
    study = load(tmp_path, "[axes.scenario]\nh = [3.6]\nduration = { low = 1, high = 2, number = 2 }")
    assert dict(study.axes) == {"scenario.h": (3.6,), "scenario.duration": (1.0, 2.0)}
    with pytest.raises(StudyError, match=r"axes: scenario\.h\.low: give a list"):
        load(tmp_path, "axes.scenario.h = { low = 1 }")


def test_a_million_rows_are_the_most(tmp_path: Path) -> None:
    assert len(load(tmp_path, "draws = 1_000\nrepeats = 1_000")) == 1_000_000
    with pytest.raises(StudyError, match=r"1001000 rows; at most 1000000 are run\. Take fewer values\."):
        load(tmp_path, "draws = 1_001\nrepeats = 1_000")


@pytest.mark.parametrize("number", [0, 12, 13])
def test_at_most_twelve_columns_are_drawn(number: int) -> None:
    given = {**LIFT, "figures": list(FIGURES)[:number]}
    if number <= 12:
        assert StudyFile.model_validate(given).figures == list(FIGURES)[:number]
    else:
        with pytest.raises(ValidationError, match="figures"):
            StudyFile.model_validate(given)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            "[[cases]]\nname = 'good'\nset = {}\n[[cases]]\nname = 'bad'\nset = { 'steps' = 0 }",
            "case 'bad': steps: must be greater than or equal to 1",
        ),
        ("[[cases]]\nname = 'bad'\nset = { 'steps' = 0 }", "study.toml: steps: must be"),
        ("[[cases]]\nname = 'a'\nset = {}\n[[cases]]\nname = 'a'\nset = {}", "cases: two of them have the same name"),
        ("axes.scenario.h = [3.6, 'far']\naxes.steps = [3, -1]", "axis steps: steps: must be"),
        ("axes.settle_s = [0.0, -0.5]", "axis settle_s: settle_s: must be greater than or equal to 0"),
        ("axes.settle_s = [1e5, 1.1e5]", "axis settle_s: settle_s: must be less than or equal to 100000"),
        ("axes.disturbances.latency_s = [0.0, -1.0]", "axis disturbances.latency_s: disturbances: latency_s"),
        ("set.disturbances = 3", "set: disturbances: give a table, not 3"),
    ],
)
def test_a_bad_value_is_named_with_its_axis_or_its_case(text: str, said: str, tmp_path: Path) -> None:
    with pytest.raises(StudyError) as caught:
        load(tmp_path, text)
    assert said in str(caught.value)


def test_a_key_that_is_set_holds_in_all_rows_and_an_axis_goes_before_it(tmp_path: Path) -> None:
    study = load(
        tmp_path,
        "axes.scenario.h = [3.5, 3.6]\n[set]\nsteps = 7\nscenario.h = 3.4\nscenario.b = 0.45\n"
        "'disturbances.lag_s' = 0.5\n[[cases]]\nname = 'a'\nset = { 'scenario.b' = 0.5, 'scenario.h' = 3.0 }",
    )
    settings, amounts = study.settings(study.row(1).values)
    assert isinstance(settings, ScenarioFile)
    assert (settings.steps, settings.scenario) == (7, {"h": 3.6, "b": 0.5})
    assert amounts.lag_s == 0.5
    data, disturbed = study.data(study.row(0).values)
    data["scenario"]["h"] = "changed"
    disturbed["lag_s"] = "changed"
    assert study.data(study.row(0).values)[0]["scenario"]["h"] == 3.5
    assert study.data({})[1]["lag_s"] == 0.5


@pytest.mark.parametrize(
    "change",
    ["seed = 4", "draws = 2", "repeats = 2", "timeout_s = 5.0", "axes.scenario.h = [3.6]", "set.steps = 9",
     "disturbances.lag_s = 0.1", "cases = [{ name = 'a', set = {} }]", "figures = ['steps']"],
)  # fmt: skip
def test_the_digest_is_of_all_that_decides_about_the_rows_and_of_no_folder(change: str, tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    one, same = load(tmp_path / "a", ""), load(tmp_path / "b", "")
    assert one.folder != same.folder
    assert one.digest == same.digest
    assert len(one.digest) == 64
    assert load(tmp_path / "b", change).digest != one.digest


def test_bodies_of_a_cell_file_are_kept_apart_where_it_says_so(tmp_path: Path) -> None:
    cells = Path(str(SCENARIOS["paper_lift"].__code__.co_filename)).parent / "cells"
    text = (cells / "paper_lift.toml").read_text(encoding="utf-8")
    (tmp_path / "cell.toml").write_text(text, encoding="utf-8")
    plain = load(tmp_path, "set.steps = 3", 'cell = "cell.toml"')
    assert plain.scenario == ""
    assert build_row(plain, 0).scene is None
    assert not build_row(plain, 0).avoids
    kept = load(tmp_path, "[set]\nsteps = 3\ncollision = { avoid = false }", 'cell = "cell.toml"')
    assert build_row(kept, 0).scene is not None
    with pytest.raises(StudyError, match="give one of cell, scenario"):
        load(tmp_path, "", "")


def test_versions_name_what_the_bits_of_a_row_depend_on() -> None:
    found = versions()
    names = ["python", "coopqp", "pin", "numpy", "scipy", "daqp", "osqp", "proxsuite", "solver", "processor"]
    assert list(found) == names
    assert found["numpy"] == np.__version__
    assert all(isinstance(value, str) and value for value in found.values())


def test_a_study_and_its_rows_stay_as_they_are(tmp_path: Path) -> None:
    study = load(tmp_path, "axes.scenario.h = [3.5, 3.6]")
    row = study.row(1)
    for thing, name in ((study, "seed"), (row, "index")):
        with pytest.raises(AttributeError):
            setattr(thing, name, 3)
    assert (row.index, row.values, row.draw, row.repeat) == (1, {"scenario.h": 3.6}, 0, 0)
    assert CaseTable(name="a", set={}).set == {}
