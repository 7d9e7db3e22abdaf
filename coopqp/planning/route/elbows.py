"""Elbow samples: ways of redundant arms whose joints are led, where the arms' least motion does not get through.

Both trees meet in a pose of the object, and the arms' elbows differ there. From the start the arms go on with their
least motion, and back from the goal, too; in between the elbows go over from one motion to the other while the object
moves on. Where they do so is tried; the way then carries the joints' positions.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from coopqp.collision.edges import LEAST_SIGMA
from coopqp.model.batch import REACHED
from coopqp.paths.geometry import PathGeometry
from coopqp.planning.route.sampling import rounded
from coopqp.planning.route.search import Searched
from coopqp.planning.route.shape import corners_of
from coopqp.planning.route.shorten import shortened
from coopqp.planning.route.tree import Node
from coopqp.spatial import Array

#: Largest deviations at corners [m] that are tried.
_WIDEST = (0.1, 0.02)
#: Shares of the way before and behind the meeting over which the elbows go over that are tried.
_OVER = (0.9, 0.6, 0.3, 0.1)
#: Joints that move further between samples jump [rad or m].
_JUMP = 0.5


class Led(NamedTuple):
    """A way with the motion of its joints.

    Attributes:
        geometry: the way.
        s: of samples along it (K,) [m].
        rows: the object's pose there, rows of R (9), p (3): (K, 12).
        positions: joint positions there (K, nv) [rad or m].
    """

    geometry: PathGeometry
    s: Array
    rows: Array
    positions: Array


def led_ways(
    task: Searched, before: list[Node], behind: list[Node], rng: np.random.Generator, until: float
) -> Iterator[Led]:
    """Ways whose samples keep limits and distances.

    Args:
        task: what is searched.
        before: nodes from a start to the pose where the trees meet.
        behind: nodes from a goal to that pose.
        rng: random numbers.
        until: :func:`time.perf_counter` when ways are made no shorter any more [s].
    """
    before, behind = (shortened(task.edges, way, rng, until) for way in (before, behind))
    first, last = corners_of(before), corners_of(behind)[::-1]
    poses = (*first, *last[1:])
    corners = np.array([pose.row() for pose in poses])
    for widest in _WIDEST:
        deviations = np.full(len(poses) - 2, widest)
        geometry = rounded(poses, deviations)
        s, rows, _ = task.edges.samples(corners, deviations)
        ahead = _walked(task, rows, before[0].x)
        back = _walked(task, rows[::-1], behind[0].x)[::-1]
        met = float(s[int(np.linalg.norm(rows[:, 9:] - first[-1].p, axis=1).argmin())])
        for low in _OVER:
            for high in _OVER:
                begins, ends = (1.0 - low) * met, met + high * (s[-1] - met)
                u = np.clip((s - begins) / (ends - begins), 0.0, 1.0)
                share = (u * u * (3.0 - 2.0 * u))[:, None]
                x = _onto(task, rows, ahead + share * (back - ahead))
                if x is not None and _keeps(task, x):
                    yield Led(geometry, s, rows, x)


def _walked(task: Searched, rows: Array, x: Array) -> Array:
    """Joint positions (K, nv) along poses with the arms' least motion; behind the end of their reach the last ones."""
    out = np.tile(x, (len(rows), 1))
    for arm, own, X in zip(task.arms, task.columns, task.grasp.T_object_tool, strict=True):
        q, reached = arm.trajectories(_tools(rows, X), x[None, own])
        last = int(reached[0])
        out[: last + 1, own], out[last + 1 :, own] = q[0, : last + 1], q[0, last]
    return out


def _tools(rows: Array, X: object) -> Array:
    """Placements of a tool (K, 4, 4) for poses of the object."""
    T = np.tile(np.eye(4), (len(rows), 1, 1))
    T[:, :3, :3], T[:, :3, 3] = rows[:, :9].reshape(-1, 3, 3), rows[:, 9:]
    out: Array = T @ X.homogeneous  # type: ignore[attr-defined]
    return out


def _onto(task: Searched, rows: Array, x: Array) -> Array | None:
    """Positions near x (K, nv) that hold the object at its poses; None if there are none."""
    out = x.copy()
    for arm, own, X in zip(task.arms, task.columns, task.grasp.T_object_tool, strict=True):
        q, residual = arm.newton(_tools(rows, X), x[:, own])
        if not (residual <= REACHED).all() or arm.singular_values(q)[:, -1].min() < LEAST_SIGMA:
            return None
        out[:, own] = q
    return out


def _keeps(task: Searched, x: Array) -> bool:
    """Whether positions (K, nv) keep limits and distances, and no joint jumps."""
    kept = task.kept
    if not ((x >= kept.lower) & (x <= kept.upper)).all() or np.abs(np.diff(x, axis=0)).max() > _JUMP:
        return False
    return all((task.edges.rooms(row) >= kept.spare).all() for row in x)
