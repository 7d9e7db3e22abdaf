"""All branches of an arm at a tool pose: all joint positions that reach it, and the whole turns inside the limits."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from coopqp.checks import ArrayLike, as_count
from coopqp.model.batch import REACHED, ArmKinematics
from coopqp.spatial import Array, Placement

#: Solutions that differ by less in every joint are one [rad or m].
MERGED = 1e-5
#: Seeds per round, most rounds, and hits of every branch that end the search after a round without a new branch.
_ROUND, _MOST_ROUNDS, _ENOUGH_HITS = 64, 12, 4
#: An arm of six joints has at most 16 solutions; more than these are samples of infinitely many at a singularity.
_MOST_APART = 64
#: Most solutions of a redundant arm, and seeds for them.
_MOST_REDUNDANT, _REDUNDANT_SEEDS = 256, 256
#: Positions outside a limit by less count as inside [rad or m].
AT_LIMIT = 1e-9


@dataclass(frozen=True, eq=False)
class Branches:
    """Solutions of one arm at one tool pose, each once, whole turns aside; the one furthest inside the limits first.

    A redundant arm has infinitely many; then these are samples.

    Attributes:
        q: joint positions (B, n) [rad or m], each joint at the turn furthest inside its limits.
        hits: number of seeds that ended in each (B,).
        margins: distance to the nearer limit (B, n) [rad or m]; negative outside.
        sigma_min: smallest singular value of the tool's Jacobian (B,), in metres and radians.
        seeds: number of seeds.
        closest: smallest residual of any seed [m, rad]: the remaining error if no seed leads to a solution.
    """

    q: Array
    hits: npt.NDArray[np.intp]
    margins: Array
    sigma_min: Array
    seeds: int
    closest: float

    def __len__(self) -> int:
        return len(self.q)

    @property
    def inside(self) -> npt.NDArray[np.bool_]:
        """True for branches inside all limits (B,)."""
        return self.margins.min(axis=1, initial=np.inf) >= -AT_LIMIT


def find_branches(
    kinematics: ArmKinematics,
    T_world_tool: Placement,
    *,
    seed_factor: int = 1,
    near: ArrayLike | None = None,
    seed: int = 0,
    quick: bool = False,
) -> Branches:
    """Search all branches at a tool pose with random seeds until a round finds no new one.

    Args:
        kinematics: the arm.
        T_world_tool: the pose.
        seed_factor: multiplies the numbers of seeds.
        near: further seeds (S, n) [rad or m], tried first.
        seed: seed of the random numbers.
        quick: a first look, with few seeds: branches may be missing.
    """
    seed_factor = as_count(seed_factor, "find_branches: seed_factor")
    search = _Search(kinematics, T_world_tool)
    rng = np.random.default_rng(seed)
    if near is not None:
        search.try_seeds(np.asarray(near, dtype=float))
    if kinematics.n > 6:
        search.try_seeds(kinematics.seeds(_ROUND if quick else _REDUNDANT_SEEDS * seed_factor, rng))
        return search.result(_MOST_REDUNDANT * seed_factor)
    for rounds in range(1, 2 if quick else _MOST_ROUNDS + 1):
        new = search.try_seeds(kinematics.seeds(_ROUND * seed_factor, rng))
        if len(search.found) > _MOST_APART:
            break
        new += search.try_neighbours()
        enough = min(search.hits) >= _ENOUGH_HITS if search.hits else rounds >= _ENOUGH_HITS
        if new == 0 and rounds > 1 and enough:
            break
    return search.result(None)


def turns_inside(kinematics: ArmKinematics, low: Array, high: Array) -> list[tuple[int, ...]]:
    """Whole turns of each joint with which motions from ``low`` to ``high`` (n,) [rad or m] are inside the limits."""
    choices: list[tuple[int, ...]] = []
    for j in range(kinematics.n):
        lower, upper = kinematics.lower[j] - AT_LIMIT, kinematics.upper[j] + AT_LIMIT
        if not kinematics.turns[j] or not kinematics.bounded[j]:
            choices.append((0,) if lower <= low[j] and high[j] <= upper else ())
            continue
        first = int(np.ceil((lower - low[j]) / (2.0 * np.pi)))
        last = int(np.floor((upper - high[j]) / (2.0 * np.pi)))
        choices.append(tuple(range(first, last + 1)))
    return choices


def all_turns(kinematics: ArmKinematics, q: Array) -> Array:
    """The same angles as ``q`` (n,) at every combination of whole turns inside the limits (T, n)."""
    choices = turns_inside(kinematics, q, q)
    turned = [q + 2.0 * np.pi * np.array(k) for k in itertools.product(*choices)]
    return np.array(turned).reshape(-1, kinematics.n)


def amount(value: float, *, slides: bool) -> str:
    """A distance of a joint for a message: degrees, or millimetres of joints that slide."""
    return f"{1e3 * value:.1f} mm" if slides else f"{np.rad2deg(value):.1f}°"


class _Search:
    """Solutions found so far, each once."""

    def __init__(self, kinematics: ArmKinematics, T_world_tool: Placement) -> None:
        self.kinematics, self.T = kinematics, T_world_tool
        self.found = np.empty((0, kinematics.n))
        self.hits: list[int] = []
        self.seeds, self.closest, self._expanded = 0, np.inf, 0

    def try_seeds(self, seeds: Array) -> int:
        """Solve from seeds; returns how many solutions are new."""
        if not len(seeds):
            return 0
        answer = self.kinematics.solve(self.T, seeds)
        self.seeds += len(seeds)
        self.closest = min(self.closest, float(answer.residual.min()))
        new = 0
        for q in answer.q[answer.residual <= REACHED]:
            same = np.flatnonzero(self.kinematics.same(self.found, q, within=MERGED))
            if same.size:
                self.hits[int(same[0])] += 1
                continue
            self.found = np.vstack([self.found, self.kinematics.nearest_turns(q)])
            self.hits.append(1)
            new += 1
        return new

    def try_neighbours(self) -> int:
        """Solve from the latest solutions, with one joint turned by half a turn or reversed."""
        latest = self.found[self._expanded :]
        self._expanded = len(self.found)
        seeds = []
        for j in np.flatnonzero(~self.kinematics.slides):
            for change in (latest[:, j] + np.pi, -latest[:, j]):
                changed = latest.copy()
                changed[:, j] = change
                seeds.append(changed)
        return self.try_seeds(np.vstack(seeds)) if seeds else 0

    def result(self, most: int | None) -> Branches:
        margins = self.kinematics.margins(self.found)
        order = np.argsort(-margins.min(axis=1, initial=np.inf), kind="stable")[:most]
        q = self.found[order]
        sigma = self.kinematics.singular_values(q)[:, -1] if len(q) else np.empty(0)
        hits = np.array(self.hits, dtype=np.intp)[order]
        return Branches(q, hits, margins[order], sigma, self.seeds, self.closest)
