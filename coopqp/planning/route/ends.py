"""The ends of a way: joint positions that hold the object at a pose, clear of bodies, or why there are none."""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from coopqp.collision.edges import Edges, columns_of
from coopqp.core._core import SMALL_CLEARANCE
from coopqp.model.batch import ArmKinematics
from coopqp.model.branches import AT_LIMIT, Branches, all_turns, amount, find_branches
from coopqp.model.cell import RobotCell
from coopqp.model.grasp import Grasp
from coopqp.spatial import Array

if TYPE_CHECKING:
    from coopqp.collision.scene import CollisionScene

#: Roots of a tree; combinations of branches that are looked at one by one; branches of each arm that are combined.
_ROOTS, _MOST_TRIED, _MOST_OPTIONS = 3, 100, 48
#: Branches whose smallest singular value is less than this are no ends [m, rad].
_SINGULAR = 1e-3


@dataclass(frozen=True, eq=False)
class Ends:
    """Joint positions of all arms at one pose of the object.

    Attributes:
        x: joint positions (M, nv) [rad or m], the preferred first; M = 0 if there are none.
        rooms: rooms of all pairs there (M, P) [m].
        why: why there are none, naming the arm and the limit, or the pair; empty if there are.
        proved: whether there are none at all, and not only among those that were tried.
        object_alone: whether the object alone is the reason, whatever the arms do.
    """

    x: Array
    rooms: Array
    why: str = ""
    proved: bool = True
    object_alone: bool = False


def _none(cell: RobotCell, why: str, *, proved: bool = True, object_alone: bool = False) -> Ends:
    """No ends, and why."""
    return Ends(np.empty((0, cell.nv)), np.empty((0, 0)), why, proved, object_alone)


def ends_at(
    cell: RobotCell,
    arms: Sequence[ArmKinematics],
    grasp: Grasp,
    T_world_object: pin.SE3,
    scene: CollisionScene,
    edges: Edges,
    *,
    near: Array | None = None,
    given: Mapping[int, Array] | None = None,
) -> Ends:
    """Find the ends at a pose.

    Args:
        cell, arms, grasp: the arms with their kinematics, and how they hold the object.
        T_world_object: the pose.
        scene, edges: the bodies.
        near: joint positions (nv,) to which the ends are near; None for ends far from the joints' limits.
        given: positions of arms, by their numbers, that these have there [rad or m].
    """
    task = cell, arms, grasp, T_world_object, scene, edges, near, given or {}
    found = _ends(*task, quick=True)
    return found if len(found.x) or found.object_alone else _ends(*task, quick=False)


def _ends(
    cell: RobotCell,
    arms: Sequence[ArmKinematics],
    grasp: Grasp,
    T_world_object: pin.SE3,
    scene: CollisionScene,
    edges: Edges,
    near: Array | None,
    given: Mapping[int, Array],
    *,
    quick: bool,
) -> Ends:
    """The ends among all branches of each arm, or among those that a quick look finds."""
    columns, options = columns_of(cell, arms), []
    for k, q in given.items():
        if arms[k].margins(q).min() < -AT_LIMIT:
            return _none(cell, f"arm {arms[k].arm.name} is outside its limits at the positions that are given")
    for k, (arm, own, X) in enumerate(zip(arms, columns, grasp.T_object_tool, strict=True)):
        if k in given:
            options.append([(0.0, given[k])])
            continue
        found = find_branches(arm, T_world_object * X, near=None if near is None else near[None, own], quick=quick)
        choices = _choices(arm, found, None if near is None else near[own])
        if not choices:
            return _none(cell, _no_branch(arm, found))
        options.append(choices)
    rest = np.clip(np.zeros(cell.nv), cell.limits.lower, cell.limits.upper) if near is None else near
    x: list[Array] = []
    rooms: list[Array] = []
    blocked: int | None = None
    object_alone = np.isfinite(scene.required_at(np.empty((0, cell.nv)))[1])
    for tried, choice in enumerate(_combinations(options)):
        if tried == _MOST_TRIED or len(x) == _ROOTS:
            break
        row = rest.copy()
        for own, q in zip(columns, choice, strict=True):
            row[own] = q
        room = edges.rooms(row)
        if room.min(initial=np.inf) >= -SMALL_CLEARANCE:
            x.append(row)
            rooms.append(room)
        elif blocked is None:
            k = int(room.argmin())
            alone = object_alone & (room < -SMALL_CLEARANCE)
            blocked = int(np.where(alone, room, np.inf).argmin()) if alone.any() else k
            if alone.any():
                break
    if x:
        return Ends(np.array(x), np.array(rooms))
    assert blocked is not None
    first, second = scene.labels[blocked]
    if object_alone[blocked]:
        return _none(cell, f"{first} and {second} come inside their margin", object_alone=True)
    why = f"{first} and {second} come inside their margin"
    return _clear_of_all(cell, arms, scene, edges, columns, options, rest, why)


def _choices(arm: ArmKinematics, found: Branches, near: Array | None) -> list[tuple[float, Array]]:
    """Positions inside the limits with their cost, the cheapest first: far from ``near``, or close to the limits."""
    rows = found.q[found.inside & (found.sigma_min >= _SINGULAR)]
    turned = [q for row in rows for q in all_turns(arm, row)]
    cost = [float(-arm.margins(q).min()) if near is None else float(np.linalg.norm(q - near)) for q in turned]
    order = np.argsort(cost, kind="stable")[:_MOST_OPTIONS]
    return [(cost[i], turned[i]) for i in order]


def _combinations(options: Sequence[Sequence[tuple[float, Array]]]) -> Iterator[list[Array]]:
    """One position of each arm, by the sum of their costs."""
    first = (0,) * len(options)
    queue, known = [(sum(own[0][0] for own in options), first)], {first}
    while queue:
        _, index = heapq.heappop(queue)
        yield [own[i][1] for own, i in zip(options, index, strict=True)]
        for k in range(len(options)):
            after = (*index[:k], index[k] + 1, *index[k + 1 :])
            if after[k] < len(options[k]) and after not in known:
                known.add(after)
                heapq.heappush(queue, (sum(own[i][0] for own, i in zip(options, after, strict=True)), after))


def _no_branch(arm: ArmKinematics, found: Branches) -> str:
    name = arm.arm.name
    if not len(found):
        return f"arm {name} does not reach its grasp ({found.closest:.2g} m or rad remain)"
    if not found.inside.any():
        j = int(found.margins[0].argmin())
        how_far = amount(-found.margins[0, j], slides=bool(arm.slides[j]))
        return f"arm {name} would be {how_far} outside {arm.joints[j]}, in the best of its {len(found)} branches"
    return f"arm {name} is singular (σ_min {found.sigma_min.max():.1g})"


def _clear_of_all(
    cell: RobotCell,
    arms: Sequence[ArmKinematics],
    scene: CollisionScene,
    edges: Edges,
    columns: Sequence[Array],
    options: Sequence[Sequence[tuple[float, Array]]],
    rest: Array,
    why: str,
) -> Ends:
    """A clear combination among all of them."""
    ways = []
    for own, _arm, columns_own, choices in zip(cell.v_slices, arms, columns, options, strict=True):
        whole = np.tile(rest[own], (len(choices), 1, 1))
        whole[:, 0, columns_own - own.start] = [q for _, q in choices]
        ways.append(whole)
    choice = scene.clear_choice(ways)
    if choice is None:
        sampled = any(arm.n > 6 or len(own) == _MOST_OPTIONS for arm, own in zip(arms, options, strict=True))
        return _none(cell, f"{why}, in every combination of branches", proved=not sampled)
    row = rest.copy()
    for own, way, i in zip(cell.v_slices, ways, choice, strict=True):
        row[own] = way[i, 0]
    return Ends(row[None], edges.rooms(row)[None])
