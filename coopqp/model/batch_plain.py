"""The functions of ``kinematics_binding.cpp`` in NumPy: all configurations at once.

Arrays are flat and hold the same numbers; the result is written into them. See ``kinematics_binding.cpp``
for their content.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from coopqp.spatial import Array, cross, rotations

_PER_JOINT, _SLIDES, _WEIGHT = 14, 12, 13
_LEAST_DAMPING = 1e-15
_EYE3, _EYE6 = np.eye(3), np.eye(6)


def place(arm: Array, q: Array, poses: Array, jacobians: Array, /) -> None:
    """Tool poses and transposed Jacobians at configurations."""
    T, J = _place(arm, q)
    poses.reshape(T.shape)[:] = T
    jacobians.reshape(J.shape)[:] = J


def solve(
    arm: Array,
    poses: Array,
    q: Array,
    residuals: Array,
    tolerance: float,
    steps: int,
    longest: float,
    damping: float,
    /,
) -> None:
    """Damped Newton's method from each configuration to its pose."""
    n = (arm.size - 12) // _PER_JOINT
    target, q = poses.reshape(-1, 12), q.reshape(-1, n)
    live, x = np.arange(len(q)), q.copy()
    for i in range(steps + 1):
        T, J = _place(arm, x)
        e = _errors(T, target)
        residual = np.abs(e).max(axis=1, initial=0.0)
        residual[~np.isfinite(residual)] = np.inf
        q[live], residuals[live] = x, residual
        go = (residual > tolerance) & (residual < np.inf)
        if i == steps or not go.any():
            return
        if not go.all():
            live, x, target, J, e = live[go], x[go], target[go], J[go], e[go]
        v, largest = _newton_step(arm, J, e, damping * (e * e).sum(axis=1))
        v[largest == np.inf] = 0.0
        x = x + np.minimum(1.0, longest / np.maximum(largest, 1e-300))[:, None] * v


def singular_values(matrices: Array, rows: int, columns: int, values: Array, /) -> None:
    """Singular values of matrices, descending."""
    A = matrices.reshape(-1, rows, columns)
    values.reshape(len(A), -1)[:] = np.linalg.svd(A, compute_uv=False)


def derivatives(arm: Array, q: Array, twists: Array, twist_slopes: Array, slopes: Array, curvatures: Array, /) -> None:
    """Derivatives q′ and q″ of the joints of arms whose tools have twists V and V′ per unit of s.

    The tool follows ``J(q) q′ = V(s)``, so

        q′ = J⁺ V,   q″ = J⁺ (V′ − J′ q′)      (six joints: J⁺ = J⁻¹; fewer: least squares)

    with ``J′ = Σ_i q′_i ∂_i J``. More joints: ``q′ = W² Jᵀ y`` with ``J W² Jᵀ y = V`` and the weights W, so
    ``q″ = W² (J′ᵀ y + Jᵀ y′)`` with ``J W² Jᵀ y′ = V′ − J′ q′ − J W² J′ᵀ y``.
    """
    V, dV = twists.reshape(-1, 6), twist_slopes.reshape(-1, 6)
    J = _place(arm, q)[1]  # Jᵀ (m, n, 6), as it lies in memory
    n = J.shape[1]
    with np.errstate(all="ignore"):
        if n <= 6:
            inverse = _inverse(J) if n == 6 else np.asarray(np.linalg.pinv(J), dtype=np.float64)
            slope = _by_rows(V, inverse)
            curvature = _by_rows(dV - _by_rows(slope, jacobian_slopes(J, slope)), inverse)
        else:
            W = arm[: _PER_JOINT * n].reshape(n, _PER_JOINT)[:, _WEIGHT] ** 2
            JW = J * W[:, None]
            gram = _inverse(J.transpose(0, 2, 1) @ JW)
            y = _by_rows(V, gram)
            slope = _by_columns(JW, y)
            dJ = jacobian_slopes(J, slope)
            turn = W * _by_columns(dJ, y)
            dy = _by_rows(dV - _by_rows(slope, dJ) - _by_rows(turn, J), gram)
            curvature = turn + _by_columns(JW, dy)
    slopes.reshape(slope.shape)[:], curvatures.reshape(slope.shape)[:] = slope, curvature


def jacobian_slopes(J: Array, slope: Array) -> Array:
    """``J′ = Σ_i q′_i ∂_i J`` of serial arms, transposed (m, n, 6), from Jᵀ (m, n, 6) and q′ (m, n).

    The derivative of a serial arm's Jacobian is a Lie bracket of its columns: joint i turns all that comes after it,
    ``∂_i (v_j, ω_j) = (ω_i × v_j, ω_i × ω_j)`` for i ≤ j, and moves the tool's point under the joints before it,
    ``∂_i v_j = ω_j × v_i`` for i > j. Sums over i become running sums over the arm.
    """
    v, w = J[:, :, :3], J[:, :, 3:]
    moved = J * slope[:, :, None]
    turned = moved[:, :, 3:].cumsum(axis=1)  # by the joints up to j
    beyond = moved[:, ::-1, :3].cumsum(axis=1)[:, ::-1] - moved[:, :, :3]  # by the joints after j
    return np.concatenate([cross(turned, v) + cross(w, beyond), cross(turned, w)], axis=2)


def walk(
    arm: Array, poses: Array, q: Array, reached: Array, tolerance: float, longest: float, halvings: int, /
) -> None:
    """From each start along all poses, by small steps that pass no singularity."""
    poses = poses.reshape(-1, 12)
    q = q.reshape(reached.size, len(poses), -1)
    going = np.ones(reached.size, dtype=bool)
    reached[:] = 0.0
    for k in range(1, len(poses)):
        q[:, k] = q[:, k - 1]
        here = np.flatnonzero(going)
        x, arrived = _step_to(arm, poses[k - 1], poses[k], q[here, k], tolerance, longest, halvings)
        q[here[arrived], k] = x[arrived]
        going[here[~arrived]] = False
        reached[going] = k


def _step_to(
    arm: Array, start: Array, goal: Array, q: Array, tolerance: float, longest: float, halvings: int
) -> tuple[Array, npt.NDArray[np.bool_]]:
    x, residual = q.copy(), np.empty(len(q))
    solve(arm, np.tile(goal, (len(q), 1)), x, residual, tolerance, 12, longest, 0.0)
    good: npt.NDArray[np.bool_] = (residual <= tolerance) & (np.abs(x - q).max(axis=1, initial=0.0) <= longest)
    good &= _negative(arm, x) == _negative(arm, q)
    bad = np.flatnonzero(~good)
    if bad.size and halvings > 0:
        middle = _halfway(start, goal)
        x[bad], good[bad] = _step_to(arm, start, middle, q[bad], tolerance, longest, halvings - 1)
        on = bad[good[bad]]
        if on.size:
            x[on], good[on] = _step_to(arm, middle, goal, x[on], tolerance, longest, halvings - 1)
    return x, good


def _negative(arm: Array, q: Array) -> npt.NDArray[np.bool_]:
    J = _place(arm, q)[1]
    return np.linalg.det(J) < 0.0 if J.shape[1] == 6 else np.zeros(len(q), dtype=bool)


def _halfway(start: Array, goal: Array) -> Array:
    R0, R1 = start[:9].reshape(3, 3), goal[:9].reshape(3, 3)
    w = 0.5 * _rotation_vectors((R1 @ R0.T)[None])
    return np.concatenate([(rotations(w)[0] @ R0).ravel(), 0.5 * (start[9:] + goal[9:])])


def _place(arm: Array, q: Array) -> tuple[Array, Array]:
    n = (arm.size - 12) // _PER_JOINT
    joints, tool = arm[: _PER_JOINT * n].reshape(n, _PER_JOINT), arm[_PER_JOINT * n :]
    q = q.reshape(-1, n)
    m = len(q)
    c, s = np.cos(q), np.sin(q)
    R, p = np.tile(_EYE3, (m, 1, 1)), np.zeros((m, 3))
    J, origins = np.zeros((m, n, 6)), np.empty((m, n, 3))
    for j, joint in enumerate(joints):
        p = p + _times(R, joint[9:12])
        R = _times(R, joint[:9].reshape(3, 3))
        z = R[:, :, 2]
        if joint[_SLIDES]:
            p = p + q[:, j, None] * z
            J[:, j, :3] = z
        else:
            x, y = R[:, :, 0].copy(), R[:, :, 1]
            cj, sj = c[:, j, None], s[:, j, None]
            R[:, :, 0] = cj * x + sj * y
            R[:, :, 1] = cj * y - sj * x
            J[:, j, 3:] = z
        origins[:, j] = p
    T = np.empty((m, 12))
    T[:, 9:] = p + _times(R, tool[9:])
    T[:, :9] = _times(R, tool[:9].reshape(3, 3)).reshape(m, 9)
    turns = joints[:, _SLIDES] == 0.0
    away = T[:, None, 9:] - origins
    for i in range(3):
        a, b = (i + 1) % 3, (i + 2) % 3
        J[:, turns, i] = (J[:, :, 3 + a] * away[:, :, b] - J[:, :, 3 + b] * away[:, :, a])[:, turns]
    return T, J


def _times(R: Array, M: Array) -> Array:
    """R @ M as one product of matrices."""
    return (R.reshape(-1, 3) @ M).reshape(len(R), 3, *M.shape[1:])


def _inverse(A: Array) -> Array:
    try:
        return np.asarray(np.linalg.inv(A), dtype=np.float64)
    except np.linalg.LinAlgError:
        return np.full(A.shape, np.nan)


def _by_columns(A: Array, b: Array) -> Array:
    """``A b`` for matrices (m, k, l) and columns b (m, l)."""
    return (A @ b[:, :, None])[:, :, 0]


def _by_rows(b: Array, A: Array) -> Array:
    """``bᵀ A`` for rows b (m, k) and matrices (m, k, l)."""
    return (b[:, None, :] @ A)[:, 0, :]


def _errors(T: Array, target: Array) -> Array:
    e = np.empty((len(T), 6))
    e[:, :3] = target[:, 9:] - T[:, 9:]
    e[:, 3:] = _rotation_vectors(target[:, :9].reshape(-1, 3, 3) @ T[:, :9].reshape(-1, 3, 3).transpose(0, 2, 1))
    return e


def _rotation_vectors(R: Array) -> Array:
    """Rotation vectors (m, 3) of rotations (m, 3, 3), from the largest entry of their quaternions."""
    xx, yy, zz = R[:, 0, 0], R[:, 1, 1], R[:, 2, 2]
    a, b, c = R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]
    d, e, f = R[:, 1, 0] + R[:, 0, 1], R[:, 0, 2] + R[:, 2, 0], R[:, 2, 1] + R[:, 1, 2]
    x = 1.0 + np.array([xx + yy + zz, xx - yy - zz, yy - xx - zz, zz - xx - yy])
    rows = np.array([[x[0], a, b, c], [a, x[1], d, e], [b, d, x[2], f], [c, e, f, x[3]]])
    v = rows[x.argmax(axis=0), :, np.arange(len(R))]
    v = np.where(v[:, :1] < 0.0, -v, v)
    norm = np.linalg.norm(v[:, 1:], axis=1)
    ratio = 2.0 * np.arctan2(norm, v[:, 0]) / np.where(norm > 0.0, norm, 1.0)
    return ratio[:, None] * v[:, 1:]


def _newton_step(arm: Array, J: Array, e: Array, damping: Array) -> tuple[Array, Array]:
    weights = arm[: _PER_JOINT * J.shape[1]].reshape(-1, _PER_JOINT)[:, _WEIGHT]
    scaled = J * weights[:, None]
    G = scaled.transpose(0, 2, 1) @ scaled
    damping = damping + _LEAST_DAMPING * np.trace(G, axis1=1, axis2=2)
    with np.errstate(all="ignore"):
        try:
            y = np.linalg.solve(G + damping[:, None, None] * _EYE6, e[:, :, None])
        except np.linalg.LinAlgError:
            y = np.linalg.pinv(G) @ e[:, :, None]
        v: Array = weights * (scaled @ y)[:, :, 0]
        largest = np.abs(v).max(axis=1, initial=0.0)
    largest[~np.isfinite(largest)] = np.inf
    return v, largest
