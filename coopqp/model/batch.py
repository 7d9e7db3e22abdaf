"""Kinematics of one arm at thousands of tool poses at once: inverse kinematics, singular values, limit margins.

The core computes them (``arm.h``, ``binding/kinematics.cpp``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, final

import numpy as np
import numpy.typing as npt

from coopqp.checks import ArrayLike, as_floats
from coopqp.core import _core
from coopqp.core._core import MOST_JOINTS
from coopqp.errors import InvalidInputError, ModelError
from coopqp.model.cell import Arm
from coopqp.model.links import check_count, joint_links
from coopqp.spatial import Array, Placement, as_placement, as_placements, cross

#: A solution reaches its pose within this [m, rad].
REACHED = 1e-9
#: Newton steps from a seed; almost all seeds that arrive take fewer.
_STEPS = 40
#: Largest step of a joint [rad or m], and damping over the square of the error.
_LONGEST, _DAMPING = 1.0, 1e-2
#: Largest step of a joint between poses of a walk [rad or m], and how often the way between two poses is halved for it.
_WALKING_STEP, _HALVINGS = 0.3, 12


def singular_values(A: Array) -> Array:
    """Singular values of M finite matrices (M, k, l), descending (M, min(k, l)); k or l is at most 6."""
    rows, columns = A.shape[1:]
    if max(rows, columns) > MOST_JOINTS:
        return np.asarray(np.linalg.svd(A, compute_uv=False))
    values = np.empty((len(A), min(rows, columns)))
    _core.singular_values(np.ascontiguousarray(A), rows, columns, values)
    return values


@dataclass(frozen=True, eq=False)
class BatchSolutions:
    """Answers of inverse kinematics to M tool poses.

    Attributes:
        q: joint positions (M, n) [rad or m], where Newton's method ended.
        residual: largest entry of the remaining displacement and rotation vector (M,) [m, rad].
        sigma_min: smallest singular value of the tool's Jacobian (M,), in metres and radians.
        margins: distance of each joint to its nearer limit (M, n) [rad or m]; negative outside.
    """

    q: Array
    residual: Array
    sigma_min: Array
    margins: Array

    @property
    def reached(self) -> npt.NDArray[np.bool_]:
        """True where the pose is reached within 1e-9 m and rad (M,)."""
        return self.residual <= REACHED


@dataclass(frozen=True, eq=False)
class Walks:
    """Ways of one arm along K tool poses, from M starts.

    Attributes:
        q: joint positions (M, K, n) [rad or m]; constant after the last pose that was reached.
        reached: index of the last pose that was reached without a jump and without passing a singularity (M,).
        sigma_min: smallest singular value of the tool's Jacobian (M, K).
    """

    q: Array
    reached: npt.NDArray[np.intp]
    sigma_min: Array

    @property
    def complete(self) -> npt.NDArray[np.bool_]:
        """True where the last pose was reached (M,)."""
        return self.reached == self.q.shape[1] - 1


@final
class ArmKinematics:
    """Batch kinematics of one arm: the joints that move its tool, positions in radians or metres.

    Args:
        arm: the arm, at its base.

    Attributes:
        joints: names of the joints that move the tool, n of them.
        columns: their velocity coordinates in the arm's model (n,).
        shared: indices of those that other arms share.
        slides: True for prismatic joints (n,).
        lower, upper: position limits (n,) [rad or m], ±inf without.
        bounded: True for joints with both limits (n,).
        middle: middle between the limits, 0 without (n,) [rad or m].
        scale: unit of each joint, its largest speed [rad/s or m/s], 1 without (n,).
        turns: True for joints that tell whole turns apart: they revolve and are not continuous (n,).
        numbers: the arm for the core, as ``arm.h`` lists it.

    Raises:
        ModelError: a joint neither turns about an axis nor slides along one; or there are too many.
    """

    def __init__(self, arm: Arm) -> None:
        self.arm, model = arm, arm.model
        frame = model.frames[model.getFrameId(arm.tool_frame)]
        chain = [int(j) for j in model.supports[frame.parentJoint] if j]
        check_count(arm.name, len(chain))
        try:
            R, p, pitch, aligned = joint_links(model, chain)
            screws = [model.names[j] for j, along in zip(chain, pitch, strict=True) if along and np.isfinite(along)]
            if screws:
                raise ModelError(f"joint {screws[0]} neither turns about an axis nor slides along one")
        except ModelError as error:
            raise ModelError(f"arm '{arm.name}': {error}") from error
        R[0], p[0] = arm.T_world_base.rotation @ R[0], arm.T_world_base.act(p[0])
        self.joints = tuple(model.names[j] for j in chain)
        self.columns = np.array([model.joints[j].idx_v for j in chain], dtype=np.intp)
        self.shared = np.array([j for j, name in enumerate(self.joints) if name in arm.shared], dtype=np.intp)
        self.slides = pitch != 0.0
        self.continuous = np.array([model.joints[j].nq != model.joints[j].nv for j in chain])
        self.turns = ~self.slides & ~self.continuous
        self.lower, self.upper = arm.limits.lower[self.columns], arm.limits.upper[self.columns]
        self.bounded = np.isfinite(self.lower) & np.isfinite(self.upper)
        self.middle = np.where(self.bounded, 0.5 * (self.lower.clip(-1e9) + self.upper.clip(None, 1e9)), 0.0)
        speed = arm.limits.velocity[self.columns]
        self.scale = np.where(np.isfinite(speed), speed, 1.0)
        weights = self.scale if len(chain) > 6 else np.ones(len(chain))
        rows = np.column_stack([R.reshape(-1, 9), p, self.slides, weights / weights.max()])
        tool = np.concatenate([(aligned.T @ frame.placement.rotation).ravel(), aligned.T @ frame.placement.translation])
        self.numbers = np.concatenate([rows.ravel(), tool])

    @property
    def n(self) -> int:
        """Number of joints that move the tool."""
        return len(self.joints)

    # -- forwards ------------------------------------------------------------------------------------------------

    def tool_poses(self, q: ArrayLike) -> Array:
        """T_world_tool at joint positions (M, n), as matrices (M, 4, 4)."""
        x = self._positions(q)
        poses = np.empty((len(x), 12))
        _core.place(self.numbers, x, poses, np.empty(6 * x.size))
        T = np.zeros((len(x), 4, 4))
        T[:, :3, :3], T[:, :3, 3], T[:, 3, 3] = poses[:, :9].reshape(-1, 3, 3), poses[:, 9:], 1.0
        return T

    def jacobians(self, q: ArrayLike) -> Array:
        """Jacobians (M, 6, n) of the tool's point, [linear; angular] in world axes."""
        x = self._positions(q)
        J = np.empty((len(x), self.n, 6))
        _core.place(self.numbers, x, np.empty(12 * len(x)), J)
        return J.transpose(0, 2, 1)

    def derivatives(self, q: ArrayLike, twists: Array, slopes: Array) -> tuple[Array, Array]:
        """Derivatives q′ and q″ (M, n) of the joints along a way of the tool.

        A redundant arm takes the shortest way, in the unit of each joint's largest speed; one of fewer than six joints
        the way that comes closest. Where the arm is singular entries are not finite, or large.

        Args:
            q: joint positions (M, n) [rad or m].
            twists, slopes: twist of the tool's point in world axes per unit of the way (M, 6), and its derivative.
        """
        x = self._positions(q)
        V, dV = (np.ascontiguousarray(np.broadcast_to(v, (len(x), 6)), dtype=float) for v in (twists, slopes))
        first, second = np.empty_like(x), np.empty_like(x)
        _core.derivatives(self.numbers, x, V, dV, first, second)
        return first, second

    def singular_values(self, q: ArrayLike) -> Array:
        """Singular values of the tool's Jacobian, descending (M, min(6, n)), in metres and radians."""
        return singular_values(self.jacobians(q).transpose(0, 2, 1))

    def margins(self, q: Array) -> Array:
        """Distance of positions (…, n) to the nearer limit [rad or m]: negative outside, inf without limits."""
        return np.minimum(q - self.lower, self.upper - q)

    # -- inverse -------------------------------------------------------------------------------------------------

    def solve(
        self,
        poses: ArrayLike,
        q_start: ArrayLike,
        *,
        tolerance: float = REACHED,
        steps: int = _STEPS,
        longest: float = _LONGEST,
    ) -> BatchSolutions:
        """Damped Newton's method from each start to its pose. Limits play no part in it.

        Args:
            poses: T_world_tool, (M, 4, 4), or one pose for all starts. Rows of R (9), p (3), (M, 12), are not checked.
            q_start: starts (M, n) [rad or m].
            tolerance: largest accepted residual [m, rad].
            steps: largest number of steps.
            longest: longest step of a joint [rad or m].
        """
        q, residual = self.newton(poses, q_start, tolerance=tolerance, steps=steps, longest=longest)
        return BatchSolutions(q, residual, self.singular_values(q)[:, -1], self.margins(q))

    def newton(
        self,
        poses: ArrayLike,
        q_start: ArrayLike,
        *,
        tolerance: float = REACHED,
        steps: int = _STEPS,
        longest: float = _LONGEST,
    ) -> tuple[Array, Array]:
        """Positions (M, n) and residuals (M,) of :meth:`solve`, without singular values."""
        q = self._positions(q_start)
        numbers = self._poses(poses, len(q))
        residual = np.empty(len(q))
        _core.solve(self.numbers, numbers, q, residual, tolerance, steps, longest, _DAMPING)
        return q, residual

    def walk(self, poses: ArrayLike, q_start: ArrayLike, *, tolerance: float = REACHED) -> Walks:
        """From each start (M, n), which reaches the first of K poses (K, 4, 4), along all of them.

        A redundant arm takes the shortest way, in the unit of each joint's largest speed.
        """
        q, reached = self.trajectories(poses, q_start, tolerance=tolerance)
        sigma = self.singular_values(q.reshape(-1, self.n))[:, -1].reshape(len(q), -1)
        return Walks(q, reached, sigma)

    def trajectories(
        self, poses: ArrayLike, q_start: ArrayLike, *, tolerance: float = REACHED
    ) -> tuple[Array, npt.NDArray[np.intp]]:
        """Positions (M, K, n) and last poses (M,) of :meth:`walk`, without singular values."""
        starts = self._positions(q_start)
        numbers = self._poses(poses, None)
        q = np.empty((len(starts), len(numbers), self.n))
        q[:, 0] = starts
        reached = np.zeros(len(starts))
        _core.walk(self.numbers, numbers, q, reached, tolerance, _WALKING_STEP, _HALVINGS)
        return q, reached.astype(np.intp)

    def nearest_turns(self, q: Array) -> Array:
        """The same angles (…, n) at the turn where each joint is furthest inside its limits, else least outside."""
        whole = np.round((q - self.middle) / (2.0 * np.pi))
        return np.where(self.slides, q, q - 2.0 * np.pi * whole)

    def same(self, q: Array, other: Array, *, within: float) -> npt.NDArray[np.bool_]:
        """Whether positions (…, n) differ by less than ``within`` in every joint, whole turns aside."""
        away = q - other
        away = np.where(self.slides, away, away - 2.0 * np.pi * np.round(away / (2.0 * np.pi)))
        return np.abs(away).max(axis=-1) < within

    def seeds(self, count: int, rng: np.random.Generator) -> Array:
        """Random positions (count, n): half inside the limits, half at any angle."""
        low, high = np.where(self.bounded, self.lower, -np.pi), np.where(self.bounded, self.upper, np.pi)
        inside = rng.uniform(low, high, (count, self.n))
        anywhere = rng.uniform(-np.pi, np.pi, (count, self.n))
        anywhere[: count // 2] = inside[: count // 2]
        return np.where(self.slides, inside, anywhere)

    # -- arguments -----------------------------------------------------------------------------------------------

    def _positions(self, q: ArrayLike) -> Array:
        x = as_floats(q)
        if x.ndim != 2 or x.shape[1] != self.n or not np.isfinite(x).all():
            raise InvalidInputError(
                f"expected finite joint positions of shape (M, {self.n}), got shape {x.shape}",
                f"ArmKinematics of arm '{self.arm.name}'",
                f"Give one row per configuration: {', '.join(self.joints)}.",
            )
        return np.ascontiguousarray(x)

    def _poses(self, poses: Any, count: int | None) -> Array:
        """Poses as rows of R (9), p (3)."""
        where = f"ArmKinematics of arm '{self.arm.name}': poses"
        rows = poses if _are_rows(poses) else pose_rows(pose_matrices(poses, where))
        if count is not None and len(rows) == 1:
            rows = np.broadcast_to(rows, (count, 12))
        if not len(rows) or (count is not None and len(rows) != count):
            raise InvalidInputError(f"{len(rows)} poses for {count} starts", where, "Give one pose per start, or one.")
        return np.ascontiguousarray(rows)


def _are_rows(poses: Any) -> bool:
    return isinstance(poses, np.ndarray) and poses.ndim == 2 and poses.shape[1] == 12 and poses.dtype == np.float64


def pose_rows(T: Array) -> Array:
    """Poses (M, 4, 4) as rows of R (9), p (3): (M, 12)."""
    return np.concatenate([T[:, :3, :3].reshape(-1, 9), T[:, :3, 3]], axis=1)


def pose_matrices(poses: Placement | Sequence[Placement] | Array, where: str) -> Array:
    """Matrices (M, 4, 4) from one placement or from many.

    Raises:
        InvalidInputError: a placement is not valid; the message gives its index.
    """
    if isinstance(poses, np.ndarray) and poses.ndim == 3 and poses.shape[1:] == (4, 4) and poses.dtype == np.float64:
        x, y, z = (poses[:, i, :3] for i in range(3))
        with np.errstate(all="ignore"):
            # A right-handed rotation: two unit rows at right angles, and their cross product.
            defects = (
                np.einsum("ij,ij->i", x, x) - 1.0,
                np.einsum("ij,ij->i", y, y) - 1.0,
                np.einsum("ij,ij->i", x, y),
                *(z - cross(x, y)).T,
            )
            good = all(bool((np.abs(d) < 1e-9).all()) for d in defects) and bool(np.isfinite(poses[:, :3, 3]).all())
        if good and bool((poses[:, 3] == [0.0, 0.0, 0.0, 1.0]).all()):
            return poses
    if hasattr(poses, "homogeneous") or (isinstance(poses, np.ndarray) and poses.ndim == 2):
        return np.asarray(as_placement(poses, where).homogeneous)[None]
    return np.array([T.homogeneous for T in as_placements(poses, where)]).reshape(-1, 4, 4)
