"""What the check of distances says in words and in its record."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from coopqp.collision.clearance_check import NO_SHAPES, ClearanceCheck, remark
from coopqp.model.shapes import NearPair
from coopqp.planning import PathVerdict

CERTIFIED, SAMPLED, UNDECIDED, INFEASIBLE = PathVerdict


def near(distance: float, first: str = "plate", second: str = "post") -> NearPair:
    return NearPair(first, second, distance)


def report(verdict: PathVerdict, distance: float | None = 0.0312, **changes: Any) -> ClearanceCheck:
    values: dict[str, Any] = {
        "verdict": verdict,
        "pair": None if distance is None else near(distance),
        "margin": 0.01,
        "clock": 1.234,
        "proved": -np.inf,
        "stop": None,
        "stopped_by": None,
        "undecided": np.empty((0, 2)),
        "why": "",
        "clocks": np.array([0.0, 1.234]),
        "distances": np.array([0.05, 0.0312]),
    }
    return ClearanceCheck(**{**values, **changes})


@pytest.mark.parametrize(
    ("check", "text"),
    [
        (report(CERTIFIED, None), "distances: no pair keeps one."),
        (
            report(CERTIFIED, proved=0.0185),
            "distances: all margins are kept, which is proved; closest 31.2 mm, plate and post at 1.23 s "
            "(proved: at least 28.5 mm).",
        ),
        (
            report(SAMPLED, why="Nothing is proved"),
            "distances: all margins are kept at samples; closest 31.2 mm, plate and post at 1.23 s. Nothing is proved.",
        ),
        (
            report(UNDECIDED, why="not decided on 1–2 s"),
            "distances: not decided on 1–2 s; closest sample 31.2 mm, plate and post at 1.23 s.",
        ),
        (
            report(INFEASIBLE, 0.004, stop=0.857, stopped_by=near(0.01, "arm", "wall")),
            "distances: arm and wall come inside their margin at 0.86 s; closest 4 mm, plate and post at 1.23 s.",
        ),
        (
            report(INFEASIBLE, -0.004, stop=0.857, stopped_by=near(0.01, "arm", "wall"), why="Move it"),
            "distances: arm and wall come inside their margin at 0.86 s; plate and post overlap by 4 mm at 1.23 s. "
            "Move it.",
        ),
        (
            report(INFEASIBLE, 0.0, stop=0.857, stopped_by=near(0.01, "arm", "wall")),
            "distances: arm and wall come inside their margin at 0.86 s; plate and post touch at 1.23 s.",
        ),
        (
            report(INFEASIBLE, 0.004, stop=0.0, stopped_by=near(0.008, "arm", "wall")),
            "distances: arm and wall start 8 mm apart, inside their margin; closest 4 mm, plate and post at 1.23 s.",
        ),
        (
            report(INFEASIBLE, 0.0, stop=0.0, stopped_by=near(0.0, "arm", "wall")),
            "distances: arm and wall start 0 mm apart, inside their margin; plate and post touch at 1.23 s.",
        ),
        (
            report(INFEASIBLE, -0.004, stop=0.0, stopped_by=near(-0.008, "arm", "wall"), why="Move it"),
            "distances: arm and wall start overlapping by 8 mm, inside their margin. Move it.",
        ),
    ],
)
def test_distances_are_told_in_millimetres_with_pair_and_clock(check: ClearanceCheck, text: str) -> None:
    assert check.explain() == text


def test_remarks_follow_on_lines_of_their_own() -> None:
    bare = [f"arm {name} {NO_SHAPES}" for name in "ab"]
    hulls = [f"mesh {name} counts as its hull" for name in "cde"]
    assert remark(()) == []
    assert remark(bare) == bare
    assert remark(hulls[:1]) == hulls[:1]
    assert remark([hulls[0], bare[0], hulls[1], bare[1], hulls[2]]) == [*bare, f"{hulls[0]}, and 2 more of the kind"]
    noted = replace(report(CERTIFIED, None), notes=(hulls[0], bare[0]))
    assert noted.explain().splitlines() == ["distances: no pair keeps one.", f"note: {bare[0]}.", f"note: {hulls[0]}."]


def test_the_record_is_what_json_can_hold() -> None:
    """What is proved has a number, what is not has none."""
    check = report(
        INFEASIBLE, stop=0.5, stopped_by=near(0.008, "arm", "wall"), undecided=np.array([[0.1, 0.2]]), why="so",
        notes=("a",),
    )  # fmt: skip
    expected = {
        "verdict": "INFEASIBLE",
        "closest": {"between": ["plate", "post"], "distance_m": 0.0312},
        "margin_m": 0.01,
        "clock_s": 1.234,
        "proved_m": None,
        "stop_s": 0.5,
        "stopped_by": {"between": ["arm", "wall"], "distance_m": 0.008},
        "undecided_s": [[0.1, 0.2]],
        "reason": "so",
        "clocks_s": [0.0, 1.234],
        "distances_m": [0.05, 0.0312],
        "notes": ["a"],
    }
    assert json.loads(json.dumps(check.record())) == expected
    proved = report(CERTIFIED, None, proved=0.02).record()
    assert proved["proved_m"] == 0.02
    assert proved["closest"] is None
    assert proved["stopped_by"] is None
