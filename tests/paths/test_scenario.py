"""What a scenario says of its object unless told otherwise, and records of paths that nobody changes."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from coopqp.paths import PathGeometry, SpeedProfile
from coopqp.paths.elbows import Elbows
from coopqp.paths.geometry import Blend, MotionBounds, Straight
from coopqp.paths.grasp_motion import GraspMotion, GraspPiece
from coopqp.paths.path import ScrewParameters
from coopqp.paths.scenario import EngineSettings
from coopqp.scenarios import Scenario, paper_lift

HERE = pin.SE3.Identity()


def plain() -> Scenario:
    lift = paper_lift()
    return Scenario("plain", lift.cell, lift.grasp, lift.path, lift.q_start, 0.01)


def test_an_object_is_a_box_of_10_cm_and_20_kg_about_its_origin() -> None:
    task = plain()
    assert task.object_size == (0.1, 0.1, 0.1)
    assert task.object_mass == 20.0
    assert task.T_object_body == HERE
    assert task.obstacles == ()
    assert task.engine is None
    assert repr(task).startswith("Scenario(plain: ")
    assert repr(task).endswith(f"{task.path.duration:.4g} s in steps of 10 ms)")


def test_in_the_engine_joints_follow_their_commands_with_their_whole_torque_and_no_forces() -> None:
    settings = EngineSettings()
    assert dict(settings.disturbances) == dict(settings.options) == dict(settings.controller) == {}
    assert dict(settings.tolerances) == {}
    assert (settings.forces, settings.palms, settings.internal_force) == (None, None, None)
    assert settings.shares_load is False
    assert settings.torque_share == 1.0


X, R = np.zeros(3), np.eye(3)


@pytest.mark.parametrize(
    "record",
    [
        EngineSettings(),
        ScrewParameters(X, X, 0.0),
        Elbows(np.array([0.0, 1.0]), np.zeros((2, 1)), np.zeros((2, 1))),
        SpeedProfile(np.array([0.0, 1.0, 2.0]), np.array([0.0, 1.0, 0.0])),
        MotionBounds(X, X, X, X),
        Straight(R, X, X, X, 1.0),
        Blend(R, X, np.zeros((2, 3)), np.zeros((2, 3)), 1.0),
        PathGeometry((Straight(R, X, X, X, 1.0),)),
        GraspPiece(HERE, HERE, np.zeros(29)),
        GraspMotion((), ((0.0, ()),)),
    ],
    ids=lambda record: type(record).__name__,
)
def test_records_of_a_path_are_constant_and_equal_themselves_alone(record: Any) -> None:
    constant(record)


def test_a_scenario_is_constant_and_equals_itself_alone() -> None:
    constant(plain())


def constant(record: Any) -> None:
    field = dataclasses.fields(record)[0].name
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(record, field, None)
    assert record != dataclasses.replace(record)
    assert len({record, dataclasses.replace(record)}) == 2
