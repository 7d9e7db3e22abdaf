"""Rows that brake all arms together ahead of singularities and joint limits, where no look-ahead does.

An edge e(q) ≥ 0 is what must not be crossed: the least singular value of an arm's tool Jacobian, less a margin, and the
way of a joint to each of its limits. From the joint velocities v of the last step all joints come to rest together in
the time ``T = max_j |v_j| / a_j``. The edge comes closer at ``s = max(−∇e·v, 0)``, so braking together slows it down
by ``a_e = S s / T``. The next velocities v⁺ keep, with a step of length h,

    −∇e·v⁺ ≤ max(min(e / max(0.05 s, 5 h), √(a_e² h² + 2 a_e e) − a_e h), (1 − h/T) s).

The chain bends: an object that goes on with its twist makes joints accelerate by ``A⁻¹ Ȧ v``. Where that takes too
large a share k of the accelerations, all joints slow down, for it falls with the square of their speed:

    vᵀ W v⁺ ≤ max(√(η / k), 1 − h/T) vᵀ W v.

Joints that brake together keep all rows, and so do joints at rest. See docs/derivations.md.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import final

import numpy as np
import pinocchio as pin

from coopqp.constraints.velocity import Rows
from coopqp.model.chain import Chain, jacobian_slope
from coopqp.model.limits import BindingLimit, LimitKind
from coopqp.model.state import CellState
from coopqp.native.constants import (
    APPROACH_STEPS,
    APPROACH_TIME,
    BEND_GIVES_WAY,
    BEND_GIVES_WAY_TO,
    BEND_OFF_PATH,
    BEND_SHARE,
    EDGE_SHARE,
    FASTEST_JOINT,
    GIVES_WAY,
    SINGULAR_MARGIN,
)
from coopqp.spatial import Array, twist_at


@final
class BrakingRows:
    """The rows of one chain.

    Args:
        chain: a workspace; its content is overwritten.
        acceleration: of each joint, that braking together is planned with (nv,) [rad/s² or m/s²].

    Attributes:
        labels: names of the limits that rows stand for. ``Rows.owner`` counts them from the end: label i is −1 − i.
    """

    def __init__(self, chain: Chain, acceleration: Array) -> None:
        cell = chain.cell
        self._chain, self._acceleration = chain, acceleration
        self._metric = np.where(np.isfinite(cell.limits.velocity), cell.limits.velocity, 1.0) ** -2.0
        names = [name.partition("/")[::2] for name in cell.joint_names]
        self.labels = (
            *(BindingLimit(cell.arm_names[part[0]], "", LimitKind.SINGULARITY) for part in chain.parts),
            *(BindingLimit(arm, joint, LimitKind.POSITION) for arm, joint in names),
            *(BindingLimit(arm, joint, LimitKind.ACCELERATION) for arm, joint in names),
        )

    def rows(self, q: Array, v: Array, h: float, about: Array, *, gives_way: bool = False, hold: bool = False) -> Rows:
        """The rows that may bind the next velocities, v⁺.

        Args:
            q: commanded configuration (nq,).
            v: joint velocities of the last step (nv,).
            h: length of the next step [s].
            about: origin of the object (3,) [m].
            gives_way: the arms have left their path to give way.
            hold: the arms are to rest, as they are where bodies overlap; then no row gives way to a body.
        """
        chain, limits, speed = self._chain, self._chain.cell.limits, np.abs(v)
        chain.evaluate(q, about)
        chain.invert()
        x, T = chain.cell.positions(q), max(float((speed / self._acceleration).max()), h)
        distances, away = self._singular_edges(q, about)
        to_singular, one = self._bounds(-away, distances, v, h, T), np.eye(len(v))
        up = self._bounds(one, limits.upper - x, v, h, T)
        down = self._bounds(-one, x - limits.lower, v, h, T)
        bent, bend_bound, used, joint = self._bend(v, h, T, BEND_OFF_PATH if gives_way else BEND_SHARE)
        n, nv = len(distances), len(v)
        G = np.vstack([-away, one, bent])
        upper = np.concatenate([to_singular, up, [bend_bound]])
        lower = np.concatenate([np.full(n, -np.inf), -down, [-np.inf]])
        owner = -1 - np.append(np.arange(n + nv), n + nv + joint)
        reach = np.minimum(
            np.maximum(speed, np.minimum(limits.velocity, speed + limits.acceleration * h)), FASTEST_JOINT
        )
        some = np.abs(G) @ reach > np.minimum(upper, -lower)  # no admissible velocity breaks the others
        soft = np.full(len(G), GIVES_WAY)
        if gives_way and not hold and used <= BEND_GIVES_WAY_TO:
            soft[-1] = BEND_GIVES_WAY
        return Rows(G[some], lower[some], upper[some], soft[some], owner[some])

    def _singular_edges(self, q: Array, about: Array) -> tuple[Array, Array]:
        """Distances of the chain's parts to singularity (P,), and their gradients (P, nv)."""
        chain, tools = self._chain, CellState(self._chain.cell, q).T_world_tool
        distances, away = np.empty(len(chain.parts)), np.zeros((len(chain.parts), chain.nv))
        for i, (part, columns) in enumerate(zip(chain.parts, chain.part_columns, strict=True)):
            if len(part) == 1:
                at_tool = twist_at(chain.jacobians[part[0]], tools[part[0]].translation - about)
                sigma, away[i, columns] = least_singular_value(at_tool)
            else:
                sigma, away[i, columns] = self._group_edge(i, tools, about)
            distances[i] = sigma - SINGULAR_MARGIN
        return distances, away

    def _group_edge(self, i: int, tools: Sequence[pin.SE3], about: Array) -> tuple[float, Array]:
        """The least singular value of a group of arms about their tools, and its gradient (n,)."""
        chain = self._chain
        at_tools = [twist_at(J, T.translation - about) for J, T in zip(chain.jacobians, tools, strict=True)]
        U, s, Vt = np.linalg.svd(chain.stacked(i, at_tools), full_matrices=False)
        slopes = list(at_tools)
        for k in chain.parts[i]:
            own = np.searchsorted(chain.part_columns[i], chain.moving_columns[k])
            slopes[k] = jacobian_slope(at_tools[k], Vt[-1][own])
        return float(s[-1]), U[:, -1] @ chain.stacked(i, slopes)

    def _bounds(self, towards: Array, distances: Array, v: Array, h: float, T: float) -> Array:
        """Largest ``towards v⁺`` (m,), for edges at distances (m,) that come closer at ``towards v`` (m, nv).

        An edge that stands still may begin to move: a_e is what the joints' accelerations make of a step from rest.
        """
        e, s = np.maximum(distances, 0.0), np.maximum(towards @ v, 0.0)
        a = EDGE_SHARE * np.maximum(s, np.abs(towards) @ self._acceleration * h) / T
        stopping = np.sqrt((a * h) ** 2 + 2.0 * a * e) - a * h
        gentle = np.minimum(e / max(APPROACH_TIME, APPROACH_STEPS * h), stopping)
        return np.maximum(gentle, (1.0 - h / T) * s)

    def _bend(self, v: Array, h: float, T: float, most: float) -> tuple[Array, float, float, int]:
        """The row by the chain's bend (nv,), its bound for a largest share, the share, and the joint that needs it."""
        chain = self._chain
        pairs = zip(chain.jacobians, chain.moving_columns, strict=True)
        turning = np.array([bend(J, v[columns]) for J, columns in pairs])
        used = np.abs(chain.joint_velocities(turning)) / self._acceleration
        joint = int(used.argmax())
        row = v * self._metric
        size = math.sqrt(row @ v)
        if not used[joint] > 0.5 * most or not size > 0.0:
            return row, np.inf, 0.0, joint
        bound = max(math.sqrt(most / used[joint]), 1.0 - h / T) * size
        return row / size, bound, float(used[joint]), joint


def least_singular_value(J: Array) -> tuple[float, Array]:
    """The least singular value σ of an arm's J (6, n) about its tool, and its gradient over the joints (n,).

    ``∂σ/∂q_j = uᵀ (∂J/∂q_j) w`` with the singular vectors u and w. That is ``uᵀ J′_j`` with ``J′ = Σ_i w_i ∂_i J``: the
    two differ by turns of ``J w``, which is σ u.
    """
    U, s, Vt = np.linalg.svd(J, full_matrices=False)
    return float(s[-1]), U[:, -1] @ jacobian_slope(J, Vt[-1])


def bend(J: Array, v: Array) -> Array:
    """``J̇ v`` (6,) of an arm with J (6, n) about a point that moves with the object, and velocities v (n,)."""
    bent: Array = jacobian_slope(J, v) @ v
    return bent
