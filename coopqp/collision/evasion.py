"""Self-motion of redundant arms near bodies: the arms keep clear, the object stays on its path."""

from __future__ import annotations

from typing import final

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from coopqp.collision.built_scene import BuiltScene
from coopqp.collision.distances import Distances, LowerBounds
from coopqp.core._core import EVADES_EARLY, GENTLE, HELPS, SMALL_CLEARANCE, YIELDS
from coopqp.model.cell import RobotCell
from coopqp.model.chain import moving_columns
from coopqp.paths.joint_trajectories import CellTrajectory
from coopqp.spatial import Array

#: Where nothing else is said: the approach to a margin [1/s], and how far redundant arms keep from it [m].
APPROACH, COMFORT = 5.0, 0.03
#: Pieces of a trajectory along which redundant arms evade, at least.
_PIECES = 150
#: Accepted violation of a row; DAQP's default is 1e-6.
_TOLERANCE = 1e-10


def carrying(cell: RobotCell) -> list[npt.NDArray[np.intp]]:
    """Per arm, the velocity coordinates of its own joints that move its tool."""
    return [np.setdiff1d(columns, cell.shared) for columns in moving_columns(cell)]


@final
class Evasion:
    """Least self-motion z with ``G (q′ + N z) ≥ lower``. If no z keeps all rows, each may be broken at a cost.

    N is an orthonormal basis of each arm's self-motion in units of its joints' speeds.

    Args:
        cell: the arms, of which the redundant ones move.
    """

    def __init__(self, cell: RobotCell) -> None:
        import daqp

        self._solve = daqp.solve
        self._cell, self._data = cell, cell.model.createData()
        speed = cell.limits.velocity
        self._scale = np.where(np.isfinite(speed), speed, 1.0)
        self._arms = {k: own for k, own in enumerate(carrying(cell)) if len(own) > 6}

    def __bool__(self) -> bool:
        return bool(self._arms)

    def basis(self, q: Array) -> Array:
        """N (nv, z) at a configuration (nq,)."""
        model, cell = self._cell.model, self._cell
        pin.computeJointJacobians(model, self._data, q)
        columns: list[Array] = []
        for k, own in self._arms.items():
            J = np.asarray(pin.getFrameJacobian(model, self._data, cell.tool_frames[k], pin.LOCAL))[:, own]
            scale = self._scale[own]
            rest: npt.NDArray[np.float64] = np.linalg.svd(J * scale)[2][6:]
            for row in rest:
                column = np.zeros(cell.nv)
                column[own] = row * scale
                columns.append(column)
        return np.array(columns).T

    def slope(self, q: Array, slope: Array, G: Array, lower: Array) -> Array:
        """q′ (nv,) with the least self-motion at ``q`` (nq,)."""
        missing = lower - G @ slope
        if not (missing > 0.0).any():
            return slope
        N = self.basis(q)
        A = G @ N
        helps = np.abs(A).max(axis=1) > HELPS
        if not helps.any():
            return slope
        # A least-distance problem; each row has an unknown to give way by, so it has a solution.
        A, b = A[helps], missing[helps]
        m, n = len(b), len(b) + A.shape[1]
        rows = np.hstack([A, np.eye(m) / YIELDS])
        free, inequality = np.full(m, np.inf), np.zeros(m, dtype=np.intc)
        z, _, flag, _ = self._solve(np.eye(n), np.zeros(n), rows, free, b, inequality, primal_tol=_TOLERANCE)
        if flag != 1:
            return slope
        return slope + N @ z[: A.shape[1]]


@final
class EvadingSlopes:
    """Slopes of joint trajectories with the self-motion that keeps ``ḋ ≥ −ξ (d − m − comfort)``.

    It begins and ends gently, so that slopes bend and accelerations stay small: bounds are lower where a pair comes
    into view, and a small missing speed is met only in part, by its square.

    Args:
        built: what may touch what.
        bounds: lower bounds of distances, which follow the configurations that are asked about.
        approach, comfort: ξ [1/s], and the distance beyond the margin that is kept [m]. 0: arms do not evade.

    Attributes:
        begins: clearance below which a pair may change slopes [m]; 0 if none does.
    """

    def __init__(self, built: BuiltScene, bounds: LowerBounds, *, approach: float, comfort: float) -> None:
        self._built, self._bounds, self._approach, self._comfort = built, bounds, approach, comfort
        self._evasion = Evasion(built.cell)
        self.begins = comfort + EVADES_EARLY if self._evasion and comfort > 0.0 else 0.0
        self._in_view = np.full(len(built.labels), self.begins)
        self._moving = np.flatnonzero(built.moves)

    def __bool__(self) -> bool:
        return self.begins > 0.0

    def at(self, q: Array, slope: Array) -> Array:
        """q′ (nv,) at a configuration (nq,)."""
        if not self:
            return slope
        bounds = self._bounds
        bounds.follow(self._built.cell.positions(q))
        bounds.clearances[self._moving] = np.inf  # where they will be nobody knows
        bounds.distances.place(q)
        near = bounds.near(self._in_view)
        if not near:
            return slope
        G = bounds.distances.gradient(near).rows
        spare = bounds.clearances[near] - self._comfort
        lower = -self._approach * spare / np.maximum(1.0 - np.maximum(spare, 0.0) / EVADES_EARLY, SMALL_CLEARANCE)
        first = np.clip(lower - G @ slope, 0.0, GENTLE)
        return self._evasion.slope(q, slope, G, lower - first + first**2 / (2.0 * GENTLE))


def evading_trajectory(built: BuiltScene, way: CellTrajectory) -> tuple[Array, Array] | None:
    """A trajectory on which redundant arms keep off by their self-motion, as a controller leads them.

    Returns:
        places on the way (K,) and joint positions (K, nv) there; None without redundant arms.
    """
    cell = built.cell
    if all(len(own) <= 6 for own in carrying(cell)):
        return None
    evading = EvadingSlopes(built, LowerBounds(built, Distances(built)), approach=APPROACH, comfort=COMFORT)
    pieces = max(1, -(-_PIECES // max(len(way.places) - 1, 1)))
    places = np.interp(np.arange(pieces * (len(way.places) - 1) + 1) / pieces, np.arange(len(way.places)), way.places)
    clocks, poses = way.clocks(places), way.poses(places)
    x = way.positions(places[:1])[0]
    rows = [x[0]]
    for i, span in enumerate(np.diff(clocks).tolist()):
        ahead = way.reached(rows[-1], poses[i + 1])
        if ahead is None:
            return None
        if span > 0.0:
            slope = evading.at(cell.configuration(rows[-1]), (ahead - rows[-1]) / span)
            ahead = way.reached(rows[-1] + span * slope, poses[i + 1])
            if ahead is None:
                return None
        rows.append(ahead)
    return places, np.array(rows)
