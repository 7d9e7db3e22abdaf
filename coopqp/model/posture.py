"""Null-space motion of redundant arms: posture, centring, manipulability."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, final

import numpy as np
import pinocchio as pin

from coopqp.checks import Doc, documented, keep_scalars
from coopqp.model.cell import RobotCell
from coopqp.spatial import Array


@documented
@dataclass(frozen=True, kw_only=True, eq=False)
class PostureOptions:
    """Weights of the null-space goals. All goals act in the null-space of the chain and never disturb it."""

    gain: Annotated[float, Doc("gain towards 'target' [1/s]")] = 1.0
    target: Annotated[Any, Doc("preferred configuration (nq,); None for the configuration at reset")] = None
    centring: Annotated[float, Doc("gain towards the middle between the position limits [1/s]")] = 0.0
    manipulability: Annotated[
        float, Doc("gain along the gradient of √det(J Jᵀ) [rad²/s]; costs a finite difference per joint")
    ] = 0.0
    speed_share: Annotated[
        float, Doc("upper bound of the wanted null-space velocity, as a share of every joint's speed limit")
    ] = 0.2

    @property
    def asks(self) -> bool:
        """Whether a goal other than the default one is asked for."""
        return self.target is not None or (self.gain, self.centring, self.manipulability) != (1.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        keep_scalars(self, "gain", "centring", "manipulability", open_low=False)
        keep_scalars(self, "speed_share", high=1.0)


@final
class Posture:
    """Wanted joint velocities of the redundant arms of a cell; zero for the other arms."""

    def __init__(self, cell: RobotCell, options: PostureOptions) -> None:
        self._cell = cell
        self._arms = [(k, s) for k, s in enumerate(cell.v_slices) if s.stop - s.start > 6]
        self._redundant = np.zeros(cell.nv, dtype=bool)
        for _, s in self._arms:
            self._redundant[s] = True
        limits = cell.limits
        bounded = np.isfinite(limits.lower) & np.isfinite(limits.upper) & self._redundant
        self._bounded = np.flatnonzero(bounded)
        self._middle = 0.5 * (limits.lower[bounded] + limits.upper[bounded])
        self._speeds = np.where(np.isfinite(limits.velocity), limits.velocity, 1.0)
        target = options.target
        self.target = None if target is None else cell.check_configuration(target, "PostureOptions: target")
        self._given = target is not None
        self.take(options)

    def take(self, options: PostureOptions) -> None:
        """Take other weights; the target stays."""
        self._options, self._cap = options, options.speed_share * self._speeds
        self._data = self._cell.model.createData() if options.manipulability else None

    def reset(self, q: Array) -> None:
        """Take ``q`` as the target, unless one was given."""
        if not self._given:
            self.target = q

    def velocity(self, q: Array) -> Array:
        """Wanted joint velocities (nv,) at ``q``. The caller projects them on the null-space."""
        o, cell = self._options, self._cell
        v = np.zeros(cell.nv)
        if self.target is not None and o.gain:
            v += o.gain * pin.difference(cell.model, q, self.target)
        if o.centring:
            v[self._bounded] += o.centring * (self._middle - cell.positions(q)[self._bounded])
        if o.manipulability:
            v += o.manipulability * self._manipulability_gradient(q)
        v[~self._redundant] = 0.0
        excess = np.abs(v / self._cap).max()
        return v / excess if excess > 1.0 else v

    def _manipulability(self, q: Array) -> Array:
        """√det(J Jᵀ) of the redundant arms."""
        cell, data = self._cell, self._data
        pin.computeJointJacobians(cell.model, data, q)
        J = [pin.getFrameJacobian(cell.model, data, cell.tool_frames[k], pin.LOCAL)[:, s] for k, s in self._arms]
        values: Array = np.sqrt(np.maximum(np.linalg.det(np.array([one @ one.T for one in J])), 0.0))
        return values

    def _manipulability_gradient(self, q: Array, h: float = 1e-5) -> Array:
        """Gradient (nv,) of each arm's √det(J Jᵀ) with respect to its joints, by central differences.

        An arm's Jacobian depends on its own joints only: a joint of every arm moves at once.
        """
        cell = self._cell
        gradient = np.zeros(cell.nv)
        for i in range(max((s.stop - s.start for _, s in self._arms), default=0)):
            has = np.array([i < s.stop - s.start for _, s in self._arms])
            own = np.array([s.start + i for _, s in self._arms])[has]
            e = np.zeros(cell.nv)
            e[own] = h
            up, down = (self._manipulability(pin.integrate(cell.model, q, way)) for way in (e, -e))
            gradient[own] = (up - down)[has] / (2.0 * h)
        return gradient
