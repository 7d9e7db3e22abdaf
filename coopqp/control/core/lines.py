"""Straight segments for the NumPy kernel: reference pose, its adjoint and the twist along it, in one product.

On a segment ``R = R₀ Rot(r, θ)`` with θ = u φ, ``p = p₀ + u d`` and, by Rodrigues,

    R = R₀ r rᵀ + cos θ R₀ (I − r rᵀ) + sin θ R₀ [r]×

so the entries of R, p and of [p]× R are linear in (1, cos θ, sin θ, u, u cos θ, u sin θ). The twist over a span in
which u gains g is ν = g (V⁻¹(δ r) Rᵀ d, φ r) / span, δ = g φ: with b = R₀ᵀ d, its part f across the axis, and
r × f = h (so r × h = −f), ``Rᵀ d = b − f + cos θ f − sin θ h``. V⁻¹(δ r) leaves the axis alone and multiplies what is
across by ``k − ½ δ [r]×``, k = (δ/2) cot(δ/2). Hence ν is linear in three more numbers,

    g / span · (1,  k cos θ − ½ δ sin θ,  −k sin θ − ½ δ cos θ)

and all 54 numbers are one constant matrix times nine.
"""

from __future__ import annotations

import math

import numpy as np

from coopqp.control.core.workspace import Workspace
from coopqp.spatial import Array, skew


class LineFollower:
    """Fills ``ws.posed`` where ``ON_LINE`` is set."""

    def __init__(self, workspace: Workspace) -> None:
        self._ws = workspace
        self._numbers = b""
        self._matrix = np.zeros((9, 54))
        self._factors = np.zeros(9)
        self._start, self._duration, self._quintic, self._angle = 0.0, 1.0, False, 0.0

    def follow(self, clock: float, span: float) -> bool:
        """Reference pose at ``clock`` and ν over ``span``; False where the numbers are no segment."""
        ws = self._ws
        numbers = ws.line.tobytes()
        try:
            if numbers != self._numbers:
                self._prepare(ws.line)
                self._numbers = numbers
            x = (clock - self._start) / self._duration
            u = self._value(x)
            theta, gain, half, k = u * self._angle, 0.0, 0.0, 1.0
            c, s = math.cos(theta), math.sin(theta)
            if span < 0.0:
                gain = self._slope(x) / self._duration
            elif span != 0.0:
                step = self._value(x + span / self._duration) - u
                half, gain = 0.5 * step * self._angle, step / span
                # (δ/2) cot(δ/2) by series: the next term is below rounding
                k = half / math.tan(half) if abs(half) > 0.01 else 1.0 - half * half * (1 / 3 + half * half / 45)
        except (ArithmeticError, ValueError):
            return False
        self._factors[:] = 1.0, c, s, u, u * c, u * s, gain, gain * (k * c - half * s), -gain * (k * s + half * c)
        np.dot(self._factors, self._matrix, out=ws.posed)
        return True

    def _prepare(self, line: Array) -> None:
        R0, p0, turn, d = line[:9].reshape(3, 3), line[9:12], line[12:15], line[15:18]
        self._start, self._duration, law = line[18:21].tolist()
        self._quintic = law != 0.0
        angle = self._angle = math.sqrt(float(turn @ turn))
        if not math.isfinite(angle):
            raise ValueError("the segment's rotation is not finite")
        r = turn / angle if angle > 0.0 else turn
        along = np.outer(r, r)
        rotations = R0 @ along, R0 - R0 @ along, R0 @ skew(r)  # of 1, cos θ, sin θ
        M = np.zeros((9, 54))
        for i, R in enumerate(rotations):
            for row, P in ((i, skew(p0)), (3 + i, skew(d))):
                action = M[row, :36].reshape(6, 6)
                action[:3, 3:] = P @ R
                if row < 3:
                    action[:3, :3] = action[3:, 3:] = R
                    M[row, 36:45] = R.ravel()
        M[0, 45:48], M[3, 45:48] = p0, d
        b = R0.T @ d
        f = b - along @ b if angle > 0.0 else b
        M[6, 48:51], M[7, 48:51], M[8, 48:51] = b - f, f, skew(r) @ f
        M[6, 51:] = turn
        self._matrix = M

    def _value(self, x: float) -> float:
        if x <= 0.0:
            return 0.0
        if x >= 1.0:
            return 1.0
        return min(x * x * x * (10.0 + x * (6.0 * x - 15.0)), 1.0) if self._quintic else x

    def _slope(self, x: float) -> float:
        if x < 0.0 or x >= 1.0:
            return 0.0
        return 30.0 * x * x * (1.0 - x) * (1.0 - x) if self._quintic else 1.0
