"""Presses: small known wrenches between the arms that hold one object at rest, by which wrist sensors are identified.

Arm k shall push the object with ``f``. The others balance it with the least wrenches at their tools, and each arm's
place on the object moves by what its servos yield, ``e_j = C_j w_j``: the object stays where it is. Each press goes to
one side, then to the other, and back. In two presses an arm pushes along two directions that are square to each other;
its share of the other arms' presses adds more. So forces and torques of every sensor are seen from all sides. No force
in a press is above :data:`PRESS_FORCE`, no torque at a tool above :data:`MOST_TORQUE`,
no motion above :data:`MOST_MOTION`.
"""

from __future__ import annotations

import math
from typing import final

import numpy as np

from coopqp.control.monitoring.stress import whole_compliance
from coopqp.core._core import STRUCTURE
from coopqp.forces.internal import SHARE_LENGTH
from coopqp.model.grasp import Grasp
from coopqp.paths.time_law import TimeLaw
from coopqp.spatial import Array

#: Force of a press [N], its torque beside the couples that balance it [N·m], and the largest of these [N·m].
PRESS_FORCE, PRESS_TORQUE, MOST_TORQUE = 6.0, 1.0, 3.0
#: Largest motion of the object as a pressing arm sees it [m]: less than what counts as off its path.
MOST_MOTION = 5e-4
#: Size of the first press, which finds how stiff the servos are, as a share of the others.
FIRST_PRESS = 0.2
#: Length of a press [s], its ramp from rest to one side [s], and the rest before the first one [s].
PRESS_TIME, RAMP_TIME, REST_TIME = 0.52, 0.16, 0.2
#: Presses of all arms together, at least.
_FEWEST = 6
#: Pairs of ways that are tried for an arm.
_TRIED = 12
_SEED = 21


@final
class PressPlan:
    """Which way each grasp moves when.

    Args:
        grasp: how the arms hold the object.
        compliances: C of each arm's servos at the object frame (N, 6, 6) [m/N …], in its axes.
        shared: that of joints that arms share (6 N, 6 N); None without any.

    Attributes:
        duration: time of all presses, with the rest before and after them [s].
        ends_first: time at which the first, small press is over [s].
    """

    def __init__(self, grasp: Grasp, compliances: Array, shared: Array | None = None) -> None:
        n = len(grasp)
        each = max(2, math.ceil(_FEWEST / n))
        rng = np.random.default_rng(_SEED)
        order = [(k, i) for i in range(each) for k in range(n)]
        each_ways = [self._ways(grasp, compliances, shared, k, each, rng) for k in range(n)]
        ways = [each_ways[k][i] for k, i in order]
        self.ways = np.array([FIRST_PRESS * ways[0], *ways])
        self.ends_first = REST_TIME + PRESS_TIME
        self.duration = REST_TIME + PRESS_TIME * len(self.ways) + REST_TIME

    @staticmethod
    def _ways(
        grasp: Grasp, compliances: Array, shared: Array | None, arm: int, count: int, rng: np.random.Generator
    ) -> Array:
        """Motions of all grasps (count, N, 6) for presses of an arm along square directions that may be the largest."""
        turns = np.linalg.qr(rng.normal(size=(_TRIED, 2, 3, 3)))[0][..., np.arange(count) % 3]
        pushes = (turns * np.array([PRESS_FORCE, PRESS_TORQUE])[:, None, None]).reshape(_TRIED, 6, count)
        wrenches = (balancing(grasp, arm) @ pushes).swapaxes(1, 2).reshape(_TRIED, count, -1, 6)
        to_object = np.array([X.actionInverse.T for X in grasp.T_object_tool])
        ways = np.einsum("kij,ntkj->ntki", compliances @ to_object, wrenches)
        if shared is not None:
            on_object = np.einsum("kij,ntkj->ntki", to_object, wrenches)
            ways += (on_object.reshape(-1, len(shared)) @ shared).reshape(ways.shape)
        forces, torques, far = (
            np.linalg.norm(part, axis=3).max(axis=2) for part in (wrenches[..., :3], wrenches[..., 3:], ways[..., :3])
        )
        sizes = 1.0 / np.max([forces / PRESS_FORCE, torques / MOST_TORQUE, far / MOST_MOTION], axis=0)
        best = int(sizes.min(axis=1).argmax())
        return sizes[best][:, None, None] * ways[best]

    def shift(self, time: float, scale: float) -> Array:
        """Motion of each grasp (N, 6) [m, rad] at a time; ``scale`` is the size of all presses but the first."""
        i, within = divmod(time - REST_TIME, PRESS_TIME)
        if not 0 <= i < len(self.ways):
            return np.zeros_like(self.ways[0])
        return (scale if i else 1.0) * _side(within) * self.ways[int(i)]


def balancing(grasp: Grasp, arm: int) -> Array:
    """Map (6 N, 6) from an arm's wrench at its tool to those of all arms at their tools: the others cancel it.

    Theirs are the least ones.
    """
    metric = np.array([1.0] * 3 + [SHARE_LENGTH] * 3)
    to_object = [X.actionInverse.T for X in grasp.T_object_tool]
    scaled = np.hstack([A * metric for k, A in enumerate(to_object) if k != arm])
    least = np.linalg.pinv(scaled) @ -to_object[arm]
    others = metric[:, None] * least.reshape(-1, 6, 6)
    return np.asarray(np.insert(others, arm, np.eye(6), axis=0).reshape(-1, 6))


def _side(within: float) -> float:
    """Where a press stands: 0, to one side (1), to the other (−1), back to 0."""
    ramp, half = RAMP_TIME, 0.5 * (PRESS_TIME - RAMP_TIME)
    law = TimeLaw.QUINTIC.value_at
    if within < half:
        return law(within / ramp) if within < ramp else 1.0
    if within < half + ramp:
        return 1.0 - 2.0 * law((within - half) / ramp)
    left = PRESS_TIME - within
    return -(law(left / ramp) if left < ramp else 1.0)


def of_grip(compliances: Array, shared: Array | None = None) -> Array:
    """G (6 N, 6 N): wrenches of the arms on the object, in its frame, per motion of their commanded places on it.

    Args:
        compliances: of each arm's own joints (N, 6, 6).
        shared: compliance of the joints that arms share (6 N, 6 N); None without such joints.
    """
    n = len(compliances)
    if shared is not None:
        stiffness = np.linalg.inv(whole_compliance(compliances + STRUCTURE * np.eye(6), shared))
        all_arms = stiffness.reshape(-1, n, 6).sum(axis=1)  # of motions of all arms by the same
        return stiffness - all_arms @ np.linalg.solve(all_arms.reshape(n, 6, 6).sum(axis=0), all_arms.T)
    each = np.linalg.inv(compliances + STRUCTURE * np.eye(6))
    out, together = np.zeros((6 * n, 6 * n)), each.reshape(-1, 6)
    for k, own in enumerate(each):
        out[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] = own
    out -= together @ np.linalg.solve(each.sum(axis=0), together.T)
    return out
