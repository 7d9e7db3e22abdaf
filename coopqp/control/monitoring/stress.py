"""Forces of the arms on the object, estimated from the deflections of the servos, without a sensor.

A servo of stiffness Kp that stands off its command pushes with ``Kp (q_command − q_measured)``. At the object that is
the wrench ``w_k = C_k⁻¹ A_k (q_command − q_measured)`` with the compliance ``C_k = A_k Kp⁻¹ A_kᵀ``, as
:meth:`coopqp.forces.internal.StressModel.from_servos` reads it.

An arm in a rigid grip that does not follow its command is dragged along by the others, and all arms then stand off
their commands by the same displacement: nothing parts them, but the wrenches do not cancel. At rest, where neither
inertia nor damping plays a part, the total wrench points the arm that does not follow straight back along its way:
``C_k Σ w`` is the distance by which its servos' target lags behind.

Arms that share joints give way to each other's wrenches: with C the compliance of all arms (6 N, 6 N), which has
blocks beside its diagonal for these joints, ``w = C⁻¹ A (q_command − q_measured)``, and arm k lags by
``(Σ_j (C⁻¹)_jk)⁻¹ Σ w``.
"""

from __future__ import annotations

from typing import Any, final

import numpy as np
import pinocchio as pin

from coopqp.model.cell import RobotCell
from coopqp.model.chain import Chain
from coopqp.model.grasp import Grasp
from coopqp.native.constants import (
    AT_REST,
    LET_GO,
    PACE_TIME,
    SERVOS_SETTLED,
    SOON,
    STRAIGHT_BACK,
    STRUCTURE,
    TURN_LENGTH,
    UNBALANCED,
)
from coopqp.spatial import Array

#: Weights of translation and rotation where directions of motion are compared [1, m/rad].
_SCALE = np.array([1.0] * 3 + [TURN_LENGTH] * 3)


@final
class StressWatch:
    """Forces at the grasps from commanded and measured configurations, filtered.

    Args:
        cell, grasp: the arms, and how they hold.
        stiffness: Kp of the joint servos (nv,) [N·m/rad or N/m].
        delay: age of a measurement against the command [s]; the motion in that time is no deflection.
        filter_time: time constant of the filter on deflections [s].

    Attributes:
        forces: at each grasp, if every arm follows its command (N,) [N].
        behind: index of the arm that does not follow; -1 if none is found.
        gap: distance by which its servos' target lags behind [m].
        pull: force with which the others pull it [N].
    """

    def __init__(self, cell: RobotCell, grasp: Grasp, *, stiffness: Array, delay: float, filter_time: float) -> None:
        self._cell, self._chain = cell, Chain(cell, grasp)
        self._softness, self._delay, self._filter_time = 1.0 / stiffness, delay, filter_time
        self.reset()

    def reset(self) -> None:
        """Forget."""
        self.forces, self.behind, self.gap, self.pull = np.zeros(len(self._cell)), -1, 0.0, 0.0
        self._slow = np.zeros(len(self._cell))
        self._deflection, self._way = np.zeros(self._cell.nv), np.zeros(self._cell.nv)
        self._last: Array | None = None
        self._rest = 0.0

    def memory(self) -> tuple[Any, ...]:
        """The state of a copy; the rest is found anew from every sample."""
        return self._deflection, self._way, self._last, self._rest, self._slow

    def restore(self, memory: tuple[Any, ...]) -> None:
        """Go on from a copy of what :meth:`memory` returned."""
        self._deflection, self._way, self._last, self._rest, self._slow = memory

    def soon(self, arm: int, limit: float) -> float:
        """What the force of an arm comes to soon at its pace, from half of a limit on [N]."""
        force = float(self.forces[arm])
        return force if not force >= LET_GO * limit else force + SOON / PACE_TIME * max(force - self._slow[arm], 0.0)

    def read(self, measured: Array, commanded: Array, dt: float, holds: Any = True) -> None:
        """Take one sample: configurations at the same time (nq,), ``dt`` seconds after the last ones.

        Nothing presses on arms that do not hold; ``holds`` (N,) tells which do, by default all.
        """
        model, chain = self._cell.model, self._chain
        keep = self._filter_time / (self._filter_time + dt)
        velocity = np.zeros(self._cell.nv) if self._last is None else pin.difference(model, self._last, commanded) / dt
        self._last = commanded
        off = pin.difference(model, measured, commanded) - self._delay * velocity
        self._deflection = self._deflection + (1.0 - keep) * (off - self._deflection)
        chain.evaluate(measured, about=chain.carried(measured)[0].translation)
        C, bent = chain.compliances(self._softness), chain.twists(self._deflection)
        shared = chain.shared_compliance(self._softness)
        wrenches = servo_wrenches(C, bent, shared) * np.reshape(holds, (-1, 1))
        self.forces = np.linalg.norm(wrenches[:, :3], axis=1)
        self._slow = self._slow + dt / (PACE_TIME + dt) * (self.forces - self._slow)
        self.behind = -1
        if np.abs(velocity).max() > AT_REST:
            self._way, self._rest = velocity, 0.0
            return
        self._rest += dt
        total = wrenches.sum(axis=0)
        if self._rest > SERVOS_SETTLED and np.linalg.norm(total[:3]) > UNBALANCED * self.forces.max():
            back, way = self._behind_by(C, total, shared), chain.twists(self._way) * _SCALE
            size = np.linalg.norm(back * _SCALE, axis=1) * np.linalg.norm(way, axis=1)
            straight = np.einsum("ij,ij->i", back * _SCALE, way) / np.maximum(size, 1e-300)
            k = int(straight.argmax())
            if straight[k] > STRAIGHT_BACK:
                self.behind, self.gap = k, float(np.linalg.norm(back[k, :3]))
                self.pull = float(np.linalg.norm((total - wrenches[k])[:3]))

    def _behind_by(self, compliances: Array, total: Array, shared: Array | None) -> Array:
        """By how much the servos' target of each arm would lag behind for the total wrench (N, 6) [m, rad]."""
        back: Array = compliances @ total
        if shared is not None:
            stiffness = np.linalg.inv(whole_compliance(compliances + STRUCTURE * np.eye(6), shared))
            sums = stiffness.reshape(len(back), 6, -1).sum(axis=0)  # of what all arms feel of where one of them is
            for k in (k for group in self._cell.groups for k in group):
                back[k] = np.linalg.solve(sums[:, 6 * k : 6 * k + 6], total)
        return back


def servo_wrenches(compliances: Array, yielded: Array, shared: Array | None = None) -> Array:
    """Wrenches (N, 6) of servos that yield by displacements (N, 6).

    Args:
        compliances: of each arm's own joints (N, 6, 6).
        yielded: of the object as each arm carries it.
        shared: compliance of the joints that arms share (6 N, 6 N); None without such joints.
    """
    C = compliances + STRUCTURE * np.eye(6)
    if shared is None:
        return np.asarray(np.linalg.solve(C, yielded[:, :, None])[:, :, 0])
    return np.asarray(np.linalg.solve(whole_compliance(C, shared), yielded.ravel())).reshape(-1, 6)


def whole_compliance(compliances: Array, shared: Array) -> Array:
    """The compliance of all arms (6 N, 6 N), from that of their own joints (N, 6, 6) and of those that they share."""
    out = shared.copy()
    for k, own in enumerate(compliances):
        out[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] += own
    return out
