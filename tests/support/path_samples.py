"""Samples of lines with rounded corners from the pieces of their geometry: those of ``rounded.cpp``."""

from __future__ import annotations

import numpy as np

from coopqp.collision.edges import LEAST_SAMPLES, Samples
from coopqp.paths.geometry import Blend, PathGeometry, Straight, ramp
from coopqp.planning.route.tree import STEP
from coopqp.spatial import Array, rotations


def samples_of(geometry: PathGeometry) -> Samples:
    """Samples of straight lines and blends, each piece's ends among them: all pieces at once.

    Args:
        geometry: its pieces are :class:`Straight` or :class:`Blend`.
    """
    lengths = np.array([piece.length for piece in geometry.pieces])
    counts = np.maximum(np.ceil(lengths / STEP).astype(int), LEAST_SAMPLES)
    own = np.repeat(np.arange(len(lengths)), counts)
    number = np.arange(len(own)) - np.repeat(np.cumsum(counts) - counts, counts)
    low, high = number / counts[own], (number + 1.0) / counts[own]
    lead, ways, turns = (np.array(rows) for rows in zip(*map(_numbers, geometry.pieces), strict=True))
    bent = np.array([isinstance(piece, Blend) for piece in geometry.pieces])[own]
    before, after = _progress(low, bent), _progress(high, bent)
    # As a blend's: p = p_C + α e_0 + β e_1, R = R_C exp(α w_0) exp(β w_1).
    a, b = (np.append(start, end[-1:]) for start, end in zip(before[:2], after[:2], strict=True))
    of = np.append(own, own[-1:])
    R = lead[of, :9].reshape(-1, 3, 3) @ rotations(a[:, None] * turns[of, 0]) @ rotations(b[:, None] * turns[of, 1])
    p = lead[of, 9:] + a[:, None] * ways[of, 0] + b[:, None] * ways[of, 1]
    # α′ falls and β′ grows along a blend.
    motion = np.empty((len(own), 2))
    for i, vectors in enumerate((ways, turns)):
        sizes = np.sqrt((vectors * vectors).sum(axis=2))[own]
        motion[:, i] = (before[2] * sizes[:, 0] + after[3] * sizes[:, 1]) * (high - low)
    s = np.append((geometry.marks[:-1])[own] + low * lengths[own], geometry.length)
    return Samples(s, np.hstack([R.reshape(-1, 9), p]), motion)


def _numbers(piece: object) -> tuple[Array, Array, Array]:
    """R (9), p (3); both ways (2, 3) [m]; both turns (2, 3) [rad], of a line the first ones."""
    if isinstance(piece, Straight):
        nothing = np.zeros(3)
        return np.append(piece.R, piece.p), np.array([piece.way, nothing]), np.array([piece.turn, nothing])
    assert isinstance(piece, Blend)
    return np.append(piece.R, piece.p), piece.ways, piece.turns


def _progress(share: Array, bent: Array) -> tuple[Array, Array, Array, Array]:
    """α, β and their slopes over the share: of a line (share, 0, 1, 0), of a blend those of its ramp."""
    x = 2.0 * share - 1.0
    level, slope, _ = ramp(x)
    return (
        np.where(bent, x - level, share),
        np.where(bent, level, 0.0),
        np.where(bent, 2.0 * (1.0 - slope), 1.0),
        np.where(bent, 2.0 * slope, 0.0),
    )
