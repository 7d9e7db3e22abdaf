"""What joint velocities may be: docs/derivations.md, "The velocity bounds are never empty" and "Braking together".

Gradients are central differences: nothing here is derived twice.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from closed_chain import Array, ClosedChain

#: Half the way of a central difference [rad or m].
STEP = 1e-5


@dataclass
class Bounds:
    """Bounds l ≤ v ≤ u of a step (nv,), and the velocities that lead joints back which are outside their limits."""

    lower: Array
    upper: Array
    outside: Array
    back: Array


def stopping_speed(way: Array, a: Array, h: float) -> Array:
    """The largest v with v h + v²/2a ≤ way; way / h without an acceleration limit."""
    with np.errstate(invalid="ignore", over="ignore"):
        braking = -a * h + np.sqrt((a * h) ** 2 + 2.0 * a * way)
    return np.where(np.isfinite(a) & np.isfinite(way), braking, way / h)


def velocity_bounds(limits: Any, x: Array, v: Array, h: float) -> Bounds:
    """From joint positions x and the last velocities v (nv,), for a step of length h [s]."""
    a, fastest = limits.acceleration, limits.velocity
    fastest = np.where(np.isfinite(a) | np.isfinite(fastest), fastest, 0.05 / h)
    up, down = limits.upper - x, x - limits.lower
    upper = np.minimum(fastest, stopping_speed(np.maximum(up, 0.0), a, h))
    lower = -np.minimum(fastest, stopping_speed(np.maximum(down, 0.0), a, h))
    upper, lower = (np.clip(bound, v - a * h, v + a * h) for bound in (upper, lower))
    outside = (up < 0.0) | (down < 0.0)
    inwards = np.where(up < 0.0, up - 1e-5, 1e-5 - down) / h
    share = 0.2 * np.where(np.isfinite(limits.velocity), limits.velocity, 1.0)
    return Bounds(lower, upper, outside, np.clip(np.clip(inwards, -share, share), lower, upper))


def brake_share(limits: Any, x: Array, v: Array, h: float) -> float:
    """The share of their speed that joints keep which brake together for the first of their limits."""
    speed = np.abs(v)
    longest = float((speed / limits.acceleration).max())
    if longest <= 0.0:
        return 1.0
    planned = longest / 0.8
    room = np.where(v > 0.0, limits.upper - x, x - limits.lower)
    late = (speed * (h + 0.5 * planned) > room) & (room >= 0.0)
    if not late.any():
        return 1.0
    time = float((room[late] / speed[late]).min())
    return max(0.0, 1.0 - h / min(max(2.0 * (time - h), longest), planned))


@dataclass
class Rows:
    """Rows G v ≤ upper that give way before the arms part: ``soft`` units of slack per unit (m,)."""

    G: Array
    upper: Array
    soft: Array


def braking_rows(chain: ClosedChain, limits: Any, q: Array, x: Array, v: Array, h: float, about: Array) -> Rows:
    """Rows by which arms brake together ahead of singularities, of limits, and where the chain bends."""
    speed = np.abs(v)
    a = planned(limits, h)
    T = max(float((speed / a).max()), h)
    edges, away = _singular_edges(chain, q)
    one = np.eye(chain.nv)
    towards = np.vstack([-away, one, -one])
    room = np.maximum(np.concatenate([edges, limits.upper - x, x - limits.lower]), 0.0)
    s = np.maximum(towards @ v, 0.0)
    a_e = 0.8 * np.maximum(s, np.abs(towards) @ a * h) / T
    with np.errstate(invalid="ignore"):
        gentle = np.minimum(room / max(0.05, 5.0 * h), np.sqrt((a_e * h) ** 2 + 2.0 * a_e * room) - a_e * h)
    gentle = np.where(np.isfinite(room), gentle, np.inf)
    upper = np.maximum(gentle, (1.0 - h / T) * s)
    row, most = _bend(chain, limits, a, q, v, h, T, about)
    G, upper = np.vstack([towards, row]), np.append(upper, most)
    fastest = np.minimum(limits.velocity, speed + limits.acceleration * h)
    reach = np.minimum(np.maximum(speed, fastest), 1e9)
    binds = np.abs(G) @ reach > upper
    return Rows(G[binds], upper[binds], np.full(int(binds.sum()), 0.1))


def planned(limits: Any, h: float) -> Array:
    """Accelerations that braking is planned with: 95 %, and full speed after 22 steps where there is no limit (nv,)."""
    free = np.where(np.isfinite(limits.velocity), limits.velocity, 1.0) / (22.0 * h)
    return np.where(np.isfinite(limits.acceleration), 0.95 * limits.acceleration, free)


def _singular_edges(chain: ClosedChain, q: Array) -> tuple[Array, Array]:
    """Of each part the least singular value about its tools, less 0.01, and its gradient (nv,)."""

    def least(q: Array) -> Array:
        J = np.array(chain.tool_jacobians(q))
        return np.array([np.linalg.svd(chain.stacked(J, part))[1][-1] for part in chain.parts])

    gradient = np.zeros((len(chain.parts), chain.nv))
    for j in range(chain.nv):
        step = STEP * np.eye(chain.nv)[j]
        gradient[:, j] = (least(chain.moved(q, step)) - least(chain.moved(q, -step))) / (2.0 * STEP)
    return least(q) - 0.01, gradient


def _bend(
    chain: ClosedChain, limits: Any, a: Array, q: Array, v: Array, h: float, T: float, about: Array
) -> tuple[Array, float]:
    """The row vᵀ W v⁺ of unit length, and its bound: J̇ v would take too much of the accelerations."""
    W = 1.0 / np.where(np.isfinite(limits.velocity), limits.velocity, 1.0) ** 2
    size = float(np.sqrt(v @ (W * v)))
    if size == 0.0:
        return np.zeros(chain.nv), np.inf
    before, after = chain.carried(chain.moved(q, -STEP * v)), chain.carried(chain.moved(q, STEP * v))
    here = chain.carried(q)
    J = chain.jacobians(q, about)
    bent = np.zeros((chain.n, 6))
    for k in range(chain.n):
        held = here[k].actInv(pin.SE3(np.eye(3), about)).translation  # the point moves with the object
        J_before = chain.jacobians(chain.moved(q, -STEP * v), before[k].act(held))[k]
        J_after = chain.jacobians(chain.moved(q, STEP * v), after[k].act(held))[k]
        bent[k] = (J_after - J_before) @ v / (2.0 * STEP)
    used = float((np.abs(chain.least_motion(J, bent[:, :, None])[:, 0]) / a).max())
    if used <= 0.35:
        return np.zeros(chain.nv), np.inf
    return W * v / size, max(np.sqrt(0.7 / used), 1.0 - h / T) * size
