"""Drivers of a cell file: each robot has one, which has its joints and its settings, and a misfit is named."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from places import CELL_FILES

from coopqp import load_cell_file
from coopqp.drivers import SimDriver
from coopqp.files import CellFileError
from coopqp.files.cellfile.build import CellRun
from coopqp.files.cellfile.schema import CellFile

SIM, UR = {"kind": "sim"}, {"kind": "ur", "address": "192.0.2.1"}
LAGS = SIM | {"lag": 0.03}
PAPER, LIFT = "paper_lift", "torso_lift"


@pytest.fixture(scope="module")
def with_drivers() -> Callable[..., CellRun]:
    """A cell that comes with coopqp, with tables of drivers by name."""
    read = {name: load_cell_file(CELL_FILES / f"{name}.toml") for name in (PAPER, LIFT)}

    def with_tables(cell: str, **tables: dict[str, Any]) -> CellRun:
        settings = read[cell].settings.model_dump(exclude_none=True, exclude_unset=True)
        return replace(read[cell], settings=CellFile.model_validate(settings | {"drivers": tables}))

    return with_tables


def test_every_arm_has_the_driver_of_its_table_where_it_starts(with_drivers: Callable[..., CellRun]) -> None:
    run = with_drivers(PAPER, master=LAGS, slave_1=SIM, slave_2=UR)
    made, cell = run.drivers(), run.scenario.cell
    assert list(made) == ["master", "slave_1", "slave_2"]
    assert [type(driver).__name__ for driver in made.values()] == ["SimDriver", "SimDriver", "UrDriver"]
    for driver in made.values():
        assert driver.joint_names == tuple(f"joint_{i}" for i in range(1, 7))
    master, slave = made["master"], made["slave_1"]
    assert isinstance(master, SimDriver)
    assert isinstance(slave, SimDriver)
    assert master.options.lag == 0.03
    assert slave.options.lag != 0.03
    for name, robot in (("master", master), ("slave_1", slave)):
        robot.connect()
        state = robot.read()
        robot.close()
        assert state is not None
        np.testing.assert_allclose(state.q, run.scenario.q_start[cell.blocks[name]], atol=1e-9)


def test_a_kind_for_every_robot_keeps_settings_of_that_kind_alone(with_drivers: Callable[..., CellRun]) -> None:
    made = with_drivers(PAPER, master=LAGS, slave_1=UR).drivers("sim")
    lags = [driver.options.lag for driver in made.values() if isinstance(driver, SimDriver)]
    assert len(lags) == 3
    assert lags[0] == 0.03
    assert lags[1] == lags[2] != 0.03


@pytest.mark.parametrize(
    ("cell", "tables", "words"),
    [
        (PAPER, {}, "arm 'master' has no driver. Give a table [drivers.master], or --driver sim."),
        (PAPER, {"master": SIM, "slave_2": SIM}, "arm 'slave_1' has no driver."),
        (PAPER, {"maste": SIM}, "drivers: no arm named 'maste'; arms: master, slave_1, slave_2."),
        (
            PAPER,
            dict.fromkeys(("master", "slave_1", "slave_2"), SIM | {"loss": 1.0}),
            "drivers.master: SimOptions: loss",
        ),
        (LIFT, {}, "robot 'lift' (lift/lift, left, right) has no driver. Give a table [drivers.lift]"),
        (LIFT, {"left": SIM}, "robot 'lift' (lift/lift, right) has no driver."),
        (LIFT, {"lft": SIM}, "drivers: no robot or arm named 'lft'; robots: lift; arms: left, right."),
        (
            LIFT,
            {"lift": UR},
            "drivers.lift: a driver 'ur' has one arm, and this robot has lift/lift, left, right. Give each arm a table"
            " of its own, [drivers.left], [drivers.right], and [drivers.lift] another kind for lift/lift.",
        ),
        (
            LIFT,
            {"lift": UR, "left": SIM, "right": SIM},
            "drivers.lift: a driver 'ur' has one arm, and this robot has lift/lift. Give [drivers.lift] another kind"
            " for lift/lift.",
        ),
        (
            LIFT,
            {"lift": UR, "left": SIM},
            "a driver 'ur' has one arm, and this robot has lift/lift, right. Give each arm a table of its own,"
            " [drivers.right], and [drivers.lift] another kind for lift/lift.",
        ),
    ],
)
def test_drivers_that_do_not_fit_are_named(
    cell: str, tables: dict[str, dict[str, Any]], words: str, with_drivers: Callable[..., CellRun]
) -> None:
    run = with_drivers(cell, **tables)
    with pytest.raises(CellFileError) as caught:
        run.drivers()
    assert words in str(caught.value)


def test_an_arm_beside_the_lift_it_stands_on_may_have_a_driver_for_one_arm(
    with_drivers: Callable[..., CellRun],
) -> None:
    made = with_drivers(LIFT, left=UR, right=SIM, lift=SIM).drivers()
    assert {name: driver.joint_names[0] for name, driver in made.items()} == {
        "left": "left_joint_1", "right": "right_joint_1", "lift": "lift",
    }  # fmt: skip
