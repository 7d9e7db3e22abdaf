"""Distances along a whole way before the motion, proved between samples, and the choice of branches that keep clear.

Between two places of a way the joints move by no more than m_j, so a pair with reach ρ comes no closer than
``½ (d₁ + d₂ − Σ ρ_j m_j)``. Intervals are halved until this is more than the margin.
"""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple, final

import numpy as np
import numpy.typing as npt

from coopqp.collision.clearance import Clearance
from coopqp.collision.distances import Distances
from coopqp.model.shapes import NearPair
from coopqp.planning.branch_checks import PathVerdict
from coopqp.planning.clearance import ClearanceCheck
from coopqp.planning.joint_trajectories import CellWay
from coopqp.spatial import Array

if TYPE_CHECKING:
    from coopqp.collision.scene import CollisionScene

#: A pair this far inside its margin is outside it but for rounding [m].
_ROUNDING = 1e-6
#: The least distance is proved to within this [m], or this share of its room.
_RESOLUTION, _SHARE = 2e-4, 0.05
#: Where a pair first comes inside its margin is found to within this motion of its bodies [m].
_CROSSING = 1e-5
#: Intervals with less motion than this are halved no more [m].
_SHORTEST = 1e-6
#: Intervals that are halved at once, and in all.
_AT_ONCE, _MOST = 64, 30_000
#: Where nothing is proved, joints are taken to move this many times the straight way between samples.
_BENT = 1.1
#: Pieces of a way along which redundant arms evade, at least.
_EVADING = 150

Flags = npt.NDArray[np.bool_]
Indices = npt.NDArray[np.intp]


class _Interval(NamedTuple):
    """An interval of the way with the pairs that are still open on it."""

    lowest: float  # of the rooms that are proved
    number: int
    low: float
    high: float
    x_low: Array
    x_high: Array
    pairs: Indices
    low_rooms: Array
    high_rooms: Array
    motion: float  # largest of the pairs


def along(scene: CollisionScene, way: CellWay, *, any_start: bool = False) -> ClearanceCheck:
    """Judge a way; see :class:`coopqp.planning.ClearanceCheck`.

    Args:
        scene: what may touch what.
        way: motion of the arms and the object.
        any_start: the way stands for those from any other start, too.
    """
    return replace(_Judge(scene, way, any_start=any_start).answer(), notes=scene.notes)


@final
class _Judge:
    """The search for the least room along one way."""

    def __init__(self, scene: CollisionScene, way: CellWay, *, any_start: bool) -> None:
        built, self._any_start = scene.built, any_start
        self._scene, self._way, self._built, self._cell = scene, way, built, scene.cell
        self._distances = Distances(scene)
        self._numbers = itertools.count()
        second = [int(pair.second) for pair in built.geometry.collisionPairs]
        self._pairs = np.flatnonzero(~np.isin(second, built.moving))  # where bodies move to nobody knows
        redundant = [own for own in self._cell.v_slices if own.stop - own.start > 6]
        free = np.zeros(self._cell.nv, dtype=bool)
        for own in redundant:
            free[own] = True
        self._elbows = (built.reach[:, free] > 0.0).any(axis=1) & ~np.isfinite(built.levers)
        self._sure = True
        self._bound = np.inf
        self._open: list[_Interval] = []  # what cannot be decided
        self._least: tuple[float, float, int] = (np.inf, 0.0, -1)  # room, place, pair
        self._first: tuple[float, int, float] | None = None  # place, pair, room of the first sample inside

    def answer(self) -> ClearanceCheck:
        """The verdict."""
        way = self._way
        if not self._pairs.size:
            nothing = np.zeros(0)
            return ClearanceCheck(
                verdict=PathVerdict.CERTIFIED, pair=None, margin=0.0, clock=0.0, room=np.inf, stop=None,
                stopped_by=None, undecided=np.empty((0, 2)), why="", clocks=nothing, distances=nothing,
            )  # fmt: skip
        places = way.places
        x = way.positions(places)[0]
        d = np.array([self._distances.all(self._cell.configuration(row)) for row in x])
        self._required = np.where(self._built.inside, np.minimum(self._built.margins, d[0]), self._built.margins)
        rooms = d - self._required
        inside = (rooms[:, self._pairs] < -_ROUNDING).any(axis=0)
        judged = self._pairs
        # Pairs that depend on the object's pose alone come first: no motion of an elbow and no other start helps there.
        object_alone = np.isfinite(self._built.levers)
        for decides in (object_alone, ~self._elbows) if self._any_start else (~self._elbows,):
            if decides[self._pairs[inside]].any():
                judged = self._pairs[decides[self._pairs]]
                break
        for u, row in zip(places.tolist(), rooms, strict=True):
            self._seen(u, judged, row[judged])
        self._halve([
            self._interval(a, b, x[i], x[i + 1], judged, rooms[i, judged], rooms[i + 1, judged])
            for i, (a, b) in enumerate(itertools.pairwise(places.tolist()))
        ])  # fmt: skip
        return self._put_together(places, d[:, self._pairs].min(axis=1))

    # -- the search --------------------------------------------------------------------------------------------------

    def _target(self) -> float:
        """The room that is to be proved [m]."""
        least = self._least[0]
        return max(least - max(_RESOLUTION, _SHARE * least), -_ROUNDING)

    def _seen(self, place: float, pairs: Indices, rooms: Array) -> None:
        k = int(rooms.argmin())
        if rooms[k] < self._least[0]:
            self._least = float(rooms[k]), place, int(pairs[k])
        if rooms[k] < -_ROUNDING and (self._first is None or place < self._first[0]):
            self._first = place, int(pairs[k]), float(rooms[k])

    def _interval(
        self, low: float, high: float, x_low: Array, x_high: Array, pairs: Indices, low_rooms: Array, high_rooms: Array
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
        rooms = 0.5 * (low_rooms + high_rooms - moved)
        still = rooms < self._target()
        self._bound = min(self._bound, float(rooms[~still].min(initial=np.inf)))
        return _Interval(
            float(rooms[still].min(initial=np.inf)), next(self._numbers), low, high, x_low, x_high, pairs[still],
            low_rooms[still], high_rooms[still], float(moved[still].max(initial=0.0)),
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
                rooms = d - self._required[interval.pairs]
                self._seen(u, interval.pairs, rooms)
                for half in (
                    self._interval(interval.low, u, interval.x_low, row, interval.pairs, interval.low_rooms, rooms),
                    self._interval(u, interval.high, row, interval.x_high, interval.pairs, rooms, interval.high_rooms),
                ):
                    if half.pairs.size:
                        heapq.heappush(queue, half)
        self._bound = min([self._bound, *(interval.lowest for interval in queue)])

    # -- the answer --------------------------------------------------------------------------------------------------

    def _put_together(self, places: Array, least: Array) -> ClearanceCheck:
        room, at, k = self._least
        clocks = self._way.clocks(np.append(places, at))
        order = np.argsort(clocks, kind="stable")
        pair = self._pair(k, room)
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
            k_open = self._open[0].pairs[int((self._open[0].low_rooms + self._open[0].high_rooms).argmin())]
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
            margin=float(self._built.margins[k]),
            clock=float(clocks[-1]),
            room=min(self._bound, room) if sure else -np.inf,
            stop=stop,
            stopped_by=by,
            undecided=undecided,
            why=why,
            clocks=clocks[order],
            distances=distances,
        )

    def _pair(self, k: int, room: float) -> NearPair:
        first, second = self._built.labels[k]
        return NearPair(first, second, room + float(self._required[k]))


def _merged(intervals: Array) -> Array:
    """Intervals in their order (U, 2), those that touch as one."""
    out: list[list[float]] = []
    for a, b in intervals.tolist():
        if out and a <= out[-1][1] + 1e-9:
            out[-1][1] = max(out[-1][1], b)
        else:
            out.append([a, b])
    return np.array(out).reshape(-1, 2)


# -- redundant arms ----------------------------------------------------------------------------------------------------


def evading(scene: CollisionScene, way: CellWay) -> tuple[Array, Array] | None:
    """A way on which redundant arms keep off by their self-motion, as a controller leads them; None without such arms.

    Returns:
        places (K,) and joint positions (K, nv) there.
    """
    clearance = Clearance(scene)
    cell = scene.cell
    if all(own.stop - own.start <= 6 for own in cell.v_slices):
        return None
    pieces = max(1, -(-_EVADING // max(len(way.places) - 1, 1)))
    places = np.interp(np.arange(pieces * (len(way.places) - 1) + 1) / pieces, np.arange(len(way.places)), way.places)
    clocks, poses = way.clocks(places), way.poses(places)
    x = way.positions(places[:1])[0]
    rows = [x[0]]
    for i, span in enumerate(np.diff(clocks).tolist()):
        ahead = way.reached(rows[-1], poses[i + 1])
        if ahead is None:
            return None
        if span > 0.0:
            slope = clearance.evaded(cell.configuration(rows[-1]), (ahead - rows[-1]) / span)
            ahead = way.reached(rows[-1] + span * slope, poses[i + 1])
            if ahead is None:
                return None
        rows.append(ahead)
    return places, np.array(rows)


# -- the choice of branches --------------------------------------------------------------------------------------------


def clear_choice(scene: CollisionScene, ways: Sequence[Array]) -> tuple[int, ...] | None:
    """One way for each arm, the best first, so that all margins are kept at samples.

    Args:
        scene: whose margins are kept.
        ways: positions of all joints of each arm along its ways (B, K, its joints) [rad or m].
    """
    return _Choice(scene, ways).found(())


@final
class _Choice:
    """A search in depth: arm after arm the best way that is clear of itself, the object, and the arms before."""

    def __init__(self, scene: CollisionScene, ways: Sequence[Array]) -> None:
        built, cell = scene.built, scene.cell
        self._built, self._cell, self._ways, self._distances = built, cell, ways, Distances(scene)
        second = np.array([int(pair.second) for pair in built.geometry.collisionPairs], dtype=int)
        kept = ~np.isin(second, built.moving) & ~built.inside
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
            x[:, self._cell.v_slices[k]] = self._ways[k][b]
        reach, margins = self._built.reach[pairs], self._built.margins[pairs]
        rooms = np.full(len(pairs), -np.inf)
        before = x[0]
        for row in x:
            rooms -= reach @ np.abs(row - before)
            before = row
            ask = np.flatnonzero(rooms < 0.0)
            if not ask.size:
                continue
            self._distances.place(self._cell.configuration(row))
            for i in ask.tolist():
                rooms[i] = self._distances.one(int(pairs[i])) - margins[i]
                if rooms[i] < -_ROUNDING:
                    return False
        return True
