"""The torques that the drives feed forward to carry the object."""

from __future__ import annotations

from typing import final

import numpy as np
import pinocchio as pin

from coopqp.checks import as_vector, require
from coopqp.errors import InvalidInputError, UnreachableError
from coopqp.forces.load_sharing import LoadShare
from coopqp.model.cell import RobotCell
from coopqp.model.chain import moving_columns
from coopqp.model.grasp import Grasp
from coopqp.simulation.plants.physics_options import PhysicsOptions
from coopqp.spatial import Array, cross


@final
class LoadFeedForward:
    """Feed-forward torques for the load, with the cell and the grasp as the drives know them.

    Args:
        cell, grasp: the arms and the placements of their tools on the object.
        options: ``load_feed_forward``, ``load_shares``, ``servo``, gravity and the masses that the drives assume.
        object_mass: mass of the object [kg].
        centre: its centre of mass in the object frame (3,) [m].
        load: load sharing for the whole motion of the object; None for its weight alone.
        armature: inertia of the drives at the joints (nv,).

    Raises:
        InvalidInputError: ``load`` is of other arms or another gravity, or ``load_shares`` do not fit.
    """

    def __init__(
        self,
        cell: RobotCell,
        grasp: Grasp,
        options: PhysicsOptions,
        *,
        object_mass: float,
        centre: Array,
        load: LoadShare | None,
        armature: Array,
    ) -> None:
        if load is not None:
            require(load, LoadShare, "PhysicsPlant: load", "Give a coopqp.forces.LoadShare.")
            if load.cell.joint_names != cell.joint_names:
                raise InvalidInputError(
                    "it shares the load of other arms", "PhysicsPlant: load", "Build it of the cell."
                )
            if not np.allclose(load.cell.model.gravity.linear, options.gravity):
                raise InvalidInputError("its gravity is another one", "PhysicsPlant: load", "Set cell.model.gravity.")
        self._cell, self._grasp, self._options, self._load, self._armature = cell, grasp, options, load, armature
        self._weight = -object_mass * np.array(options.gravity)
        self._centre = centre
        self.reset()
        self._data = cell.model.createData()
        #: Which tools each joint moves (N, nv).
        self._moves = np.zeros((len(cell), cell.nv), dtype=bool)
        for moved, columns in zip(self._moves, moving_columns(cell), strict=True):
            moved[columns] = True

    def reset(self) -> None:
        """All arms bear the weight by their shares."""
        shares, lever = self._shares(np.array([X.translation for X in self._grasp.T_object_tool]))
        self._forces = np.outer(shares, self._weight)  # of the arms on the object, world axes
        self._levers = np.tile(lever / len(self._cell), (len(self._cell), 1))
        self._borne: tuple[bool, ...] = (True,) * len(self._cell)
        self._goal = self._ways = self._forces, self._levers
        self._left = 0.0

    def hand_over(self, bears: tuple[bool, ...], grasp: Grasp, part: float) -> None:
        """Go over to the shares of the arms that bear the weight (N,), in parts of the whole way.

        Args:
            bears: at least one of the arms.
            grasp: where the tools are on the object.
            part: of the way from one set of arms to the next.
        """
        if bears != self._borne:
            points = np.array([X.translation for X in grasp.T_object_tool])[list(bears)]
            alone, lever = self._shares(points) if all(bears) else _least_moment(points, self._centre)
            shares, levers = np.zeros(len(bears)), np.zeros((len(bears), 3))
            shares[list(bears)], levers[list(bears)] = alone, lever / len(points)
            goal = np.outer(shares, self._weight), levers
            self._ways = goal[0] - self._forces, goal[1] - self._levers
            self._goal, self._borne, self._left = goal, bears, 1.0
        if self._left > 0.0:
            part = min(part, self._left)
            self._left -= part
            self._forces, self._levers = (
                self._goal
                if self._left <= 0.0
                else (self._forces + part * self._ways[0], self._levers + part * self._ways[1])
            )

    def _shares(self, points: Array) -> tuple[Array, Array]:
        """Each arm's share of the weight (N,), and the lever (3,) [m], in object axes, of the moment they leave."""
        n = len(self._cell)
        if self._options.load_shares is None:
            return _least_moment(points, self._centre)
        shares = as_vector(self._options.load_shares, n, "PhysicsOptions: load_shares")
        if abs(float(shares.sum()) - 1.0) > 1e-9:
            raise InvalidInputError(
                f"load_shares {shares.tolist()} do not sum to 1", "PhysicsOptions", "Give shares of the weight."
            )
        return shares, self._centre - shares @ points

    def torque(self, q: Array, velocity: Array | None = None, acceleration: Array | None = None) -> Array:
        """Torques (nv,) [N·m or N] at ``q`` (nq,), at rest by default.

        Jᵀf for the object's weight. With load sharing: for the whole motion of object and arms, less the arms' weight
        that the drives already carry. Torque-controlled drives know the arms' part by themselves.
        """
        if not self._options.load_feed_forward:
            return np.zeros(self._cell.nv)
        if self._load is None:
            return self._options.assumed_payload * self._of_weight(q)
        still = np.zeros(self._cell.nv)
        return self._of_motion(
            self._load,
            q,
            still if velocity is None else velocity,
            still if acceleration is None else acceleration,
        )

    def _of_weight(self, q: Array) -> Array:
        cell, data = self._cell, self._data
        J = np.asarray(pin.computeJointJacobians(cell.model, data, q))
        tools = [data.oMi[j] * X for j, X in zip(cell.tool_joints, cell.T_joint_tool, strict=True)]
        R_object = tools[0].rotation @ self._grasp.T_object_tool[0].rotation.T
        points = np.array([T.translation for T in tools])
        # about the world's origin, like J
        moments = cross(self._levers @ R_object.T, self._weight[None]) + cross(points, self._forces)
        by_arm: Array = np.hstack([self._forces, moments]) @ J  # (N, nv): of the wrench of each arm
        return np.where(self._moves, by_arm, 0.0).sum(axis=0)

    def _of_motion(self, load: LoadShare, q: Array, v: Array, dv: Array) -> Array:
        twist, change = load.object_motion(q, v, dv)
        try:
            shared = load.share(q, twist=twist, acceleration=change, joint_velocity=v, joint_acceleration=dv)
        except UnreachableError:  # no torques for such an acceleration: feed forward the torques of rest
            v = dv = np.zeros(self._cell.nv)
            shared = load.share(q, joint_velocity=v, joint_acceleration=dv)
        out: Array = self._options.assumed_payload * shared.load_torques
        if self._options.servo != "position":
            return out
        arms = shared.torques - shared.load_torques
        if self._options.gravity_compensation:
            arms = arms - pin.computeGeneralizedGravity(self._cell.model, self._data, q)
        return out + self._options.assumed_mass * arms + self._armature * dv


def _least_moment(points: Array, centre: Array) -> tuple[Array, Array]:
    """Shares of the weight (N,) at grasps (N, 3) [m], of the least moment, and the lever (3,) of what they leave."""
    n = len(points)
    system = np.vstack([np.ones(n), (points - centre).T])
    shares = np.linalg.lstsq(system, np.array([1.0, 0.0, 0.0, 0.0]), rcond=1e-9)[0]
    total = float(shares.sum())
    shares = shares / total if abs(total) > 1e-6 else np.full(n, 1.0 / n)
    return shares, centre - shares @ points
