"""A2 and A9: at the limits, with every solver, no limit is exceeded and all arms slow down together."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from checks import Sharing, fenced_out, needed_speeds, saturated, slows_together
from runs import cooperative, limited

from coopqp import LinePath, ServoPath
from coopqp.scenarios import (
    Scenario,
    at_limit,
    at_singularity,
    dual_arm7,
    fast_lift,
    five_joint_pair,
    mixed_cell,
    paper_lift,
    ring,
)
from coopqp.solvers import available_solvers


def at_limit_without_preview() -> tuple[Scenario, Any]:
    return at_limit(margin=0.1, acceleration=5.0), None


def moving_target(acceleration: float) -> tuple[Scenario, Any]:
    """Three arms that follow a target beyond their joint limits."""
    task = at_limit(margin=0.1, acceleration=acceleration)
    start, goal = task.path.pose(0.0), task.path.pose(task.path.duration)
    return replace(task, path=ServoPath(start, speed=0.8, spin=2.0)), goal


def outside() -> tuple[Scenario, Any]:
    task = replace(paper_lift(time_law="quintic"), dt=0.002)
    return fenced_out(task, {1: 0.05, 9: -0.05}, velocity=1.0, acceleration=5.0), None


#: Saturating tasks: the task, its target or None, and the controller's options.
SATURATING: dict[str, tuple[Callable[[], tuple[Scenario, Any]], dict[str, Any]]] = {
    "speed": (lambda: (fast_lift(), None), {}),
    "speed and acceleration": (lambda: (limited(fast_lift(), acceleration=5.0), None), {}),
    "no preview": (lambda: (limited(fast_lift(), acceleration=5.0), None), {"preview": None}),
    "position, no preview": (at_limit_without_preview, {"preview": None}),
    "moving target": (lambda: moving_target(np.inf), {}),
    "moving target, acceleration": (lambda: moving_target(5.0), {}),
    "redundant": (
        lambda: (limited(dual_arm7(duration=0.5, time_law="linear"), velocity=0.3, acceleration=5.0), None),
        {},
    ),
    "four arms": (lambda: (limited(mixed_cell(duration=0.5, time_law="linear"), velocity=0.5), None), {}),
    "five joints": (
        lambda: (limited(five_joint_pair(duration=0.5, time_law="linear"), velocity=0.5, acceleration=5.0), None),
        {},
    ),
    # Past the pole joints turn with their whole acceleration; ahead of it, and of an elbow, all arms brake more gently.
    "singular": (lambda: (at_singularity("wrist", 1, miss=0.05, speed=0.6, acceleration=5.0), None), {"preview": None}),
    "outside": (outside, {}),
}


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::coopqp.errors.StartWarning")
def test_limits_hold_after_clipping(count: Callable[[int], int], catalogue: Any) -> None:
    worst, solvers, steps = np.zeros(3), available_solvers(), 0
    for solver, (name, (build, options)) in itertools.product(solvers, SATURATING.items()):
        task, goal = build()
        start = int(1.6 / task.dt) if name == "singular" else 0
        runs = [
            saturated(cooperative(task, solver=solver, shortcut=shortcut, **options), task, start, count(120), goal)
            for shortcut in (True, False)  # False: a QP at every step
        ]
        assert runs[1].qps == runs[1].steps
        assert runs[1].touching > 0.25 * runs[1].steps, name
        assert not any(r.broken for r in runs), (name, solver)
        worst = np.maximum(worst, np.max([r.excess for r in runs], axis=0))
        steps += sum(r.steps for r in runs)
    for kind, excess, target, unit in zip(
        ("position", "velocity", "acceleration"), worst, (1e-12, 1e-12, 1e-12), ("rad", "rad/s", ""), strict=True
    ):
        name = f"{kind} excess, {', '.join(solvers)}"
        catalogue.row("A2", name, cases=steps, measured=excess, target=target, unit=unit)


@pytest.mark.slow
def test_one_joint_saturates(count: Callable[[int], int], catalogue: Any) -> None:
    """Each joint of three arms in turn is limited to half the speed that the path needs."""
    found = []
    for i, law in enumerate(("linear", "quintic")):
        task = replace(paper_lift(duration=2.0, time_law=law), dt=0.001)
        peak = needed_speeds(task)
        joints = np.flatnonzero(peak > 0.02)
        assert len(joints) >= 12
        shares = np.linspace(0.5, 0.8, count(1))
        runs = [(int(j), float(s)) for j in joints[i::2] for s in shares]
        found += [slows_together(cooperative, task, share, joint=j, peak=peak) for j, share in runs]
    assert min(s.steps for s in found) > 100
    sharing(catalogue, "one joint at its speed limit, each in turn", found)


def sharing(catalogue: Any, what: str, found: list[Sharing], note: str = "") -> None:
    steps = sum(s.steps for s in found)
    spread, angle = max(s.spread for s in found), max(s.angle for s in found)
    catalogue.row("A9", f"{what}: spread of path rate", cases=steps, measured=spread, target=1e-6, note=note)
    catalogue.row("A9", f"{what}: direction of the object", cases=steps, measured=angle, target=0.01, unit="°")


@pytest.mark.slow
@pytest.mark.parametrize("acceleration", [np.inf, 5.0], ids=["speed", "acceleration"])
def test_random_paths_too_fast(
    acceleration: float, count: Callable[[int], int], catalogue: Any, rng: np.random.Generator
) -> None:
    """Path speeds differ by up to 1e-5 where joint velocities jump (docs/reliability.md); the arms do not part."""
    found: list[Sharing] = []
    for i in range(count(4)):
        base = (paper_lift, ring, dual_arm7, mixed_cell)[i % 4]()
        path = LinePath.displaced(
            base.path.pose(0.0),
            translation=rng.uniform(-0.05, 0.05, 3),
            rotation=rng.uniform(-0.12, 0.12, 3),
            duration=0.5,
            time_law="linear" if i % 2 else "quintic",
        )
        task = limited(replace(base, path=path, dt=0.001), acceleration=acceleration)
        found.append(slows_together(cooperative, task, 0.6, peak=needed_speeds(task)))
    name = f"random paths, {'speed' if np.isinf(acceleration) else 'speed and acceleration'} limited"
    steps, note = sum(s.steps for s in found), f"path rates differ by {max(s.spread for s in found):.1g} at most"
    angle, chain = max(s.angle for s in found), max(s.chain_mm for s in found)
    catalogue.row("A9", f"{name}: direction of the object", cases=steps, measured=angle, target=0.01, unit="°")
    catalogue.row("A9", f"{name}: chain error", cases=steps, measured=chain, target=3e-4, unit="mm", note=note)
