"""Placements and twists: validation of arguments, and what Pinocchio does not have for them.

Twists and spatial displacements are ``[linear; angular]``, as in Pinocchio. A placement ``T_a_b`` is the pose
of frame b in frame a. Functions accept a :class:`pinocchio.SE3` or a 4x4 homogeneous matrix.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
import pinocchio as pin

from coopqp.checks import NOT_NUMBERS, Array as Array, Flags as Flags, as_floats
from coopqp.errors import InvalidInputError

Placement: TypeAlias = "pin.SE3 | Array"

#: Largest accepted entry of ``|R Rᵀ − I|`` of a rotation argument: matrices printed with four decimals have 2e-4.
ROTATION_TOLERANCE = 3e-4
#: Up to this one a rotation is taken as it is; beyond, the nearest rotation is.
_TAKEN_AS_IS = 1e-9


def as_placement(value: Placement, where: str) -> pin.SE3:
    """Return ``value`` as a new :class:`pinocchio.SE3`.

    A rotation that was rounded, as in a printed matrix, becomes the nearest rotation.

    Raises:
        InvalidInputError: not an SE3 or 4x4 matrix, an entry is not finite, or the 3x3 block is not a rotation.
    """
    if isinstance(value, pin.SE3):
        if _is_placement(value):
            return pin.SE3(value)
        matrix = np.asarray(value.homogeneous, dtype=float)
    else:
        try:
            matrix = as_floats(value)
        except NOT_NUMBERS as error:
            raise InvalidInputError(
                f"not a placement ({error})", where, "Give a pinocchio.SE3 or a 4x4 matrix."
            ) from error
    if matrix.shape != (4, 4):
        raise InvalidInputError(
            f"a placement must be 4x4, got shape {matrix.shape}",
            where,
            "Give a pinocchio.SE3 or a 4x4 matrix.",
        )
    if not np.all(np.isfinite(matrix)):
        raise InvalidInputError("the placement has NaN or infinite entries", where, "Give finite numbers.")
    if np.abs(matrix[3] - [0.0, 0.0, 0.0, 1.0]).max() > 0.0:
        raise InvalidInputError(
            f"the last row of a homogeneous matrix is [0, 0, 0, 1], got {matrix[3].tolist()}",
            where,
            "Check that the matrix is not transposed.",
        )
    R = matrix[:3, :3]
    with np.errstate(over="ignore", invalid="ignore"):
        defect, det = float(np.abs(R @ R.T - np.eye(3)).max()), float(np.linalg.det(R))
    if not defect <= ROTATION_TOLERANCE or det < 0.0:
        raise InvalidInputError(
            f"its 3x3 block is not a rotation (|R Rᵀ − I| = {defect:.3g}, det R = {det:.6g})",
            where,
            f"Give an orthonormal, right-handed rotation (tolerance {ROTATION_TOLERANCE:g}).",
        )
    if defect > _TAKEN_AS_IS:
        U, _, Vt = np.linalg.svd(R)
        R = U @ Vt
    return pin.SE3(R.copy(), matrix[:3, 3].copy())


def _is_placement(T: pin.SE3) -> bool:
    """Whether :func:`as_placement` takes a placement as it is, in plain numbers; a NaN in R makes det R NaN."""
    (a, b, c), (d, e, f), (g, h, i) = T.rotation.tolist()
    x, y, z = T.translation.tolist()
    squares = max(abs(a * a + b * b + c * c - 1.0), abs(d * d + e * e + f * f - 1.0), abs(g * g + h * h + i * i - 1.0))
    angles = max(abs(a * d + b * e + c * f), abs(a * g + b * h + c * i), abs(d * g + e * h + f * i))
    det = a * (e * i - f * h) + b * (f * g - d * i) + c * (d * h - e * g)
    return squares <= _TAKEN_AS_IS and angles <= _TAKEN_AS_IS and det > 0.0 and math.isfinite(x + y + z)


def axis_angle(R: Array) -> tuple[Array, float]:
    """Unit axis (3,) and angle in [0, π] [rad] of a rotation, both to rounding at every angle; axis 0 at angle 0.

    At π the vector of Eq. (10c) vanishes. Then the axis is an eigenvector of the rotation for eigenvalue 1 (either
    sign). The logarithm of Pinocchio 4.1 is off by up to 4e-11 near π.
    """
    w = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])  # Eq. (10c)
    sin2, cos = float(np.linalg.norm(w)), 0.5 * (float(np.trace(R)) - 1.0)
    angle = float(np.arctan2(0.5 * sin2, cos))
    if cos < 0.0:
        # Near π the skew part loses accuracy, the symmetric part does not.
        r: Array = np.linalg.eigh(0.5 * (R + R.T))[1][:, 2]
        return (-r if w @ r < 0.0 else r), angle
    return (w / sin2, angle) if sin2 >= 1e-15 else (np.zeros(3), 0.0)


def as_placements(values: Sequence[Placement] | Array, where: str) -> tuple[pin.SE3, ...]:
    """Validate a sequence of placements. Error messages append the index to ``where``."""
    try:
        items = tuple(values)
    except TypeError as error:
        raise InvalidInputError(
            f"expected a sequence of placements, got {type(values).__name__}", where, "Give a list, one entry each."
        ) from error
    return tuple(as_placement(value, f"{where}[{i}]") for i, value in enumerate(items))


def adjoint(T: Placement) -> Array:
    """``Ad(T)``, shape (6, 6). For ``T = T_a_b`` it maps a twist in frame b to frame a."""
    if not isinstance(T, pin.SE3):
        T = as_placement(T, "adjoint")
    return np.asarray(T.action, dtype=float)


def for_twists(R: Array) -> Array:
    """A rotation for twists: ``R`` (3, 3) in both diagonal blocks, shape (6, 6)."""
    out = np.zeros((6, 6))
    out[:3, :3] = out[3:, 3:] = R
    return out


def skew(v: Array) -> Array:
    """``[v]×``, shape (3, 3)."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def rotations(w: Array) -> Array:
    """Rotations (M, 3, 3) about rotation vectors (M, 3) [rad]."""
    angle = np.linalg.norm(w, axis=1)
    x, y, z = (w / np.where(angle > 0.0, angle, 1.0)[:, None]).T
    K = np.zeros((len(w), 3, 3))
    K[:, 0, 1], K[:, 0, 2], K[:, 1, 2] = -z, y, -x
    K[:, 1, 0], K[:, 2, 0], K[:, 2, 1] = z, -y, x
    s, half = np.sin(angle)[:, None, None], np.sin(0.5 * angle)[:, None, None]
    return np.eye(3) + s * K + 2.0 * half * half * (K @ K)


def twist_at(twists: Array, way: Array) -> Array:
    """Twists [linear; angular] (6, n) at a point that is ``way`` (3,) [m] further on the same body."""
    return np.vstack([twists[:3] + skew(way).T @ twists[3:], twists[3:]])


def cross(a: Array, b: Array) -> Array:
    """Cross products along the last axis, of shapes that broadcast; of few rows faster than :func:`numpy.cross`."""
    ax, ay, az, bx, by, bz = (v[..., i] for v in (a, b) for i in range(3))
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)
