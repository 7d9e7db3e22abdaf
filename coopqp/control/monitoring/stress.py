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

import numpy as np

from coopqp.core._core import STRUCTURE
from coopqp.spatial import Array


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
