"""A bound of the speed by the load: lines in z = σ² and σ̇, for the look-ahead and for the timing.

Along a path the joints move at ``q′ σ`` and accelerate at ``q′ σ̇ + q″ z``. The wrench on the object, and the arms' own
torques, are then affine in (z, σ̇):

    f = f₀ + z f_z + σ̇ f_σ̇,    τ = τ₀ + z τ_z + σ̇ τ_σ̇ + Jᵀ c.

The pairs (z, σ̇) for which a load share exists are the projection of a convex set: convex. Its points furthest in a fan
of directions span a polygon inside it, and the polygon's edges are the lines. Each point of the polygon is a mean of
points that the arms can carry, so they can carry it, too: the lines are safe, and tight up to the fan's fineness.
"""

from __future__ import annotations

from typing import Any, final

import numpy as np
import pinocchio as pin

from coopqp.checks import as_count, as_scalar, require
from coopqp.forces.cones import Cone, Cones
from coopqp.forces.load_sharing import LoadShare
from coopqp.spatial import Array

#: Distance of the point that the search for a furthest point aims at, and largest accepted parameter; both in units in
#: which a parameter changes the load by as much as the load itself.
_FAR, _FURTHEST = 100.0, 20.0
#: A side of the polygon that is shorter than this, in units of its size, is a corner.
_CORNER = 1e-7


@final
class LoadBound:
    """A rate bound (:class:`coopqp.RateBound`) that keeps the load within what the arms can share.

    Give it to ``QPController(constraints=[…])`` or ``coopqp.planning.time_path(bounds=[…])``. Where the arms cannot
    even hold the object at rest, the bound allows no rate.

    Args:
        load: how the load is shared, and its limits.
        directions: number of directions of the fan; more are tighter, and slower. Nine leave about 2 %.
        share: share of the room at rest that is used, in (0, 1]: the rest is for the controller's corrections.
        name: how ``ControlStep.binding`` calls it.

    Raises:
        InvalidInputError: bad arguments.
    """

    def __init__(self, load: LoadShare, *, directions: int = 9, share: float = 1.0, name: str = "load") -> None:
        require(load, LoadShare, "LoadBound: load", "Give a coopqp.forces.LoadShare.")
        self.load, self.name = load, name
        self.directions = max(3, as_count(directions, "LoadBound: directions"))
        self.share = as_scalar(share, "LoadBound: share", high=1.0)
        self._data = load.cell.model.createData()

    def lines(self, knot: Any) -> tuple[Array, Array, Array]:
        """a, b and c with ``a z + b σ̇ ≤ c`` at a :class:`coopqp.Knot`; c < 0 where rest is not admissible."""
        corners = self.polygon(knot)
        if corners is None:
            return np.zeros(1), np.zeros(1), np.array([-1.0])
        sides = np.diff(corners, axis=0)
        long = np.linalg.norm(sides / np.abs(corners).max(axis=0), axis=1) > _CORNER
        a, b = sides[long, 1], -sides[long, 0]  # outwards: from −σ̇ over z to +σ̇ the polygon is on the left
        c = a * corners[:-1][long, 0] + b * corners[:-1][long, 1]
        return a, b, self.share * np.maximum(c, 0.0)  # rest is one of the points

    def polygon(self, knot: Any) -> Array | None:
        """Corners (m, 2) of admissible (z, σ̇), from the least σ̇ at rest to the largest; None if rest is not admissible.

        The side between the last and the first corner is z = 0.
        """
        torque, wrench, to_torque = self._affine(knot)
        return self._admissible(torque, wrench, to_torque, self._fan())

    def _admissible(self, torques: Array, wrenches: Array, to_torque: Array, fan: Array) -> Array | None:
        """Corners (m, 2) of a polygon of parameters (z, s) with an answer for f₀ + z f_z + s f_s; z ≥ 0.

        Each corner has an answer itself, so all their means have. They go from the least s at z = 0 through the
        furthest points in each direction of the fan to the largest s at z = 0. None if the arms cannot exert f₀.

        Args:
            torques: torques of the arms alone (3, nv): at z = s = 0, per z, per s.
            wrenches: wrenches on the object (3, 6), likewise.
            to_torque: result of :meth:`LoadShare.to_torques`.
            fan: directions (m, 2) in (z, s), z ≥ 0, each parameter in units in which it changes the load by as much as
                the load itself.
        """
        load = self.load
        unit = max(1.0, float(np.linalg.norm(wrenches[0])))
        moving = [load.moving_part(w) for w in wrenches]
        sizes = []
        for torque, w in zip(torques[1:], wrenches[1:], strict=True):
            change = float(np.linalg.norm(w)) / unit + float((np.abs(torque) / load.torque_limits).max())
            sizes.append(1.0 / max(change, 1e-9))
        size_z, size_s = sizes
        ny = load.free.shape[1]
        rows = load.cones(
            (torques[0], moving[0]),
            [(size_s * torques[2], size_s * moving[2]), (size_z * torques[1], size_z * moving[1])],
            to_torque,
            unit,
        )
        along_s, along_z = np.eye(ny + 2)[ny:]
        none, nothing = np.zeros(1), np.zeros(ny + 2)
        rows.append(Cone(np.zeros((1, ny + 2)), none, along_z, 0.0))  # z ≥ 0
        rows += [Cone(axis[None], none, nothing, _FURTHEST) for axis in (along_s, along_z)]
        cones = Cones(rows, inside=True)
        still = Cones([*rows, Cone(along_s[None], none, nothing, 0.0)], inside=True)
        if still.nearest(np.zeros(ny + 1), 0.0) is None:
            return None
        weights = np.append(np.full(ny, 1.0 / _FAR**2), [1.0, 1.0])
        found = [np.array([0.0, 0.0])] * (len(fan) + 2)
        for i, sign in ((0, -1.0), (-1, 1.0)):
            x = cones.nearest(np.append(np.zeros(ny), sign * _FAR), 0.0, weights=weights[:-1])
            found[i] = found[i] if x is None else np.array([0.0, x[-1]])
        for i, (z, s) in enumerate(fan, start=1):
            x = cones.nearest(np.concatenate([np.zeros(ny), [_FAR * s, _FAR * z]]), weights=weights)
            found[i] = found[i] if x is None else np.array([max(x[-1], 0.0), x[-2]])
        return np.array(found) * [size_z, size_s]

    def _fan(self) -> Array:
        """Directions (m, 2) in (z, σ̇), from −σ̇ over z to +σ̇."""
        angles = np.linspace(-0.5 * np.pi, 0.5 * np.pi, self.directions)
        return np.column_stack([np.cos(angles), np.sin(angles)])

    def _affine(self, knot: Any) -> tuple[Array, Array, Array]:
        """Torques of the arms (3, nv), wrenches on the object (3, 6): at rest, per z and per σ̇; and c to torques."""
        load, state = self.load, knot.state
        model, data, q, none = load.cell.model, self._data, state.q, np.zeros(load.cell.nv)
        at_rest = np.array(pin.rnea(model, data, q, none, none))
        per_z = pin.rnea(model, data, q, knot.slope, knot.curvature) - at_rest
        per_change = pin.rnea(model, data, q, none, knot.slope) - at_rest
        R = (state.T_world_tool[0] * load.grasp.T_object_tool[0].inverse()).rotation
        twist, curve = load.object_motion(q, knot.slope, knot.curvature)
        held = load.wrench(R)
        wrench_z = load.wrench(R, twist=twist, acceleration=curve) - held
        wrench_change = load.wrench(R, acceleration=twist) - held
        return (
            np.array([at_rest, per_z, per_change]),
            np.array([held, wrench_z, wrench_change]),
            load.to_torques(state),
        )
