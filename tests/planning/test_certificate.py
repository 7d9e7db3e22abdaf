"""The proof of an arm's way through knots."""

from __future__ import annotations

import numpy as np

from coopqp import check_path
from coopqp.constraints.samples import sample_path
from coopqp.model.batch import ArmKinematics
from coopqp.paths.segments import segments_of
from coopqp.planning import PathVerdict
from coopqp.planning.branch_checks import check_trajectory, path_at, tool_path
from coopqp.scenarios import dual_arm7


def test_a_knot_that_is_given_twice_is_proved_and_a_jump_is_not() -> None:
    """Numerical warnings are errors here: an interval without length is no division by its length."""
    task = dual_arm7(duration=1.0)
    found = check_path(task.cell, task.grasp, task.path, q_start=task.q_start).arms[0].chosen
    assert found.verdict is PathVerdict.CERTIFIED
    kinematics = ArmKinematics(task.cell.arms[0])
    whole = tool_path(segments_of(task.path), sample_path(task.path, task.grasp), task.grasp.T_object_tool[0])
    assert whole.segments is not None
    at = len(whole.places) // 2
    again = path_at(whole, np.insert(whole.places, at, whole.places[at]))
    x, _ = found.trajectory.at(whole.places, whole.segments.poses(whole.segment, whole.share))
    repeated = check_trajectory(kinematics, again, np.insert(x, at, x[at], axis=0))
    assert repeated.verdict is PathVerdict.CERTIFIED
    x = np.insert(x, at, x[at], axis=0)
    x[at] += 1e-3
    assert check_trajectory(kinematics, again, x).verdict is not PathVerdict.CERTIFIED
