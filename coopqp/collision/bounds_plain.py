"""The functions of ``distances_binding.cpp`` in NumPy, for where there is no compiler. P pairs, reaches (nv, P)."""

from __future__ import annotations

import numpy as np

from coopqp.spatial import Array


def follow(rooms: Array, reach: Array, positions: Array, x: Array, continuous: Array) -> None:
    """Move the joints from ``positions`` to ``x`` (nv,). Each room (P,) loses the most that this way can take."""
    way = np.abs(x - positions)
    way = np.where(continuous != 0.0, np.minimum(way, np.abs(2.0 * np.pi - way)), way)
    rooms -= way @ reach
    positions[:] = x


def certify(rooms: Array, reach: Array, spare: float, shares: Array, out: Array) -> bool:
    """Put the largest ``reach / (room − spare)`` of each joint into ``out`` (nv,); False if a room is ≤ spare."""
    out[:] = 0.0
    if not (rooms > spare).all():
        return False
    np.divide(1.0, rooms - spare, out=shares)
    (reach * shares).max(axis=1, initial=0.0, out=out)
    return True


def near(rooms: Array, watch: Array) -> list[int]:
    """Pairs whose room is below their watch (P,)."""
    found: list[int] = np.flatnonzero(rooms < watch).tolist()
    return found


def soonest(rooms: Array, most: Array, least: float) -> int:
    """The pair that may use up its room first: a unit of motion takes ``most`` (P,) of it. Rooms count as ``least``."""
    return int((most / np.maximum(rooms, least)).argmax())


def rows(
    ends: Array, J: Array, kinds: Array, rooms: Array, pairs: list[int], approach: float, G: Array, lower: Array
) -> None:
    """``ḋ = G v ≥ lower`` of pairs: G (m, nv), lower (m,) = −ξ times the room, at most 0.

    Args:
        ends: unit normal and nearest point of each, in the world (m, 6).
        J: world Jacobians of the joints (nv, 6).
        kinds, rooms: kinds (P, nv) and rooms (P,) [m] of all pairs.
        pairs: numbers of the pairs of the rows.
        approach: ξ [1/s].
        G, lower: arrays that get the rows and bounds.
    """
    n, p = ends[:, :3], ends[:, 3:]
    G[:] = (np.hstack([n, np.cross(p, n)]) @ J.T) * kinds[pairs]
    lower[:] = -approach * np.maximum(rooms[pairs], 0.0)


def binding(G: Array, lower: Array, fastest: Array) -> list[int]:
    """Rows that joints at speeds up to ``fastest`` (nv,) can break."""
    found: list[int] = np.flatnonzero(np.abs(G) @ fastest > -lower).tolist()
    return found
