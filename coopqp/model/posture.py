"""The posture task of redundant arms: a target, the middle of the joints' ranges, manipulability."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, final

import numpy as np
import pinocchio as pin

from coopqp.checks import Doc, documented, keep_scalars
from coopqp.model.cell import RobotCell
from coopqp.model.chain import jacobian_slope, moving_columns
from coopqp.spatial import Array


@documented
@dataclass(frozen=True, kw_only=True, eq=False)
class PostureOptions:
    """Weights of the goals of the posture task. All act in the null-space of the chain and never disturb it."""

    gain: Annotated[float, Doc("gain towards 'target' [1/s]")] = 1.0
    target: Annotated[Any, Doc("preferred configuration (nq,); None for the configuration at reset")] = None
    centring: Annotated[float, Doc("gain towards the middle between the position limits [1/s]")] = 0.0
    manipulability: Annotated[float, Doc("gain along the gradient of √det(J Jᵀ) [rad²/s]")] = 0.0
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
        moving = moving_columns(cell)
        own = [len(np.setdiff1d(columns, cell.shared)) for columns in moving]
        self._arms = [(k, s) for k, s in enumerate(cell.v_slices) if own[k] > 6]
        self._redundant = np.zeros(cell.nv, dtype=bool)
        for _, s in self._arms:
            self._redundant[s] = True
        for group in cell.groups:
            for k in group:
                self._redundant[moving[k]] = True
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

    def _manipulability_gradient(self, q: Array) -> Array:
        """Gradient (nv,) of each arm's m = √det(J Jᵀ) over its joints: ``∂_i m = m tr(J⁺ ∂_i J)``."""
        cell, gradient = self._cell, np.zeros(self._cell.nv)
        pin.computeJointJacobians(cell.model, self._data, q)
        for k, s in self._arms:
            frame = cell.tool_frames[k]
            J = pin.getFrameJacobian(cell.model, self._data, frame, pin.LOCAL_WORLD_ALIGNED)[:, s]
            m = np.sqrt(max(np.linalg.det(J @ J.T), 0.0))
            inverse = np.linalg.pinv(J)
            gradient[s] = [m * np.sum(inverse.T * jacobian_slope(J, joint)) for joint in np.eye(J.shape[1])]
        return gradient
