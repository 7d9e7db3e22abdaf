"""A3: joints that start outside their limits return, and the arms keep the object meanwhile."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from checks import Return, fenced_out, from_outside, ideal_return, shifted_together
from runs import cooperative

from coopqp.scenarios import Scenario, dual_arm7, mixed_cell, paper_lift
from coopqp.solvers import available_solvers

pytestmark = pytest.mark.filterwarnings("ignore::coopqp.errors.StartWarning")

DEPTHS = (0.001, 0.01, 0.05, 0.2)  # [rad]
LIMITED = {"velocity": 1.0}  # [rad/s]
RATIO, CHAIN_MM = 1.35, 0.05


@pytest.fixture(name="lift", scope="module")
def _lift() -> Scenario:
    return replace(paper_lift(time_law="quintic"), dt=0.002)


def rows(catalogue: Any, what: str, found: list[Return], *, capped: int = 0, contradict: bool = False) -> None:
    """Add the worst figures of all runs to the row; ``capped`` steps held because a solver hit its cap."""
    steps = sum(r.steps for r in found)
    violations = sum(r.failures + r.broken + (r.outward > 1e-9) + (r.growth > 1e-12) for r in found) - capped
    name = f"{what}: outward velocity, growing distance, other limits, failures"
    note = f"{capped} steps held at OSQP's cap on the iterations, which keeps steps short" if capped else ""
    ratio, chain = max(r.ratio for r in found), max(r.chain_mm for r in found)
    if contradict:
        note = f"chain error up to {chain:.2g} mm; how long it takes, and the chain, are not promised here"
    catalogue.row("A3", name, cases=steps, measured=violations, target=0, note=note)
    if contradict:
        return
    catalogue.row("A3", f"{what}: time to get in / ideal", cases=len(found), measured=ratio, target=RATIO)
    catalogue.row("A3", f"{what}: chain error", cases=len(found), measured=chain, target=CHAIN_MM, unit="mm")


@pytest.mark.slow
def test_every_joint_comes_back(lift: Scenario, count: Callable[[int], int], catalogue: Any) -> None:
    found = []
    for i in range(count(36)):
        joint, side = divmod(i % 36, 2)
        depth = DEPTHS[(i // 36 + joint + 2 * side) % 4]
        acceleration = 5.0 if (joint // 4 + i // 144) % 2 else np.inf
        depths = {joint: depth if side else -depth}
        found.append(from_outside(cooperative, fenced_out(lift, depths, acceleration=acceleration, **LIMITED), depths))
    rows(catalogue, "one joint outside", found)


def together(task: Scenario, rng: np.random.Generator, runs: int, **options: Any) -> list[Return]:
    found = []
    for i in range(runs):
        size = 10.0 ** rng.uniform(np.log10(DEPTHS[0]), np.log10(DEPTHS[-1]))
        depths, motion = shifted_together(rng, task, size, int(rng.integers(2, 7)))
        fenced = fenced_out(task, depths, acceleration=5.0 if i % 2 else np.inf, **LIMITED)
        ideal = ideal_return(fenced, depths, motion)
        found.append(from_outside(cooperative, fenced, depths, ideal, **options))
    return found


@pytest.mark.slow
def test_joints_of_several_arms_come_back_at_once(
    lift: Scenario, count: Callable[[int], int], catalogue: Any, rng: np.random.Generator
) -> None:
    found = together(lift, rng, count(20))
    for make in (dual_arm7, mixed_cell):
        found += together(replace(make(time_law="quintic"), dt=0.002), rng, count(8))
    rows(catalogue, "2 to 6 joints outside", found)


@pytest.mark.slow
def test_with_every_solver(
    lift: Scenario, count: Callable[[int], int], catalogue: Any, rng: np.random.Generator
) -> None:
    """OSQP sometimes hits its iteration cap; then the arms hold."""
    others = [solver for solver in available_solvers() if solver != "daqp"]
    found = {solver: together(lift, rng, count(4), solver=solver) for solver in others}
    capped = sum(r.failures for r in found.get("osqp", []))
    rows(catalogue, ", ".join(others), [r for runs in found.values() for r in runs], capped=capped)


@pytest.mark.slow
def test_joints_whose_ways_back_contradict_each_other(
    lift: Scenario, count: Callable[[int], int], catalogue: Any, rng: np.random.Generator
) -> None:
    """If no object motion leads all joints of several arms back, no joint moves further out."""
    found = []
    for i in range(count(10)):
        joints = rng.choice(lift.cell.nv, int(rng.integers(3, 7)), replace=False)
        depths = {int(j): float(rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(-3.0, -0.7)) for j in joints}
        task = fenced_out(lift, depths, acceleration=5.0 if i % 2 else np.inf, **LIMITED)
        found.append(from_outside(cooperative, task, depths))
    # The worst known case for the chain.
    four = replace(mixed_cell(time_law="quintic"), dt=0.002)
    depths = {7: 0.002, 16: 0.0129, 23: 0.0179, 19: -0.0244, 5: -0.0099, 1: 0.1099}
    found.append(from_outside(cooperative, fenced_out(four, depths, acceleration=5.0, **LIMITED), depths))
    rows(catalogue, "ways back contradict", found, contradict=True)
