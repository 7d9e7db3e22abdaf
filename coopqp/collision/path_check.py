"""Distances along a whole joint trajectory before the motion, proved between samples.

Between two places of a way the joints move by no more than m_j, so a pair with reach ρ comes no closer than
``½ (d₁ + d₂ − Σ ρ_j m_j)``. Intervals are halved until this is more than the margin.
"""

from __future__ import annotations

import heapq
import itertools
from dataclasses import replace
from typing import NamedTuple, final

import numpy as np
import numpy.typing as npt

from coopqp.collision.built_scene import BuiltScene
from coopqp.collision.clearance_check import ClearanceCheck
from coopqp.collision.distances import Distances
from coopqp.core._core import SMALL_CLEARANCE
from coopqp.model.shapes import NearPair
from coopqp.paths.certificate import PathVerdict
from coopqp.paths.joint_trajectories import CellTrajectory
from coopqp.spatial import Array

#: The least distance is proved to within this [m], or this share of its clearance.
_RESOLUTION, _SHARE = 2e-4, 0.05
#: Where a pair first comes inside its margin is found to within this motion of its bodies [m].
_CROSSING = 1e-5
#: Intervals with less motion than this are halved no more [m].
_SHORTEST = 1e-6
#: Intervals that are halved at once, and in all.
_AT_ONCE, _MOST = 64, 30_000
#: Where nothing is proved, joints are taken to move this many times the straight way between samples.
_BENT = 1.1
Indices = npt.NDArray[np.intp]


class _Interval(NamedTuple):
    """An interval of the way with the pairs that are still open on it."""

    lowest: float  # of the clearances that are proved
    number: int
    low: float
    high: float
    x_low: Array
    x_high: Array
    pairs: Indices
    low_clearances: Array
    high_clearances: Array
    motion: float  # largest of the pairs


def check_clearance(built: BuiltScene, way: CellTrajectory, *, any_start: bool = False) -> ClearanceCheck:
    """Judge a way; see :class:`coopqp.planning.ClearanceCheck`.

    Args:
        built: what may touch what.
        way: motion of the arms and the object.
        any_start: the way stands for those from any other start, too.
    """
    return replace(_PathCheck(built, way, any_start=any_start).answer(), notes=tuple(built.notes.values()))


@final
class _PathCheck:
    """The search for the least clearance along one way."""

    def __init__(self, built: BuiltScene, way: CellTrajectory, *, any_start: bool) -> None:
        self._any_start, self._way, self._built, self._cell = any_start, way, built, built.cell
        self._distances = Distances(built)
        self._numbers = itertools.count()
        self._pairs = np.flatnonzero(~built.moves)  # where bodies move to nobody knows
        redundant = [own for own in self._cell.columns if len(own) > 6]
        free = np.zeros(self._cell.nv, dtype=bool)
        for own in redundant:
            free[own] = True
        self._elbows = (built.reach[:, free] > 0.0).any(axis=1) & ~np.isfinite(built.levers)
        self._sure = True
        self._bound = np.inf
        self._open: list[_Interval] = []  # what cannot be decided
        self._least: tuple[float, float, int] = (np.inf, 0.0, -1)  # clearance, place, pair
        self._first: tuple[float, int, float] | None = None  # place, pair, clearance of the first sample inside

    def answer(self) -> ClearanceCheck:
        """The verdict."""
        way = self._way
        if not self._pairs.size:
            nothing = np.zeros(0)
            return ClearanceCheck(
                verdict=PathVerdict.CERTIFIED, pair=None, margin=0.0, clock=0.0, proved=np.inf, stop=None,
                stopped_by=None, undecided=np.empty((0, 2)), why="", clocks=nothing, distances=nothing,
            )  # fmt: skip
        places = way.places
        x = way.positions(places)[0]
        d = np.array([self._distances.all(self._cell.configuration(row)) for row in x])
        self._required = np.where(self._built.inside, np.minimum(self._built.margins, d[0]), self._built.margins)
        clearances = d - self._required
        inside = (clearances[:, self._pairs] < -SMALL_CLEARANCE).any(axis=0)
        judged = self._pairs
        # Pairs that depend on the object's pose alone come first: no motion of an elbow and no other start helps there.
        object_alone = np.isfinite(self._built.levers)
        for decides in (object_alone, ~self._elbows) if self._any_start else (~self._elbows,):
            if decides[self._pairs[inside]].any():
                judged = self._pairs[decides[self._pairs]]
                break
        for u, row in zip(places.tolist(), clearances, strict=True):
            self._seen(u, judged, row[judged])
        self._halve([
            self._interval(a, b, x[i], x[i + 1], judged, clearances[i, judged], clearances[i + 1, judged])
            for i, (a, b) in enumerate(itertools.pairwise(places.tolist()))
        ])  # fmt: skip
        return self._put_together(places, d[:, self._pairs].min(axis=1))

    # -- the search --------------------------------------------------------------------------------------------------

    def _target(self) -> float:
        """The clearance that is to be proved [m]."""
        least = self._least[0]
        return max(least - max(_RESOLUTION, _SHARE * least), -SMALL_CLEARANCE)

    def _seen(self, place: float, pairs: Indices, clearances: Array) -> None:
        k = int(clearances.argmin())
        if clearances[k] < self._least[0]:
            self._least = float(clearances[k]), place, int(pairs[k])
        if clearances[k] < -SMALL_CLEARANCE and (self._first is None or place < self._first[0]):
            self._first = place, int(pairs[k]), float(clearances[k])

    def _interval(
        self,
        low: float,
        high: float,
        x_low: Array,
        x_high: Array,
        pairs: Indices,
        low_clearances: Array,
        high_clearances: Array,
    ) -> _Interval:
        """An interval with the pairs that may come too close on it."""
        a, b = np.array([low]), np.array([high])
        known = self._way.motion(a, b)[0]
        blind = ~np.isfinite(known)
        joints = np.where(blind, _BENT * np.abs(x_high - x_low), known)
        reach = self._built.reach[pairs]
        moved = reach @ joints
        unknown = (reach[:, blind] > 0.0).any(axis=1)
        origin, turn = self._way.object_motion(a, b)
        levers = self._built.levers[pairs]
        rigid = np.isfinite(levers) & np.isfinite(origin[0])
        if rigid.any():
            moved[rigid] = np.minimum(moved[rigid], origin[0] + turn[0] * levers[rigid])
            unknown &= ~rigid
        if unknown.any():
            self._sure = False
        clearances = 0.5 * (low_clearances + high_clearances - moved)
        still = clearances < self._target()
        self._bound = min(self._bound, float(clearances[~still].min(initial=np.inf)))
        return _Interval(
            float(clearances[still].min(initial=np.inf)), next(self._numbers), low, high, x_low, x_high, pairs[still],
            low_clearances[still], high_clearances[still], float(moved[still].max(initial=0.0)),
        )  # fmt: skip

    def _halve(self, intervals: list[_Interval]) -> None:
        """Halve intervals, the worst first, until all are decided; those before the first sample inside, if any."""
        queue = [interval for interval in intervals if interval.pairs.size]
        heapq.heapify(queue)
        halved = 0
        while queue:
            chosen: list[_Interval] = []
            while queue and len(chosen) < _AT_ONCE and queue[0].lowest < self._target():
                interval = heapq.heappop(queue)
                if self._first is not None and interval.low >= self._first[0]:
                    continue
                if interval.motion < (_SHORTEST if self._first is None else _CROSSING) or halved >= _MOST:
                    self._open.append(interval)
                else:
                    chosen.append(interval)
            if not chosen:
                break
            halved += len(chosen)
            middles = np.array([0.5 * (interval.low + interval.high) for interval in chosen])
            x, solved = self._way.positions(middles)
            for interval, u, row, found in zip(chosen, middles.tolist(), x, solved.tolist(), strict=True):
                if not found:
                    self._open.append(interval)
                    continue
                self._distances.place(self._cell.configuration(row))
                d = np.array([self._distances.one(int(k)) for k in interval.pairs])
                clearances = d - self._required[interval.pairs]
                self._seen(u, interval.pairs, clearances)
                for half in (
                    self._interval(
                        interval.low, u, interval.x_low, row, interval.pairs, interval.low_clearances, clearances
                    ),
                    self._interval(
                        u, interval.high, row, interval.x_high, interval.pairs, clearances, interval.high_clearances
                    ),
                ):
                    if half.pairs.size:
                        heapq.heappush(queue, half)
        self._bound = min([self._bound, *(interval.lowest for interval in queue)])

    # -- the answer --------------------------------------------------------------------------------------------------

    def _put_together(self, places: Array, least: Array) -> ClearanceCheck:
        clearance, at, k = self._least
        clocks = self._way.clocks(np.append(places, at))
        order = np.argsort(clocks, kind="stable")
        pair = self._pair(k, clearance)
        distances = np.append(least, min(pair.distance, float(np.interp(at, places, least))))[order]
        verdict, why, stop, by, undecided = PathVerdict.CERTIFIED, "", None, None, np.empty((0, 2))
        end = float(clocks.max())
        if self._first is not None:
            place, first, inside = self._first
            stop, by = float(self._way.clocks(np.array([place]))[0]), self._pair(first, inside)
            verdict = PathVerdict.INFEASIBLE
            if self._elbows[first] and place > 0.0:
                verdict, undecided = PathVerdict.UNDECIDED, np.array([[stop, end]])
                why = "Another motion of its elbow was not found, but is not excluded"
        elif self._open:
            verdict = PathVerdict.UNDECIDED
            ends = np.array(sorted((interval.low, interval.high) for interval in self._open))
            undecided = _merged(self._way.clocks(ends.ravel()).reshape(-1, 2))
            k_open = self._open[0].pairs[int((self._open[0].low_clearances + self._open[0].high_clearances).argmin())]
            first_name, second_name = self._built.labels[k_open]
            why = (
                f"it is not decided on {undecided[0, 0]:.4g}–{undecided[0, 1]:.4g} s whether {first_name} and "
                f"{second_name} keep their margin of {1e3 * self._built.margins[k_open]:.4g} mm"
            )
        elif len(places) == 1:
            verdict, why = PathVerdict.SAMPLED, "They are judged at the start alone"
        elif not self._sure:
            verdict, why = PathVerdict.SAMPLED, "Between them nothing is proved"
        if not self._way.complete and self._first is None:  # an arm's way ends early: beyond it nothing is judged
            rest = [[end, self._way.duration]]
            undecided = _merged(np.array(sorted([*undecided.tolist(), *rest])))
            verdict = PathVerdict.UNDECIDED
            ended = f"from {end:.4g} s on nothing is judged, since the way of an arm ends there"
            why = f"{why}; {ended}" if why and len(undecided) > 1 else ended
        sure = verdict is PathVerdict.CERTIFIED
        return ClearanceCheck(
            verdict=verdict,
            pair=pair,
            margin=float(self._required[k]),
            clock=float(clocks[-1]),
            proved=min(self._bound, clearance) if sure else -np.inf,
            stop=stop,
            stopped_by=by,
            undecided=undecided,
            why=why,
            clocks=clocks[order],
            distances=distances,
        )

    def _pair(self, k: int, clearance: float) -> NearPair:
        first, second = self._built.labels[k]
        return NearPair(first, second, clearance + float(self._required[k]))


def _merged(intervals: Array) -> Array:
    """Intervals in their order (U, 2), those that touch as one."""
    out: list[list[float]] = []
    for a, b in intervals.tolist():
        if out and a <= out[-1][1] + 1e-9:
            out[-1][1] = max(out[-1][1], b)
        else:
            out.append([a, b])
    return np.array(out).reshape(-1, 2)
