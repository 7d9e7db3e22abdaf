"""What a verdict says of a run: figures, causes and times, compared with runs whose faults are known by hand."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from coopqp import Arm, InvalidInputError, Recording, RobotCell, Status
from coopqp.scenarios import Scenario, robot_path
from coopqp.simulation import RecordingError, ViolationKind, check_run, evaluate, read_run
from coopqp.simulation.evaluation.assessment import Finding, run_figures
from coopqp.spatial import Array

STEPS, DT = 20, 0.1
ARRIVED, ENDED = "Did the object arrive?", "Did all phases end?"
CLEAR, CARRIED = "Did all keep clear?", "Do the arms carry the load?"
SQUEEZED, HELD = "Is the object held without squeezing?", "Do the palms hold the object?"
POSITIONS, RATES = "Are the joints inside their positions?", "Are the joints within speed and acceleration?"


def at_rest(task: Scenario, **changes: Any) -> Recording:
    """A sound run of twenty steps of 0.1 s: the arms rest, and so does the path, whose clock goes on."""
    time = DT * np.arange(STEPS + 1.0)
    q = np.tile(task.q_start, (STEPS + 1, 1))
    made = Recording(
        time=time, q=q, q_command=q, velocity=np.zeros((STEPS, task.cell.nv)), clock=time, rate=np.ones(STEPS),
        status=np.zeros(STEPS), reference=np.tile(task.path.pose(0.0).homogeneous, (STEPS + 1, 1, 1)),
        T_object_tool=np.array([X.homogeneous for X in task.grasp.T_object_tool]), notes=(),
        metadata={"duration": STEPS * DT, "finished": True},
    )  # fmt: skip
    metadata = {**made.metadata, **changes.pop("metadata", {})}
    return replace(made, metadata=metadata, **changes)


def findings(task: Scenario, run: Recording) -> dict[str, Finding]:
    """The verdict by its questions."""
    return {found.question: found for found in evaluate(task.cell, run, read_run(task.cell, run))}


def finding(task: Scenario, run: Recording, question: str) -> Finding:
    """One line of the verdict; a cause is told where the answer is no."""
    found = findings(task, run)[question]
    assert found.holds == (not found.cause) or question == ENDED
    return found


def changed(shape: tuple[int, ...], entries: dict[Any, float]) -> Array:
    """Zeros but for some entries."""
    out = np.zeros(shape)
    for at, value in entries.items():
        out[at] = value
    return out


# -- forces and torques ------------------------------------------------------------------------------------------------


def loaded(task: Scenario, load: dict[str, Any], **changes: Any) -> Recording:
    n = STEPS
    still = {"wrenches": np.zeros((n, len(task.cell), 6)), "torques": np.zeros((n, task.cell.nv))}
    return at_rest(task, **{**still, **changes}, metadata={"load": load})


def test_the_joint_with_the_largest_torque_is_named_since_it_was_too_much(paper: Scenario) -> None:
    limits: list[float | None] = [None] * paper.cell.nv
    limits[7], limits[3] = 50.0, 20.0
    torques = changed((STEPS, paper.cell.nv), {(2, 7): 30.0, (4, 3): 21.0, (6, 7): -55.0, (9, 7): 52.0, (9, 0): 1e4})
    run = loaded(paper, {"torque_limits": limits}, torques=torques)
    found = finding(paper, run, CARRIED)
    assert found.answer == "at most 110.0 % of a torque (slave_1/joint_2)"
    assert found.cause == "slave_1/joint_2: torque, since 0.700 s"
    violations = [v for v in check_run(run, paper.cell).violations if v.kind is ViolationKind.TORQUE]
    assert [(v.step, v.arm, v.joint) for v in violations] == [
        (4, "master", "joint_4"), (6, "slave_1", "joint_2"), (9, "slave_1", "joint_2")
    ]  # fmt: skip
    np.testing.assert_allclose([v.amount for v in violations], [0.05, 0.1, 0.04])
    np.testing.assert_allclose([v.time for v in violations], [0.5, 0.7, 1.0])
    figures = run_figures(paper.cell, run, read_run(paper.cell, run))
    assert figures["torque, most used"] == "110.0 % (slave_1/joint_2, 0.70 s)"
    assert [figures[f"torque of {arm}"] for arm in paper.cell.arm_names] == [
        "105.0 % of its limit", "110.0 % of its limit", "0.0 % of its limit"
    ]  # fmt: skip
    just = loaded(paper, {"torque_limits": limits}, torques=np.clip(torques, -20.0, 20.0))
    assert finding(paper, just, CARRIED).answer == "at most 100.0 % of a torque (master/joint_4)"
    assert check_run(just, paper.cell).ok


def test_loads_that_are_no_numbers_are_not_kept(paper: Scenario) -> None:
    load = {"torque_limits": [50.0] * 18, "internal_force": 10.0}
    heavy = loaded(paper, load, torques=changed((STEPS, 18), {(4, 7): math.nan}))
    assert finding(paper, heavy, CARRIED).cause == "slave_1/joint_2: torque, since 0.500 s"
    lost = loaded(paper, load, wrenches=changed((STEPS, 3, 6), {(6, 0, 2): math.nan}))
    assert finding(paper, lost, SQUEEZED).cause.endswith("internal force, since 0.700 s")
    for run, kind in ((heavy, ViolationKind.TORQUE), (lost, ViolationKind.SQUEEZE)):
        assert set(check_run(run, paper.cell).counts) == {kind}


def pushed(task: Scenario, newtons: dict[int, float]) -> Array:
    """Wrenches (T, N, 6) of two arms that push against each other along the line between them in some steps."""
    tools = task.grasp.T_object_tool
    way = tools[2].translation - tools[1].translation
    way /= np.linalg.norm(way)
    out = np.zeros((STEPS, len(tools), 6))
    for step, force in newtons.items():
        out[step, 1, :3], out[step, 2, :3] = force * tools[1].rotation.T @ way, -force * tools[2].rotation.T @ way
    return out


def test_arms_that_push_against_each_other_squeeze_once_the_object_moves(paper: Scenario) -> None:
    wrenches = pushed(paper, {1: 90.0, 3: 2.0, 8: 11.0, 12: 14.0, STEPS - 1: 4.0})
    wrenches[8, 0, 2] = 1e-3  # hardly anything of a third arm
    rate = np.r_[np.zeros(3), np.ones(STEPS - 3)]
    run = loaded(paper, {"internal_force": 10.0}, wrenches=wrenches, rate=rate)
    found = finding(paper, run, SQUEEZED)
    assert found.answer == "internal force ≤ 14.0 N in motion (accepted: 10 N)"
    assert found.cause in {f"arm {arm}: internal force, since 0.900 s" for arm in ("slave_1", "slave_2")}
    figures = run_figures(paper.cell, run, read_run(paper.cell, run))
    assert figures["internal force in motion"].startswith("14.0 N (slave_")
    assert figures["internal force in motion"].endswith(", 1.30 s)")
    assert figures["internal force at the end"] == "4.0 N"
    assert {v.step for v in check_run(run, paper.cell).violations if v.kind is ViolationKind.SQUEEZE} == {8, 12}
    free = replace(run, metadata={**run.metadata, "load": {}})
    assert finding(paper, free, SQUEEZED).answer == "internal force ≤ 14.0 N in motion"
    never = loaded(paper, {"internal_force": 10.0}, wrenches=wrenches, rate=np.zeros(STEPS))
    assert finding(paper, never, SQUEEZED).answer == "the object did not move"
    assert "internal force in motion" not in run_figures(paper.cell, never, read_run(paper.cell, never))


PALMS = {"palms": [{"kind": "palm", "friction": 0.5}] * 3}


def pressed(newtons: float = 100.0, across: dict[tuple[int, int], float] | None = None) -> Array:
    """Wrenches of palms that press along their z axes, with forces across in some steps and arms."""
    out = np.zeros((STEPS, 3, 6))
    out[:, :, 2] = newtons
    for (step, arm), force in (across or {}).items():
        out[step, arm, 0] = force
    return out


def test_the_used_friction_of_palms_is_that_of_coulomb_s_law(paper: Scenario) -> None:
    rate = np.r_[np.zeros(4), np.ones(STEPS - 4)]
    run = loaded(paper, PALMS, wrenches=pressed(across={(2, 0): 49.0, (7, 1): -21.0, (9, 2): 10.0}), rate=rate)
    assert finding(paper, run, HELD).answer == "at most 42 % of a palm's friction (slave_1)"
    figures = run_figures(paper.cell, run, read_run(paper.cell, run))
    assert figures["friction, most used"] == "42.0 % (slave_1, 0.80 s)"
    assert "squeeze at the end" in figures
    assert "internal force in motion" not in figures
    wrenches = pressed()
    wrenches[1, 0, 2], wrenches[11, 2, 2], wrenches[13:, 1, 2] = -1.0, -5.0, 0.0
    lost = replace(run, wrenches=wrenches)
    found = finding(paper, lost, HELD)
    assert (found.answer, found.cause) == ("arm slave_2 let go", "arm slave_2: friction, since 1.200 s")
    still = replace(run, wrenches=wrenches, rate=np.zeros(STEPS))
    assert finding(paper, still, HELD).answer == "the object did not move"
    assert "friction, most used" not in run_figures(paper.cell, still, read_run(paper.cell, still))


@pytest.mark.parametrize(
    "load",
    [
        5,
        [1.0],
        {"torque_limits": ["strong"] * 18},
        {"torque_limits": [1.0] * 17},
        {"torque_limits": 5.0},
        {"internal_force": "much"},
        {"internal_force": [1.0]},
        {"internal_force": 10**400},
        {"palms": 5},
        {"palms": [{"kind": "odd"}] * 3},
        {"palms": [{"kind": "palm", "friction": 0.5}] * 2},
        {"palms": [{"kind": "rigid"}] * 3},
        {"torque_limits": [1.0]},
        {"palms": [{"colour": "red"}] * 3},
        {"palms": ["palm"] * 3},
    ],
)
def test_a_damaged_load_is_named(paper: Scenario, load: Any) -> None:
    with pytest.raises(RecordingError, match="'load' in the recording's metadata is damaged"):
        findings(paper, loaded(paper, load))


def test_forces_of_another_cell_are_refused_and_half_of_them_are_none(paper: Scenario) -> None:
    for changes in ({"torques": np.zeros((STEPS, 17))}, {"wrenches": np.zeros((STEPS, 2, 6))}):
        with pytest.raises(InvalidInputError, match="forces of another cell"):
            check_run(loaded(paper, {}, **changes), paper.cell)
    for name in ("torques", "wrenches"):
        run = loaded(paper, {}, **{name: None})
        assert CARRIED not in findings(paper, run)


# -- the end -----------------------------------------------------------------------------------------------------------


def coded(*parts: tuple[Status, int]) -> Array:
    """The codes of statuses, each for a number of steps; TRACKING for the rest."""
    codes = [status.code for status, steps in parts for _ in range(steps)]
    return np.array([*codes, *[Status.TRACKING.code] * (STEPS - len(codes))], dtype=float)


@pytest.mark.parametrize(
    ("changes", "answer", "cause"),
    [
        ({}, "2 s for a path of 2 s, 0 of 20 steps slowed", ""),
        (
            {"status": coded((Status.TRACKING, 3), (Status.SLOWED, 4), (Status.BLOCKED, 2))},
            "2 s for a path of 2 s, 6 of 20 steps slowed",
            "",
        ),
        (
            {"status": coded((Status.TRACKING, 1), (Status.PAUSED, 2), (Status.JOGGING, 3), (Status.OFF_PATH, 4))},
            "2 s for a path of 2 s, 0 of 20 steps slowed, 2 paused, 3 led by hand, 4 off the path",
            "",
        ),
        (
            {"status": coded((Status.TRACKING, 5), (Status.HOLDING, 2)), "notes": ("5: arms are lost.", "9: other")},
            "2 s for a path of 2 s, 0 of 20 steps slowed, 2 steps stopped by a failure",
            "holding from 0.500 s on: arms are lost",
        ),
        (
            {"status": coded((Status.TRACKING, 16), (Status.BLOCKED, 4)), "metadata": {"finished": False},
             "notes": ("3: early", "16: too far.", "17: much too far.", "x: no step", "20: late")},
            "the object's clock stands at 2 s after 2 s for a path of 2 s",
            "blocked since 1.600 s: much too far",
        ),
        (
            {"status": coded((Status.TRACKING, 14), (Status.BLOCKED, 2), (Status.HOLDING, 2), (Status.FAULT, 2)),
             "metadata": {"finished": False}, "notes": ("14: it began",)},
            "the object's clock stands at 2 s after 2 s for a path of 2 s, 4 steps stopped by a failure",
            "fault since 1.400 s: it began",
        ),
        (
            {"metadata": {"finished": False}},
            "the object's clock stands at 2 s after 2 s for a path of 2 s",
            "the run ended before the path did, at 2.000 s",
        ),
        (
            {"status": coded((Status.TRACKING, 17), (Status.WAITING, 3)), "metadata": {"finished": False}},
            "the object's clock stands at 2 s after 2 s for a path of 2 s, 3 waiting",
            "waiting since 1.700 s",
        ),
        ({"metadata": {"finished": False, "duration": math.inf}}, "2 s, 0 of 20 steps slowed; the path has no end", ""),
    ],
)  # fmt: skip
def test_the_end_of_a_run_in_words(paper: Scenario, changes: dict[str, Any], answer: str, cause: str) -> None:
    found = finding(paper, at_rest(paper, **changes), ARRIVED)
    assert (found.answer, found.cause) == (answer, cause)


def test_limits_that_stopped_a_run_are_named_longest_first(paper: Scenario) -> None:
    def limit(joint: int, kind: str = "velocity") -> list[str]:
        return ["slave_1", f"joint_{joint}", kind]

    binding = [[3, [limit(6)]], [10, [limit(5), limit(2)]], [12, [limit(1), limit(2)]], [13, [limit(1), limit(4)]],
               [16, [limit(4)]], [18, []]]  # fmt: skip
    status = coded((Status.TRACKING, 10), (Status.BLOCKED, 10))
    run = at_rest(paper, status=status, notes=("10: the reason",), metadata={"finished": False, "binding": binding})
    first, second, third = (f"arm slave_1 joint joint_{j}: velocity" for j in (4, 1, 2))
    assert finding(paper, run, ARRIVED).cause == f"blocked since 1.000 s by {first}, {second}, {third}"


# -- phases ------------------------------------------------------------------------------------------------------------


def of_phases(*spans: tuple[str, float, float]) -> dict[str, Any]:
    return {"phases": [{"name": name, "start_s": start, "end_s": end} for name, start, end in spans]}


def test_the_time_in_each_phase_and_at_its_gate(paper: Scenario) -> None:
    """The clock waits for 0.3 s at the end of the second phase, and the last one is not reached."""
    clock = DT * np.array([*range(11), 10, 10, 10, *range(11, 18)], dtype=float)
    status = coded((Status.TRACKING, 10), (Status.WAITING, 3))
    metadata = of_phases(("reach", 0.0, 0.4), ("lift", 0.4, 1.0), ("set down", 1.0, 1.7), ("go", 1.7, 2.5))
    run = at_rest(paper, clock=clock, status=status, metadata={**metadata, "finished": False})
    found = finding(paper, run, ENDED)
    assert found.answer == "reach 0.4 s; lift 0.6 s, then waiting 0.3 s; set down 0.7 s; go was not reached"
    assert not found.holds
    assert finding(paper, replace(run, metadata={**metadata, "finished": True}), ENDED).holds
    assert ENDED not in findings(paper, at_rest(paper))


@pytest.mark.parametrize(
    "phases", [5, [1.0], [{"name": "a", "start_s": 0.0}], [{"name": "a", "start_s": "early", "end_s": 1.0}]]
)
def test_damaged_phases_are_named(paper: Scenario, phases: Any) -> None:
    with pytest.raises(RecordingError, match="'phases' in the recording's metadata is damaged"):
        findings(paper, at_rest(paper, metadata={"phases": phases}))


# -- distances ---------------------------------------------------------------------------------------------------------

NEAR = {"avoided": True, "left_out": [], "closest_m": 0.0215, "between": ["object", "post"], "time_s": 1.25,
        "margin_m": 0.02}  # fmt: skip
WHERE = "object and post at 1.25 s"
LEFT_OUT = [["a", "c"], ["b", "c"], ["a", "d"]]


@pytest.mark.parametrize(
    ("changes", "answer", "cause"),
    [
        ({}, f"nothing touched: closest 21.5 mm, {WHERE}", ""),
        ({"closest_m": 0.02 - 5e-7}, f"nothing touched: closest 20 mm, {WHERE}", ""),
        (
            {"closest_m": 0.0195},
            f"nothing touched: closest 19.5 mm, {WHERE}",
            f"{WHERE}, inside the margin of 20 mm",
        ),
        ({"closest_m": 0.0195, "avoided": False}, f"nothing touched: closest 19.5 mm, {WHERE}", ""),
        ({"closest_m": 0.0}, f"{WHERE} touched", WHERE),
        ({"closest_m": -0.003, "avoided": False}, f"{WHERE} touched", WHERE),
        (
            {"left_out": LEFT_OUT},
            f"a and b with c, a with d overlap at the start and are not judged; else nothing touched: closest 21.5 mm, "
            f"{WHERE}",
            "a and b with c, a with d overlap at the start",
        ),
        (
            {"left_out": [["a", "c"]], "closest_m": -0.001},
            f"a with c overlap at the start and are not judged; else {WHERE} touched",
            f"a with c overlap at the start; {WHERE}",
        ),
        ({"notes": ["first", "second"]}, f"nothing touched: closest 21.5 mm, {WHERE}; first, and 1 more of the kind",
         ""),
    ],
)  # fmt: skip
def test_the_least_distance_of_a_run_in_words(
    paper: Scenario, changes: dict[str, Any], answer: str, cause: str
) -> None:
    found = finding(paper, at_rest(paper, metadata={"clearance": {**NEAR, **changes}}), CLEAR)
    assert (found.answer, found.cause) == (answer, cause)


def test_pairs_that_are_all_left_out_are_told_without_a_distance(paper: Scenario) -> None:
    entry = {"avoided": False, "left_out": [["a", "c"]]}
    found = finding(paper, at_rest(paper, metadata={"clearance": entry}), CLEAR)
    assert found.answer == "a with c overlap at the start and are not judged"
    assert found.cause == "a with c overlap at the start"


@pytest.mark.parametrize(
    "entry",
    [
        5,
        {},
        {**NEAR, "left_out": [["a"]]},
        {**NEAR, "closest_m": "near"},
        {**NEAR, "closest_m": 10**400},
        {**NEAR, "between": 5},
        {**NEAR, "margin_m": [0.1]},
        {**NEAR, "notes": 5},
        {name: value for name, value in NEAR.items() if name != "time_s"},
        {name: value for name, value in NEAR.items() if name != "avoided"},
    ],
)
def test_a_damaged_clearance_is_named(paper: Scenario, entry: Any) -> None:
    with pytest.raises(RecordingError, match="'clearance' in the recording's metadata is damaged"):
        findings(paper, at_rest(paper, metadata={"clearance": entry}))


# -- joints, arms, the object ------------------------------------------------------------------------------------------


def test_a_joint_outside_is_told_with_its_amount_and_since_when(paper: Scenario) -> None:
    upper, lower = (paper.cell.limits.upper, paper.cell.limits.lower)
    q = at_rest(paper).q_command.copy()
    q[11, 8], q[12, 8], q[5, 2] = upper[8] + np.deg2rad(0.25), upper[8] + np.deg2rad(0.5), lower[2] - np.deg2rad(0.1)
    found = finding(paper, at_rest(paper, q_command=q), POSITIONS)
    assert found.answer == "slave_1/joint_3 is 0.5° outside"
    assert found.cause == "arm slave_1 joint joint_3: position, since 1.100 s"
    q = at_rest(paper).q_command.copy()
    q[3, 13] = lower[13] + np.deg2rad(1.5)
    inside = finding(paper, at_rest(paper, q_command=q), POSITIONS)
    assert inside.answer == "closest: slave_2/joint_2, 1.5° inside"


def test_a_joint_that_moves_no_tool_is_told_outside_alone(paper: Scenario) -> None:
    """Such as fingers, which stand at their limit when they are closed."""
    file = robot_path("rx90l")
    arms = [
        Arm.from_urdf(arm.name, file, tool_frame="wrist_link", T_world_base=arm.T_world_base)
        for arm in paper.cell.arms
    ]  # fmt: skip
    hands = replace(paper, cell=RobotCell(arms))
    q = np.zeros((STEPS + 1, 18))
    q[:, [5, 11, 17]] = hands.cell.limits.upper[5]
    answer = finding(hands, at_rest(hands, q=q, q_command=q), POSITIONS).answer
    assert answer.startswith("closest: ")
    assert "joint_6" not in answer
    q[:, 11] += np.deg2rad(0.5)
    assert finding(hands, at_rest(hands, q=q, q_command=q), POSITIONS).answer == "slave_1/joint_6 is 0.5° outside"
    q[4:6, 13] = np.nan
    lost = finding(paper, at_rest(paper, q_command=q), POSITIONS)
    assert (lost.answer, lost.cause) == ("not finite", "not finite since 0.400 s")
    free = replace(paper, cell=paper.cell.with_limits(lower=-np.inf, upper=np.inf))
    assert finding(free, at_rest(free), POSITIONS).answer == "no joint has a limit"


def test_a_joint_that_is_too_fast_is_told_since_when(paper: Scenario) -> None:
    limited = replace(paper, cell=paper.cell.with_limits(velocity=2.0, acceleration=5.0))
    v = changed((STEPS, 18), {(2, 4): 0.4, (3, 4): 0.8, (9, 14): -2.2, (10, 14): -2.0})
    found = finding(limited, at_rest(limited, velocity=v), RATES)
    assert found.answer == (
        "speed ≤ 110 % of the limit (slave_2/joint_3); acceleration ≤ 440 % of the limit (slave_2/joint_3)"
    )
    assert found.cause == (
        "arm slave_2 joint joint_3: velocity, since 0.900 s; arm slave_2 joint joint_3: acceleration, since 0.900 s"
    )
    v = changed((STEPS, 18), {(0, 4): 0.4, (1, 4): 0.8, (2, 4): 0.4})
    kept = finding(limited, at_rest(limited, velocity=v), RATES)
    assert kept.answer == (
        "speed ≤ 40 % of the limit (master/joint_5); acceleration ≤ 80 % of the limit (master/joint_5)"
    )
    free = replace(paper, cell=paper.cell.with_limits(velocity=np.inf))
    assert finding(free, at_rest(free), RATES).answer == "no limit of speed; no limit of acceleration"


def test_tolerances_come_from_the_recording_and_name_who_is_off(paper: Scenario) -> None:
    """The path is 2 mm away from the sixth sample on: the object is off it, and arms agree."""
    reference = at_rest(paper).reference.copy()
    reference[6:, 0, 3] += 2e-3
    run = at_rest(paper, reference=reference)
    off = finding(paper, run, "Is the object on its path?")
    assert off.answer.endswith("(asked: 1 mm, 0.5°)")
    assert off.cause.startswith("the object at arm ")
    assert off.cause.endswith(", beyond the tolerance since 0.600 s")
    said = {"settings": {"verdict": {"object_mm": 2.5, "object_deg": 0.25, "other": 3}}}
    tolerant = finding(paper, at_rest(paper, reference=reference, metadata=said), "Is the object on its path?")
    assert tolerant.holds
    assert tolerant.answer.endswith("(asked: 2.5 mm, 0.25°)")
    for damaged in (5, {"object_mm": "wide"}, {"object_mm": -1.0}):
        bad = at_rest(paper, metadata={"settings": {"verdict": damaged}})
        with pytest.raises(RecordingError, match="'verdict' in the recording's settings is damaged"):
            findings(paper, bad)


AGREED, ON_PATH = "Do the arms agree on where the object is?", "Is the object on its path?"


def test_the_arms_that_part_most_are_named_since_they_do(paper: Scenario) -> None:
    """A turn of the last arm's flange by 4 mrad, and a smaller one of another, move their views of the object."""
    q = at_rest(paper).q_command.copy()
    assert finding(paper, at_rest(paper), AGREED).answer.endswith("(asked: 0.1 mm, 0.1°)")
    q[9:12, 17] += 4e-3
    q[9:12, 11] -= 1e-3
    found = finding(paper, at_rest(paper, q_command=q), AGREED)
    assert found.cause == "arms slave_1 and slave_2, beyond the tolerance since 0.900 s"
    measured = at_rest(paper, q=q)
    assert finding(paper, measured, AGREED).holds
    off = finding(paper, measured, ON_PATH)
    assert off.cause == "the object at arm slave_2, beyond the tolerance since 0.900 s"
    given = {"object_mm": 5.0, "object_deg": 1.0}
    wide = evaluate(paper.cell, measured, read_run(paper.cell, measured), tolerances=given)
    (asked,) = [f for f in wide if f.question == ON_PATH]
    assert asked.holds
    assert asked.answer.endswith("(asked: 5 mm, 1°)")


def test_arms_are_named_by_the_grasps_that_have_given_way(paper: Scenario) -> None:
    """The arms rest, and the grasps of two are recorded as moved against each other: those two are apart."""
    shift = np.zeros((STEPS, 3, 6))
    shift[7:, 1, 0], shift[7:, 2, 0] = 2e-3, -1.5e-3
    run = at_rest(paper, shift=shift)
    assert finding(paper, run, AGREED).cause == "arms slave_1 and slave_2, beyond the tolerance since 0.800 s"
    assert finding(paper, run, ON_PATH).cause == "the object at arm slave_1, beyond the tolerance since 0.800 s"
