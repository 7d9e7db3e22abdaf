"""What a wrist sensor really reads, from presses: arm, axes, sign, gain, bias, drift and delay.

Known motions e of the grasps cause wrenches ``W = G(s) e`` of the arms on the object, up to the servos' stiffness: that
of arm k is ρ exp(s_k) times the one that is told. The sensor that is taken for arm i's reads

    ``Y_i(t) = ρ [g_f R, 0; 0, g_t R] V_a(t − δ) + b + c t + noise``,  ``V_a = W_a + τ Ẇ_a``

with the arm a that it sits at, its axes R (a proper rotation), the gains of forces and torques with their signs, its
delay δ, and what the damping of the servos adds, τ = kd/kp, one for all. For each δ the sums of products are collected.
Then τ and each δ leave the least rest with free matrices in place of g R. For every arm a the proper R (Kabsch) and the
gains follow in turn, for Y and for −Y. The best permutation of the sensors is taken.

Within the object all wrenches cancel, whatever the gains: so an arm that is softer than the others changes how forces
and torques of all arms share a press, as no gain does. s is found together with R and the gains (Gauss-Newton), with a
mean of 0: stiffness that all arms share is ρ. Then times, R, gains and the permutation are found once more.
"""

from __future__ import annotations

import itertools
from typing import Any, final

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from coopqp.forces.presses import of_grip
from coopqp.spatial import Array

#: Delays that are tried [s], and values of τ [s]: servos of a tenth of their stiffness may have damping for all of it.
DELAYS = np.arange(0.0, 0.2001, 0.005)
LEADS = np.array([0.0, 0.008, 0.016, 0.024, 0.032, 0.04, 0.056, 0.076, 0.1, 0.13, 0.18, 0.25, 0.34, 0.48])
#: Part of a reading that the model may miss, and least noise of forces [N] and torques [N·m].
_MODEL, _LEAST_NOISE = 0.05, np.array([0.1, 0.01])
_PARTS = _FORCE, _TORQUE = slice(0, 3), slice(3, 6)
#: Steps of Gauss-Newton for s, the largest change of an s in a step, and the largest s.
_TURNS, _STRIDE, _MOST = 8, 0.7, 3.0
#: Directions of ė that are smaller than this share of the largest [(m/s)²] are none.
_SEEN = 1e-8
#: Step of a difference quotient in s, and a change in a step below which s has settled.
_STEP, _SETTLED = 1e-4, 1e-3
#: What gains and axes that nothing tells are held by.
_LITTLE = 1e-2
#: Doubt in s before anything is heard: without a reason an arm is as stiff as the others.
_DOUBT = 0.3


@final
class SensorFit:
    """The fit of all sensors. After :meth:`go_on` has returned true, the results are its attributes.

    Args:
        times: time of each sample (T,) [s].
        readings: of the sensors (T, N, 6) [N, N·m], NaN for lost ones.
        motions: e, how far the grasps stand from each other as commanded, in the object's axes (T, N, 6) [m, rad].
        compliances: C of each arm's servos at the object frame as told, in its axes (N, 6, 6) [m/N …].
        to_tools: maps of wrenches from the object frame to each tool (N, 6, 6).
        shared: the compliance of joints that arms share (6 N, 6 N); None without any. Their stiffness is not found.

    Attributes:
        arms: index of the arm that each sensor sits at (N,).
        rotations: R of each sensor (N, 3, 3).
        gains: ρ g of forces and of torques (N, 2).
        stiffer: exp(s), stiffness of each arm over the one that is told, beside ρ (N,).
        offsets: b in the middle of the time (N, 6) [N, N·m], with the wrenches at rest.
        slopes: c (N, 6) [N/s, N·m/s].
        delays: δ (N,) [s].
        lead: τ [s].
        misfit: what the model leaves of each reading's changes beside noise, as a share (N,).
        noise: standard deviation of each sensor's forces and torques (N, 2) [N, N·m].
        lost: share of each sensor's samples that were lost (N,).
        doubts: standard deviation of the axes of each sensor by its noise (N,) [rad].
    """

    def __init__(
        self,
        times: Array,
        readings: Array,
        motions: Array,
        compliances: Array,
        to_tools: Array,
        shared: Array | None = None,
    ) -> None:
        self._count = n = readings.shape[1]
        self._compliances, self._shared, self._to_tools = compliances, shared, to_tools
        t = times - 0.5 * (times[0] + times[-1])
        self._heard: NDArray[np.bool_] = np.asarray(np.isfinite(readings).all(axis=2))
        self._read = np.where(self._heard[:, :, None], readings, 0.0)
        self.lost = 1.0 - self._heard.mean(axis=0)
        e = motions.reshape(len(t), 6 * n)
        self._t, self._regressors = t, np.hstack([e, np.gradient(e, t, axis=0)])
        self.noise = self._noise()
        self._found: list[list[tuple[Array, Array, Array, Array]]] = []
        self._take(np.zeros(n))
        pairs = list(itertools.product(range(n), range(n)))
        round_: list[tuple[str, tuple[Any, ...]]] = [*(("_time", pair) for pair in pairs), ("_settle", ())]
        round_ += [*(("_make", pair) for pair in pairs), ("_assign", ()), *[("_soften", ())] * _TURNS]
        #: What is left to do: methods and their arguments.
        self._work = [("_collect", tuple(DELAYS[i : i + 2])) for i in range(0, len(DELAYS), 2)]
        self._work += [*round_, *round_, ("_conclude", ())]

    def _take(self, s: Array) -> None:
        """Take a stiffness of the arms."""
        self._s, self._maps = s, self._wrenches(s)

    def _wrenches(self, s: Array) -> Array:
        """Maps from e to the wrenches at the tools (N, 6, 6 N), with stiffness exp(s)."""
        n = self._count
        return self._to_tools @ of_grip(self._compliances * np.exp(-s)[:, None, None], self._shared).reshape(
            n, 6, 6 * n
        )

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
        if self._work:
            (name, given), *self._work = self._work
            getattr(self, name)(*given)
        return not self._work

    def _collect(self, *delays: float) -> None:
        """The sums of products with some delays."""
        for late in delays:
            self._found.append(self._delayed(late))

    def _delayed(self, late: float) -> list[tuple[Array, Array, Array, Array]]:
        """The sums of products of each sensor with one delay."""
        at = np.interp(self._t - late, self._t, np.arange(len(self._t)))
        below = np.minimum(at.astype(int), len(self._t) - 2)
        share = (at - below)[:, None]
        x = (1.0 - share) * self._regressors[below] + share * self._regressors[below + 1]
        x = np.hstack([x, np.ones((len(x), 1)), self._t[:, None]])
        return [self._sums(x[h], self._read[h, k]) for k, h in enumerate(self._heard.T)]

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

    def _still(self, k: int, arm: int) -> tuple[Array, Array, Array, Array]:
        """Sums of e e, e Y and Y Y of sensor k at an arm without what follows ė in any way; how ė explains both."""
        m = 6 * self._count
        gram, cross, yy, _ = self._found[int(self._late[k, arm])][k]
        own = np.asarray(np.linalg.pinv(gram[m:, m:], rcond=_SEEN, hermitian=True), dtype=float)
        fast = own @ np.hstack([gram[m:, :m], cross[m:]])
        return (
            gram[:m, :m] - gram[:m, m:] @ fast[:, :m],
            cross[:m] - gram[:m, m:] @ fast[:, m:],
            yy - cross[m:].T @ fast[:, m:],
            fast,
        )

    def _weights(self, k: int, yy: Array) -> Array:
        """One over the variance of a sample, for forces and torques (2,)."""
        samples = max(int(self._heard[:, k].sum()), 1)
        sizes = np.array([np.trace(yy[_FORCE, _FORCE]), np.trace(yy[_TORQUE, _TORQUE])]) / samples
        return 1.0 / (np.maximum(self.noise[k], _LEAST_NOISE) ** 2 + _MODEL**2 * sizes)

    def _time(self, k: int, arm: int) -> None:
        """What free matrices leave of sensor k at an arm, for all τ and delays."""
        n, m, leads = self._count, 6 * self._count, LEADS[:, None, None, None]
        if k == 0 and arm == 0:
            self._all_rests = np.zeros((n, n, len(LEADS), len(DELAYS)))
        gram, cross, yy = (np.array([row[k][i] for row in self._found]) for i in range(3))
        G = self._maps[arm]
        still, both, fast = G @ gram[:, :m, :m] @ G.T, G @ gram[:, :m, m:] @ G.T, G @ gram[:, m:, m:] @ G.T
        vv = still + leads * (both + both.swapaxes(-1, -2)) + leads**2 * fast
        vy = G @ cross[:, :m] + leads * (G @ cross[:, m:])
        for w, p in zip(self._weights(k, yy[0]), _PARTS, strict=True):
            own, seen = vv[..., p, p], vy[..., p, p]
            own = own + (1e-6 * np.trace(own, axis1=-2, axis2=-1) + 1e-12)[..., None, None] * np.eye(3)
            explained = (seen * np.linalg.solve(own, seen)).sum(axis=(-2, -1))
            self._all_rests[k, arm] += w * (np.trace(yy[:, p, p], axis1=-2, axis2=-1) - explained)

    def _settle(self) -> None:
        """τ, and the delay of each sensor at each arm."""
        j = int(self._all_rests.min(axis=3).min(axis=1).sum(axis=0).argmin())
        self.lead, self._rests = float(LEADS[j]), self._all_rests[:, :, j]
        self._late = self._rests.argmin(axis=2)
        self._made: dict[tuple[int, int], tuple[float, Array, Array]] = {}

    def _make(self, k: int, arm: int) -> None:
        """R and gains of sensor k at an arm."""
        self._made[k, arm] = self._fitted(k, arm)

    def _fitted(self, k: int, arm: int) -> tuple[float, Array, Array]:
        """Weighed rest of sensor k at an arm, R, and the gains."""
        (ee, ey, yy, _), G = self._still(k, arm), self._maps[arm]
        vv, vy = G @ ee @ G.T, G @ ey
        weights = self._weights(k, yy)
        best: tuple[float, Array, Array] | None = None
        for signs in itertools.product((1.0, -1.0), repeat=2):
            g, R, last = np.array(signs), np.eye(3), np.full(2, np.inf)
            while np.abs(g - last).max() > 1e-3 * np.abs(g).max():
                last = g
                mixed = sum(w * s * vy[p, p] for w, s, p in zip(weights, g, _PARTS, strict=True))
                R = proper(np.asarray(mixed).T)
                g = np.array([np.trace(R @ vy[p, p]) / max(np.trace(vv[p, p]), 1e-12) for p in _PARTS])
                g = np.where(g * signs > 0.0, g, 0.0)
            rest = sum(
                w * (np.trace(yy[p, p]) - 2.0 * s * np.trace(R @ vy[p, p]) + s**2 * np.trace(vv[p, p]))
                for w, s, p in zip(weights, g, _PARTS, strict=True)
            )
            if best is None or rest < best[0]:
                best = (float(rest), R, g)
        if best is None:
            return np.inf, np.eye(3), np.zeros(2)
        return best

    def _assign(self) -> None:
        """Which sensor sits at which arm."""
        n = self._count
        self.arms = cheapest(np.array([[self._made[k, a][0] for a in range(n)] for k in range(n)]))
        best = [self._made[k, a] for k, a in enumerate(self.arms.tolist())]
        self.rotations, self.gains = np.array([m[1] for m in best]), np.array([m[2] for m in best])
        self._sits = [self._still(k, a) for k, a in enumerate(self.arms)]
        self._weigh = [np.repeat(self._weights(k, sums[2]), 3) for k, sums in enumerate(self._sits)]

    def _soften(self) -> None:
        """One step of Gauss-Newton for s, R and the logarithms of the gains of all sensors together."""
        n, m = self._count, 5 * self._count
        apart = np.linalg.qr(np.hstack([np.ones((n, 1)), np.eye(n)[:, 1:]]))[0][:, 1:]  # all of mean 0
        slopes = np.array([(self._wrenches(self._s + _STEP * d) - self._maps) / _STEP for d in apart.T])
        H, b = np.zeros((m + n - 1, m + n - 1)), np.zeros(m + n - 1)
        for k, a in enumerate(self.arms):
            L, weights, (ee, ey, _, _) = self._reads(k), self._weigh[k], self._sits[k]
            F, ways = L @ self._maps[a], np.zeros((4 + n, 6, 6 * n))
            ways[0, _FORCE], ways[1, _TORQUE] = F[_FORCE], F[_TORQUE]
            for j, e in enumerate(np.eye(3)):
                for p in _PARTS:
                    ways[2 + j, p] = np.cross(e, F[p], axisb=0).T
            ways[5:] = L @ slopes[:, a]
            at = np.r_[5 * k : 5 * k + 5, m : m + n - 1]
            weighed = weights[:, None] * ways
            H[np.ix_(at, at)] += np.einsum("cij,dij->cd", weighed @ ee, ways)
            b[at] += np.einsum("cij,ij->c", weighed, ey.T - F @ ee)
        b[m:] -= apart.T @ self._s / _DOUBT**2
        move = np.linalg.solve(H + np.diag(np.r_[np.full(m, _LITTLE), np.full(n - 1, _DOUBT**-2)]), b)
        move *= min(1.0, _STRIDE / max(float(np.abs(move).max()), 1e-12))
        if float(np.abs(move).max()) < _SETTLED:
            while self._work[0][0] == "_soften":
                self._work = self._work[1:]
        before, rest = (self.rotations, self.gains, self._s), self._rest()
        for share in (1.0, 0.3, 0.1, 0.0):
            own = share * move[:m].reshape(n, 5)
            self.gains = before[1] * np.exp(own[:, :2])
            self.rotations = np.array([turn(w) @ R for w, R in zip(own[:, 2:], before[0], strict=True)])
            self._take(np.clip(before[2] + share * apart @ move[m:], -_MOST, _MOST))
            if self._rest() <= rest:
                return

    def _reads(self, k: int) -> Array:
        """[g_f R, 0; 0, g_t R] of sensor k."""
        L = np.zeros((6, 6))
        for g, p in zip(self.gains[k], _PARTS, strict=True):
            L[p, p] = g * self.rotations[k]
        return L

    def _rest(self) -> float:
        """The weighed rest of all sensors, and of the doubt in s."""
        out = float(self._s @ self._s) / _DOUBT**2
        for k, (a, (ee, ey, yy, _)) in enumerate(zip(self.arms, self._sits, strict=True)):
            F = self._reads(k) @ self._maps[a]
            out += float(self._weigh[k] @ (np.diag(yy) - 2.0 * (F * ey.T).sum(axis=1) + ((F @ ee) * F).sum(axis=1)))
        return out

    def _conclude(self) -> None:
        """What is left."""
        n, late, rests = self._count, self._late, self._rests
        self.stiffer = np.exp(self._s)
        self.delays = np.array([_between(rests[k, a], late[k, a]) for k, a in enumerate(self.arms)])
        self.offsets, self.slopes, self.misfit = np.zeros((n, 6)), np.zeros((n, 6)), np.zeros(n)
        self.doubts = np.zeros(n)
        for k, (a, (ee, ey, yy, fast)) in enumerate(zip(self.arms, self._sits, strict=True)):
            F = self._reads(k) @ self._maps[a]
            shape = np.vstack([F.T, fast[:, 6 * n :] - fast[:, : 6 * n] @ F.T])
            plain = self._found[int(late[k, a])][k][3]
            self.offsets[k], self.slopes[k] = plain[:, :6] - plain[:, 6:] @ shape
            heard = sum(self._weigh[k][p.start] * (F[p] @ ee @ F[p].T) for p in _PARTS)
            least = float(np.trace(heard) - np.linalg.norm(heard, 2))  # a turn does not show along its own axis
            self.doubts[k] = 1.0 / np.sqrt(max(least, 1e-12))
            rest = np.diag(yy - 2.0 * F @ ey + F @ ee @ F.T)[_FORCE].sum()
            samples = int(self._heard[:, k].sum())
            noise = 3.0 * samples * self.noise[k, 0] ** 2
            self.misfit[k] = max(rest - noise, 0.0) / max(np.trace(yy[_FORCE, _FORCE]), noise, 1e-12)


def proper(M: Array) -> Array:
    """The proper rotation R (3, 3) of the largest trace(Rᵀ M)."""
    U, _, Vt = np.linalg.svd(M)
    return U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt


def turn(way: Array) -> Array:
    """The rotation (3, 3) by a vector [rad]."""
    return np.asarray(pin.exp3(way))


def cheapest(costs: Array) -> NDArray[np.intp]:
    """The permutation p (N,) of the least sum of costs[k, p[k]], by the sets of arms that are taken."""
    n = len(costs)
    best: dict[int, tuple[float, tuple[int, ...]]] = {0: (0.0, ())}
    for row in costs:
        then: dict[int, tuple[float, tuple[int, ...]]] = {}
        for taken, (cost, order) in best.items():
            for a in range(n):
                both = taken | 1 << a
                if both != taken and (both not in then or cost + row[a] < then[both][0]):
                    then[both] = (cost + float(row[a]), (*order, a))
        best = then
    return np.array(best[(1 << n) - 1][1], dtype=np.intp)


def _between(rests: Array, i: int) -> float:
    """The delay at the lowest point of the parabola through the least rest and its neighbours [s]."""
    if not 0 < i < len(rests) - 1:
        return float(DELAYS[i])
    low, mid, high = rests[i - 1 : i + 2]
    bend = low - 2.0 * mid + high
    return float(DELAYS[i] + (DELAYS[1] - DELAYS[0]) * (0.5 * (low - high) / bend if bend > 0.0 else 0.0))
