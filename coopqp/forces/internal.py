"""Internal wrenches: the part of the arms' wrenches that does not move the load."""

from __future__ import annotations

import numpy as np

from coopqp.checks import ArrayLike, as_floats
from coopqp.errors import InvalidInputError
from coopqp.model.grasp import Grasp
from coopqp.spatial import Array

#: Metric of torques against forces in the load's shares [m]: short, so that forces carry the load where they can.
SHARE_LENGTH = 0.1


def internal_wrenches(wrenches: ArrayLike, grasp: Grasp) -> Array:
    """The part of the arms' wrenches that does not move the object, in its frame (…, N, 6) [N, N·m].

    Args:
        wrenches: wrench of each arm on the object, at the origin and in the axes of its tool (…, N, 6) [N, N·m].
        grasp: the placements of the tools.

    Raises:
        InvalidInputError: not one wrench per arm.
    """
    w, n = as_floats(wrenches), len(grasp)
    if w.shape[-2:] != (n, 6):
        raise InvalidInputError(f"wrenches of shape {w.shape}", "internal_wrenches", f"Give one per arm, (…, {n}, 6).")
    to_object, shares = load_shares(grasp)
    internal_of = (np.eye(6 * n) - shares @ np.tile(np.eye(6), n)) @ to_object
    return (w.reshape(-1, 6 * n) @ internal_of.T).reshape(w.shape)


def load_shares(grasp: Grasp) -> tuple[Array, Array]:
    """Maps: wrenches at the tools to the object frame (6 N, 6 N), and S, the load to its shares there (6 N, 6)."""
    n = len(grasp)
    scale = np.tile([1.0] * 3 + [SHARE_LENGTH] * 3, n)
    to_object = np.zeros((6 * n, 6 * n))
    for k, X in enumerate(grasp.T_object_tool):
        to_object[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] = X.actionInverse.T
    scaled = to_object.reshape(n, 6, 6 * n).sum(axis=0) * scale  # of full rank: its pseudo-inverse is Aᵀ (A Aᵀ)⁻¹
    shares: Array = to_object @ (scale[:, None] * np.linalg.solve(scaled @ scaled.T, scaled).T)
    return to_object, shares
