"""What a wrist sensor really reads, from presses: arm, axes, sign, gain, bias, drift and delay.

Known motions of the grasps cause known wrenches W_a of the arms on the object, up to the servos' stiffness ρ. The
sensor that is taken for arm i's reads

    ``Y_i(t) = ρ [g_f R, 0; 0, g_t R] V_a(t − δ) + b + c t + noise``,  ``V_a = W_a + τ Ẇ_a``

with the arm a that it sits at, its axes R (a proper rotation), the gains of forces and torques with their signs, its
delay δ, and what the damping of the servos adds, τ = kd/kp, one for all. For each δ the sums of products are collected.
Then τ and each δ leave the least rest with free matrices in place of g R. For every arm a the proper R (Kabsch) and the
gains follow in turn, for Y and for −Y. The best permutation of the sensors is taken.
"""

from __future__ import annotations

import itertools
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from coopqp.spatial import Array

#: Delays that are tried [s], and values of τ [s].
DELAYS = np.arange(0.0, 0.2001, 0.005)
LEADS = np.array([0.0, 0.008, 0.016, 0.024, 0.032, 0.04, 0.056, 0.076, 0.1, 0.13])
#: Part of a reading that the model may miss, and least noise of forces [N] and torques [N·m].
_MODEL, _LEAST_NOISE = 0.05, np.array([0.1, 0.01])
_PARTS = _FORCE, _TORQUE = slice(0, 3), slice(3, 6)


@final
class SensorFit:
    """The fit of all sensors. After :meth:`go_on` has returned true, the results are its attributes.

    Args:
        times: time of each sample (T,) [s].
        readings: of the sensors (T, N, 6) [N, N·m], NaN for lost ones.
        expected: W, the wrenches that the presses cause with the stiffness that is told, in the tools' axes
            (T, N, 6) [N, N·m].

    Attributes:
        arms: index of the arm that each sensor sits at (N,).
        rotations: R of each sensor (N, 3, 3).
        gains: ρ g of forces and of torques (N, 2).
        offsets: b in the middle of the time (N, 6) [N, N·m], with the wrenches at rest.
        slopes: c (N, 6) [N/s, N·m/s].
        delays: δ (N,) [s].
        lead: τ [s].
        misfit: what the model leaves of each reading's changes beside noise, as a share (N,).
        noise: standard deviation of each sensor's forces and torques (N, 2) [N, N·m].
        lost: share of each sensor's samples that were lost (N,).
    """

    def __init__(self, times: Array, readings: Array, expected: Array) -> None:
        self._count = n = readings.shape[1]
        t = times - 0.5 * (times[0] + times[-1])
        self._heard: NDArray[np.bool_] = np.asarray(np.isfinite(readings).all(axis=2))
        self._read = np.where(self._heard[:, :, None], readings, 0.0)
        self.lost = 1.0 - self._heard.mean(axis=0)
        W = expected.reshape(len(t), 6 * n)
        rate = np.gradient(W, t, axis=0)
        self._t, self._regressors = t, np.hstack([W, rate])
        self.noise = self._noise()
        self._found: list[list[tuple[Array, Array, Array, Array]]] = []
        self._made: list[list[tuple[float, Array, Array]]] = []
        self._done = 0

    def _noise(self) -> Array:
        """Noise of forces and torques (N, 2), from second differences of samples in a row."""
        out = np.zeros((self._count, 2))
        for k in range(self._count):
            y, heard = self._read[:, k], self._heard[:, k]
            ok = heard[2:] & heard[1:-1] & heard[:-2]
            second = (y[2:] - 2.0 * y[1:-1] + y[:-2])[ok]
            if len(second):
                middle = np.median(np.abs(second), axis=0) / (0.6745 * np.sqrt(6.0))
                out[k] = np.maximum([middle[_FORCE].max(), middle[_TORQUE].max()], _LEAST_NOISE)
        return out

    def go_on(self) -> bool:
        """Do one more part of the work; true when all is done."""
        i, n = self._done, self._count
        self._done += 1
        if i < len(DELAYS):
            self._collect(DELAYS[i])
        elif i == len(DELAYS):
            self._time()
        elif i <= len(DELAYS) + n:
            k = i - len(DELAYS) - 1
            self._made.append([self._fitted(k, a) for a in range(n)])
        else:
            self._conclude()
            return True
        return False

    def _collect(self, late: float) -> None:
        """The sums of products with one delay."""
        at = np.interp(self._t - late, self._t, np.arange(len(self._t)))
        below = np.minimum(at.astype(int), len(self._t) - 2)
        share = (at - below)[:, None]
        x = (1.0 - share) * self._regressors[below] + share * self._regressors[below + 1]
        x = np.hstack([x, np.ones((len(x), 1)), self._t[:, None]])
        self._found.append([self._sums(x[h], self._read[h, k]) for k, h in enumerate(self._heard.T)])

    @staticmethod
    def _sums(x: Array, y: Array) -> tuple[Array, Array, Array, Array]:
        """Sums of x x (m, m), x y (m, 6) and y y (6, 6) without offset and slope; and how to get both of these."""
        gram, cross = x.T @ x, x.T @ y
        own = np.linalg.pinv(gram[-2:, -2:])
        to_plain = own @ gram[-2:, :-2]
        return (
            gram[:-2, :-2] - gram[:-2, -2:] @ to_plain,
            cross[:-2] - gram[:-2, -2:] @ own @ cross[-2:],
            y.T @ y - cross[-2:].T @ own @ cross[-2:],
            np.hstack([own @ cross[-2:], to_plain]),
        )

    def _seen(self, gram: Array, cross: Array, arm: int, lead: Any) -> tuple[Array, Array]:
        """Sums of V V (…, 6, 6) and V Y (…, 6, 6) of an arm, from those of W and Ẇ."""
        a, b = slice(6 * arm, 6 * arm + 6), slice(6 * (self._count + arm), 6 * (self._count + arm) + 6)
        both = gram[..., a, b]
        vv: Array = gram[..., a, a] + lead * (both + both.swapaxes(-1, -2)) + lead**2 * gram[..., b, b]
        vy: Array = cross[..., a, :] + lead * cross[..., b, :]
        return vv, vy

    def _weights(self, k: int, yy: Array) -> Array:
        """One over the variance of a sample, for forces and torques (2,)."""
        samples = max(int(self._heard[:, k].sum()), 1)
        sizes = np.array([np.trace(yy[_FORCE, _FORCE]), np.trace(yy[_TORQUE, _TORQUE])]) / samples
        out: Array = 1.0 / (np.maximum(self.noise[k], _LEAST_NOISE) ** 2 + _MODEL**2 * sizes)
        return out

    def _time(self) -> None:
        """τ, and the delay of each sensor at each arm."""
        n = self._count
        rests = np.zeros((n, n, len(LEADS), len(DELAYS)))
        leads = LEADS[:, None, None, None]
        for k, a in itertools.product(range(n), range(n)):
            gram, cross = (np.array([row[k][i] for row in self._found]) for i in (0, 1))
            yy = np.array([row[k][2] for row in self._found])
            vv, vy = self._seen(gram, cross, a, leads)
            for w, p in zip(self._weights(k, yy[0]), _PARTS, strict=True):
                own, seen = vv[..., p, p], vy[..., p, p]
                own = own + (1e-6 * np.trace(own, axis1=-2, axis2=-1) + 1e-12)[..., None, None] * np.eye(3)
                explained = (seen * np.linalg.solve(own, seen)).sum(axis=(-2, -1))
                rests[k, a] += w * (np.trace(yy[:, p, p], axis1=-2, axis2=-1) - explained)
        j = int(rests.min(axis=3).min(axis=1).sum(axis=0).argmin())
        self.lead, self._rests = float(LEADS[j]), rests[:, :, j]
        self._late = self._rests.argmin(axis=2)

    def _conclude(self) -> None:
        """Which sensor sits at which arm, and what is left."""
        from scipy.optimize import linear_sum_assignment  # here, since it takes long to import

        n, made, late, rests = self._count, self._made, self._late, self._rests
        costs = np.array([[m[0] for m in row] for row in made])
        self.arms = linear_sum_assignment(costs)[1]
        best = [made[k][a] for k, a in enumerate(self.arms)]
        self.rotations = np.array([m[1] for m in best])
        self.gains = np.array([m[2] for m in best])
        self.delays = np.array([_between(rests[k, a], late[k, a]) for k, a in enumerate(self.arms)])
        self.offsets, self.slopes, self.misfit = np.zeros((n, 6)), np.zeros((n, 6)), np.zeros(n)
        for k, a in enumerate(self.arms):
            sums = self._found[int(late[k, a])][k]
            shape = np.zeros((sums[0].shape[0], 6))
            for g, part in zip(self.gains[k], _PARTS, strict=True):
                for place, factor in ((a, 1.0), (n + a, self.lead)):
                    shape[6 * place + part.start : 6 * place + part.stop, part] = factor * g * self.rotations[k].T
            level = sums[3][:, :6] - sums[3][:, 6:] @ shape
            self.offsets[k], self.slopes[k] = level
            rest = np.diag(sums[2] - 2.0 * sums[1].T @ shape + shape.T @ sums[0] @ shape)[_FORCE].sum()
            samples = int(self._heard[:, k].sum())
            noise = 3.0 * samples * self.noise[k, 0] ** 2
            self.misfit[k] = max(rest - noise, 0.0) / max(np.trace(sums[2][_FORCE, _FORCE]), noise, 1e-12)

    def _fitted(self, k: int, arm: int) -> tuple[float, Array, Array]:
        """Weighed rest of sensor k at an arm, R, and the gains."""
        sums = self._found[int(self._late[k, arm])][k]
        vv, vy = self._seen(sums[0], sums[1], arm, self.lead)
        weights = self._weights(k, sums[2])
        best: tuple[float, Array, Array] | None = None
        for signs in itertools.product((1.0, -1.0), repeat=2):
            g, R = np.array(signs), np.eye(3)
            for _ in range(8):
                mixed = sum(w * s * vy[p, p] for w, s, p in zip(weights, g, _PARTS, strict=True))
                R = proper(np.asarray(mixed).T)
                g = np.array([np.trace(R @ vy[p, p]) / max(np.trace(vv[p, p]), 1e-12) for p in _PARTS])
                g = np.where(g * signs > 0.0, g, 0.0)
            rest = sum(
                w * (np.trace(sums[2][p, p]) - 2.0 * s * np.trace(R @ vy[p, p]) + s**2 * np.trace(vv[p, p]))
                for w, s, p in zip(weights, g, _PARTS, strict=True)
            )
            if best is None or rest < best[0]:
                best = (float(rest), R, g)
        if best is None:
            return np.inf, np.eye(3), np.zeros(2)
        return best


def proper(M: Array) -> Array:
    """The proper rotation R (3, 3) of the largest trace(Rᵀ M)."""
    U, _, Vt = np.linalg.svd(M)
    out: Array = U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt
    return out


def _between(rests: Array, i: int) -> float:
    """The delay at the lowest point of the parabola through the least rest and its neighbours [s]."""
    if not 0 < i < len(rests) - 1:
        return float(DELAYS[i])
    low, mid, high = rests[i - 1 : i + 2]
    bend = low - 2.0 * mid + high
    return float(DELAYS[i] + (DELAYS[1] - DELAYS[0]) * (0.5 * (low - high) / bend if bend > 0.0 else 0.0))
