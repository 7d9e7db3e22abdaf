"""Axes of a study's figure have units: from the key, from the schema, from the scenario."""

from __future__ import annotations

import inspect
from dataclasses import replace
from pathlib import Path

import pytest

from coopqp.checks import meanings
from coopqp.scenarios import SCENARIOS
from coopqp.studies import Study, Sweep, load_study
from coopqp.studies.units import name_and_unit
from coopqp.visualization import sweep_figure
from coopqp.visualization.style import figure_bytes

PAPER = Path(inspect.getfile(SCENARIOS["paper_lift"])).with_name("cells") / "paper_lift.toml"
PURE = {"friction", "assumed_mass", "assumed_payload"}


def study_of(folder: Path, task: str) -> Study:
    (folder / "cell.toml").write_bytes(PAPER.read_bytes())
    file = folder / "study.toml"
    file.write_text(f'name = "s"\n{task}\n[axes]\ncontroller.path_gain = [1, 2]\n', encoding="utf-8")
    return load_study(file)


@pytest.mark.parametrize(
    ("key", "expected"),
    [
        ("scenario.duration", ("scenario.duration", "s")),
        ("scenario.beta", ("scenario.beta", "m")),
        ("scenario.time_law", ("scenario.time_law", "")),
        ("controller.path_gain", ("controller.path_gain", "1/s")),
        ("controller.kind", ("controller.kind", "")),
        ("dt_s", ("dt", "s")),
        ("steps", ("steps", "")),
        ("case", ("case", "")),
        ("verdict.chain_mm", ("verdict.chain", "mm")),
        ("disturbances.encoder_noise_rad", ("disturbances.encoder_noise", "rad")),
        ("disturbances.drop_share", ("disturbances.drop_share", "")),
    ],
)
def test_keys_of_a_scenario(key: str, expected: tuple[str, str], tmp_path: Path) -> None:
    assert name_and_unit(study_of(tmp_path, 'scenario = "paper_lift"'), key) == expected


@pytest.mark.parametrize(
    ("key", "expected"),
    [
        ("arms.slave_1.limits.velocity_deg_per_s", ("arms.slave_1.limits.velocity", "deg/s")),
        ("arms.slave_1.limits.acceleration_rad_per_s2", ("arms.slave_1.limits.acceleration", "rad/s²")),
        ("arms.1.base.xyz_m.0", ("arms.1.base.xyz.0", "m")),
        ("arms.slave_1.base.xyz_m.0", ("arms.slave_1.base.xyz.0", "m")),
        ("path.duration_s", ("path.duration", "s")),
        ("arms.slave_1.geometry", ("arms.slave_1.geometry", "")),
    ],
)
def test_keys_of_a_cell_file(key: str, expected: tuple[str, str], tmp_path: Path) -> None:
    assert name_and_unit(study_of(tmp_path, 'cell = "cell.toml"'), key) == expected


def test_every_number_of_a_scenario_has_its_unit() -> None:
    for name, build in SCENARIOS.items():
        units = meanings(build)
        for argument, parameter in inspect.signature(build).parameters.items():
            if isinstance(parameter.default, float) and argument not in PURE:
                assert units.get(argument, "").startswith("["), f"{name}: {argument}"


def test_the_axis_and_the_lines_of_a_figure_have_units(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    study = study_of(tmp_path, 'scenario = "paper_lift"')
    rows = [{"controller.path_gain": gain, "outcome": "ok", "chain_mm": 1.0, "object_mm": 1.0, "time_s": 1.0}
            for gain in (1, 2)]  # fmt: skip
    figure = sweep_figure(Sweep(study, tuple(rows[0]), tuple(rows), (0.0, 0.0), ()))
    assert {axes.get_xlabel() for axes in figure.axes if axes.get_xlabel()} == {"controller.path gain [1/s]"}


def test_cases_of_a_figure_are_text(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    cases = (("$x^{", {}), ("_b", {}))
    study = replace(study_of(tmp_path, 'scenario = "paper_lift"'), cases=cases, name="$y_{")
    rows = [{"controller.path_gain": gain, "case": case, "outcome": "ok", "chain_mm": 1.0, "object_mm": 1.0,
             "time_s": 1.0} for case, _ in cases for gain in (1, 2)]  # fmt: skip
    figure = sweep_figure(Sweep(study, tuple(rows[0]), tuple(rows), (0.0,) * 4, ()))
    assert figure_bytes(figure, dpi=20)
    legends = [legend for axes in figure.findobj() if (legend := getattr(axes, "legend_", None)) is not None]
    assert [text.get_text() for text in legends[0].get_texts()] == [r"\$x^{", " b"]
