"""Maps and searches of placements: what is asked, in which order, what is told, and what the best is."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.optimize

from coopqp.scenarios import SCENARIOS
from coopqp.studies import CellPlaced, Goals, PlaceStudy, StudyError, load_place_study
from coopqp.studies.placement import AxisTable, PlaceFile

TEXT = """
name = "one way"
scenario = "paper_lift"
{more}
[axes]
{axes}
[[bases]]
arm = "slave_1"
xyz_m = [{x}, 0.5, 0]
"""
H = "h = {{ low = 3.5, high = 3.6, number = {number} }}"


def study(folder: Path, axes: str, x: str = '"h"', more: str = "distances = false") -> PlaceStudy:
    file = folder / "place.toml"
    file.write_text(TEXT.format(axes=axes, x=x, more=more), encoding="utf-8")
    return load_place_study(file)


def test_a_search_asks_for_what_is_worst_first_and_keeps_the_best(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """SciPy minimises; the next smaller shares of the arms count a tenth, a hundredth and a thousandth."""
    made = study(tmp_path, H.format(number=2) + "\nk = { low = -1.0, high = 2.0 }", more="seed = 7\ndistances = false")
    asked: list[Any] = []
    points = [(3.55, 0.0), (3.58, 1.0), (3.52, -1.0), (9.0, 0.0)]

    def evolution(cost: Any, bounds: Any, **options: Any) -> None:
        asked.append((bounds, options))
        asked.append([cost(np.array(point)) for point in points])

    monkeypatch.setattr(scipy.optimize, "differential_evolution", evolution)
    told: list[tuple[int, int]] = []
    best = made.search(lambda done, total: told.append((done, total)), generations=3)
    (bounds, options), costs = asked
    assert bounds == [(3.5, 3.6), (-1.0, 2.0)]
    assert options.pop("maxiter") == 3
    assert options == {"popsize": 8, "rng": 7, "tol": 1e-3, "polish": False, "init": "sobol"}
    placed = [made.at({"h": h, "k": k}) for h, k in points]
    ranks = [found.rank for found in placed]
    for cost, rank in zip(costs, ranks, strict=True):
        weights = np.array([1.0, 0.1, 0.01, 0.001])[: len(rank)]
        assert cost == pytest.approx(-weights @ np.array(rank[:4]), rel=1e-12)
    assert len(ranks[0]) == 6
    assert len(ranks[3]) == 1
    assert best.rank == max(ranks)
    assert told == [(i, 8 * 2 * 4) for i in range(1, 5)]
    made.search(generations=0)
    assert asked[2][1]["maxiter"] == 0


def test_progress_of_a_search_ends_where_it_was_to_end(tmp_path: Path) -> None:
    made = study(tmp_path, H.format(number=2))
    told: list[tuple[int, int]] = []
    best = made.search(lambda done, total: told.append((done, total)), generations=0)
    assert told == [(i, 8) for i in range(1, 9)]
    assert best.feasible
    assert 3.5 <= best.values["h"] <= 3.6
    again = study(tmp_path, H.format(number=2)).search(generations=0)
    assert dict(again.values) == dict(best.values)
    other = study(tmp_path, H.format(number=2), more="seed = 1\ndistances = false").search(generations=0)
    assert dict(other.values) != dict(best.values)


@pytest.mark.parametrize(
    ("numbers", "fits"),
    [((500, 200), True), ((500, 201), False), ((400, 300), False), ((500,), True), ((500, 500, 500), True)],
)
def test_a_map_has_a_hundred_thousand_placements_at_most(numbers: Any, fits: bool, tmp_path: Path) -> None:
    """Of more than two axes there is no map."""
    axes = "\n".join(
        f"{name} = {{ low = 3.5, high = 3.6, number = {n} }}" for name, n in zip("hkl", numbers, strict=False)
    )
    if fits:
        assert len(study(tmp_path, axes).axes) == len(numbers)
    else:
        with pytest.raises(StudyError, match=r"place\.toml: axes: more than 100000 placements"):
            study(tmp_path, axes)


@pytest.mark.parametrize(
    ("axis", "said"),
    [
        ({"low": 1.0, "high": 1.0}, "low must be below high"),
        ({"low": 1.0, "high": 0.5}, "low must be below high"),
        ({"low": 0.0, "high": 1.0, "number": 1}, "number"),
        ({"low": 0.0, "high": 1.0, "number": 501}, "number"),
        ({"low": 0.0, "high": 1.0, "number": 2.5}, "number"),
        ({"high": 1.0}, "low"),
    ],
)
def test_an_axis_grows_and_has_two_to_five_hundred_values(axis: Any, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        AxisTable.model_validate(axis)
    usual = AxisTable(low=0.0, high=1.0)
    assert (usual.number, usual.now) == (21, None)
    assert usual.values == pytest.approx([0.05 * i for i in range(21)])
    for number in (2, 500):
        assert len(AxisTable(low=0.0, high=1.0, number=number).values) == number


def test_a_place_file_has_axes_and_bases_and_may_have_goals(tmp_path: Path) -> None:
    usual = study(tmp_path, H.format(number=2), more="")
    assert usual.seed == 0
    assert usual.placer.goals == Goals()
    assert np.isfinite(usual.at({"h": 3.6}).clearance)  # distances count
    other = study(tmp_path, H.format(number=2), more="goals = { sigma_min = 0.3, clearance_mm = 5 }\ndistances = false")
    assert other.placer.goals == Goals(sigma_min=0.3, clearance_mm=5.0)
    assert np.isnan(other.at({"h": 3.6}).clearance)
    base = {"arm": "left", "xyz_m": [0, 0, 0]}
    axis = {"low": 0.0, "high": 1.0}
    given = {"name": "s", "scenario": "paper_lift", "axes": {"h": axis}, "bases": [base]}
    for change, said in (
        ({"axes": {}}, "axes"),
        ({"axes": {f"a{i}": axis for i in range(13)}}, "axes"),
        ({"bases": []}, "bases"),
        ({"bases": [base] * 65}, "bases"),
        ({"bases": [{"arm": "left", "xyz_m": [0, 0]}]}, "xyz_m"),
        ({"bases": [{"arm": "left", "xyz_m": [0, 0, 0, 0]}]}, "xyz_m"),
        ({"bases": [{"arm": "left", "robot": "one", "xyz_m": [0, 0, 0]}]}, "give one of arm, robot"),
        ({"bases": [{"xyz_m": [0, 0, 0]}]}, "give one of arm, robot"),
        ({"seed": -1}, "seed"),
        ({"cell": "cell.toml"}, "give one of cell, scenario"),
    ):
        with pytest.raises(ValueError, match=said):
            PlaceFile.model_validate({**given, **change})
    most = {"axes": {f"a{i}": axis for i in range(12)}, "bases": [base] * 64, "seed": 0}
    assert len(PlaceFile.model_validate({**given, **most}).bases) == 64


def test_a_cell_file_is_placed_as_its_scenario(tmp_path: Path) -> None:
    cells = Path(str(SCENARIOS["paper_lift"].__code__.co_filename)).parent / "cells"
    (tmp_path / "cell.toml").write_text((cells / "paper_lift.toml").read_text(encoding="utf-8"), encoding="utf-8")
    here = study(tmp_path, H.format(number=2), more="")
    file = tmp_path / "place.toml"
    file.write_text(file.read_text(encoding="utf-8").replace('scenario = "paper_lift"', 'cell = "cell.toml"'))
    there = load_place_study(file)
    a, b = here.at({"h": 3.55}), there.at({"h": 3.55})
    np.testing.assert_allclose([arm.shares for arm in a.arms], [arm.shares for arm in b.arms], atol=1e-6)
    assert np.isfinite(b.clearance)
    with pytest.raises(AttributeError):
        here.seed = 3  # type: ignore[misc]
    assert len({here, there}) == 2


def test_an_axis_that_nobody_names_is_told_with_the_base(tmp_path: Path) -> None:
    with pytest.raises(StudyError, match=r"no axis named 'g' in bases: arm 'slave_1'"):
        study(tmp_path, H.format(number=2), x='"-g"')
    assert study(tmp_path, H.format(number=2), x='"-h"').bases({"h": 3.5})[1].translation[0] == -3.5


def test_distances_are_told_in_millimetres_and_the_first_of_equal_shares_binds(tmp_path: Path) -> None:
    placed = study(tmp_path, H.format(number=2)).at({"h": 3.55})
    far = replace(placed, clearance=1.2344, near=("one", "two"), near_s=0.5)
    assert far.explain().splitlines()[-1] == "closest: one and two, 1234 mm at 0.50 s of the path"
    level = replace(placed, arms=tuple(replace(arm, shares=(0.5, 0.5)) for arm in placed.arms))
    assert "master's σ_min is 0.50 of good" in level.explain()
    assert isinstance(level, CellPlaced)
    with pytest.raises(AttributeError):
        level.clearance = 1.0  # type: ignore[misc]
