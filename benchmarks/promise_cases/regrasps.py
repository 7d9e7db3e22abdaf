"""Forces in an engine where arms let go and attach, with wrist sensors and without.

Internal are the wrenches beyond the least ones at the grasps that hold, which is said here once more in NumPy.
"""

from __future__ import annotations

import importlib.util
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin

from coopqp import ControlStep, ForceController, ForceOptions, LinePath, QPController, simulate
from coopqp.planning import Payload
from coopqp.programs import Phase, Program, Travels
from coopqp.scenarios import Scenario, hand_over, paper_lift
from coopqp.simulation import Disturbances, PhysicsPlant
from promise_cases import Promise
from promise_cases.forces import STIFFNESS, off, shares

_ARMS = ("master", "slave_1", "slave_2")


def _three_two_three() -> Scenario:
    """Up with three arms; one of them goes over while two hold; up with three."""
    task = paper_lift(duration=3.0, time_law="quintic")
    task = replace(task, cell=task.cell.with_limits(acceleration=5.0))
    X, here = task.grasp.T_object_tool[2], task.path.pose(0.0)
    up = LinePath.displaced(here, translation=(0.0, 0.0, 0.1), duration=2.0)
    on = LinePath.displaced(up.goal, translation=(0.0, 0.0, 0.1), duration=2.0)
    over = {"slave_2": Travels(to=pin.SE3(X.rotation, X.translation + np.array([-0.1, 0.0, 0.0])))}
    phases = [Phase("up", path=up), Phase("over", arms=over, duration=2.0), Phase("on", path=on)]
    return replace(task, path=Program(task.cell, task.grasp, phases))


@dataclass(frozen=True)
class _Engine:
    """A run in the engine: peak forces of an arm [N], internal ones with the arms that hold."""

    ratio: float
    between: float
    rest: float
    unborne: float


def _in_engine_run(task: Scenario, *, relax: bool, **disturbances: Any) -> _Engine:
    """Peak force after attaching over before; internal force between the changes, and a second after the end [N]; and
    the part of the weight that the arms that hold do not bear between the changes.

    Internal are wrenches beyond the least ones at the grasps that hold, 0.25 s away from releases and attachments.
    """
    motion, plant = task.path.grasps, PhysicsPlant.of(task, disturbances=Disturbances(**disturbances))
    assert motion is not None
    (leaves, attaches), rows = motion.changes, []

    def see(step: ControlStep) -> None:
        w, held = plant.wrenches(), np.array(motion.holds(step.clock))
        places = task.grasp.moved_by(motion.placements(step.clock)).T_object_tool
        points = np.array([X.translation for X in places])[held]
        most, borne = float(np.linalg.norm(w[:, :3], axis=1).max()), float(w[held, 2].sum())
        own = w[held]
        own[:, 3:] -= np.cross(points, own[:, :3])
        inner = ((np.eye(own.size) - shares(points)) @ own.ravel()).reshape(-1, 6)[:, :3]
        rows.append((step.clock, most, float(np.linalg.norm(inner, axis=1).max()), borne))

    inner = QPController(task.cell, task.grasp, task.path, dt=0.004)
    payload = Payload(mass=task.object_mass, centre=task.T_object_body.translation)
    made = ForceController(inner, ForceOptions(stiffness=np.tile(STIFFNESS, 3), payload=payload)) if relax else inner
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        recording = simulate(made, plant, q_start=task.q_start, observe=see, settle=1.0, patience=None)
    clock, force, internal, borne = np.array(rows).T
    if not recording.finished:
        return _Engine(np.inf, np.inf, np.inf, np.inf)
    before, after = clock <= leaves - 0.004, clock >= attaches
    settled = (clock > leaves + 0.25) & (clock < attaches - 0.25)
    weight = 9.81 * task.object_mass
    return _Engine(
        ratio=float(force[after].max() / force[before].max()),
        between=float(internal[settled].max()),
        rest=float(internal[-1]),
        unborne=1.0 - float(borne[settled].min()) / weight,
    )


def in_engine(quick: bool) -> Iterator[Promise]:
    """Forces where an arm lets go and attaches again, with and without wrist sensors."""
    if importlib.util.find_spec("mujoco") is None:
        return
    bases: dict[str, dict[str, Any]] = {"": {}}
    if not quick:
        bases |= {f", base of {arm} 1 mm + 0.1° off": {"base_offset": {arm: off(1.0, 0.1)}} for arm in _ARMS}
    for name, task in (("3 → 2 → 3", _three_two_three()), ("hand_over, the leader under way", hand_over())):
        alone = _in_engine_run(task, relax=False)
        yield Promise(f"{name} in the engine: peak force after attaching, over before", alone.ratio, 1.3, "")
        runs = [_in_engine_run(task, relax=True, **base) for base in bases.values()]
        case = f"{name} in the engine, ForceController{' and bases off' if len(runs) > 1 else ''}"
        yield Promise(f"{case}: peak force after attaching, over before", max(run.ratio for run in runs), 1.3, "")
        yield Promise(
            f"{case}: internal force at rest (QPController: {alone.rest:.0f})", max(r.rest for r in runs), 5.0, "N"
        )
        if name == "3 → 2 → 3":  # at rest, so that nothing but the weight is borne
            between, unborne = max(run.between for run in runs), max(run.unborne for run in runs)
            yield Promise(f"{case}: internal force while two hold", between, 5.0, "N")
            yield Promise(f"{case}: weight that these two do not bear", unborne, 0.01, "")
