"""The verdict on a program phase by phase, from those on its arms and distances."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from coopqp import LinePath
from coopqp.collision.clearance_check import ClearanceCheck
from coopqp.model.batch import ArmKinematics
from coopqp.model.shapes import NearPair
from coopqp.paths.joint_trajectories import ArmTrajectory
from coopqp.planning import PathVerdict
from coopqp.planning.arm_check import ArmCheck
from coopqp.planning.branch_checks import BranchCheck
from coopqp.planning.phase_checks import explained, phase_checks
from coopqp.programs import Phase, Program
from coopqp.scenarios import Scenario, paper_lift

CERTIFIED, SAMPLED, UNDECIDED, INFEASIBLE = PathVerdict
NOTHING = np.empty((0, 2))


@pytest.fixture(scope="module")
def task() -> Scenario:
    return paper_lift(time_law="quintic")


@pytest.fixture(scope="module")
def program(task: Scenario) -> Program:
    """Up for 1 s, a rest of 2 s, down for 1 s."""
    low = task.path.pose(0.0)
    high = pin.SE3(low.rotation, low.translation + np.array([0.0, 0.0, 0.05]))
    phases = [
        Phase("up", path=LinePath(low, high, duration=1.0)),
        Phase("rest", duration=2.0),
        Phase("down", path=LinePath(high, low, duration=1.0)),
    ]
    return Program(task.cell, task.grasp, phases)


def arm(task: Scenario, name: str, verdict: PathVerdict = CERTIFIED, **changes: Any) -> ArmCheck:
    kinematics = ArmKinematics(task.cell.arms[0])
    values: dict[str, Any] = {
        "verdict": verdict,
        "why": "",
        "until": 4.0,
        "clocks": np.zeros(1),
        "q": np.zeros((1, 6)),
        "sigma_min": np.ones(1),
        "manipulability": np.ones(1),
        "margins": np.ones(6),
        "margin_clocks": np.zeros(6),
        "certified": np.array([[0.0, 4.0]]),
        "undecided": NOTHING,
        "sigma_bound": 0.0,
        "trajectory": ArmTrajectory.sampled(kinematics, np.eye(4), np.zeros(1), np.zeros((1, 6))),
    }
    chosen = BranchCheck(**{**values, **changes})
    trouble = f"arm {name} ends" if verdict is INFEASIBLE else ""
    return ArmCheck(
        arm=name, joints=("j",) * 6, slides=(False,) * 6, chosen=chosen, branches=(chosen,), trouble=trouble
    )


def distances(verdict: PathVerdict = CERTIFIED, **changes: Any) -> ClearanceCheck:
    values: dict[str, Any] = {
        "pair": None, "margin": 0.0, "clock": 0.0, "proved": 0.0, "stop": None, "stopped_by": None,
        "undecided": NOTHING, "why": "", "clocks": np.zeros(1), "distances": np.zeros(1),
    }  # fmt: skip
    return ClearanceCheck(verdict=verdict, **{**values, **changes})


def lines(program: Program, arms: list[ArmCheck], clearance: ClearanceCheck | None = None) -> list[str]:
    found = phase_checks(program, arms, clearance)
    assert [(p.start, p.end) for p in found] == [(0.0, 1.0), (1.0, 3.0), (3.0, 4.0)]
    said = explained(found)
    heads = ["phase up (0–1 s): ", "phase rest (1–3 s): ", "phase down (3–4 s): "]
    assert [text.startswith(head) for text, head in zip(said, heads, strict=True)] == [True] * 3
    return [text[len(head) :] for text, head in zip(said, heads, strict=True)]


def test_other_paths_have_no_phases(task: Scenario) -> None:
    assert phase_checks(task.path, [arm(task, "a")], None) == ()


def test_what_is_alike_for_all_names_no_arm(task: Scenario, program: Program) -> None:
    assert lines(program, [arm(task, "a"), arm(task, "b")], distances()) == ["certified."] * 3
    assert lines(program, [arm(task, n, SAMPLED) for n in "ab"]) == ["sampled."] * 3
    assert lines(program, [arm(task, "a"), arm(task, "b", SAMPLED)]) == ["sampled; arm b."] * 3
    assert lines(program, [arm(task, "a")], distances(SAMPLED)) == ["sampled."] * 3


def test_only_the_phases_of_an_interval_are_not_decided(task: Scenario, program: Program) -> None:
    open_ = arm(task, "b", UNDECIDED, undecided=np.array([[1.0, 2.0]]), certified=np.array([[0.0, 1.0], [2.0, 4.0]]))
    assert lines(program, [arm(task, "a"), open_]) == ["certified.", "undecided; arm b.", "certified."]
    unproved = arm(task, "b", UNDECIDED, undecided=np.array([[1.5, 2.0]]), certified=np.array([[0.0, 1.5]]))
    assert lines(program, [unproved, arm(task, "a")]) == ["certified.", "undecided; arm b.", "sampled; arm b."]
    near = distances(UNDECIDED, undecided=np.array([[2.5, 3.5]]))
    assert lines(program, [arm(task, "a")], near) == ["certified.", "undecided.", "undecided."]


def test_after_an_arm_ends_no_phase_is_reached(task: Scenario, program: Program) -> None:
    ends = arm(task, "b", INFEASIBLE, until=1.5, certified=np.array([[0.0, 1.5]]))
    later = arm(task, "a", INFEASIBLE, until=3.5)
    assert lines(program, [later, ends]) == ["certified.", "infeasible; arm b ends.", "not reached."]
    start = arm(task, "b", INFEASIBLE, until=0.0)
    assert lines(program, [start])[0] == "infeasible; arm b ends."
    assert lines(program, [start])[1:] == ["not reached."] * 2
    at_end = arm(task, "b", INFEASIBLE, until=4.0)
    assert lines(program, [at_end])[2] == "infeasible; arm b ends."
    at_mark = arm(task, "b", INFEASIBLE, until=1.0, certified=np.array([[0.0, 1.0]]))
    assert lines(program, [at_mark]) == ["certified.", "infeasible; arm b ends.", "not reached."]


def test_a_pair_inside_its_margin_ends_the_phases(task: Scenario, program: Program) -> None:
    stop = distances(INFEASIBLE, stop=0.5, stopped_by=NearPair("bar", "post", 0.01))
    found = lines(program, [arm(task, "a"), arm(task, "b", INFEASIBLE, until=2.0)], stop)
    assert found == ["infeasible; bar and post come inside their margin.", "not reached.", "not reached."]


def test_a_pair_that_another_elbow_may_evade_decides_no_phase(task: Scenario, program: Program) -> None:
    """The phases are no worse than the verdict on the distances itself."""
    near = distances(UNDECIDED, stop=1.5, stopped_by=NearPair("elbow", "post", 0.01), undecided=np.array([[1.5, 4.0]]))
    why = "elbow and post come inside their margin on the motion that was found"
    assert lines(program, [arm(task, "a")], near) == ["certified.", f"undecided; {why}.", "undecided."]


def test_the_record_of_a_phase_is_plain(task: Scenario, program: Program) -> None:
    ends = arm(task, "b", INFEASIBLE, until=1.5, certified=np.array([[0.0, 1.5]]))
    _, second, third = (p.record() for p in phase_checks(program, [ends], None))
    assert second == {
        "name": "rest", "start_s": 1.0, "end_s": 3.0, "verdict": "INFEASIBLE", "arm": "b", "why": "arm b ends",
    }  # fmt: skip
    assert (third["verdict"], third["why"]) == (None, "it is not reached")
