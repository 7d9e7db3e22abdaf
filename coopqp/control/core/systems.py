"""Joint velocities from twists, for the NumPy kernel: one linear system per arm, whichever way is cheapest.

A NumPy call costs the same for one arm as for ten, so a few arms are factorised one by one and many in one batch; arms
that are no square systems go through :meth:`Chain.invert`.
"""

from __future__ import annotations

import math
from typing import Protocol, final

import eigenpy  # type: ignore[import-untyped]
import numpy as np

from coopqp.control.core.workspace import Workspace
from coopqp.spatial import Array

#: Largest inverse that the fused step trusts; beyond, singular values have to be looked at.
_LARGE_INVERSE = 1e6
#: From so many arms on a batch is cheaper.
_MANY = 8


class ArmSystems(Protocol):
    """The arms of a workspace, each with its world twist in a row of W (n, 6)."""

    def solve(self, cap: float) -> bool:
        """Fill ``ws.velocity``; False if an arm is singular."""
        ...

    def along(self, twist: Array) -> None:
        """Fill ``ws.along_velocity`` for one world twist (6,) of all arms, at the Jacobians of the last solve."""
        ...

    def well_conditioned(self) -> bool:
        """No entry of an arm's inverse is so large that its singular values have to be looked at."""
        ...


def make_systems(ws: Workspace, W: Array) -> ArmSystems:
    """The cheapest for these arms."""
    if not (ws.eligible and bool((ws.sizes == 6).all())):
        return _AnyArms(ws, W)
    adjacent = ws.nv == 6 * ws.n_arms and bool((np.diff(ws.starts) == 6).all())
    return _Batch(ws, W) if adjacent and ws.n_arms >= _MANY else _OneByOne(ws, W)


@final
class _OneByOne:
    """Factors of every arm: a third of the cost of np.linalg.inv, most of which is checks."""

    def __init__(self, ws: Workspace, W: Array) -> None:
        self._ws, self._arms = ws, []
        for k, start in enumerate(ws.starts.tolist()):
            columns = slice(start, start + 6)
            # Views of Pinocchio's memory and of the result: making one costs as much as a product.
            views = ws.jacobian_T.T[:, columns], W[k], ws.velocity[columns], ws.along_velocity[columns]
            self._arms.append((eigenpy.PartialPivLU(6), *views))

    def solve(self, cap: float) -> bool:
        for lu, jacobian, w, v, _ in self._arms:
            lu.compute(jacobian)
            v[:] = lu.solve(w)
        velocity = self._ws.velocity
        return bool(np.dot(velocity, velocity) < math.inf)

    def along(self, twist: Array) -> None:
        for lu, _, _, _, along in self._arms:
            along[:] = lu.solve(twist)

    def well_conditioned(self) -> bool:
        # The Jacobian's norm is above 1 (its angular columns are unit vectors), and its inverse's below 1 / rcond.
        return all(lu.rcond() * _LARGE_INVERSE > 1.0 for lu, *_ in self._arms)


@final
class _Batch:
    """All arms in one call of LAPACK."""

    def __init__(self, ws: Workspace, W: Array) -> None:
        self._ws, self._W = ws, W[:, :, None]
        self._jacobians = ws.jacobian_T.reshape(ws.n_arms, 6, 6).transpose(0, 2, 1)
        self._velocity = ws.velocity.reshape(ws.n_arms, 6, 1)
        self._along_velocity = ws.along_velocity.reshape(ws.n_arms, 6, 1)

    def solve(self, cap: float) -> bool:
        try:
            self._velocity[:] = np.linalg.solve(self._jacobians, self._W)
        except np.linalg.LinAlgError:
            return False
        velocity = self._ws.velocity
        return bool(np.dot(velocity, velocity) < math.inf)

    def along(self, twist: Array) -> None:
        self._along_velocity[:] = np.linalg.solve(self._jacobians, twist[:, None])

    def well_conditioned(self) -> bool:
        return bool(np.abs(np.linalg.inv(self._jacobians)).max() < _LARGE_INVERSE)


@final
class _AnyArms:
    """Arms of any number of joints, redundant ones near the null-space motion that is wished for."""

    def __init__(self, ws: Workspace, W: Array) -> None:
        self._ws, self._W = ws, W

    def solve(self, cap: float) -> bool:
        ws, chain = self._ws, self._ws.chain
        chain.invert()
        if chain.singular:
            return False
        chain.joint_velocities(self._W, ws.velocity)
        if ws.redundant:
            ws.velocity += chain.null_part(cap * ws.null_along + ws.null_offset)
        return True

    def along(self, twist: Array) -> None:
        ws = self._ws
        ws.chain.joint_velocities(np.broadcast_to(twist, (ws.n_arms, 6)), ws.along_velocity)
        if ws.redundant:
            ws.along_velocity += ws.chain.null_part(ws.null_along)

    def well_conditioned(self) -> bool:
        return True  # a chain that is singular says so
