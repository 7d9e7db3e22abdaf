"""What a result says of itself at a prompt is a few lines, whatever it holds."""

from __future__ import annotations

import pytest

from coopqp import check_path, find_start, plan
from coopqp.scenarios import plate_and_post, pliers


@pytest.mark.slow
def test_results_have_short_reprs() -> None:
    task = plate_and_post()
    cell = task.cell.with_limits(acceleration=5.0)
    start, check = find_start(cell, task.grasp, task.path), check_path(cell, task.grasp, task.path)
    made = plan(cell, task.grasp, task.path, q_start=start.q)
    shown = [start, *start.arms, *start.arms[0].branches, check, *check.arms, *check.arms[0].branches, made]
    shown += [check.arms[0].branches[0].trajectory, made.path.profile, pliers().path.grasps]
    assert max(len(repr(each)) for each in shown) < 800
    assert repr(start).startswith("Start(q=array(18,), grasp=Grasp(…), arms=3 × ArmStart, clocks=array(")
