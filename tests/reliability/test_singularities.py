"""Into a singularity, a wait there, and out again: every arm, with and without acceleration limits."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import settings

from coopqp import ControlStep, LimitKind, LinePath, QPController, QPOptions, Status
from coopqp.scenarios import Scenario, at_singularity, five_joint_pair, scara_pair
from coopqp.simulation import Monitor, Tolerances, Verdict

pytestmark = pytest.mark.slow

#: Number of steps that a blocked object waits.
DWELL = 100
#: Longest time there, and longest time back [s].
LONGEST = 6.0
NIGHTLY = settings.get_current_profile_name() == "nightly"
NOTHING_ELSE = Tolerances(chain_mm=1e9, chain_deg=1e9, object_mm=1e9, object_deg=1e9)


@dataclass(frozen=True)
class Excursion:
    """The result of one way there and back.

    Attributes:
        verdict: the monitor's verdict on the limits.
        jump: largest change of σ between two steps, except for the shortened last step of a path.
        blocked: True if the object had to wait.
        back: True if the object came back.
        pole: True if a singularity blocked the object on its way back.
    """

    verdict: Verdict
    jump: float
    steps: int
    blocked: bool
    back: bool
    pole: bool


def excursion(task: Scenario, **options: Any) -> Excursion:
    controller = QPController(task.cell, task.grasp, task.path, dt=task.dt, options=QPOptions(**options))
    controller.reset(task.q_start)
    monitor = Monitor(task.cell, task.grasp, tolerances=NOTHING_ELSE)
    jump, blocked = 0.0, False
    steps: list[ControlStep] = []

    def go() -> Any:
        nonlocal jump
        rate, waited = None, 0
        for _ in range(int(LONGEST / task.dt)):
            step = controller.step()
            steps.append(step)
            waited = waited + 1 if step.status is Status.BLOCKED else 0
            if step.finished or waited >= DWELL:
                return step
            if rate is not None:
                jump = max(jump, abs(step.rate - rate))
            rate = step.rate
        return step

    there = go()
    blocked = there.status is Status.BLOCKED
    controller.follow(LinePath(task.path.pose(there.clock_next), task.path.pose(0.0), duration=2.0))
    back = go()
    pole = any(b.kind is LimitKind.SINGULARITY for b in back.binding)
    monitor.observe_all(steps)
    return Excursion(monitor.verdict(), jump, len(steps), blocked, back.finished, pole)


def six_joints() -> Iterator[tuple[Scenario, float]]:
    """Tasks with their distance from the pole [rad]; nightly each arm with and without acceleration limits."""
    for i, acceleration in enumerate((np.inf, 5.0)):
        for k, kind in enumerate(("wrist", "elbow", "reach")):
            for arm in range(3):
                if NIGHTLY or (k + arm) % 2 == i:
                    yield at_singularity(kind, arm, acceleration=acceleration), 0.0  # type: ignore[arg-type]
        for miss in (1e-4, 5e-4, 1.1e-3, 2e-3, 1e-2):
            yield at_singularity("wrist", 0, acceleration=acceleration, miss=miss), miss


def few_joints() -> Iterator[Scenario]:
    """Pairs of arms with four and five joints that are led to the end of the reach of one arm or both.

    Each way with or without acceleration limits in turn; nightly with both.
    """
    ways = {
        scara_pair: [(0.3, 0.0, 0.0), (-0.3, 0.0, 0.0), (0.0, 0.6, 0.0), (-0.15, -0.3, 0.0)],
        five_joint_pair: [(0.3, 0.0, 0.0), (-0.3, 0.0, 0.0), (0.0, 0.0, 0.5)],
    }
    for make, translations in ways.items():
        for k, translation in enumerate(translations):
            for acceleration in (np.inf, 5.0) if NIGHTLY else ((5.0, np.inf)[k % 2],):
                task = make()
                path = LinePath.displaced(task.path.pose(0.0), translation=translation, duration=2.0, time_law="linear")
                yield replace(task, cell=task.cell.with_limits(acceleration=acceleration), path=path)


@pytest.fixture(scope="module", name="previewed")
def _previewed() -> list[tuple[Scenario, float, Excursion]]:
    return [(task, miss, excursion(task)) for task, miss in six_joints()]


@pytest.fixture(scope="module", name="few")
def _few() -> list[tuple[Scenario, Excursion]]:
    return [(task, excursion(task)) for task in few_joints()]


def accelerates(task: Scenario) -> bool:
    return bool(np.isfinite(task.cell.limits.acceleration).any())


def test_limits_are_kept(previewed: Any, few: Any, catalogue: Any) -> None:
    met = [e for _, miss, e in previewed if miss == 0.0]
    for found in (met, [e for _, e in few]):
        assert sum(e.blocked for e in found) >= len(found) // 2
    for arms, found in (("six", [e for _, _, e in previewed]), ("four and five", [e for _, e in few])):
        catalogue.row(
            "A8",
            f"singularities, arms of {arms} joints: limits",
            cases=sum(e.steps for e in found),
            measured=sum(sum(e.verdict.counts.values()) for e in found),
            target=0,
            unit="violations",
            note=f"{len(found)} ways there and back",
        )


def test_the_chain_on_previewed_paths(previewed: Any, few: Any, catalogue: Any) -> None:
    of_all = (("six", [e for _, _, e in previewed], 0.0015), ("four and five", [e for _, e in few], 0.0005))
    for arms, found, target in of_all:
        catalogue.row(
            "A8",
            f"singularities, arms of {arms} joints: chain",
            cases=sum(e.steps for e in found),
            measured=1e3 * max(e.verdict.worst.chain_m for e in found),
            target=target,
            unit="mm",
        )


def test_what_is_only_near_is_passed(previewed: Any, catalogue: Any) -> None:
    near = [e for _, miss, e in previewed if miss > 1e-3]
    catalogue.row(
        "A8",
        "a pole missed by more than 1 mrad: object blocked",
        cases=len(near),
        measured=sum(e.blocked or not e.back for e in near),
        target=0,
    )


def test_the_object_comes_out_again(previewed: Any, catalogue: Any) -> None:
    """The object comes back. Only near a pole (within a milliradian) may the way back also be blocked."""
    stuck = [task for task, miss, e in previewed if not e.back and not (0.0 < miss <= 1e-3 and e.pole)]
    catalogue.row(
        "A8", "singularities, arms of six joints: not out again", cases=len(previewed), measured=len(stuck), target=0
    )


def test_arms_with_few_joints_come_out_again(few: Any, catalogue: Any) -> None:
    stuck = [task for task, e in few if not e.back]
    catalogue.row(
        "A8",
        "singularities, arms of four and five joints: not out again",
        cases=len(few),
        measured=len(stuck),
        target=0,
    )


@pytest.mark.parametrize("limited", [True, False])
def test_the_rate_changes_smoothly(limited: bool, previewed: Any, few: Any, catalogue: Any) -> None:
    found = [e for task, *_, e in (*previewed, *few) if accelerates(task) is limited]
    catalogue.row(
        "A8",
        f"singularities, {'' if limited else 'no '}acceleration limits: change of σ from step to step",
        cases=sum(e.steps for e in found),
        measured=max(e.jump for e in found),
        target=0.05,
    )
