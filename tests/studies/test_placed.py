"""Figures of a placement from those of its arms: order, score, time, reasons and record."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from coopqp import InvalidInputError
from coopqp.studies import CellPlaced, Goals
from coopqp.studies.placed import ArmPlaced

LEFT = ArmPlaced(
    arm="left", robot="", feasible=True, reach=1.0, sigma_min=0.1, margin=0.5, tightest="joint_2", slides=False,
    times=np.array([1.0, 0.5, 0.2]), q=np.array([0.1, 0.2]), shares=(0.5, 0.9), why="",
)  # fmt: skip
RIGHT = replace(LEFT, arm="right", tightest="rail", slides=True, margin=0.04, shares=(0.8, 0.4),
                times=np.array([0.2, 0.7, 0.3]))  # fmt: skip
LOST = replace(LEFT, arm="right", feasible=False, reach=0.25, shares=(0.0, 0.0), times=np.empty(0),
               margin=float("nan"), why="arm right is too far")  # fmt: skip


def cell(*arms: ArmPlaced, clearance: float = 0.05, **changes: Any) -> CellPlaced:
    bases = tuple(pin.SE3(np.eye(3), np.array([float(k), 0.0, 0.0])) for k in range(len(arms)))
    given = {"values": {"x": 0.5}, "near": ("left/link_3", "post"), "near_s": 1.25, "goals": Goals(clearance_mm=20.0)}
    return CellPlaced(bases=bases, arms=arms, clearance=clearance, **{**given, **changes})


def test_the_score_is_the_least_share_and_the_time_that_of_the_slowest_arm_at_each_part() -> None:
    placed = cell(LEFT, RIGHT)
    assert placed.follows
    assert placed.feasible
    assert placed.score == 0.4
    assert placed.rank == (0.4, 0.5, 0.8, 0.9)
    assert placed.time_s == pytest.approx(1.0 + 0.7 + 0.3)
    assert [LEFT.time_s, RIGHT.time_s] == pytest.approx([1.7, 1.2])
    assert placed.why == ""
    lines = placed.explain().splitlines()
    assert lines[0].startswith("arm left: σ_min 0.100, least margin 28.6°")
    assert "at joint_2, by speed limits alone 1.70 s" in lines[0]
    assert "40.0 mm at rail" in lines[1]
    assert "by speed limits alone 2.00 s" in lines[2]
    assert "right's margin is 0.40 of good" in lines[2]
    assert lines[3] == "closest: left/link_3 and post, 50 mm at 1.25 s of the path"
    assert "left's σ_min is 0.50 of good" in cell(LEFT).explain()


def test_what_touches_is_worse_than_what_is_clear_and_better_than_what_does_not_follow() -> None:
    clear, near, touching = cell(LEFT, RIGHT), cell(LEFT, RIGHT, clearance=0.01), cell(LEFT, RIGHT, clearance=-0.02)
    lost, lost_later = cell(LEFT, LOST), cell(LEFT, replace(LOST, reach=0.75))
    ranks = [placed.rank for placed in (lost, lost_later, touching, near, clear)]
    assert ranks == sorted(ranks)
    assert len(set(ranks)) == 5
    assert touching.rank == (-1.02,)
    assert near.rank == (-1.0,)
    assert lost.rank == (-2.0 + 0.625,)
    for placed in (near, touching, lost):
        assert not placed.feasible
        assert np.isnan(placed.score)
    assert near.time_s == clear.time_s
    assert np.isnan(lost.time_s)
    assert np.isnan(LOST.time_s)
    assert near.why == "left/link_3 and post come inside their margin of 20 mm: 10 mm at 1.25 s of the path"
    assert touching.why == "left/link_3 and post touch at 1.25 s of the path"
    assert f"{near.why}." in near.explain().splitlines()
    assert not cell(LEFT, clearance=0.02).touches  # at the threshold it is good
    assert not cell(LEFT, clearance=float("nan")).touches


def test_the_arm_that_follows_least_is_named_first() -> None:
    both = cell(replace(LOST, arm="left", reach=0.5, why="arm left is short"), LOST, clearance=float("nan"))
    assert both.why == "arm right is too far; arm left is short"
    lines = both.explain().splitlines()
    assert lines == ["arm left is short.", "arm right is too far."]
    assert "joints that arms share: lift 0.3 m." in cell(LEFT, shared=("lift 0.3 m",)).explain()


def test_a_record_is_json_without_nan() -> None:
    lost = cell(LEFT, LOST, clearance=float("nan"))
    record = json.loads(json.dumps(lost.record(), allow_nan=False))
    assert record["values"] == {"x": 0.5}
    assert [record[name] for name in ("feasible", "score", "time_s", "clearance_m")] == [False, None, None, None]
    assert record["why"] == "arm right is too far"
    assert list(record["bases"]) == ["left", "right"]
    np.testing.assert_array_equal(record["bases"]["right"]["matrix"], lost.bases[1].homogeneous)
    left, right = record["arms"]
    assert left == {
        "name": "left", "feasible": True, "reach": 1.0, "sigma_min": 0.1, "margin": 0.5, "tightest": "joint_2",
        "time_s": pytest.approx(1.7), "q_start": [0.1, 0.2], "why": "",
    }  # fmt: skip
    assert (right["margin"], right["time_s"], right["reach"]) == (None, None, 0.25)
    good = cell(LEFT, replace(RIGHT, robot="torso")).record()
    assert (good["score"], good["clearance_m"], good["near"]) == (0.4, 0.05, ["left/link_3", "post"])
    assert good["near_s"] == 1.25
    assert list(good["bases"]) == ["left", "torso"]


@pytest.mark.parametrize("name", ["sigma_min", "margin_deg", "margin_mm", "clearance_mm"])
@pytest.mark.parametrize("value", [-1.0, float("nan"), "a"])
def test_goals_are_positive_numbers(name: str, value: Any) -> None:
    with pytest.raises(InvalidInputError, match=name):
        Goals(**{name: value})
    assert Goals(clearance_mm=0.0).clearance_mm == 0.0
