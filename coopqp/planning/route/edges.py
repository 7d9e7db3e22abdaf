"""Edges of a search: what the search asks of the arms and the bodies. :mod:`coopqp.collision.edges` answers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
import pinocchio as pin

from coopqp.model.batch import ArmKinematics
from coopqp.model.cell import RobotCell
from coopqp.model.grasp import Grasp
from coopqp.model.shapes import Body
from coopqp.planning.clearance_check import Bodies
from coopqp.spatial import Array

#: Smallest singular value of a tool's Jacobian on the way, in metres and radians.
LEAST_SIGMA = 0.02
#: Joints stay this far inside their limits [rad or m].
JOINT_MARGIN = 0.05
#: Bodies keep this much more than their margin at the samples of an edge [m].
SPARE = 0.003


@dataclass(frozen=True, eq=False)
class EdgeLimits:
    """What an edge keeps.

    Attributes:
        lower, upper: positions of all joints (nv,) [rad or m].
        required: distance of each pair (P,) [m].
        spare: how much more each pair keeps at samples (P,) [m].
        sigma_min: smallest singular value of a tool's Jacobian, in metres and radians.
    """

    lower: Array
    upper: Array
    required: Array
    spare: Array
    sigma_min: float = LEAST_SIGMA


class Samples(NamedTuple):
    """Samples along a geometry.

    Attributes:
        s: where they are (K,) [m].
        poses: of the object, rows of R (9), p (3): (K, 12).
        motion: between samples the origin moves by at most this [m], and the object turns by this [rad] (K − 1, 2).
    """

    s: Array
    poses: Array
    motion: Array


class Stop(NamedTuple):
    """What stops an edge.

    Attributes:
        kind: ``"reach"``, ``"limit"``, ``"singular"`` or ``"pair"``; empty where nothing stops it.
        number: the first joint of the arm, the joint, or the pair.
    """

    kind: str
    number: int


class Walked(NamedTuple):
    """An edge as far as it is free.

    Attributes:
        positions: joint positions (K, nv) at its poses [rad or m], K of them reached.
        rooms: lower bounds of distance less what is required (K, P) [m].
        stop: what stops it behind the last of these poses.
    """

    positions: Array
    rooms: Array
    stop: Stop


class Edges(Protocol):
    """Walks of all arms along poses of the object that keep limits and distances, between the poses, too."""

    def walk(self, poses: Array, motion: Array, x: Array, rooms: Array) -> Walked:
        """Walk as far as everything is kept.

        Args:
            poses: of the object, rows of R (9), p (3): (K, 12).
            motion: between poses the origin moves by at most this [m], and the object turns by this [rad] (K − 1, 2).
            x: joint positions (nv,) at the first pose.
            rooms: rooms (P,) there.
        """
        ...

    def object_along(self, poses: Array, motion: Array, rooms: Array) -> int:
        """How many of the poses, from the first one on, the object keeps its distances at from what stands.

        What the arms would have to do is left out, and what is between the poses: one that is not passed is not walked
        to either. Arguments as for :meth:`walk`.
        """
        ...

    def arms_along(self, poses: Array, x: Array) -> Array:
        """Joint positions (K, nv) of that walk as far as the arms follow, whatever the distances."""
        ...

    def line(self, start: Array, goal: Array, steps: int) -> Array:
        """Poses along the straight edge between two (12,), rows of R (9), p (3): (steps + 1, 12)."""
        ...

    def samples(self, poses: Array, deviations: Array) -> Samples:
        """Samples of straight lines with corners rounded off, those of :func:`coopqp.planning.route.sampling.rounded`.

        Args:
            poses: both ends, and the corners, rows of R (9), p (3): (M, 12).
            deviations: at most this far from each corner (M − 2,) [m].
        """
        ...

    def rooms(self, x: Array) -> Array:
        """Distance less what is required (P,) [m] at joint positions (nv,), or a lower bound of it."""
        ...


class SearchedBodies(Bodies, Protocol):
    """Bodies among which a way is searched: :class:`coopqp.CollisionScene`."""

    @property
    def moving(self) -> Sequence[Body]:
        """Bodies whose place is told in motion."""
        ...

    @property
    def labels(self) -> Sequence[tuple[str, str]]:
        """Names of the bodies of each pair, P of them."""
        ...

    @property
    def notes(self) -> Sequence[str]:
        """Remarks on the bodies, e.g. that a mesh counts as its hull."""
        ...

    @property
    def starts_inside(self) -> Array:
        """Pairs that may start inside their margin (P,), and come no closer then."""
        ...

    def required_at(self, starts: Array) -> tuple[Array, Array]:
        """Required distances (P,) [m], where pairs may start inside their margin as at ``starts`` (M, nv), and levers.

        Levers (P,) are finite for pairs of the object and a body that stands: no motion of an arm changes these.
        """
        ...

    def edges(self, arms: Sequence[ArmKinematics], grasp: Grasp, limits: EdgeLimits) -> Edges:
        """Edges of these arms, which hold the object by a grasp."""
        ...

    def pushed(self, T_world_object: pin.SE3, along: Array, required: Array) -> pin.SE3 | None:
        """A pose pushed across a line until the object keeps its distances from what stands; None if it does not.

        Args:
            T_world_object: the pose.
            along: unit vector of the line (3,), along which it is not pushed.
            required: distance of each pair (P,) [m].
        """
        ...

    def widened(self, clearance: float) -> SearchedBodies:
        """The same bodies, which keep so much more than their margins [m]."""
        ...

    def standing(self, places: Mapping[str, pin.SE3]) -> SearchedBodies:
        """The same bodies, of which those that move stand at places in the world, or where they are by default."""
        ...


def columns_of(cell: RobotCell, arms: Sequence[ArmKinematics]) -> list[Array]:
    """Columns of each arm's joints among those of the cell."""
    return [own.start + arm.columns for own, arm in zip(cell.v_slices, arms, strict=True)]


def limits_with(cell: RobotCell, starts: Array, required: Array) -> EdgeLimits:
    """What edges keep that begin at ``starts`` (M, nv), and may begin nearer to a joint's limit than others get."""
    lower = np.minimum(cell.limits.lower + JOINT_MARGIN, starts.min(axis=0))
    upper = np.maximum(cell.limits.upper - JOINT_MARGIN, starts.max(axis=0))
    return EdgeLimits(lower, upper, required, np.full(len(required), SPARE))
