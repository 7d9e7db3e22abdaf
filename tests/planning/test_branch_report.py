"""What the check of an arm says in words, in its table and in its record."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from coopqp.model.batch import ArmKinematics
from coopqp.paths.certificate import follows, worst
from coopqp.paths.joint_trajectories import ArmTrajectory
from coopqp.planning import PathVerdict
from coopqp.planning.arm_check import ArmCheck, arm_record
from coopqp.planning.branch_checks import BranchCheck
from coopqp.scenarios import paper_lift

CERTIFIED, SAMPLED, UNDECIDED, INFEASIBLE = PathVerdict


@pytest.fixture(scope="module")
def trajectory() -> ArmTrajectory:
    kinematics = ArmKinematics(paper_lift().cell.arms[0])
    return ArmTrajectory.sampled(kinematics, np.eye(4), np.arange(3.0), np.zeros((3, 6)))


def branch(trajectory: ArmTrajectory, verdict: PathVerdict = CERTIFIED, **changes: Any) -> BranchCheck:
    values: dict[str, Any] = {
        "verdict": verdict,
        "why": "",
        "until": 2.0,
        "clocks": np.array([0.0, 0.756, 2.0]),
        "q": np.arange(18.0).reshape(3, 6),
        "sigma_min": np.array([0.4, 0.1234, 0.3]),
        "manipulability": np.array([0.2, 0.3, 0.04567]),
        "margins": np.array([np.inf, 1.0, np.deg2rad(12.34), 0.5, 2.0, 3.0]),
        "margin_clocks": np.array([0.0, 0.1, 0.256, 0.3, 0.4, 0.5]),
        "certified": np.array([[0.0, 2.0]]),
        "undecided": np.empty((0, 2)),
        "sigma_bound": 0.1,
        "trajectory": trajectory,
    }
    return BranchCheck(**{**values, **changes})


def report(*branches: BranchCheck, chosen: int | None = 0, trouble: str = "", slides: int | None = None) -> ArmCheck:
    return ArmCheck(
        arm="left",
        joints=tuple(f"joint_{j + 1}" for j in range(6)),
        slides=tuple(j == slides for j in range(6)),
        chosen=None if chosen is None else branches[chosen],
        branches=branches,
        trouble=trouble,
    )


TAIL = "; least margin 12.3° at joint_3 (0.26 s); σ_min 0.123 (0.76 s); manipulability 0.0457 (2.00 s)."


@pytest.mark.parametrize(
    ("verdicts", "begin"),
    [
        ([CERTIFIED], "arm left follows the path"),
        ([SAMPLED], "arm left follows the path"),
        ([UNDECIDED], "arm left may not follow the path"),
        ([CERTIFIED, INFEASIBLE, SAMPLED], "arm left: 2 of 3 branches follow the path"),
        ([CERTIFIED, UNDECIDED], "arm left: 1 of 2 branches follow the path, 1 is not decided"),
        ([UNDECIDED, UNDECIDED], "arm left: 0 of 2 branches follow the path, 2 are not decided"),
    ],
)
def test_branches_that_follow_and_that_are_open_are_counted(
    trajectory: ArmTrajectory, verdicts: list[PathVerdict], begin: str
) -> None:
    check = report(*(branch(trajectory, verdict) for verdict in verdicts))
    assert check.explain() == begin + TAIL
    assert check.verdict is verdicts[0]
    assert check.follows


def test_trouble_and_reasons_are_sentences(trajectory: ArmTrajectory) -> None:
    nowhere = report(chosen=None, trouble="arm left does not reach its grasp")
    assert nowhere.explain() == "arm left does not reach its grasp."
    assert nowhere.verdict is INFEASIBLE
    assert not nowhere.follows
    known = report(branch(trajectory, INFEASIBLE), trouble="arm left leaves its limits")
    assert known.explain() == "arm left leaves its limits."
    assert not known.follows
    open_ = report(branch(trajectory, UNDECIDED, why="is not decided on 1–2 s"))
    assert open_.explain() == f"arm left may not follow the path{TAIL} It is not decided on 1–2 s."


def test_margins_have_the_unit_of_their_joint(trajectory: ArmTrajectory) -> None:
    slides = report(branch(trajectory), slides=2)
    assert "least margin 215.4 mm at joint_3 (0.26 s)" in slides.explain()
    free = report(branch(trajectory, margins=np.full(6, np.inf)))
    assert "least margin none: its joints have no limits;" in free.explain()


def test_the_table_marks_the_branch_that_is_checked(trajectory: ArmTrajectory) -> None:
    out = branch(trajectory, INFEASIBLE, why="ends")
    assert report(out, branch(trajectory), chosen=1).table() == [
        ["branch", "verdict", "least margin", "σ_min", "because it"],
        ["1", "infeasible", "12.3° at joint_3 (0.26 s)", "0.123", "ends"],
        ["2*", "certified", "12.3° at joint_3 (0.26 s)", "0.123", ""],
    ]


def test_the_record_of_an_arm_is_what_json_can_hold(trajectory: ArmTrajectory) -> None:
    open_ = branch(
        trajectory, UNDECIDED, why="so", until=1.5, sigma_bound=0.0, certified=np.array([[0.0, 1.0]]),
        undecided=np.array([[1.0, 2.0]]),
    )  # fmt: skip
    record = json.loads(json.dumps(arm_record(report(branch(trajectory), open_, chosen=1, trouble="t"))))
    first, second = record.pop("branches")
    assert record == {
        "name": "left",
        "verdict": "UNDECIDED",
        "reason": "t",
        "joints": [f"joint_{j}" for j in range(1, 7)],
        "chosen": 1,
    }
    assert first == {
        "verdict": "CERTIFIED",
        "reason": "",
        "until_s": 2.0,
        "q": [0.0, 1.0, 2.0, 3.0, 4.0, 5.0],
        "margins": [None, 1.0, np.deg2rad(12.34), 0.5, 2.0, 3.0],
        "margin_clocks_s": [0.0, 0.1, 0.256, 0.3, 0.4, 0.5],
        "sigma_min": 0.1234,
        "sigma_min_clock_s": 0.756,
        "sigma_min_bound": 0.1,
        "manipulability": 0.04567,
        "manipulability_clock_s": 2.0,
        "certified_s": [[0.0, 2.0]],
        "undecided_s": [],
    }
    changed = {"verdict": "UNDECIDED", "reason": "so", "until_s": 1.5, "sigma_min_bound": None}
    assert second == {**first, **changed, "certified_s": [[0.0, 1.0]], "undecided_s": [[1.0, 2.0]]}
    assert arm_record(report(chosen=None, trouble="t"))["chosen"] is None


def test_the_worst_verdict_is_the_last_in_the_order_of_trust() -> None:
    assert worst([CERTIFIED, SAMPLED]) is SAMPLED
    assert worst([INFEASIBLE, UNDECIDED, CERTIFIED]) is INFEASIBLE
    assert worst([SAMPLED, UNDECIDED]) is UNDECIDED
    assert [follows(verdict) for verdict in PathVerdict] == [True, True, False, False]


def test_the_tightest_joint_is_the_one_with_the_least_margin(trajectory: ArmTrajectory) -> None:
    assert branch(trajectory).tightest == 2
    outside = branch(trajectory)
    assert replace(outside, margins=np.array([1.0, 2.0, 3.0, -0.1, 0.0, 5.0])).tightest == 3
