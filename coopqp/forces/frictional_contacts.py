"""Open palms: what of their friction is used, and the least squeeze with which they hold an object along its path.

Each palm presses with the squeeze s along its normal; the load is shared with the least wrenches at the tools. What a
palm transmits has to stay inside its friction cone and on its pad (:class:`coopqp.forces.Grip`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from coopqp.errors import InvalidInputError
from coopqp.forces.grips import Grip
from coopqp.forces.internal import load_shares
from coopqp.model.grasp import Grasp
from coopqp.model.limits import LimitKind
from coopqp.spatial import Array

#: Largest squeeze that is tried [N].
_MOST = 1e6


def palm_rows(palms: Sequence[Grip]) -> Array:
    """The palms' bounds for :func:`palms_used` (N, 2, 4, 6)."""
    out = np.zeros((len(palms), 2, 4, 6))
    for k, palm in enumerate(palms):
        out[k, 1, 3, :3] = palm.normal
        for bound in palm.bounds():
            if bound.kind in (LimitKind.FRICTION, LimitKind.TILT):
                rows = out[k, int(bound.kind is LimitKind.TILT)]
                rows[: len(bound.A), : palm.components], rows[3, : palm.components] = bound.A, bound.b
    return out


def palms_used(palms: Array, wrenches: Array) -> Array:
    """Share of each palm's friction and pad that is used (N,); above 1 it slips or tilts, inf where it does not press.

    Args:
        palms: for friction, then for tilting, the rows of A (3, 6), then b (6,), of |A w| ≤ b·w (N, 2, 4, 6); the
            second b is the palm's normal.
        wrenches: of the arms on the object, at the origins and in the axes of the tools (N, 6) [N, N·m].
    """
    forms = np.einsum("kbij,kj->kbi", palms, wrenches)
    asked, held = np.linalg.norm(forms[:, :, :3], axis=2), forms[:, :, 3]
    share = np.full_like(held, math.inf)
    np.divide(asked, held, out=share, where=held > 0.0)
    out: Array = share.max(axis=1)
    return out


def palms_need(palms: Array, wrenches: Array) -> float:
    """The normal force with which every palm could transmit its present tangential load [N]; inf if one does not press.

    Arguments as for :func:`palms_used`.
    """
    pressed = np.einsum("kj,kj->k", palms[:, 1, 3], wrenches)
    return float((palms_used(palms, wrenches) * pressed).max()) if (pressed > 0.0).all() else math.inf


def palm_use(palms: Sequence[Grip], wrenches: Array) -> Array:
    """Share of each palm's friction and pad that is used (N,); above 1 it slips or tilts, inf where it does not press.

    Args:
        palms: one per arm.
        wrenches: wrenches of the arms on the object, at the origins and in the axes of the tools (N, 6) [N, N·m].
    """
    return palms_used(palm_rows(palms), wrenches)


def squeeze_needed(palms: Sequence[Grip], wrenches: Array) -> float:
    """The normal force with which every palm could transmit its present tangential load [N]; inf if one does not press.

    Arguments as in :func:`palm_use`. Friction and pads hold in proportion to the normal force.
    """
    return palms_need(palm_rows(palms), wrenches)


def pressing(palms: Sequence[Grip]) -> Array:
    """Wrenches of palms that press with 1 N, at the tools (N, 6)."""
    out = np.zeros((len(palms), 6))
    out[:, :3] = [palm.normal for palm in palms]
    return out


def least_squeeze(palms: Sequence[Grip], grasp: Grasp, loads: Sequence[Array]) -> float:
    """The least normal force of the palms with which they hold all these loads [N].

    Args:
        palms: one per arm.
        grasp: the placements of the tools.
        loads: wrenches on the object at its origin and in its axes (6,), as :meth:`coopqp.forces.LoadShare.wrench`.

    Raises:
        InvalidInputError: normals that do not balance, or no squeeze holds a load.
    """
    to_object, shares = load_shares(grasp)
    press = pressing(palms)
    together = (to_object @ press.ravel()).reshape(-1, 6).sum(axis=0)
    if np.abs(together).max() > 1e-6:
        raise InvalidInputError("the palms' normals do not balance", "palms", "Let palms press against each other.")
    back = np.linalg.inv(to_object)
    carried = [(back @ (shares @ load)).reshape(-1, 6) for load in loads]

    def holds(squeeze: float) -> bool:
        return all(palm_use(palms, own + squeeze * press).max() <= 1.0 for own in carried)

    if not holds(_MOST):
        raise InvalidInputError("no squeeze holds the object", "palms", "Place the palms around its centre of mass.")
    low, high = 0.0, _MOST
    while high - low > 1e-9 * _MOST and high - low > 1e-4 * high:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if holds(middle) else (middle, high)
    return high
