"""Distances along programs whose tools move on the object: proved, and against samples that know no proof."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from runs import limited_once

from coopqp import CollisionScene, InvalidInputError, LinePath, check_path, inverse_kinematics
from coopqp.collision import Body, Sphere
from coopqp.collision.distances import Distances
from coopqp.programs import Phase, Program, Travels, Turns, Works
from coopqp.scenarios import paper_lift

PIN = (0.0, 0.8, 0.0)


def lift() -> Any:
    return limited_once(lambda: paper_lift(time_law="quintic"), 5.0)


def regrasp(task: Any, k: int = 2) -> Program:
    """An arm goes over by 10 cm, then the other two open the part on the way up."""
    X = task.grasp.T_object_tool[k]
    name = task.cell.arm_names[k]
    there = pin.SE3(X.rotation, X.translation + np.array([-0.1, 0.0, 0.0]))
    opens = {"slave_1": Turns(about=PIN, angle=0.08)}
    phases = [
        Phase("over", arms={name: Travels(to=there)}, duration=2.0),
        Phase("lift", path=task.path, arms=opens),
    ]
    return Program(task.cell, task.grasp, phases)


def sampled(task: Any, program: Program, scene: CollisionScene) -> float:
    """The least distance over margin at 80 clocks, by inverse kinematics from clock to clock."""
    distances, q, least = Distances(scene.built), task.q_start, np.inf
    for clock in np.linspace(0.0, program.duration, 80):
        q = inverse_kinematics(task.cell, program.grasp_at(task.grasp, clock), program.pose(clock), q)
        least = min(least, float((distances.all(q) - scene.built.margins)[~scene.built.moves].min()))
    return least


def test_the_proof_is_a_bound_of_what_samples_find() -> None:
    task = lift()
    program, scene = regrasp(task), CollisionScene.of(task, obstacles=[])
    check = check_path(task.cell, task.grasp, program, q_start=task.q_start, scene=scene)
    assert check.verdict.value == "CERTIFIED", check.explain()
    assert check.clearance is not None
    least = sampled(task, program, scene)
    assert check.clearance.proved <= least + 1e-9
    assert check.clearance.proved > 0.5 * least


def test_a_body_in_the_way_of_a_tool_that_goes_over_is_named() -> None:
    """A ball where only the way over comes: by its mark at the middle of the travel."""
    task = lift()
    program = regrasp(task)
    q = task.q_start
    for clock in np.linspace(0.0, 1.0, 20):
        q = inverse_kinematics(task.cell, program.grasp_at(task.grasp, clock), program.pose(clock), q)
    data = task.cell.model.createData()
    pin.framesForwardKinematics(task.cell.model, data, q)
    place = data.oMf[task.cell.tool_frames[2]].translation
    ball = Body("ball", Sphere(0.03), pin.SE3(np.eye(3), place))
    scene = CollisionScene.of(task, obstacles=[ball])
    check = check_path(task.cell, task.grasp, program, q_start=task.q_start, scene=scene)
    assert check.verdict.value == "INFEASIBLE"
    assert check.clearance is not None
    assert check.clearance.stopped_by is not None
    assert "ball" in (check.clearance.stopped_by.first, check.clearance.stopped_by.second)
    assert check.clearance.stop is not None
    assert check.clearance.stop < 1.2
    over, after = check.phases
    assert over.verdict is check.verdict
    assert "ball" in over.why
    assert after.verdict is None


def test_what_moves_by_two_time_laws_is_sampled_and_what_cannot_be_placed_is_refused() -> None:
    task = lift()
    scene = CollisionScene.of(task, obstacles=[])
    X = task.grasp.T_object_tool[2]
    line = LinePath(X, pin.SE3(X.rotation, X.translation + np.array([-0.05, 0.0, 0.0])), duration=1.0)
    program = Program(task.cell, task.grasp, [Phase("draw", path=task.path, arms={"slave_2": Works(on=line)})])
    check = check_path(task.cell, task.grasp, program, q_start=task.q_start, scene=scene)
    assert check.verdict.value == "SAMPLED", check.explain()
    with pytest.raises(InvalidInputError, match="tool of arm 'master' moves on the object"):
        check_path(task.cell, task.grasp, regrasp(task, 0), q_start=task.q_start, scene=scene)
