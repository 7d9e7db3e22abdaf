"""A phase that searches its way: round what stands there, from where the phase before ends, in its branches."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import route_cases

from coopqp import Clearance, InvalidInputError, LinePath, QPController, check_path
from coopqp.errors import UndecidedError
from coopqp.planning import Search
from coopqp.programs import Phase, Program, Turns
from coopqp.simulation import simulate

NODES = 600


@pytest.fixture(scope="module")
def found() -> tuple[route_cases.Problem, Program]:
    """Up by 2 cm, then past two posts, then up again."""
    problem = route_cases.posts3()
    lift = LinePath.displaced(problem.start, translation=(0.0, 0.0, 0.02), duration=0.5)
    over = Search(problem.goal, problem.scene, options={"nodes": NODES})
    up = LinePath.displaced(problem.goal, translation=(0.0, 0.0, 0.02), duration=0.5)
    phases = [Phase("lift", path=lift), Phase("over", path=over), Phase("up", path=up)]
    return problem, Program(problem.cell, problem.grasp, phases, q_start=problem.q_start)


def test_it_goes_round_what_stands_there_from_where_the_phase_before_ends(found: Any) -> None:
    problem, program = found
    begin, end = program.spans[1].start, program.spans[1].end
    lifted = problem.start.translation + np.array([0.0, 0.0, 0.02])
    assert np.allclose(program.pose(begin).translation, lifted)
    assert np.allclose(program.pose(end).homogeneous, problem.goal.homogeneous, atol=1e-9)
    straight = LinePath(program.pose(begin), problem.goal, duration=1.0)
    blocked = check_path(problem.cell, problem.grasp, straight, scene=problem.scene)
    assert not blocked.feasible
    speeds = [np.linalg.norm(program.twist(clock)[:3]) for clock in np.linspace(begin, end, 200)]
    assert max(speeds) <= 0.25 + 1e-6


def test_it_is_followed_clear_of_all_bodies(found: Any) -> None:
    problem, program = found
    clearance = Clearance(problem.scene)
    controller = QPController(problem.cell, problem.grasp, program, dt=0.01, constraints=[clearance])
    recording = simulate(controller, q_start=problem.q_start)
    assert recording.finished
    assert recording.metadata["failures"] == 0


def test_what_searches_needs_a_start_a_way_and_arms_at_rest_on_the_object() -> None:
    problem = route_cases.posts3()
    over = Search(problem.goal, problem.scene, options={"nodes": NODES})
    with pytest.raises(InvalidInputError, match=r"phase 'over'.*no start.*Search\(start="):
        Program(problem.cell, problem.grasp, [Phase("over", path=over)])
    with pytest.raises(InvalidInputError, match="its way is searched, and arm 'slave_1' moves on the object"):
        Phase("over", path=over, arms={"slave_1": Turns(about=(0.0, 0.0, 0.0), angle=0.1)})
    with pytest.raises(InvalidInputError, match="a path and a duration"):
        Phase("over", path=over, duration=1.0)
    with pytest.raises(InvalidInputError, match="not searched yet"):
        _ = Phase("over", path=over).seconds
    short = Search(problem.goal, problem.scene, options={"nodes": 2}, start=problem.start)
    with pytest.raises(UndecidedError, match="phase 'over'"):
        Program(problem.cell, problem.grasp, [Phase("over", path=short)], q_start=problem.q_start)
