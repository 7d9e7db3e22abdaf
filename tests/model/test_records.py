"""Records of the model are read-only; those with arrays are compared by identity, the others by value."""

from __future__ import annotations

import copy
import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from cells import rx90l

from coopqp import BindingLimit, CommonError, Grasp, JointLimits, LimitKind, PostureOptions, Robot
from coopqp.model import Free, freed_cell
from coopqp.model.batch import BatchSolutions, Walks
from coopqp.model.branches import Branches
from coopqp.model.shapes import Body, Box, Capsule, Cylinder, Hull, Mesh, NearPair, Sphere
from coopqp.model.tool_guess import ToolGuess
from coopqp.scenarios import five_joint_pair, robot_path

ROW, TABLE = np.zeros(2), np.zeros((2, 2))
BY_VALUE: dict[str, Any] = {
    "limit": BindingLimit("left", "elbow", LimitKind.REACH),
    "free": Free("left", "rx", -1.0, 1.0),
    "pair": NearPair("post", "hand", 0.1),
    "sphere": Sphere(0.1),
    "cylinder": Cylinder(0.1, 0.2),
    "capsule": Capsule(0.1, 0.2),
    "guess": ToolGuess(tool_frame="tool", locked={"finger": 0.0}, others=()),
}


def by_identity() -> dict[str, Any]:
    task = five_joint_pair()
    return {
        "arm": rx90l(geometry=False),
        "robot": Robot(robot_path("lift2"), {"left": "left_tool", "right": "right_tool"}, geometry=False),
        "limits": JointLimits(-np.ones(2), np.ones(2), np.ones(2), np.ones(2)),
        "grasp": Grasp.triangle(0.2, 0.3),
        "freed": freed_cell(task.cell, task.grasp.freed("left", "rx", range=(-1.0, 1.0))),
        "shares": CommonError.per_axis(TABLE),
        "posture": PostureOptions(target=ROW),
        "box": Box((0.1, 0.2, 0.3)),
        "hull": Hull(np.vstack([np.zeros(3), np.eye(3)])),
        "mesh": Mesh(Path(__file__)),
        "body": Body("post", Sphere(0.1), pin.SE3.Identity()),
        "answers": BatchSolutions(TABLE, ROW, ROW, TABLE),
        "walks": Walks(TABLE[None], np.zeros(1, dtype=np.intp), TABLE),
        "branches": Branches(TABLE, np.zeros(2, dtype=np.intp), TABLE, ROW, 2, 0.0),
    }


@pytest.mark.parametrize("name", BY_VALUE)
def test_records_of_numbers_and_names_are_compared_by_value(name: str) -> None:
    record = BY_VALUE[name]
    again = dataclasses.replace(record)
    assert again is not record
    assert again == record
    first = dataclasses.fields(record)[0].name
    other = copy.copy(record)
    object.__setattr__(other, first, "other")
    assert other != record


def test_records_of_arrays_are_compared_by_identity() -> None:
    """A copy is another one, and each can be a key."""
    for name, record in by_identity().items():
        assert copy.copy(record) != record, name
        assert {record: name}[record] == name


def test_no_record_can_be_changed() -> None:
    for name, record in {**BY_VALUE, **by_identity()}.items():
        for field in dataclasses.fields(record):
            with pytest.raises(dataclasses.FrozenInstanceError):
                setattr(record, field.name, None)
        with pytest.raises((dataclasses.FrozenInstanceError, TypeError)):
            record.another = name
