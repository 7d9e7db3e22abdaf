"""The functions of ``distances_binding.cpp`` in NumPy, for where there is no compiler. P pairs, reaches (nv, P)."""

from __future__ import annotations

import numpy as np

from coopqp.spatial import Array


def follow(clearances: Array, reach: Array, positions: Array, x: Array, continuous: Array) -> None:
    """Move the joints from ``positions`` to ``x`` (nv,). Each clearance (P,) loses the most that this way can take."""
    way = np.abs(x - positions)
    way = np.where(continuous != 0.0, np.minimum(way, np.abs(2.0 * np.pi - way)), way)
    clearances -= way @ reach
    positions[:] = x


def certify(clearances: Array, reach: Array, spare: float, shares: Array, out: Array) -> bool:
    """Put the largest ``reach / (clearance − spare)`` of each joint into ``out`` (nv,).

    False if a clearance is at most ``spare``.
    """
    out[:] = 0.0
    if not (clearances > spare).all():
        return False
    np.divide(1.0, clearances - spare, out=shares)
    (reach * shares).max(axis=1, initial=0.0, out=out)
    return True


def near(clearances: Array, watch: Array) -> list[int]:
    """Pairs whose clearance is below their watch (P,)."""
    return np.flatnonzero(clearances < watch).tolist()


def soonest(clearances: Array, most: Array, least: float) -> int:
    """The pair that may use up its clearance first: a unit of motion takes ``most`` (P,) of it.

    Clearances count as ``least`` at least.
    """
    return int((most / np.maximum(clearances, least)).argmax())


def rows(
    ends: Array, J: Array, kinds: Array, clearances: Array, pairs: list[int], approach: float, G: Array, lower: Array
) -> None:
    """``ḋ = G v ≥ lower`` of pairs: G (m, nv), lower (m,) = −ξ times the clearance, at most 0.

    Args:
        ends: unit normal and nearest point of each, in the world (m, 6).
        J: world Jacobians of the joints (nv, 6).
        kinds, clearances: kinds (P, nv) and clearances (P,) [m] of all pairs.
        pairs: numbers of the pairs of the rows.
        approach: ξ [1/s].
        G, lower: arrays that get the rows and bounds.
    """
    n, p = ends[:, :3], ends[:, 3:]
    G[:] = (np.hstack([n, np.cross(p, n)]) @ J.T) * kinds[pairs]
    lower[:] = -approach * np.maximum(clearances[pairs], 0.0)


def binding(G: Array, lower: Array, fastest: Array) -> list[int]:
    """Rows that joints at speeds up to ``fastest`` (nv,) can break."""
    return np.flatnonzero(np.abs(G) @ fastest > -lower).tolist()
