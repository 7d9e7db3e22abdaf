"""Every step that is not TRACKING has a cause, the one that its reason and its limits speak of."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from runs import built, drive, fast_lift

from coopqp import (
    BindingLimit,
    Cause,
    ControlStep,
    LimitKind,
    LinePath,
    Status,
    SupervisionOptions,
)
from coopqp.control.step.decoding import CAUSES, cause_of
from coopqp.core import _core
from coopqp.scenarios import at_limit, at_singularity, paper_lift

LIMIT, SINGULAR, NEAR, APART, REINS, JUMP = (
    BindingLimit("arm", "", kind)
    for kind in (
        LimitKind.VELOCITY, LimitKind.SINGULARITY, LimitKind.COLLISION, LimitKind.OUT_OF_STEP, LimitKind.OVERRIDE,
        LimitKind.PATH_JUMP,
    )
)  # fmt: skip
#: Status, cause of what the supervision found, limits, whether measured; and the cause.
CASES = [
    (Status.TRACKING, Cause.TRACKING, (LIMIT,), True, None),
    (Status.SLOWED, None, (), True, Cause.LIMIT),
    (Status.SLOWED, None, (LIMIT,), True, Cause.LIMIT),
    (Status.SLOWED, Cause.TRACKING, (), False, Cause.TRACKING),
    (Status.SLOWED, Cause.TRACKING, (LIMIT,), False, Cause.LIMIT),
    (Status.SLOWED, None, (REINS,), False, Cause.OPERATOR),
    (Status.SLOWED, None, (APART,), False, Cause.TRACKING),
    (Status.BLOCKED, None, (LIMIT, NEAR), False, Cause.CLEARANCE),
    (Status.BLOCKED, None, (SINGULAR,), False, Cause.SINGULARITY),
    (Status.BLOCKED, None, (JUMP,), False, Cause.INPUT),
    (Status.PAUSED, Cause.TRACKING, (LIMIT,), True, Cause.OPERATOR),
    (Status.OFF_PATH, None, (LIMIT,), True, Cause.LIMIT),
    (Status.OFF_PATH, None, (), True, Cause.TRACKING),
    (Status.OFF_PATH, None, (), False, Cause.INPUT),
    (Status.HOLDING, Cause.INPUT, (LIMIT,), True, Cause.INPUT),
    (Status.HOLDING, None, (LIMIT,), True, Cause.SOLVER),
    (Status.FAULT, Cause.TRACKING, (), True, Cause.TRACKING),
]


@pytest.mark.parametrize(("status", "watched", "binding", "measured", "cause"), CASES)
def test_status_reason_and_limits_make_the_cause(
    status: Status, watched: Cause | None, binding: Any, measured: bool, cause: Cause | None
) -> None:
    assert cause_of(status, watched, binding, measured=measured) is cause


def test_every_reason_has_a_cause() -> None:
    named = {name: CAUSES[code] for code, name in enumerate(_core.REASONS) if name != "NO_REASON"}
    inputs = {
        "BAD_DT", "NOT_FINITE", "OFF_CIRCLE", "JUMPED", "PATH_FAILED", "PATH_JUMPS", "LOOK_AHEAD_FAILED",
        "CONSTRAINT_FAILED", "OFF_WAY",
    }  # fmt: skip
    apart = {
        "OUT_OF_STEP_BY",
        "WAS_OUT_OF_STEP",
        "STALLED",
        "ALL_STALLED",
        "FORCE",
        "HANGS_BEHIND",
        "OFF_SERVOS",
        "OFF_LAG",
        "FORCE_GROWS",
    }
    assert {name for name, cause in named.items() if cause is Cause.INPUT} == inputs
    assert {name for name, cause in named.items() if cause is Cause.TRACKING} == apart
    assert named["CHAIN_PARTED"] is Cause.COMMANDED_CHAIN
    assert named["CHAIN_APART"] is None  # it slows nothing
    assert named["TOUCHING"] is Cause.CONTACT
    assert named.keys() == inputs | apart | {"CHAIN_PARTED", "CHAIN_APART", "TOUCHING", "UNSOLVED"}


# -- in a run --------------------------------------------------------------------------------------------------------


def seen(steps: list[ControlStep]) -> set[tuple[Status, Cause | None]]:
    assert all((step.cause is None) == (step.status is Status.TRACKING) for step in steps)
    return {(step.status, step.cause) for step in steps}


def lagging(step: ControlStep) -> Any:
    q = step.q_next.copy()
    q[-6:] += 0.02
    return q


def test_causes_of_a_run() -> None:
    controller = built(fast_lift())
    assert (Status.SLOWED, Cause.LIMIT) in seen(drive(controller, 20))
    bad = controller.step(np.full(controller.cell.nq, np.nan))
    assert (bad.status, bad.cause) == (Status.HOLDING, Cause.INPUT)
    late = controller.step(dt=10.0)
    assert (late.status, late.cause) == (Status.HOLDING, Cause.INPUT)
    controller.set_override(0.1)
    assert (Status.SLOWED, Cause.OPERATOR) in seen(drive(controller, 20))
    controller.pause()
    assert (Status.PAUSED, Cause.OPERATOR) in seen(drive(controller, 20))


def test_causes_of_arms_that_are_elsewhere() -> None:
    options = SupervisionOptions(let_in=0.0)
    for_fault = seen(drive(built(paper_lift(), supervision=options), 60, measured=lagging))
    assert for_fault >= {(Status.FAULT, Cause.TRACKING)}
    slow = SupervisionOptions(let_in=0.0, slow_from=1e-3, hold_from=0.5, fault_from=0.6)
    assert seen(drive(built(paper_lift(), supervision=slow), 60, measured=lagging)) >= {(Status.SLOWED, Cause.TRACKING)}


def test_causes_ahead() -> None:
    blocked = seen(drive(built(at_singularity("reach")), 800))
    assert {cause for status, cause in blocked if status is Status.BLOCKED} <= {Cause.LIMIT, Cause.SINGULARITY}
    blocked = seen(drive(built(at_limit(direction=(0.1, 0.05, 1.0))), 800))
    assert (Status.BLOCKED, Cause.LIMIT) in blocked


def test_cause_of_a_path_that_begins_elsewhere() -> None:
    controller, task = built(paper_lift()), paper_lift()
    assert isinstance(task.path, LinePath)
    drive(controller, 3)
    start = task.path.start.copy()
    start.translation = start.translation + np.array([0.0, 0.0, 0.01])
    controller.follow(LinePath(start, task.path.goal, duration=2.0))
    first = controller.step()
    assert (first.status, first.cause) == (Status.OFF_PATH, Cause.INPUT)


def test_a_replaced_step_keeps_its_cause() -> None:
    controller = built(paper_lift())
    step = controller.step(dt=10.0)
    assert step.replaced(reason="").cause is Cause.INPUT
