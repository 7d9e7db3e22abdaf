"""Remedies: what is changed by them, and what is said of them and of a whole check."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from user_paths import Opaque

from coopqp import Grasp, HoldPath, LinePath, ObjectPath, RobotCell, WaypointPath, check_path
from coopqp.collision.clearance_check import ClearanceCheck
from coopqp.model.shapes import NearPair
from coopqp.planning import PathCheck, PathVerdict, find_remedies
from coopqp.planning.arm_check import UndecidedInterval
from coopqp.planning.arm_starts import rolled
from coopqp.planning.check import Remedy, places_along
from coopqp.planning.remedies import Remedies, shifted
from coopqp.scenarios import paper_lift

CERTIFIED, SAMPLED, UNDECIDED, INFEASIBLE = PathVerdict
D = np.array([0.1, -0.2, 0.3])


@pytest.fixture(scope="module")
def check() -> PathCheck:
    task = paper_lift()
    return check_path(task.cell, task.grasp, task.path, q_start=task.q_start)


def way() -> WaypointPath:
    poses = [pin.SE3(pin.exp3(np.array([0.0, 0.1 * i, 0.2])), np.array([0.1 * i, 0.0, i * i * 0.1])) for i in range(3)]
    return WaypointPath(poses, durations=[1.0, 0.5], time_law="quintic")


PATHS: list[ObjectPath] = [
    LinePath(pin.SE3.Identity(), pin.SE3(np.eye(3), np.ones(3)), duration=2.0, time_law="linear"),
    LinePath(pin.SE3.Identity(), pin.SE3(np.eye(3), np.ones(3)), duration=2.0, time_law="quintic"),
    way(),
    HoldPath(way().pose(0.7), duration=3.0),
    Opaque(way()),
]


@pytest.mark.parametrize("path", PATHS, ids=lambda path: type(path).__name__)
def test_a_path_is_moved_as_a_whole(path: ObjectPath) -> None:
    moved = shifted(path, D)
    if not isinstance(path, Opaque):
        assert type(moved) is type(path)
    assert moved.duration == path.duration
    assert moved.known_ahead == path.known_ahead
    for clock in np.linspace(0.0, path.duration, 9):
        T, S = path.pose(clock), moved.pose(clock)
        np.testing.assert_allclose(S.translation, T.translation + D, atol=1e-12)
        np.testing.assert_allclose(S.rotation, T.rotation, atol=1e-12)
        np.testing.assert_allclose(moved.twist(clock), path.twist(clock), atol=1e-12)
        assert moved.next_breakpoint(clock) == path.next_breakpoint(clock)


def test_remedies_and_failures_are_told_apart(check: PathCheck) -> None:
    one, two = (Remedy(kind="shift", text=text, check=check) for text in ("a", "b"))
    tries: list[Remedy | str] = [one, "no roll", two, "no base"]
    found = Remedies.of(iter(tries))
    assert tuple(found) == (one, two)
    assert found.failed == ("no roll", "no base")
    assert Remedies().failed == ()


def test_a_path_that_is_followed_needs_no_remedy(check: PathCheck) -> None:
    assert check.feasible
    assert find_remedies(check) == ()
    assert find_remedies(check).failed == ()


def test_a_remedy_says_what_it_changes_and_its_verdict(check: PathCheck) -> None:
    remedy = Remedy(kind="shift", text="move the path by (0, 0, 0.1) m", check=check, shift=D)
    assert str(remedy) == "move the path by (0, 0, 0.1) m (certified)"
    assert check.q_start is not None
    assert json.loads(json.dumps(remedy.record())) == {
        "kind": "shift",
        "text": "move the path by (0, 0, 0.1) m",
        "verdict": "CERTIFIED",
        "shift_m": D.tolist(),
        "roll_rad": None,
        "q_start": check.q_start.tolist(),
    }
    rolls = np.array([0.0, np.pi, 0.0])
    rolled = Remedy(kind="roll", text="", check=replace(check, q_start=None), roll=rolls).record()
    assert (rolled["shift_m"], rolled["roll_rad"], rolled["q_start"]) == (None, rolls.tolist(), None)


def test_where_no_arm_gets_the_obstacles_to_all_kinds_are_told() -> None:
    """A path farther away than any remedy reaches."""
    task = paper_lift()
    cell, grasp = RobotCell(task.cell.arms[:1]), Grasp(task.grasp.T_object_tool[:1])
    far = shifted(task.path, np.array([0.0, 0.0, 9.0]))
    found = find_remedies(check_path(cell, grasp, far))
    name = cell.arm_names[0]
    assert not found
    nowhere = f"arm {name} follows it at none of 130 places up to 0.5 m away"
    assert found.failed == (
        f"rolling tools: arm {name} follows the path at none of 19 angles",
        f"moving the path: {nowhere}",
        f"moving bases: {nowhere}",
    )


# -- the whole check -------------------------------------------------------------------------------------------------


def distances(**changes: Any) -> ClearanceCheck:
    values: dict[str, Any] = {
        "verdict": CERTIFIED, "pair": None, "margin": 0.0, "clock": 0.0, "proved": 0.0, "stop": None,
        "stopped_by": None, "undecided": np.empty((0, 2)), "why": "", "clocks": np.zeros(1), "distances": np.zeros(1),
    }  # fmt: skip
    return ClearanceCheck(**{**values, **changes})


@pytest.mark.parametrize(
    ("verdict", "given", "head", "end"),
    [
        (CERTIFIED, True, "The arms can follow the whole path{}: this is proved at every point of it.", ""),
        (SAMPLED, True, "The arms follow the path{} at samples; between them nothing is proved.", ""),
        (INFEASIBLE, True, "The arms cannot follow the path{}", " from this start."),
        (INFEASIBLE, False, "The arms cannot follow the path{}", ", from any start."),
    ],
)
def test_the_verdict_is_a_sentence_with_or_without_distances(
    check: PathCheck, verdict: PathVerdict, given: bool, head: str, end: str
) -> None:
    alone = replace(check, verdict=verdict, given=given)
    assert alone.explain().splitlines()[0] == head.format("") + end
    both = replace(alone, clearance=distances(pair=NearPair("a", "b", 1.0)))
    assert both.explain().splitlines()[0] == head.format(" and keep their distances") + end
    none = replace(alone, clearance=distances()).explain().splitlines()
    assert (none[0], none[-1]) == (head.format("") + end, "distances: no pair keeps one.")
    assert len(alone.explain().splitlines()) == 1 + 3


def test_of_what_is_not_decided_three_intervals_are_told(check: PathCheck) -> None:
    intervals = tuple(UndecidedInterval(arm=f"a{i}", start=float(i), end=i + 0.5) for i in range(2))
    open_ = replace(check, verdict=UNDECIDED, intervals=intervals)
    assert open_.explain().splitlines()[0].endswith("path: 0–0.5 s for arm a0, 1–1.5 s for arm a1.")
    near = distances(verdict=UNDECIDED, undecided=np.array([[2.0, 2.25], [3.0, 4.0]]))
    more = replace(open_, clearance=near).explain().splitlines()[0]
    assert more.endswith("0–0.5 s for arm a0, 1–1.5 s for arm a1, 2–2.25 s for distances and 1 more.")
    sampled = replace(open_, clearance=distances(verdict=SAMPLED, undecided=near.undecided, pair=NearPair("a", "b", 1)))
    assert "for distances" not in sampled.explain().splitlines()[0]


def test_remedies_come_last_and_failures_only_without_any(check: PathCheck) -> None:
    remedy = Remedy(kind="shift", text="move it", check=check)
    lost = replace(check, verdict=INFEASIBLE, scene=object(), no_remedy=("rolling: no",))  # type: ignore[arg-type]
    assert lost.explain().splitlines()[-2:] == [
        "distances: not looked at, since an arm cannot follow the path.",
        "no remedy by rolling: no.",
    ]
    helped = replace(lost, remedies=(remedy,)).explain()
    assert helped.splitlines()[-1] == "remedy: move it (certified)."
    assert "no remedy" not in helped


def test_a_check_names_the_verdict_of_each_arm(check: PathCheck) -> None:
    names = check.cell.arm_names
    assert repr(check) == f"PathCheck(certified; {', '.join(f'{name}: certified' for name in names)})"


def test_places_along_a_path_count_its_pieces(check: PathCheck) -> None:
    geometry = way().geometry()
    assert geometry is not None
    first, end = geometry.marks[1:]
    s = np.array([0.0, 0.25 * first, first * (1.0 - 1e-12), first, first + 0.5 * (end - first), end])
    np.testing.assert_array_equal(places_along(geometry, s)[[0, 2, 3, 5]], [0.0, 1.0, 1.0, 2.0])
    np.testing.assert_allclose(places_along(geometry, s), [0.0, 0.25, 1.0, 1.0, 1.5, 2.0], atol=1e-9)


@pytest.mark.parametrize("turned", [90.0, -90.0])
def test_a_tool_that_is_held_a_quarter_turn_off_is_turned_back(check: PathCheck, turned: float) -> None:
    """The joints of one arm have room about its way along the path alone."""
    cell, own, chosen = check.cell, check.cell.columns[1], check.arms[1].chosen
    assert chosen is not None
    lower, upper = cell.limits.lower.copy(), cell.limits.upper.copy()
    lower[own], upper[own] = chosen.q.min(axis=0) - 0.1, chosen.q.max(axis=0) + 0.1
    tools = list(check.grasp.T_object_tool)
    tools[1] = rolled(tools[1], np.deg2rad(turned))
    off = check_path(cell.with_limits(lower=lower, upper=upper), Grasp(tuple(tools)), check.path)
    assert off.verdict is INFEASIBLE
    first = find_remedies(off)[0]
    assert first.kind == "roll"
    assert first.text == f"roll the tool of arm slave_1 by {-turned:.0f}°"
    np.testing.assert_allclose(first.roll, [0.0, -np.deg2rad(turned), 0.0])
    assert first.check.verdict is CERTIFIED
