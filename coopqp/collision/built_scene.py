"""A collision scene in arrays: its shapes, its pairs, and how fast each joint can change their distances.

Bounds of how fast a joint changes the distance of two parts hold whatever the configuration.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any, final

import numpy as np
import pinocchio as pin

from coopqp.collision.coal_geometry import reach_of
from coopqp.model.cell import RobotCell
from coopqp.model.shapes import Body
from coopqp.spatial import Array

#: Stroke of a sliding joint without limits, for bounds of motion [m].
_LONGEST_STROKE = 100.0


@dataclass(frozen=True, eq=False)
class BuiltScene:
    """A scene in arrays. P pairs of shapes.

    Attributes:
        cell: the arms.
        geometry: all shapes with their pairs, for the cell's model.
        names: name of each shape's body.
        labels: names of each pair's bodies.
        kinds: sign of each joint for each pair (P, nv): +1 where it moves the second body alone, −1 where it moves the
            first one alone, 0 where it moves both, or neither.
        reach: largest motion of a pair's distance per unit of joint motion (P, nv) [m/rad or 1].
        margins: margin of each pair (P,) [m].
        inside: pairs that may start inside their margin (P,).
        levers: largest distance of the object's points from its origin, for pairs of the object with a body that stands
            in the world (P,) [m]; infinite for others.
        moving_bodies: bodies whose place is told in motion.
        moving: number of the shape of each of them.
        notes: remarks on bodies by their names: hulls that are much larger than their meshes, and what convex parts
            leave out.
    """

    cell: RobotCell
    geometry: pin.GeometryModel
    names: tuple[str, ...]
    labels: tuple[tuple[str, str], ...]
    kinds: Array
    reach: Array
    margins: Array
    inside: Any
    levers: Array
    moving_bodies: tuple[Body, ...]
    moving: tuple[int, ...]
    notes: Mapping[str, str]

    @cached_property
    def second(self) -> Any:
        """Number of the second shape of each pair (P,)."""
        return np.array([int(pair.second) for pair in self.geometry.collisionPairs], dtype=int)

    @cached_property
    def moves(self) -> Any:
        """True for pairs with a moving body (P,)."""
        return np.isin(self.second, self.moving)


@dataclass(frozen=True, eq=False)
class Part:
    """A convex shape on a joint."""

    name: str
    joint: int
    frame: int
    T_joint_shape: pin.SE3
    geometry: Any
    object: bool = False
    moving: bool = False
    lever: float = np.inf


@final
class Levers:
    """The levers of joints on parts of a cell; lengths and extents are measured once for all pairs.

    Args:
        cell: the arms.
        parts: on joints of the cell, or on joint 0, the world.
    """

    def __init__(self, cell: RobotCell, parts: Sequence[Part]) -> None:
        model, limits = cell.model, cell.limits
        self._parts = parts
        self.chains = [joints_to(model, part.joint) for part in parts]
        self._origins = [np.array(placement.translation) for placement in model.jointPlacements]
        joints = list(model.joints)
        self._slides = [joint.shortname().startswith("JointModelP") for joint in joints]
        self._strokes = [0.0] * len(joints)  # of sliding joints, from their zero [m]
        for k, joint in enumerate(joints):
            if self._slides[k]:
                v = int(joint.idx_v)
                stroke = max(abs(float(limits.lower[v])), abs(float(limits.upper[v])))
                self._strokes[k] = stroke if stroke < _LONGEST_STROKE else _LONGEST_STROKE
        # Largest distance of a joint's frame from that of the joint before [m].
        lengths = zip(self._origins, self._strokes, strict=True)
        self._lengths = [float(np.linalg.norm(origin)) + stroke for origin, stroke in lengths]
        self._extent = cache(self._measured)

    def between(self, i: int, j: int) -> dict[int, float]:
        """The bound for each joint between two parts [m, or 1 for a sliding joint].

        A joint that turns moves the distance by no more than the lever of its nearest points, on either of both parts.
        Their levers are at most the part's own extent and the lengths of the links between it and the joint.
        """
        chain_i, chain_j = self.chains[i], self.chains[j]
        shared = len([None for x, y in zip(chain_i, chain_j, strict=False) if x == y])
        up, down = chain_i[shared:][::-1], chain_j[shared:]
        joints = [*up, *down]
        if not joints:
            return {}
        steps = [self._lengths[joint] for joint in up[:-1]]
        if up and down:
            apart = float(np.linalg.norm(self._origins[up[-1]] - self._origins[down[0]]))
            steps.append(apart + self._strokes[up[-1]] + self._strokes[down[0]])
        steps += [self._lengths[joint] for joint in down[1:]]
        levers_i = np.cumsum([self._extent(i, joints[0], bool(up)), *steps])
        levers_j = np.cumsum([self._extent(j, joints[-1], bool(down)), *reversed(steps)])[::-1]
        return {
            joint: 1.0 if self._slides[joint] else float(min(lever_i, lever_j))
            for joint, lever_i, lever_j in zip(joints, levers_i, levers_j, strict=True)
        }

    def _measured(self, i: int, joint: int, on: bool) -> float:
        """Largest distance of a part's points from the origin of its own joint, or of the first one after it."""
        part, T = self._parts[i], self._parts[i].T_joint_shape
        if on:
            return reach_of(part.geometry, T.rotation, T.translation)
        return reach_of(part.geometry, T.rotation, T.translation - self._origins[joint]) + self._strokes[joint]


def joints_to(model: pin.Model, joint: int) -> tuple[int, ...]:
    """The joints that carry a joint, itself included, from the base on."""
    chain = []
    while joint > 0:
        chain.append(joint)
        joint = int(model.parents[joint])
    return tuple(reversed(chain))
