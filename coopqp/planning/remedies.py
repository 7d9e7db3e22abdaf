"""Remedies for arms that cannot follow a path: another branch, a roll of the tool, a shift of the path or of a base.

Moving the path by D is moving each base by −D, seen from the arm. So one map, of the places at which an arm can follow
the path, serves both. Every remedy is checked before it is reported.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any, final

import numpy as np
import pinocchio as pin

from coopqp.constraints.samples import PathSamples, sample_path
from coopqp.model.batch import ArmKinematics
from coopqp.model.cell import RobotCell
from coopqp.model.grasp import Grasp
from coopqp.paths.certificate import follows
from coopqp.paths.path import HoldPath, LinePath, ObjectPath, WaypointPath
from coopqp.planning.arm_starts import arm_on_path, rolled
from coopqp.planning.check import PathCheck, Remedy, check_path
from coopqp.planning.tools_on_object import tools_move
from coopqp.spatial import Array

#: Is told what is tried, and how many of how many tries are done.
Progress = Callable[[str, int, int], object]
#: Rolls of the tool [deg], in the order in which they are tried.
_ROLLS = (180.0, 90.0, -90.0, 45.0, -45.0, 135.0, -135.0, *np.arange(-165.0, 180.0, 30.0).tolist())
#: Distances of the path or of a base [m], the least first, and number of found places that are checked.
_DISTANCES, _CHECKED = (0.05, 0.1, 0.2, 0.3, 0.5), 4
_DIRECTIONS = [np.array(d) / np.linalg.norm(d) for d in itertools.product((0, 1, -1), repeat=3) if any(d)]
#: Displacements that are tried, by their distances [m].
_PLACES = [[distance * d for d in _DIRECTIONS] for distance in _DISTANCES]
_MOST_PLACES = len(_DISTANCES) * len(_DIRECTIONS)
#: Joints that move by less between two starts stay where they are [rad or m].
_MOVED = 1e-3


@final
class Remedies(tuple[Remedy, ...]):
    """Remedies, and the kinds that failed.

    Attributes:
        failed: for each kind without a remedy, the attempts and the obstacle.
    """

    failed: tuple[str, ...] = ()

    @staticmethod
    def of(tries: Iterable[Remedy | str]) -> Remedies:
        """Remedies and failures apart, each in order."""
        tries = tuple(tries)
        found = Remedies(remedy for remedy in tries if isinstance(remedy, Remedy))
        found.failed = tuple(failure for failure in tries if isinstance(failure, str))
        return found


def find_remedies(check: PathCheck, *, progress: Progress | None = None) -> Remedies:
    """Remedies for a path that is INFEASIBLE or UNDECIDED, the simplest first; none for other verdicts.

    Each kind is tried for the arms in trouble, and one of each kind is returned: the least change that was found. Its
    check says CERTIFIED or SAMPLED. ``failed`` of the answer says of the other kinds why they gave none.

    Args:
        check: the answer of :func:`check_path`.
        progress: is told what is tried, and how many of how many tries are done; a search may take a minute.
    """
    if check.feasible:
        return Remedies()
    base = check
    if check.given:
        base = check_path(check.cell, check.grasp, check.path, scene=check.scene)
        if base.feasible:
            arms = _listed(_to_be_changed(check, base))
            return Remedies.of((Remedy(kind="branch", text=f"start {arms} in another branch", check=base),))
    if tools_move(check.path):
        return Remedies.of(("a roll, a shift or another base: they are not searched where tools move on the object",))
    search = _Search(base, progress)
    if not search.bad:  # the arms follow the path, but come too close
        return Remedies.of((search.shift(),))
    return Remedies.of((search.roll(), search.shift(), search.bases()))


def _to_be_changed(check: PathCheck, base: PathCheck) -> list[str]:
    """Arms that cannot follow the path; if there are none, those that start elsewhere to keep clear."""
    bad = [arm.arm for arm in check.arms if not follows(arm.verdict)]
    if bad or check.q_start is None or base.q_start is None:
        return bad
    x, y = (check.cell.positions(q) for q in (check.q_start, base.q_start))
    return [
        name
        for name, own in zip(check.cell.arm_names, check.cell.v_slices, strict=True)
        if np.abs(x[own] - y[own]).max() > _MOVED
    ]


def _listed(names: list[str]) -> str:
    arms = [f"arm {name}" for name in names]
    return arms[0] if len(arms) == 1 else f"{', '.join(arms[:-1])} and {arms[-1]}"


@final
class _Search:
    """Remedies of one task whose arms have no start."""

    def __init__(self, check: PathCheck, progress: Progress | None) -> None:
        self.check, self._progress = check, progress
        self.samples = sample_path(check.path, check.grasp)
        self.arms = [ArmKinematics(arm) for arm in check.cell.arms]
        self.bad = [k for k, arm in enumerate(check.arms) if not follows(arm.verdict)]
        self._scores: dict[tuple[int, tuple[float, ...], float], float] = {}
        self._verdict = ""  # verdict of the last check
        self._kind, self._done = "", 0
        rolls = len(self.bad) * len(_ROLLS)
        #: Tries of each kind at most: places that are scored, and changes that are checked. Bases ask the same places.
        self._most = {
            "rolling tools": rolls + _CHECKED,
            "moving the path": len(self.arms) * _MOST_PLACES + _CHECKED,
            "moving bases": _CHECKED,
        }

    def _begin(self, kind: str) -> None:
        """The tries of a kind begin; those of the kinds before it are done."""
        kinds = list(self._most)
        self._kind, self._done = kind, sum(self._most[k] for k in kinds[: kinds.index(kind)])
        self._tell(0)

    def _tell(self, tries: int = 1) -> None:
        self._done += tries
        if self._progress is not None:
            total = sum(self._most.values())
            self._progress(self._kind, min(self._done, total), total)

    # -- a first look --------------------------------------------------------------------------------------------

    def score(self, k: int, shift: Array, roll: float = 0.0) -> float:
        """Score of an arm on the path moved by ``shift`` in the world [m], its tool rolled; −inf if it fails."""
        key = k, tuple(shift.tolist()), roll
        if key not in self._scores:
            self._tell()
            moved = PathSamples(
                self.samples.clocks, tuple(pin.SE3(T.rotation, T.translation + shift) for T in self.samples.poses)
            )
            found = arm_on_path(
                self.arms[k], moved, self.check.grasp.T_object_tool[k], roll=roll, quick=True,
                near=np.empty((0, self.arms[k].n)),
            )  # fmt: skip
            self._scores[key] = found.feasible[0].score if found.feasible else -np.inf
        return self._scores[key]

    def _confirmed(self, cell: RobotCell, grasp: Grasp, path: ObjectPath) -> PathCheck | None:
        scene = self.check.scene
        if scene is not None and (cell is not scene.cell or grasp is not self.check.grasp):
            scene = scene.of_cell(cell, grasp)
        self._tell()
        answer = check_path(cell, grasp, path, scene=scene)
        self._verdict = answer.verdict.value
        return answer if answer.feasible else None

    # -- kinds ---------------------------------------------------------------------------------------------------

    def roll(self) -> Remedy | str:
        """Roll the tool of each arm in trouble; or why this does not help."""
        self._begin("rolling tools")
        c, still = self.check, np.zeros(3)
        options: list[list[float]] = []
        for k in self.bad:
            good = [angle for angle in _ROLLS if self.score(k, still, float(np.deg2rad(angle))) > -np.inf]
            if not good:
                return f"rolling tools: arm {c.cell.arm_names[k]} follows the path at none of {len(_ROLLS)} angles"
            options.append(good)
        for choice in itertools.islice(_together(options), _CHECKED):
            angles = np.zeros(len(c.cell))
            angles[self.bad] = np.deg2rad(choice)
            tools = tuple(rolled(X, a) for X, a in zip(c.grasp.T_object_tool, angles, strict=True))
            answer = self._confirmed(c.cell, Grasp(tools), c.path)
            if answer is not None:
                changes = [f"of arm {c.cell.arm_names[k]} by {a:.0f}°" for k, a in zip(self.bad, choice, strict=True)]
                return Remedy(kind="roll", text=f"roll the tool {' and '.join(changes)}", check=answer, roll=angles)
        return f"rolling tools: {self._in_vain()}"

    def shift(self) -> Remedy | str:
        """Move the whole path; or why this does not help."""
        self._begin("moving the path")
        c, tried = self.check, 0
        order = [*self.bad, *(k for k in range(len(c.cell)) if k not in self.bad)]
        for places in _PLACES:
            good = [D for D in places if all(self.score(k, D) > -np.inf for k in order)]
            good.sort(key=lambda D: -min(self.score(k, D) for k in order))
            for D in good:
                moved = shifted(c.path, D)
                answer = self._confirmed(c.cell, c.grasp, moved)
                if answer is not None:
                    return Remedy(kind="shift", text=f"move the path by {_metres(D)} m", check=answer, shift=D)
                tried += 1
                if tried >= _CHECKED:
                    return f"moving the path: {self._in_vain()}"
        if tried:
            return f"moving the path: {self._in_vain()}"
        for k in self.bad:
            if not any(self.score(k, D) > -np.inf for places in _PLACES for D in places):
                return f"moving the path: {self._nowhere(k)}"
        return f"moving the path: no place of {_MOST_PLACES} up to {_DISTANCES[-1]:g} m away suits all arms at once"

    def _in_vain(self) -> str:
        return f"a first look found some that all arms follow, but the check of the best says {self._verdict}"

    def _nowhere(self, k: int) -> str:
        name = self.check.cell.arm_names[k]
        return f"arm {name} follows it at none of {_MOST_PLACES} places up to {_DISTANCES[-1]:g} m away"

    def bases(self) -> Remedy | str:
        """Move the base of each arm in trouble: by −D where the path moved by D is followed; or why this is no help."""
        self._begin("moving bases")
        c = self.check
        options: list[list[Array]] = []
        units = [arms for arms in c.cell.bases if not set(arms).isdisjoint(self.bad)]
        for unit in units:
            good: list[Array] = []
            for places in _PLACES:
                scored = [(min(self.score(k, D) for k in unit), i) for i, D in enumerate(places)]
                good += [-places[i] for score, i in sorted(scored, reverse=True) if score > -np.inf]
                if len(good) >= _CHECKED:
                    break
            if not good:
                return f"moving bases: {self._nowhere(unit[0])}"
            options.append(good)
        for choice in itertools.islice(_together(options), _CHECKED):
            shift, arms = np.zeros((len(c.cell), 3)), list(c.cell.arms)
            for k, D in ((k, D) for unit, D in zip(units, choice, strict=True) for k in unit):
                base = arms[k].T_world_base
                shift[k], arms[k] = D, arms[k].placed(pin.SE3(base.rotation, base.translation + D))
            answer = self._confirmed(RobotCell(arms), c.grasp, c.path)
            if answer is not None:
                named = [f"robot {arms[u[0]].robot}" if len(u) > 1 else f"arm {c.cell.arm_names[u[0]]}" for u in units]
                changes = [f"of {name} by {_metres(shift[u[0]])} m" for name, u in zip(named, units, strict=True)]
                return Remedy(kind="base", text=f"move the base {' and '.join(changes)}", check=answer, shift=shift)
        return f"moving bases: {self._in_vain()}"


def _together(options: list[list[Any]]) -> Any:
    """One option of each list: the first of all, then the second of all, …"""
    for i in range(max(map(len, options))):
        yield [choices[min(i, len(choices) - 1)] for choices in options]


def _metres(D: Array) -> str:
    return f"({', '.join(f'{x + 0.0:.3g}' for x in np.round(D, 3))})"


def shifted(path: ObjectPath, shift: Array) -> ObjectPath:
    """A path moved by ``shift`` (3,) in the world [m]; the library's own paths keep their type."""

    def moved(T: pin.SE3) -> pin.SE3:
        return pin.SE3(T.rotation, T.translation + shift)

    if type(path) is LinePath:
        R, screw = path.start.rotation, path.screw  # it may turn by more than half a turn
        return LinePath.displaced(
            moved(path.start), translation=R @ screw.p, rotation=screw.angle * (R @ screw.r), duration=path.duration,
            time_law=path.time_law,
        )  # fmt: skip
    if type(path) is WaypointPath:
        poses = [moved(segment.start) for segment in path.segments] + [moved(path.segments[-1].goal)]
        durations = [segment.duration for segment in path.segments]
        return WaypointPath(poses, durations=durations, time_law=path.segments[0].time_law)
    if type(path) is HoldPath:
        return HoldPath(moved(path.pose(0.0)), duration=path.duration)
    return _ShiftedPath(path, shift)


@final
class _ShiftedPath(ObjectPath):
    """A user's path, moved."""

    def __init__(self, path: ObjectPath, shift: Array) -> None:
        self._path, self._shift = path, shift
        self.duration, self.known_ahead = path.duration, path.known_ahead

    def pose(self, clock: float) -> pin.SE3:
        """T_world_object at ``clock`` [s]."""
        T = self._path.pose(clock)
        return pin.SE3(T.rotation, T.translation + self._shift)

    def twist(self, clock: float) -> Array:
        """Body twist at ``clock`` [m/s, rad/s]."""
        return self._path.twist(clock)

    def next_breakpoint(self, clock: float) -> float:
        """The path's next breakpoint [s]."""
        return self._path.next_breakpoint(clock)


def with_remedies(check: PathCheck, *, progress: Progress | None = None) -> PathCheck:
    """The same answer with its remedies; ``progress`` as of :func:`find_remedies`."""
    found = find_remedies(check, progress=progress)
    return replace(check, remedies=tuple(found), no_remedy=found.failed)
