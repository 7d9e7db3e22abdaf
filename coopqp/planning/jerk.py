"""A speed profile under limits on the joints' jerk, from one without: successive linear programs.

The mean acceleration of a joint between two knots is linear in z = ṡ²:
``A_i = ½ [(q′_i + q′_{i+1}) s̈_i + q″_i z_i + q″_{i+1} z_{i+1}]``.
With the times ``t_i`` between knots the jerk is bounded where

    |A_i − A_{i−1}| ≤ J (t_{i−1} + t_i) / 2,   |A_0| ≤ J t_0 / 2,   |A_{K−2}| ≤ J t_{K−2} / 2

``t_i = 2 h_i / (√z_i + √z_{i+1})`` is convex: its tangent at a profile lies below it. With tangents in its place on the
right the limits are lines, and each profile within them is within the limits themselves. So each program starts from an
admissible profile and ends with one that takes no longer. In the end accelerations are smoothed, :func:`smoothed`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from coopqp.errors import UndecidedError
from coopqp.planning.knots import hermite
from coopqp.planning.parametrise import Limited, Lines
from coopqp.spatial import Array

#: Most programs, and the share of the duration that one has to gain before the next.
_PROGRAMS, _GAIN = 40, 2e-4
#: Rows used below this share of their bounds stay out of a program until one of them is broken.
_LOOKED_AT = 0.3
#: Searches for broken rows in one program; then all rows enter.
_LOOKS = 4
#: Knots of the smoothed profile: number for each given knot, or one per this time [s] if those are more; at most.
_FINER, _STEP, _MOST_KNOTS = 4, 0.0025, 4000
#: Time over which accelerations are averaged where jerk is measured [s].
_WINDOW = 0.01
#: Rows may be broken by this share of their bounds.
_TOLERANCE = 1e-7


@dataclass(frozen=True, eq=False)
class _Rows:
    """Rows ``|near z_i + far z_{i+1} + constant| ≤ bound``, m of them; ``first`` has i."""

    first: npt.NDArray[np.intp]
    near: Array
    far: Array
    bound: Array
    constant: Array


def jerk_limited(limited: Limited, squares: Array, jerk: Array) -> Array:
    """ṡ² at each knot (K,) under jerk limits (nv,), from an admissible profile without them.

    Raises:
        UndecidedError: a linear program fails.
    """
    knots = limited.knots
    h = np.diff(knots.s)
    own = np.flatnonzero(np.isfinite(jerk) & (np.abs(knots.slope).max(axis=0) > 0.0))
    A = _mean_accelerations(knots.slope[:, own], knots.curvature[:, own], h)
    bound = jerk[own]
    lines = [_line_rows(x, h) for x in (limited.acceleration, limited.torque) if x is not None]
    top = limited.square_bound()
    z = squares * _slow_down(A, h, squares, bound)
    total = _times(h, z).sum()
    for _ in range(_PROGRAMS):
        ahead = _program(lines, A, h, z, bound, top)
        step, gained = 1.0, False
        while step > 1e-3 and not gained:  # the tangent of the duration overestimates the gain
            tried = z + step * (ahead - z)
            spent = _times(h, tried).sum()
            gained = spent < total
            step *= 0.5
        if not gained:
            break
        z, before, total = tried, total, spent
        if before - total < _GAIN * total:
            break
    return z


def smoothed(s: Array, squares: Array) -> tuple[Array, Array]:
    """Knots and ṡ² of the same motion with the acceleration s̈ averaged over the longest time between knots.

    Between knots s̈ is constant, so it steps there by what the jerk allows for the time between them. Its mean over
    that time W has no steps: ``ṡ(t) = (s(t + W/2) − s(t − W/2)) / W``. The motion takes W longer. In the new profile s̈
    steps, too, but after short times.
    """
    h, v = np.diff(s), np.sqrt(squares)
    spans = 2.0 * h / (v[1:] + v[:-1])
    clocks = np.concatenate([[0.0], np.cumsum(spans)])
    slopes = 0.5 * np.diff(squares) / h
    area = np.concatenate([[0.0], np.cumsum(spans * (s[:-1] + spans * (0.5 * v[:-1] + spans * slopes / 6.0)))])
    width, end = float(spans.max()), float(clocks[-1])
    count = int(min(max(_FINER * len(s), end / _STEP), _MOST_KNOTS))

    def way(t: Array) -> tuple[Array, Array]:
        """s and its integral, at rest before and after."""
        i = np.clip(np.searchsorted(clocks, t, side="right") - 1, 0, len(spans) - 1)
        dt = np.clip(t, 0.0, end) - clocks[i]
        x = s[i] + dt * (v[i] + 0.5 * dt * slopes[i])
        X = area[i] + dt * (s[i] + dt * (0.5 * v[i] + dt * slopes[i] / 6.0))
        return x, X + s[-1] * np.clip(t - end, 0.0, None)

    t = np.linspace(-0.5 * width, end + 0.5 * width, count)
    (after, area_after), (before, area_before) = way(t + 0.5 * width), way(t - 0.5 * width)
    x, speed = (area_after - area_before) / width, (after - before) / width
    x[0], x[-1], speed[0], speed[-1] = 0.0, s[-1], 0.0, 0.0
    kept = np.concatenate([[True], np.diff(x[:-1]) > 1e-9 * s[-1], [True]])
    kept[:-1] &= x[:-1] < s[-1] * (1.0 - 1e-9)
    return x[kept], speed[kept] ** 2


def jerk_use(limited: Limited, squares: Array, jerk: Array) -> Array:
    """Share of the jerk limits (nv,) that is used between knots (K − 1, nv).

    The jerk is the change from the mean acceleration of the 10 ms before the middle of an interval to that of the 10 ms
    after it, over 10 ms.
    """
    knots, w = limited.knots, _WINDOW
    s, v = knots.s, np.sqrt(squares)
    spans = _times(np.diff(s), squares)
    clocks = np.concatenate([[0.0], np.cumsum(spans)])
    slopes = 0.5 * np.diff(squares) / np.diff(s)

    def velocities(t: Array) -> Array:
        i = np.clip(np.searchsorted(clocks, t, side="right") - 1, 0, len(spans) - 1)
        dt = np.clip(t, 0.0, clocks[-1]) - clocks[i]
        speed = np.where((t > 0.0) & (t < clocks[-1]), v[i] + slopes[i] * dt, 0.0)
        at = s[i] + dt * (v[i] + 0.5 * dt * slopes[i])
        return hermite(s, knots.slope, knots.curvature, at) * speed[:, None]

    middle = clocks[:-1] + 0.5 * spans
    change = velocities(middle + w) - 2.0 * velocities(middle) + velocities(middle - w)
    return np.abs(change) / (w * w * jerk)


def _times(h: Array, z: Array) -> Array:
    v = np.sqrt(np.maximum(z, 0.0))
    with np.errstate(divide="ignore"):
        out: Array = 2.0 * h / (v[1:] + v[:-1])
    return out


def _slopes_of_times(h: Array, z: Array) -> tuple[Array, Array]:
    """Derivatives of the times with respect to z at both ends; 0 at the ends of the path, where z is 0 for good."""
    v = np.sqrt(z)
    both = v[1:] + v[:-1]
    with np.errstate(divide="ignore", invalid="ignore"):
        near, far = -h / (v[:-1] * both**2), -h / (v[1:] * both**2)
    near[0], far[-1] = 0.0, 0.0
    return near, far


def _mean_accelerations(slope: Array, curvature: Array, h: Array) -> tuple[Array, Array]:
    """Coefficients of z_i and z_{i+1} in A_i, (K − 1, m) each."""
    rise = 0.25 * (slope[1:] + slope[:-1]) / h[:, None]
    return 0.5 * curvature[:-1] - rise, 0.5 * curvature[1:] + rise


def _changes(A: tuple[Array, Array], z: Array) -> Array:
    """A_i − A_{i−1} for i = 0 … K − 1, with rest before and after: (K, m)."""
    mean = A[0] * z[:-1, None] + A[1] * z[1:, None]
    rest = np.zeros((1, mean.shape[1]))
    return np.diff(np.vstack([rest, mean, rest]), axis=0)


def _spans(h: Array, z: Array) -> Array:
    """(t_{i−1} + t_i) / 2 for i = 0 … K − 1: (K,)."""
    t = np.concatenate([[0.0], _times(h, z), [0.0]])
    return 0.5 * (t[1:] + t[:-1])


def _slow_down(A: tuple[Array, Array], h: Array, z: Array, bound: Array) -> float:
    """The share of z within the limits: with λ z changes are λ times as large, and times 1/√λ times as long."""
    use = (np.abs(_changes(A, z)) / (bound * _spans(h, z)[:, None])).max()
    return float(min(1.0, 0.999 * use ** (-2.0 / 3.0)))


def _line_rows(lines: Lines, h: Array) -> _Rows:
    """Lines at both ends of each interval."""
    K, m = lines.a.shape
    parts = []
    for end in (0, 1):
        at = slice(end, K - 1 + end)
        rise = lines.a[at] / (2.0 * h[:, None])
        near, far = -rise + (1 - end) * lines.b[at], rise + end * lines.b[at]
        parts.append((near, far, lines.c[at]))
    near, far, c = (np.concatenate([p[k].ravel() for p in parts]) for k in range(3))
    first = np.tile(np.repeat(np.arange(K - 1), m), 2)
    return _Rows(first, near, far, np.tile(lines.bound, 2 * (K - 1)), c)


def _program(lines: list[_Rows], A: tuple[Array, Array], h: Array, z: Array, bound: Array, top: Array) -> Array:
    """The best profile within the limits; jerk limits have tangents at ``z``."""
    from scipy.optimize import linprog
    from scipy.sparse import csr_array, vstack

    K = len(z)
    scale = float(z.max())
    near, far = _slopes_of_times(h, z)
    gradient = np.concatenate([near, [0.0]]) + np.concatenate([[0.0], far])
    upper = np.minimum(top, 1e3 * scale) / scale
    upper[0] = upper[-1] = 0.0
    parts = [*(_two_sided(rows, K) for rows in lines), _jerk_rows(A, h, z, bound)]
    M, right = csr_array(vstack([B * scale for B, _ in parts])), np.concatenate([b for _, b in parts])
    here = z / scale
    inside = M @ here - right > -(1.0 - _LOOKED_AT)
    for look in range(_LOOKS + 1):
        if look == _LOOKS:
            inside[:] = True
        found = linprog(
            gradient / np.abs(gradient).max(), A_ub=M[inside], b_ub=right[inside],
            bounds=np.column_stack([np.zeros(K), upper]), method="highs",
        )  # fmt: skip
        if found.status != 0:
            raise UndecidedError(f"the linear program of the jerk limits failed: {found.message}")
        broken = (M @ found.x - right > _TOLERANCE) & ~inside
        if not broken.any():
            return np.maximum(found.x, 0.0) * scale
        inside |= broken
    raise AssertionError  # all rows are inside


def _two_sided(rows: _Rows, K: int) -> tuple[Any, Array]:
    """``±(row + constant) / bound ≤ 1`` as a matrix and right sides."""
    from scipy.sparse import coo_array, vstack

    m = len(rows.first)
    i = np.arange(m)
    values = np.concatenate([rows.near / rows.bound, rows.far / rows.bound])
    M = coo_array((values, (np.tile(i, 2), np.concatenate([rows.first, rows.first + 1]))), shape=(m, K))
    c = rows.constant / rows.bound
    return vstack([M, -M]), np.concatenate([1.0 - c, 1.0 + c])


def _jerk_rows(A: tuple[Array, Array], h: Array, z: Array, bound: Array) -> tuple[Any, Array]:
    """``±(A_i − A_{i−1}) / (J T_i) ≤ T_i(z)|_tangent / T_i`` with T_i = (t_{i−1} + t_i)/2 at ``z``."""
    from scipy.sparse import coo_array, vstack

    K, m = len(z), len(bound)
    spans = _spans(h, z)
    size = bound * spans[:, None]  # (K, m)
    i = np.arange(K * m).reshape(K, m)
    rows, columns, values = [], [], []

    def put(which: slice, column: npt.NDArray[np.intp], value: Array) -> None:
        rows.append(i[which].ravel())
        columns.append(np.repeat(column, m))
        values.append((value / size[which]).ravel())

    inner, k = np.arange(K - 1), slice(0, K - 1)
    put(k, inner, A[0])  # + A_i
    put(k, inner + 1, A[1])
    late = slice(1, K)
    put(late, inner, -A[0])  # − A_{i−1}
    put(late, inner + 1, -A[1])
    M = coo_array((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=(K * m, K))
    near, far = _slopes_of_times(h, z)
    # Tangent of T_i: half of the slopes of t_{i−1} and t_i, over T_i.
    G = np.zeros((K, 3))  # of z_{i−1}, z_i, z_{i+1}
    G[1:, 0] += 0.5 * near
    G[1:, 1] += 0.5 * far
    G[:-1, 1] += 0.5 * near
    G[:-1, 2] += 0.5 * far
    G /= spans[:, None]
    at = np.arange(K)[:, None] + np.array([-1, 0, 1])
    valid = (at >= 0) & (at < K)
    T = coo_array((G[valid], (np.repeat(np.arange(K), valid.sum(axis=1)), at[valid])), shape=(K, K)).tocsr()
    constant = 1.0 - T @ z
    each = T[np.repeat(np.arange(K), m)]
    right = np.repeat(constant, m)
    return vstack([M - each, -M - each]), np.concatenate([right, right])
