"""The choice of one joint trajectory for each arm, so that all bodies keep their margins at the samples."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import final

import numpy as np
import numpy.typing as npt

from coopqp.collision.built_scene import BuiltScene
from coopqp.collision.distances import Distances
from coopqp.core._core import SMALL_CLEARANCE
from coopqp.spatial import Array

Indices = npt.NDArray[np.intp]


def clear_choice(built: BuiltScene, ways: Sequence[Array]) -> tuple[int, ...] | None:
    """One way for each arm, the best first, so that all margins are kept at samples.

    Args:
        built: the scene whose margins are kept.
        ways: positions of all joints of each arm along its ways (B, K, its joints) [rad or m].
    """
    return _Choice(built, ways).found(())


@final
class _Choice:
    """A search in depth: arm after arm the best way that is clear of itself, the object, and the arms before."""

    def __init__(self, built: BuiltScene, ways: Sequence[Array]) -> None:
        cell = built.cell
        self._built, self._cell, self._ways, self._distances = built, cell, ways, Distances(built)
        kept = ~built.moves & ~built.inside
        moves = np.array([[(row[own] > 0.0).any() for own in cell.v_slices] for row in built.reach])
        moves = moves.reshape(-1, len(cell))
        self._groups: dict[frozenset[int], Indices] = {}
        for arms in itertools.chain(((k,) for k in range(len(cell))), itertools.combinations(range(len(cell)), 2)):
            only = np.zeros(len(cell), dtype=bool)
            only[list(arms)] = True
            self._groups[frozenset(arms)] = np.flatnonzero(kept & (moves == only).all(axis=1))
        self._clear: dict[frozenset[tuple[int, int]], bool] = {}

    def found(self, chosen: tuple[int, ...]) -> tuple[int, ...] | None:
        """A choice for all arms that begins with this one."""
        k = len(chosen)
        if k == len(self._ways):
            return chosen
        for b in range(len(self._ways[k])):
            if self._is_clear((k, b)) and all(self._is_clear((k, b), other) for other in enumerate(chosen)):
                answer = self.found((*chosen, b))
                if answer is not None:
                    return answer
        return None

    def _is_clear(self, *branches: tuple[int, int]) -> bool:
        key = frozenset(branches)
        if key not in self._clear:
            self._clear[key] = self._look(branches)
        return self._clear[key]

    def _look(self, branches: tuple[tuple[int, int], ...]) -> bool:
        """Whether the pairs that move with these arms and no others keep their margins at all samples."""
        pairs = self._groups[frozenset(k for k, _ in branches)]
        if not pairs.size:
            return True
        samples = len(self._ways[branches[0][0]][0])
        x = np.zeros((samples, self._cell.nv))
        for k, b in branches:
            x[:, self._cell.columns[k]] = self._ways[k][b]
        reach, margins = self._built.reach[pairs], self._built.margins[pairs]
        clearances = np.full(len(pairs), -np.inf)
        before = x[0]
        for row in x:
            clearances -= reach @ np.abs(row - before)
            before = row
            ask = np.flatnonzero(clearances < 0.0)
            if not ask.size:
                continue
            self._distances.place(self._cell.configuration(row))
            for i in ask.tolist():
                clearances[i] = self._distances.one(int(pairs[i])) - margins[i]
                if clearances[i] < -SMALL_CLEARANCE:
                    return False
        return True
