"""The closed chain as a measurement: do the arms agree on where the object is, with these bases and grips?

Arm k sees the object at ``O_k = B_k exp(b_k) F_k(q) exp(−g_k) X_k⁻¹``: its base in the world, its own kinematics up to
the tool, and its grip. While all arms hold one rigid object, its pose is one: ``r_k = log(O_0⁻¹ O_k) = 0``. Errors b_k
of the bases and g_k of the grips break this in a model, and a motion shows how: r_k is linear in them up to second
order, with

    dr_k = Jlog(O_0⁻¹ O_k) (ξ_k − Ad(O_0⁻¹ O_k)⁻¹ ξ_0),
    ξ_k  = Ad(X_k exp(g_k) F_k⁻¹) Jexp(b_k) db_k − Ad(X_k) Jexp(−g_k) dg_k.

All arms move with the world, and all grips with the object: of the 12 N numbers, 12 are a matter of choice.
"""

from __future__ import annotations

from typing import final

import numpy as np
import pinocchio as pin

from coopqp.model.cell import RobotCell
from coopqp.model.grasp import Grasp
from coopqp.model.state import CellState
from coopqp.spatial import Array

#: Closure that joints do not explain: bending links, grips [m, rad]; keeps weights finite near singularities.
_STRUCTURE = 5e-6


@final
class Closure:
    """Closure errors of measured configurations, weighed by the noise of the joints.

    Args:
        cell, grasp: the model.
        configurations: measured configurations (T, nq), checked.
        noise: standard deviation of measured joint positions (nv,) [rad or m].
    """

    def __init__(self, cell: RobotCell, grasp: Grasp, configurations: Array, noise: Array) -> None:
        cell.refuse_shared("calibrate")
        self.cell, self.grasp = cell, grasp
        self._bases = [arm.T_world_base for arm in cell.arms]
        self._ways: list[list[pin.SE3]] = []  # F_k(q_t)
        whiteners = []
        n = len(cell)
        for q in configurations:
            state = CellState(cell, q)
            self._ways.append([B.actInv(T) for B, T in zip(self._bases, state.T_world_tool, strict=True)])
            spreads = []
            for k, (s, X) in enumerate(zip(cell.v_slices, grasp.T_object_tool, strict=True)):
                A = X.action @ state.jacobian(k) * noise[s]
                spreads.append(A @ A.T)
            cov = np.kron(np.ones((n - 1, n - 1)), spreads[0]) + _STRUCTURE**2 * np.eye(6 * n - 6)
            for k in range(1, n):
                cov[6 * k - 6 : 6 * k, 6 * k - 6 : 6 * k] += spreads[k]
            whiteners.append(np.linalg.inv(np.linalg.cholesky(cov)))
        self._whiteners = np.array(whiteners)

    def errors(self, x: Array) -> Array:
        """r_k at corrections x = (b_0, g_0, b_1, …) (12 N,), shape (T, N − 1, 6) [m, rad]."""
        return np.array([[pin.log6(M).vector for M in self._relative(ways, x)[1]] for ways in self._ways])

    def residuals(self, x: Array) -> Array:
        """Weighed closure errors (T (6N − 6),): of unit variance if only the joints' noise breaks the closure."""
        r = self.errors(x).reshape(len(self._ways), -1)
        return np.einsum("tij,tj->ti", self._whiteners, r).ravel()

    def jacobian(self, x: Array) -> Array:
        """Derivative of :meth:`residuals` (T (6N − 6), 12 N)."""
        n = len(self.cell)
        b, g = x.reshape(n, 2, 6).transpose(1, 0, 2)
        base = [pin.Jexp6(pin.Motion(v)) for v in b]
        grip = [X.action @ pin.Jexp6(pin.Motion(-v)) for X, v in zip(self.grasp.T_object_tool, g, strict=True)]
        held = [X * pin.exp6(v) for X, v in zip(self.grasp.T_object_tool, g, strict=True)]
        out = np.zeros((len(self._ways), 6 * n - 6, 12 * n))
        for rows, ways in zip(out, self._ways, strict=True):
            twists = [np.hstack([(H * F.inverse()).action @ J, -A])
                      for H, F, J, A in zip(held, ways, base, grip, strict=True)]  # fmt: skip
            for k, M in enumerate(self._relative(ways, x)[1], start=1):
                J, own = pin.Jlog6(M), slice(6 * k - 6, 6 * k)
                rows[own, 12 * k : 12 * k + 12] = J @ twists[k]
                rows[own, :12] = -J @ M.actionInverse @ twists[0]
        return np.einsum("tij,tjk->tik", self._whiteners, out).reshape(-1, 12 * n)

    def distances(self, x: Array) -> Array:
        """Largest distance [m] and angle [rad] between the object poses of any two arms, (T, 2)."""
        out = np.zeros((len(self._ways), 2))
        for row, ways in zip(out, self._ways, strict=True):
            O = self._relative(ways, x)[0]
            for i, a in enumerate(O):
                for c in O[i + 1 :]:
                    M = a.actInv(c)
                    row[:] = np.maximum(row, [np.linalg.norm(M.translation), np.linalg.norm(pin.log3(M.rotation))])
        return out

    def corrected(self, x: Array) -> tuple[list[pin.SE3], list[pin.SE3]]:
        """Bases in the world and tools on the object after corrections x, with the first arm's where they were."""
        n = len(self.cell)
        b, g = x.reshape(n, 2, 6).transpose(1, 0, 2)
        bases = [B * pin.exp6(v) for B, v in zip(self._bases, b, strict=True)]
        tools = [X * pin.exp6(v) for X, v in zip(self.grasp.T_object_tool, g, strict=True)]
        world, thing = self._bases[0] * bases[0].inverse(), self.grasp.T_object_tool[0] * tools[0].inverse()
        return [world * B for B in bases], [thing * X for X in tools]

    def gauge(self) -> Array:
        """Map of corrections of all arms to those relative to the first arm, of arms 1, 2, … (12 N − 12, 12 N)."""
        n = len(self.cell)
        M = np.zeros((12 * n - 12, 12 * n))
        for k in range(1, n):
            own = slice(12 * k - 12, 12 * k)
            M[own, 12 * k : 12 * k + 12] = np.eye(12)
            M[own.start : own.start + 6, :6] = -self._bases[k].actInv(self._bases[0]).action
            M[own.start + 6 : own.stop, 6:12] = -self.grasp.T_object_tool[k].actInv(self.grasp.T_object_tool[0]).action
        return M

    def _relative(self, ways: list[pin.SE3], x: Array) -> tuple[list[pin.SE3], list[pin.SE3]]:
        """O_k of every arm, and O_0⁻¹ O_k of arms 1, 2, …"""
        b, g = x.reshape(len(ways), 2, 6).transpose(1, 0, 2)
        O = [
            B * pin.exp6(v) * F * (X * pin.exp6(w)).inverse()
            for B, v, F, X, w in zip(self._bases, b, ways, self.grasp.T_object_tool, g, strict=True)
        ]
        return O, [O[0].actInv(o) for o in O[1:]]
