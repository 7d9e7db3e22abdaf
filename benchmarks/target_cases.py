"""Targets that move: what a controller makes of them, in reach and out of it, streamed with noise and jumps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from coopqp import QPController, ServoPath, Status
from coopqp.scenarios import Scenario, dual_arm7, mixed_cell, panda_bar, paper_lift, ring, ur5_table
from coopqp.spatial import Array

CELLS: dict[str, Callable[[], Scenario]] = {
    "paper_lift": paper_lift,
    "dual_arm7": dual_arm7,
    "mixed_cell": mixed_cell,
    "panda_bar": panda_bar,
    "ur5_table": ur5_table,
    "ring of 2": lambda: ring(arms=2),
    "ring of 8": lambda: ring(arms=8),
}
IN_REACH, OUT_OF_REACH = "in reach", "out of reach"
#: Steps a second, by the number of targets a second.
STEPS_PER_S = {100: 500, 1000: 1000}
#: Length of a run [s].
SECONDS = 3.0
#: How fast the targets move [m/s], and after this long the object should be on its way [s].
SPEED, STARTED = 0.2, 0.5


@dataclass
class Chase:
    """What came of a run.

    Attributes:
        apart, off: largest chain error, and distance of the object as any arm holds it from its path [m].
        flips: steps whose change of velocity is more than the joints' acceleration allows (v_max/8 without).
        nameless: steps that are BLOCKED or HOLDING and do not say why.
        swing: largest way of the object in BLOCKED steps that follow each other, but for the first ten [m].
        lags: distances of the path from the target [m].
    """

    apart: float = 0.0
    off: float = 0.0
    flips: int = 0
    nameless: int = 0
    swing: float = 0.0
    lags: list[float] = field(default_factory=list)


def target_at(kind: str, start: pin.SE3, rng: np.random.Generator) -> Callable[[float], pin.SE3]:
    """Where the target is at a time."""
    way = rng.normal(size=3)
    way /= np.linalg.norm(way)
    side = np.cross(way, [1.0, 0.0, 0.0])
    side /= np.linalg.norm(side)
    turn, there, radius = 0.2 * rng.normal(size=3), 0.3 * rng.normal(size=3), 0.1

    def near(t: float) -> pin.SE3:  # round a circle at 0.2 m/s
        angle = SPEED * t / radius
        away = radius * (np.sin(angle) * way + (np.cos(angle) - 1.0) * side)
        return pin.SE3(start.rotation, start.translation + away)

    def far(t: float) -> pin.SE3:  # out of reach, then elsewhere
        x = 2.0 * way * np.sin(t) if t < 0.6 * SECONDS else there
        noise = 1e-4 * rng.normal(size=3)
        return pin.SE3(start.rotation @ pin.exp3(np.sin(t) * turn), start.translation + x + noise)

    return near if kind == IN_REACH else far


def held_by(task: Scenario) -> Callable[[Array], Array]:
    """Where each arm holds the object's origin at a configuration (N, 3) [m], by Pinocchio's frames."""
    model, data, frames = task.cell.model, task.cell.model.createData(), task.cell.tool_frames
    origins = [X.inverse().translation for X in task.grasp.T_object_tool]

    def held(q: Array) -> Array:
        pin.framesForwardKinematics(model, data, q)
        return np.array([data.oMf[f].act(x) for f, x in zip(frames, origins, strict=True)])

    return held


def chase(task: Scenario, kind: str, acceleration: float, hertz: int, seed: int) -> Chase:
    """Stream targets, and look at every step."""
    cell, dt = task.cell.with_limits(acceleration=acceleration), 1.0 / STEPS_PER_S[hertz]
    start, seen = task.path.pose(0.0), Chase()
    path, target = ServoPath(start), target_at(kind, start, np.random.default_rng(seed))
    controller = QPController(cell, task.grasp, path, dt=dt)
    controller.reset(task.q_start)
    held_at, steps = held_by(task), round(SECONDS / dt)
    held, reference = np.empty((steps, len(cell), 3)), np.empty((steps, 3))
    goals, velocities, blocked = np.empty((steps, 3)), np.zeros((steps + 1, cell.nv)), np.zeros(steps, dtype=bool)
    goal, every = start, STEPS_PER_S[hertz] // hertz
    for i in range(steps):
        if i % every == 0:
            goal = target(i * dt)
            controller.retarget(goal)
        step = controller.step()
        held[i], reference[i] = held_at(step.q_next), path.pose(step.clock_next).translation
        goals[i], velocities[i + 1], blocked[i] = goal.translation, step.velocity, step.status is Status.BLOCKED
        stopped = blocked[i] or step.status is Status.HOLDING
        seen.nameless += bool(stopped and not (step.binding or step.reason))
    speed = np.where(np.isfinite(cell.limits.velocity), cell.limits.velocity, 1.0)
    most = acceleration * dt * np.ones(cell.nv) if np.isfinite(acceleration) else speed / 8.0
    seen.apart = float(np.linalg.norm(held[:, :, None] - held[:, None], axis=3).max())
    seen.off = float(np.linalg.norm(held - reference[:, None], axis=2).max())
    seen.flips = int((np.abs(np.diff(velocities, axis=0)) > most * (1.0 + 1e-6) + 1e-9).any(axis=1).sum())
    seen.swing = swing(reference, blocked)
    if kind == IN_REACH:
        seen.lags = np.linalg.norm(reference - goals, axis=1)[round(STARTED / dt) :].tolist()
    return seen


def swing(positions: Array, blocked: Array) -> float:
    """Largest way within steps in a row that are blocked, but for the first ten of them [m]."""
    most, edges = 0.0, np.flatnonzero(np.diff(np.concatenate([[False], blocked, [False]])))
    for begin, end in edges.reshape(-1, 2):
        if end - begin > 10:
            most = max(most, float(np.ptp(positions[begin + 10 : end], axis=0).max()))
    return most
