"""The grasp: the placement of each tool on the object, and the object pose that follows from each arm.

``X_k = T_object_tool_k`` is fixed. Arm k carries the object at ``O_k = T_world_tool_k X_k⁻¹``. In a perfect grasp
all ``O_k`` are equal. The paper's triangle (Θ, K_B*, K_C*, Eqs. 4–6) is a special case.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from coopqp.checks import ArrayLike, as_scalar, as_vector, require
from coopqp.errors import InvalidInputError, UnknownNameError
from coopqp.model.cell import RobotCell
from coopqp.model.state import CellState
from coopqp.spatial import Array, Placement, adjoint, as_placement, as_placements

#: Θ of Eq. (5): the tool frame in the grasp-point frame of the paper. Θ is its own inverse.
THETA = np.array([[-1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])


def triangle_frames(alpha: float, beta: float) -> tuple[Array, Array]:
    """K_B* and K_C* of Eq. (6): the frames of the grasp points B and C in the frame of A, 4x4 [m]."""
    K_B = np.diag([-1.0, -1.0, 1.0, 1.0])
    K_C = K_B.copy()
    K_B[:2, 3] = -beta, 3.0 * alpha
    K_C[:2, 3] = beta, 3.0 * alpha
    return K_B, K_C


#: Directions of a tool in which a grasp may give way: slides along its axes, and turns about them.
AXES = ("x", "y", "z", "rx", "ry", "rz")


@dataclass(frozen=True)
class Free:
    """A direction in which a grasp gives way.

    Attributes:
        arm: name of the arm.
        axis: one of :data:`AXES`, of its tool.
        low, high: how far it gives way [m or rad].
    """

    arm: str
    axis: str
    low: float
    high: float

    @property
    def turns(self) -> bool:
        """Whether it is a turn."""
        return self.axis.startswith("r")

    def column(self, T_object_tool: pin.SE3) -> Array:
        """Its unit twist in the object frame (6,)."""
        twist: Array = adjoint(T_object_tool)[:, AXES.index(self.axis)]
        return twist


@dataclass(frozen=True, eq=False, init=False)
class Grasp:
    """Fixed placements of the tools on the object.

    Attributes:
        T_object_tool: placement of each arm's tool in the object frame, in the order of the cell's arms.
        free: directions in which it gives way, see :meth:`freed`.
    """

    T_object_tool: tuple[pin.SE3, ...]
    free: tuple[Free, ...] = ()

    def __init__(self, T_object_tool: Sequence[Placement] | Array, free: Sequence[Free] = ()) -> None:
        placements = as_placements(T_object_tool, "Grasp.T_object_tool")
        if not placements:
            raise InvalidInputError("no placement", "Grasp.T_object_tool", "Give one per arm.")
        object.__setattr__(self, "T_object_tool", placements)
        object.__setattr__(self, "free", tuple(free))

    def __len__(self) -> int:
        return len(self.T_object_tool)

    @staticmethod
    def triangle(alpha: float, beta: float) -> Grasp:
        """The paper's grasp: A, B, C at (0, 0), (−β, 3α), (β, 3α) on the plate. The object frame is the frame of A.

        The centroid is at (0, 2α). Lengths are in metres. Source: Eqs. (4)–(6) and (15).
        """
        a = as_scalar(alpha, "Grasp.triangle: alpha")
        b = as_scalar(beta, "Grasp.triangle: beta")
        K_B, K_C = triangle_frames(a, b)
        return Grasp((THETA, K_B @ THETA, K_C @ THETA))

    @staticmethod
    def from_configuration(
        cell: RobotCell,
        q: ArrayLike,
        T_world_object: Placement | None = None,
        *,
        nominal: Grasp | None = None,
        tolerance_m: float = 0.005,
        tolerance_rad: float = np.deg2rad(1.0),
    ) -> Grasp:
        """Latch the grasp at the present tool placements. The chain error at ``q`` is then zero.

        Args:
            cell: the cell.
            q: configuration at the moment of grasping (nq,).
            T_world_object: pose of the object; by default the pose that follows from the first arm and ``nominal``.
            nominal: the intended grasp; every tool must be within the tolerances of it.
            tolerance_m, tolerance_rad: accepted deviation from ``nominal`` [m, rad].

        Raises:
            InvalidInputError: bad ``q`` or pose, or a tool outside the tolerances (the message names the arm).
        """
        as_scalar(tolerance_m, "Grasp.from_configuration: tolerance_m", open_low=False)
        as_scalar(tolerance_rad, "Grasp.from_configuration: tolerance_rad", open_low=False)
        state = CellState(cell, q)
        if nominal is not None:
            nominal.check_arms(cell)
        if T_world_object is None:
            if nominal is None:
                raise InvalidInputError(
                    "neither the object's pose nor a nominal grasp is given",
                    "Grasp.from_configuration",
                    "Give T_world_object, or nominal.",
                )
            T_world_object = state.T_world_tool[0] * nominal.T_object_tool[0].inverse()
        T_object_world = as_placement(T_world_object, "Grasp.from_configuration: T_world_object").inverse()
        latched = Grasp(tuple(T_object_world * T for T in state.T_world_tool))
        if nominal is not None:
            for name, X, X_nominal in zip(cell.arm_names, latched.T_object_tool, nominal.T_object_tool, strict=True):
                offset = pin.log6(X_nominal.inverse() * X).vector
                d, a = float(np.linalg.norm(offset[:3])), float(np.linalg.norm(offset[3:]))
                if d > tolerance_m or a > tolerance_rad:
                    raise InvalidInputError(
                        f"arm '{name}' grasps {1e3 * d:.2f} mm and {np.rad2deg(a):.3f}° from its nominal grasp "
                        f"(tolerance {1e3 * tolerance_m:g} mm, {np.rad2deg(tolerance_rad):g}°)",
                        "Grasp.from_configuration",
                        "Grasp again, or widen the tolerances if the object allows it.",
                    )
        return latched

    def freed(self, arm: str, axis: str, *, range: tuple[float, float]) -> Grasp:
        """The same grasp, which gives way in a direction of an arm's tool: a hinge, a slider; three turns are a ball.

        A cell takes it after :func:`coopqp.model.freed_cell`, which makes passive joints of all free directions.

        Args:
            arm: name of the arm.
            axis: a slide along "x", "y", "z" or a turn "rx", "ry", "rz" about an axis of its tool.
            range: lowest and highest position [m or rad]; the placement of the grasp is at 0.

        Raises:
            UnknownNameError: no such axis.
            InvalidInputError: 0 is not inside the range, or the direction is free already.
        """
        where = f"Grasp.freed: {arm}, {axis}"
        if axis not in AXES:
            raise UnknownNameError("axis", str(axis), AXES, "Grasp.freed")
        low, high = (as_scalar(x, where, low=-np.inf) for x in range)
        if not low < 0.0 < high:
            raise InvalidInputError(f"the range is {low:g} to {high:g}", where, "Give one with 0 inside.")
        if any(free.arm == arm and free.axis == axis for free in self.free):
            raise InvalidInputError("it is free already", where, "Free each direction once.")
        return Grasp(self.T_object_tool, (*self.free, Free(arm, axis, low, high)))

    def check_arms(self, cell: RobotCell) -> None:
        """Raise InvalidInputError unless there is one placement per arm of ``cell``."""
        require(cell, RobotCell, "cell", "Give a RobotCell.")
        if self.free:
            raise InvalidInputError(
                f"the grasp of arm '{self.free[0].arm}' gives way in {self.free[0].axis}",
                "Grasp",
                "Give the cell and the grasp of coopqp.model.freed_cell(cell, grasp).",
            )
        if len(self) != len(cell):
            raise InvalidInputError(
                f"{len(self)} placements for {len(cell)} arms", "Grasp", "Give one T_object_tool per arm."
            )

    def carried(self, state: CellState) -> tuple[pin.SE3, ...]:
        """``O_k``: the object pose in the world according to each arm."""
        return tuple(T * X.inverse() for T, X in zip(state.T_world_tool, self.T_object_tool, strict=True))

    def moved_by(self, motions: Sequence[pin.SE3]) -> Grasp:
        """The same tools after a motion of each in the object frame: ``M_k X_k``."""
        return Grasp(tuple(M * X for M, X in zip(motions, self.T_object_tool, strict=True)))

    def tool_targets(self, T_world_object: Placement) -> tuple[pin.SE3, ...]:
        """Placement of each tool in the world for an object pose (Eq. 12 for any number of arms)."""
        T = as_placement(T_world_object, "Grasp.tool_targets")
        return tuple(T * X for X in self.T_object_tool)

    def arm_increments(self, increment: ArrayLike) -> Array:
        """Δ^k of Eq. (16), shape (N, 6) [m, rad]: the object's body-frame increment in each tool frame.

        ``Δ^k = Ad(X_k⁻¹) Δ``. For the paper's triangle these are the 18 component lists below Eq. (16).
        """
        delta = as_vector(increment, 6, "Grasp.arm_increments")
        return np.array([adjoint(X.inverse()) @ delta for X in self.T_object_tool])

    def relative_errors(self, state: CellState) -> Array:
        """``log(O_i⁻¹ O_j)`` of every pair i < j, shape (pairs, 6) [m, rad]. All are zero in a perfect grasp."""
        O = self.carried(state)
        n = len(O)
        return np.array([pin.log6(O[i].actInv(O[j])).vector for i in range(n) for j in range(i + 1, n)]).reshape(-1, 6)


def plate_from_points(A: Sequence[float], B: Sequence[float], C: Sequence[float]) -> tuple[pin.SE3, float, float]:
    """First method of the paper's Figure 2: the plate from its three grasp points in the world [m].

    Returns:
        (T_world_A, alpha, beta): the frame of A (x along C − B, y towards the centre of BC) and the parameters of the
        triangle in Eq. (6) [m].

    Raises:
        InvalidInputError: the points coincide, lie on a line, or do not form an isosceles triangle with apex A.
    """
    where = "plate_from_points"
    a, b, c = (as_vector(x, 3, f"{where}: {n}") for x, n in ((A, "A"), (B, "B"), (C, "C")))
    base, height = c - b, 0.5 * (b + c) - a
    width, depth = float(np.linalg.norm(base)), float(np.linalg.norm(height))
    if width < 1e-9 or depth < 1e-9:
        raise InvalidInputError("the three points do not span a triangle", where, "Give three points apart.")
    skewness = abs(float(base @ height)) / (width * depth)
    if skewness > 1e-6:
        raise InvalidInputError(
            f"|AB| = {np.linalg.norm(b - a):.6g} and |AC| = {np.linalg.norm(c - a):.6g} m differ: not isosceles at A",
            where,
            "Use a general Grasp for other triangles.",
        )
    x, y = base / width, height / depth
    y = y - (x @ y) * x
    y /= np.linalg.norm(y)
    return pin.SE3(np.column_stack([x, y, np.cross(x, y)]), a), depth / 3.0, width / 2.0


def plate_from_centroid(T_world_centroid: Placement, alpha: float) -> pin.SE3:
    """Second method of the paper's Figure 2: T_world_A from the placement of the centroid (same axes as A)."""
    T = as_placement(T_world_centroid, "plate_from_centroid")
    return T * pin.SE3(np.eye(3), np.array([0.0, -2.0 * as_scalar(alpha, "plate_from_centroid: alpha"), 0.0]))


def held_at(grasp: Grasp, shares: Array, state: CellState) -> pin.SE3:
    """Where the arms hold the object: by their shares in the common error, from the first one's view."""
    return mean_pose(grasp.carried(state), shares)


def mean_pose(O: Sequence[pin.SE3], shares: Array) -> pin.SE3:
    """The arms' views of the object as one pose: by their shares in the common error, from the first one's view."""
    errors = np.array([pin.log6(O[0].actInv(other)).vector for other in O])
    return O[0] * pin.exp6((shares * errors).sum(axis=0))
