"""Result of a path check for distances; see :mod:`coopqp.collision.path_check`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from coopqp.model.shapes import NearPair, by_depth
from coopqp.paths.certificate import PathVerdict
from coopqp.shown import Brief
from coopqp.spatial import Array

#: What a remark says of an arm that no distance is kept from.
NO_SHAPES = "has no shapes: nothing keeps a distance from it"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ClearanceCheck(Brief):
    """Distances along the whole path.

    Attributes:
        verdict: CERTIFIED: all margins are proved to be kept at every point of the path; SAMPLED: they are at samples,
            and between them as far as the samples tell; UNDECIDED: not proved on some intervals; INFEASIBLE: a pair is
            inside its margin at a sample.
        pair: the pair that comes nearest to its margin, with its distance; None if no pair keeps a distance.
        margin: margin of that pair [m].
        clock: clock of that distance [s].
        proved: lower bound of distance less margin along the whole path [m]; −inf where nothing is proved.
        stop: clock [s] at which the first pair comes inside its margin; None if none does.
        stopped_by: that pair, and its distance there.
        undecided: intervals [a, b] of the clock that are not decided (U, 2) [s].
        why: reason against a better verdict; empty if it is certified.
        clocks, distances: the least distance (K,) [m] at clocks [s], for pictures.
        notes: remarks on the bodies, e.g. that a mesh counts as its hull.
    """

    verdict: PathVerdict
    pair: NearPair | None
    margin: float
    clock: float
    proved: float
    stop: float | None
    stopped_by: NearPair | None
    undecided: Array
    why: str
    clocks: Array
    distances: Array
    notes: tuple[str, ...] = ()

    def explain(self) -> str:
        """How near bodies come, which ones, and where; then a remark on the bodies."""
        return "\n".join((self._result(), *(f"note: {text}." for text in remark(self.notes))))

    def _result(self) -> str:
        if self.pair is None:
            return "distances: no pair keeps one."
        closest = f"{_mm(self.pair.distance)}, {self.pair.first} and {self.pair.second} at {self.clock:.2f} s"
        if self.verdict is PathVerdict.CERTIFIED:
            least = _mm(self.proved + self.margin)
            return f"distances: all margins are kept, which is proved; closest {closest} (proved: at least {least})."
        if self.verdict is PathVerdict.SAMPLED:
            return f"distances: all margins are kept at samples; closest {closest}. {self.why}."
        if self.stopped_by is None:
            return f"distances: {self.why}; closest sample {closest}."
        by = self.stopped_by
        text = f"distances: {by.first} and {by.second} come inside their margin at {self.stop:.2f} s"
        if self.stop == 0.0:
            overlap = by.distance < 0.0
            size = f"overlapping{by_depth(by.distance, '.3g')}" if overlap else f"{_mm(by.distance)} apart"
            text = f"distances: {by.first} and {by.second} start {size}, inside their margin"
            if overlap:
                return f"{text}{self._so}."
        if self.pair.distance <= 0.0:
            deep = f"overlap{by_depth(self.pair.distance, '.3g')}" if self.pair.distance < 0.0 else "touch"
            return f"{text}; {self.pair.first} and {self.pair.second} {deep} at {self.clock:.2f} s{self._so}."
        return f"{text}; closest {closest}{self._so}."

    @property
    def _so(self) -> str:
        return f". {self.why}" if self.why else ""

    def record(self) -> dict[str, Any]:
        """Plain data for JSON."""

        def named(pair: NearPair | None) -> dict[str, Any] | None:
            return None if pair is None else {"between": [pair.first, pair.second], "distance_m": pair.distance}

        return {
            "verdict": self.verdict.value,
            "closest": named(self.pair),
            "margin_m": self.margin,
            "clock_s": self.clock,
            "proved_m": self.proved if np.isfinite(self.proved) else None,
            "stop_s": self.stop,
            "stopped_by": named(self.stopped_by),
            "undecided_s": self.undecided.tolist(),
            "reason": self.why,
            "clocks_s": self.clocks.tolist(),
            "distances_m": self.distances.tolist(),
            "notes": list(self.notes),
        }


def remark(notes: Sequence[str]) -> list[str]:
    """Remarks on arms without shapes; of others the first, and how many there are besides."""
    found = [note for note in notes if note.endswith(NO_SHAPES)]
    others = [note for note in notes if not note.endswith(NO_SHAPES)]
    if others:
        more = len(others) - 1
        found.append(f"{others[0]}, and {more} more of the kind" if more else others[0])
    return found


def _mm(distance: float) -> str:
    return f"{1e3 * distance:.3g} mm"
