"""Joint trajectories along a checked path: positions at any place of it, and largest speeds between places.

A place is the number of a segment plus the share of it, or the clock of a path without segments.
"""

from __future__ import annotations

import abc
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np
import numpy.typing as npt

from coopqp.model.batch import ArmKinematics
from coopqp.model.cell import RobotCell
from coopqp.paths.certificate import Proof, between
from coopqp.paths.path import ObjectPath
from coopqp.paths.segments import Indices, Segments
from coopqp.shown import Brief
from coopqp.spatial import Array, as_placement

#: Arms hold the object within this [m, rad].
_EXACT = 1e-10


@final
@dataclass(frozen=True, eq=False, repr=False)
class ArmTrajectory(Brief):
    """Joint trajectory of one arm: exact at its places; between them the tool's pose is reached.

    Attributes:
        kinematics: the arm.
        offset: T_object_tool (4, 4).
        places: (I + 1,).
        q: joint positions there (I + 1, n) [rad or m].
        rates: largest speed of each joint between them (I, n) per place; infinite where nothing is proved.
        shared: where the joints that other arms share are, (M, S) at places (M,); None without such joints.
    """

    kinematics: ArmKinematics
    offset: Array
    places: Array
    q: Array
    rates: Array
    shared: Callable[[Array], Array] | None = None

    def with_shared(self, shared: Callable[[Array], Array]) -> ArmTrajectory:
        """The same with positions of shared joints that are, to the last bit, those that their other arms have."""
        q = self.q.copy()
        q[:, self.kinematics.shared] = shared(self.places)
        return replace(self, q=q, shared=shared)

    @staticmethod
    def proved(kinematics: ArmKinematics, offset: Array, proof: Proof) -> ArmTrajectory:
        """The trajectory of a proof."""
        places = np.append(proof.segment + proof.low, proof.segment[-1] + proof.high[-1])
        return ArmTrajectory(kinematics, offset, places, np.vstack([proof.q_low, proof.q_high[-1:]]), proof.rate)

    @staticmethod
    def sampled(kinematics: ArmKinematics, offset: Array, places: Array, q: Array) -> ArmTrajectory:
        """The trajectory through samples."""
        return ArmTrajectory(kinematics, offset, places, q, np.full((len(q) - 1, kinematics.n), np.inf))

    def at(self, places: Array, T_world_object: Array) -> tuple[Array, npt.NDArray[np.bool_]]:
        """Joint positions (M, n) at places (M,), where the object is at (M, 4, 4), and where they reach its pose."""
        if len(self.places) == 1:
            return np.tile(self.q, (len(places), 1)), np.ones(len(places), dtype=bool)
        i = self._piece(places)
        low, high = self.places[i], self.places[i + 1]
        share = (places - low) / (high - low)
        given = None if self.shared is None else self.shared(places)
        poses = T_world_object @ self.offset
        q, _, solved = between(self.kinematics, poses, self.q[i], self.q[i + 1], share, given=given)
        for end, there in ((0.0, self.q[i]), (1.0, self.q[i + 1])):
            known = share == end
            q[known], solved[known] = there[known], True
        return q, solved

    def motion(self, low: Array, high: Array) -> Array:
        """Largest motion of each joint (M, n) [rad or m] between two places (M,), none of :attr:`places` between."""
        if len(self.places) == 1:
            return np.zeros((len(low), self.kinematics.n))
        return self.rates[self._piece(0.5 * (low + high))] * (high - low)[:, None]

    def _piece(self, places: Array) -> Indices:
        i = np.searchsorted(self.places, places, side="right") - 1
        return np.clip(i, 0, len(self.places) - 2)


class CellTrajectory(abc.ABC):
    """Joint trajectories of all arms of a cell.

    Args:
        cell, path: the arms, and the object's path.
        arms: the trajectory of each arm.
        rest: positions (nv,) of joints that move no tool.

    Attributes:
        places: all places of the arms' trajectories, up to the end of the shortest (K,).
        complete: they go to the end of the path.
    """

    places: Array
    complete: bool

    def __init__(self, cell: RobotCell, path: ObjectPath, arms: Sequence[ArmTrajectory], rest: Array) -> None:
        self.cell, self._path, self._arms, self._rest = cell, path, tuple(arms), rest
        self._columns = [own[arm.kinematics.columns] for own, arm in zip(cell.columns, self._arms, strict=True)]

    @property
    def duration(self) -> float:
        """Duration of the whole path [s]."""
        return self._path.duration

    @abc.abstractmethod
    def clocks(self, places: Array) -> Array:
        """Clocks (M,) [s]."""

    @abc.abstractmethod
    def poses(self, places: Array) -> Array:
        """T_world_object (M, 4, 4) at places (M,)."""

    @abc.abstractmethod
    def seen_by(self, k: int, places: Array, T_world_object: Array) -> tuple[Array, Array]:
        """Places (M,) of arm k's own trajectory, and the object (M, 4, 4) as it would hold it by a fixed grasp."""

    @abc.abstractmethod
    def reached(self, x: Array, T_world_object: Array) -> Array | None:
        """Joint positions (nv,) near ``x`` that hold the object at a pose (4, 4); None if there are none."""

    @abc.abstractmethod
    def motion(self, low: Array, high: Array) -> Array:
        """Largest motion of each joint (M, nv) between two places (M,) without a place between; inf if not proved."""

    def positions(self, places: Array) -> tuple[Array, npt.NDArray[np.bool_]]:
        """Joint positions (M, nv) [rad or m] at places (M,), and where they hold the object."""
        T = self.poses(places)
        x, solved = np.tile(self._rest, (len(places), 1)), np.ones(len(places), dtype=bool)
        for k, (columns, arm) in enumerate(zip(self._columns, self._arms, strict=True)):
            x[:, columns], found = arm.at(*self.seen_by(k, places, T))
            solved &= found
        return x, solved

    def object_motion(self, low: Array, high: Array) -> tuple[Array, Array]:
        """Motion of the object's origin [m] and its turn [rad] between places (M,) of one segment; inf if not known."""
        unknown = np.full(len(low), np.inf)
        return unknown, unknown


@final
class HeldTrajectory(CellTrajectory):
    """All tools rest on the object.

    Args:
        cell, path, arms, rest: as of :class:`CellTrajectory`.
        segments: of the path; None if it has none.
    """

    def __init__(
        self, cell: RobotCell, path: ObjectPath, segments: Segments | None, arms: Sequence[ArmTrajectory], rest: Array
    ) -> None:
        super().__init__(cell, path, arms, rest)
        self._segments = segments
        end = min(float(arm.places[-1]) for arm in self._arms)
        every = np.unique(np.concatenate([arm.places for arm in self._arms]))
        self.places = every[every <= end]
        last = path.duration if segments is None else float(len(segments))
        self.complete = end >= last or len(self.places) == 1

    def clocks(self, places: Array) -> Array:
        """See :meth:`CellTrajectory.clocks`."""
        return places if self._segments is None else self._segments.clocks(*self._segments.split(places))

    def poses(self, places: Array) -> Array:
        """See :meth:`CellTrajectory.poses`."""
        if self._segments is not None:
            return self._segments.poses(*self._segments.split(places))
        poses = [as_placement(self._path.pose(u), f"the path's pose at {u:g} s") for u in places.tolist()]
        return np.array([T.homogeneous for T in poses])

    def seen_by(self, k: int, places: Array, T_world_object: Array) -> tuple[Array, Array]:
        """See :meth:`CellTrajectory.seen_by`: as it is."""
        return places, T_world_object

    def reached(self, x: Array, T_world_object: Array) -> Array | None:
        """See :meth:`CellTrajectory.reached`."""
        if self.cell.groups:
            return None  # each arm would move the joints that it shares its own way
        out = x.copy()
        for columns, arm in zip(self._columns, self._arms, strict=True):
            answer = arm.kinematics.solve((T_world_object @ arm.offset)[None], x[None, columns], tolerance=_EXACT)
            if not answer.residual[0] <= _EXACT:
                return None
            out[columns] = answer.q[0]
        return out

    def motion(self, low: Array, high: Array) -> Array:
        """See :meth:`CellTrajectory.motion`."""
        out = np.zeros((len(low), self.cell.nv))
        for columns, arm in zip(self._columns, self._arms, strict=True):
            out[:, columns] = arm.motion(low, high)
        return out

    def object_motion(self, low: Array, high: Array) -> tuple[Array, Array]:
        """See :meth:`CellTrajectory.object_motion`."""
        if self._segments is None:
            return super().object_motion(low, high)
        s, _ = self._segments.split(0.5 * (low + high))
        motion = self._segments.bounds(s, low - s, high - s)
        return motion.way * (high - low), motion.turn * (high - low)
