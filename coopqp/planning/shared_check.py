"""The check of arms that share joints: each arm by itself, with the same positions of the shared joints.

:mod:`coopqp.planning.shared_way` chooses where the shared joints are along the path. The proof of each arm then has
their rates along each interval as given, so all arms prove the same motion of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from coopqp.constraints.samples import PathSamples
from coopqp.model.cell import RobotCell, slides
from coopqp.model.grasp import Grasp
from coopqp.paths.certificate import exactness, follows
from coopqp.paths.segments import Segments
from coopqp.planning.branch_checks import (
    BranchCheck,
    ToolPath,
    check_trajectory,
    led_inside,
    not_disproved,
    path_at,
    tool_path,
)
from coopqp.planning.on_shared import OnShared, group_joints
from coopqp.planning.shared_way import FEW, MOST_SAMPLES, SharedWay, ways_at
from coopqp.spatial import Array

#: Most further branches of an arm that are checked.
_MOST_CHECKED = 8


def check_group(
    cell: RobotCell,
    grasp: Grasp,
    samples: PathSamples,
    segments: Segments | None,
    group: tuple[int, ...],
    positions: Array | None,
) -> tuple[list[OnShared], list[list[BranchCheck]], SharedWay | None]:
    """Check the arms of a group along the best way of their shared joints.

    Args:
        cell, grasp, samples, segments: the task.
        group: indices of the arms.
        positions: joint positions of the cell at the start (nv,), if they are given.

    Returns:
        The arms, per arm its branches with the one first that belongs to the way, and the way; no branches and None
        where no way was found.
    """
    joints = group_joints(cell, group)
    arms = [OnShared(cell.arms[k], cell.columns[k], joints) for k in group]
    at_start, near = None, None
    if positions is not None:
        at_start = positions[joints]
        near = [positions[cell.columns[k][arm.whole.columns[arm.own]]] for k, arm in zip(group, arms, strict=True)]
    best: tuple[tuple[int, float], list[list[BranchCheck]], SharedWay] | None = None
    poses = [samples.tool_poses(grasp.T_object_tool[k]) for k in group]
    every = ways_at(cell, arms, group, samples, segments, poses, (MOST_SAMPLES, FEW), at_start=at_start, near=near)
    for way, starts in every:
        found = [
            _branches(arm, tool_path(segments, samples, grasp.T_object_tool[k]), way, own, alone=positions is not None)
            for k, arm, own in zip(group, arms, starts, strict=True)
        ]
        good = all(own and follows(own[0].verdict) for own in found)
        rank = (
            sum(bool(own) and follows(own[0].verdict) for own in found),
            min((o[0].until for o in found if o), default=0.0),
        )
        if best is None or rank > best[0]:
            best = rank, found, way
        if good:
            break
    if best is None:
        return arms, [[] for _ in group], None
    checked = []
    for k, arm, own in zip(group, arms, best[1], strict=True):
        tool = tool_path(segments, samples, grasp.T_object_tool[k])
        checked.append(own if any(follows(b.verdict) for b in own) else not_disproved(arm.whole, tool, own))
    return arms, checked, best[2]


def _branches(arm: OnShared, path: ToolPath, way: SharedWay, starts: Array, *, alone: bool) -> list[BranchCheck]:
    """Verdicts on the branches of an arm that begin at ``starts`` (B, n) of its own joints, along a way."""
    places = np.union1d(path.places, way.places) if path.segments is not None else path.places
    if path.segments is not None:
        whole = np.round(places)
        places = np.unique(np.where(np.abs(places - whole) < 1e-9, whole, places))
        places = places[np.r_[True, np.diff(places) > 1e-9]]
        path = path_at(path, places)
    s = way.at(places)
    exact = exactness(path.poses)
    seen = replace(path, poses=arm.seen(s, path.poses))
    rows = starts[:1] if alone else starts[:_MOST_CHECKED]
    first = arm.alone.solve(seen.poses[:1], rows, tolerance=exact, steps=8).q
    walks = arm.alone.walk(seen.poses, first, tolerance=exact)
    out = []
    for m in range(len(rows)):
        q = walks.q[m, : int(walks.reached[m]) + 1]
        if arm.alone.n > 6:
            q = led_inside(arm.alone, seen, q, exact)
        found = check_trajectory(arm.whole, path, arm.joined(s[: len(q)], q))
        out.append(replace(found, trajectory=found.trajectory.with_shared(lambda at: arm.shared(way.at(at)))))
    return out


def stands_at(cell: RobotCell, way: SharedWay) -> str:
    """A sentence on where the shared joints are."""
    names = [cell.joint_names[j] for j in way.joints]
    sliding = [slides(cell)[j] for j in way.joints]

    def at(row: Sequence[float]) -> str:
        return ", ".join(
            f"{name} at {1e3 * x:.0f} mm" if slide else f"{name} at {np.rad2deg(x):.1f}°"
            for name, x, slide in zip(names, row, sliding, strict=True)
        )

    if way.stands:
        return f"{at(way.s[0].tolist())} for the whole path"
    low, high = way.s.min(axis=0), way.s.max(axis=0)
    parts = []
    for name, a, b, first, last, slide in zip(names, low, high, way.s[0], way.s[-1], sliding, strict=True):
        unit, size = ("mm", 1e3) if slide else ("°", 180.0 / np.pi)
        if b - a < 1e-6:
            parts.append(f"{name} at {size * first:.0f} {unit}")
            continue
        text = f"{name} from {size * first:.0f} to {size * last:.0f} {unit}"
        if a < min(first, last) - 1e-6 or b > max(first, last) + 1e-6:
            text += f" between {size * a:.0f} and {size * b:.0f} {unit}"
        parts.append(text)
    return f"{', '.join(parts)} along the path"
