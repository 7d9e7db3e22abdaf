"""Notes of a run: one for each change, and one for changes that alternate quickly between few kinds."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from coopqp import BindingLimit, ControlStep, LimitKind, Status
from coopqp.scenarios import Scenario
from coopqp.simulation.recording.notes import Notes

Kind = tuple[Status, str]
TRACKS: Kind = (Status.TRACKING, "")


def steps_of(task: Scenario, kinds: Sequence[Kind], dt: float = 0.01) -> list[ControlStep]:
    """Steps with statuses, each with a joint at its velocity limit, or none."""
    n = task.cell.nv
    return [
        ControlStep(
            cell=task.cell, grasp=task.grasp, path=task.path, q=task.q_start, velocity=np.zeros(n),
            q_next=task.q_start, dt=dt, clock=0.0, clock_next=0.0, rate=1.0, status=status,
            binding=(BindingLimit("master", joint, LimitKind.VELOCITY),) if joint else (),
        )
        for status, joint in kinds
    ]  # fmt: skip


def lines(steps: Sequence[ControlStep]) -> tuple[str, ...]:
    notes = Notes()
    for step in steps:
        notes.take(step)
    return notes.lines()


def slowed(joint: int) -> Kind:
    return Status.SLOWED, f"joint_{joint}"


def test_each_change_has_its_step_and_its_explanation(paper: Scenario) -> None:
    kinds = [TRACKS, slowed(1), slowed(1), slowed(2), TRACKS, TRACKS, (Status.BLOCKED, "joint_2")]
    steps = steps_of(paper, kinds)
    assert lines(steps) == tuple(f"{i}: {steps[i].explain()}" for i in (1, 3, 4, 6))
    assert lines(steps_of(paper, [TRACKS] * 5)) == ()


def test_a_start_with_a_warning_is_noted_although_it_tracks(paper: Scenario) -> None:
    first, second = steps_of(paper, [TRACKS, TRACKS])
    warned = first.replaced(reason="an arm is off its grasp")
    assert lines([warned, second]) == (f"0: {warned.explain()}",)
    assert "an arm is off its grasp" in warned.explain()
    assert lines([first, second.replaced(reason="later")]) == ()


@pytest.mark.parametrize(("changes", "notes"), [(5, 5), (6, 1), (20, 1)])
def test_six_changes_that_alternate_make_one_note(paper: Scenario, changes: int, notes: int) -> None:
    kinds = [TRACKS, *([slowed(1), TRACKS] * 20)[:changes]]
    steps = steps_of(paper, kinds)
    found = lines(steps)
    assert len(found) == notes
    if notes == 1:
        when = f"{changes} changes from 0.010 s to {0.01 * changes:.3f} s"
        assert found == (f"1: SLOWED and TRACKING in turn, {when}; most often: {steps[1].explain()}",)


def test_bursts_far_apart_have_a_note_each(paper: Scenario) -> None:
    """Half a second without a change lies between them; changes a tenth of a second apart belong together."""
    burst = [slowed(1), slowed(2), slowed(1), slowed(2), slowed(2), slowed(1), slowed(3)]
    steps = steps_of(paper, [TRACKS, *burst, *[slowed(3)] * 50, *burst, *[slowed(3)] * 50, TRACKS])
    found = lines(steps)
    assert len(found) == 3
    when = "SLOWED for several reasons in turn, 6 changes from 0.010 s to 0.070 s; most often: "
    assert found[0] == f"1: {when}{steps[1].explain()}"
    assert found[1].startswith("58: SLOWED for several reasons in turn, 6 changes from 0.580 s to 0.640 s; ")
    assert found[2] == f"{len(steps) - 1}: {steps[-1].explain()}"
    slow = steps_of(paper, [TRACKS, slowed(1)] * 4, dt=0.099)
    assert len(lines(slow)) == 1
    assert len(lines(steps_of(paper, [TRACKS, slowed(1)] * 4, dt=0.101))) == 7


@pytest.mark.parametrize(("kinds", "notes"), [(4, 1), (5, 20)])
def test_changes_among_many_kinds_do_not_alternate(paper: Scenario, kinds: int, notes: int) -> None:
    steps = steps_of(paper, [slowed(1 + i % kinds) for i in range(20)])
    assert len(lines(steps)) == notes
