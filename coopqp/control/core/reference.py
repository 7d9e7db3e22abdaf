"""The fused step in NumPy: the fallback where nothing is compiled, and the oracle of the compiled one.

A NumPy call on such small arrays costs 0.4 µs or more whatever it does, so the step is few calls. What is linear is
gathered into constant matrices, one for each of three products:

* ``e_k = log(R⁻¹ O_k)`` is linear in R⁻¹ O_k to rounding where the error is small, as it is step after step;
* where no correction is bounded, the twists ``c_k + b_k + σν + c_p`` and the errors foreseen for the next step are the
  rows of ν, c_p, e and the errors foreseen for this one, times a matrix (:meth:`NumpyKernel._set`);
* what is compared with limits, and what the next step starts from, are rows of v, v_prev, q and the braking distance
  v |v| / 2a, times a matrix. A command that stops inside its limits, from inside, is admissible; where that fails the
  box of :class:`VelocityBox` decides.
"""

from __future__ import annotations

import math
from typing import final

import numpy as np
import numpy.typing as npt

from coopqp.control.core.lines import LineFollower
from coopqp.control.core.systems import make_systems
from coopqp.control.core.workspace import Outcome, Workspace
from coopqp.control.limits import LIMIT_TOLERANCE, rate_interval
from coopqp.spatial import Array, cross, log6_batch

#: Below this the logarithm of an error is its linear part to rounding [m, rad].
_LINEAR = 1e-8
#: Below this it is that, and −½ ω×p, to rounding.
_QUADRATIC = 1e-5
#: Errors up to this make a path correction that nobody needs to know of [m, rad].
_NO_CORRECTION = 1e-7
#: In place of infinite limits: inf − inf would be NaN. Half of a range that is open at one end is _OPEN_RANGE.
_NO_LIMIT, _OPEN_RANGE = 1e100, 1e3
_SQRT3 = 1.7320508075688774


def _linear_log() -> Array:
    """Constant (12, 13): a placement's rows [Rᵀ; p] → [e, −e, −trace R], e = [p, vee(R − Rᵀ)/2].

    The largest of them is at most _LINEAR exactly where all errors are, and none is half a turn.
    """
    M = np.zeros((12, 13))
    M[9, 0] = M[10, 1] = M[11, 2] = 1.0
    # row i, column j of Rᵀ is entry 3 i + j and holds R[j, i]
    for axis, (i, j) in enumerate(((1, 2), (2, 0), (0, 1))):
        M[3 * i + j, 3 + axis] = 0.5  # R[j, i]
        M[3 * j + i, 3 + axis] = -0.5
    M[:, 6:12] = -M[:, :6]
    M[[0, 4, 8], 12] = -1.0
    return M


_LOG = _linear_log()


@final
class NumpyKernel:
    """See :class:`StepKernel`."""

    name = "numpy"
    follows_lines = True

    def __init__(self, workspace: Workspace) -> None:
        ws = self._ws = workspace
        n, nv = ws.n_arms, ws.nv
        self._settings: list[float] = []
        self._line = LineFollower(ws)
        # Buffers, and the views of them that a step needs: a view costs as much as a product.
        O, D = np.empty((n, 4, 3)), np.empty((n, 4, 3))
        self._O, self._O_rows, self._O_origin = O, O.reshape(4 * n, 3), O[:, 3]
        self._D, self._D_rows, self._D_flat = D, D.reshape(4 * n, 3), D.reshape(n, 12)
        self._placements = _equally_spaced(ws.placements, ws.tool_joints)
        self._linear = np.empty((n, 13))
        self._linear_flat, self._linear_errors = self._linear.reshape(-1), self._linear[:, :6]
        self._linear_p, self._linear_w, self._errors_p = self._linear[:, :3], self._linear[:, 3:6], ws.errors[:, :3]
        self._same_on_all_axes = bool((ws.shares == ws.shares[:, :1]).all())
        self._mix, self._mixed = np.zeros((2 * n, 2 + 2 * n)), np.empty((2 * n, 6))
        self._cap, self._path_mix = self._mix[:n, 0], np.zeros(n)
        self._twists, self._foreseen = self._mixed[:n], self._mixed[n:]
        self._unbound = 0.0
        self._to_world = ws.action.T
        self._W = np.empty((n, 6))
        self._systems = make_systems(ws, self._W)
        # Tests |motion ahead| ≤ room: velocity, its change, where the joint could stop and where it is.
        centre, half = _ranges(ws.low, ws.high)
        ws.motion[4] = centre
        self._ahead = np.zeros((6, 5))
        self._room, self._tests = np.full((4, nv), _NO_LIMIT), np.empty((4, nv))
        self._room[0], self._room[2:] = np.minimum(ws.speed, _NO_LIMIT), half
        self._tested, self._tests_flat, self._moved = ws.ahead[:4], self._tests.reshape(-1), ws.ahead[4]
        self._brake = ws.motion[3]
        self._wanted = np.empty(nv)
        # World twists of every arm in the QP's unknowns, and of its command: the first six are the object's directions.
        self._directions = np.zeros((n, 6, 10))
        self._six_directions = np.einsum("kii->ki", self._directions[:, :, :6])
        # A tiny number in place of 1 / inf: 0 times an infinite velocity would be NaN.
        self._per_acceleration = np.maximum(ws.per_acceleration, 1e-200)

    def step(self, cap: float, clock: float, span: float) -> int:
        """Errors, corrections, nominal command, limits and, on a miss, the ray."""
        ws = self._ws
        s = ws.scalars.tolist()  # Python's numbers: NumPy's cost more to work with
        if s != self._settings:
            self._set(s)
        if s[ws.ON_LINE] != 0.0 and not self._line.follow(clock, span):
            return Outcome.OPEN
        largest = self._errors()
        if not largest < math.inf:
            return Outcome.OPEN
        self._corrections(s, cap, largest)
        np.dot(self._twists, self._to_world, out=self._W)
        velocity = ws.velocity
        if not self._systems.solve(cap):
            return Outcome.OPEN
        if ws.wants_along:
            self._along()
        worst = self._look_ahead()
        outcome, result = Outcome.NOMINAL, ws.result
        if worst <= 0.0:
            result[0], result[1], result[2] = cap, -1.0, 0.0
        elif worst < math.inf:
            outcome = self._at_limits(cap, s[ws.DT])
            if outcome == Outcome.OPEN:
                return outcome
            self._look_ahead()
        else:
            return Outcome.OPEN
        ws.predicted[:] = self._foreseen
        ws.v_prev[:] = velocity
        ws.positions[:] = self._moved
        if s[ws.HAS_PREDICTED] == 0.0 or s[ws.LAST_DT] != s[ws.DT]:
            ws.scalars[ws.HAS_PREDICTED], ws.scalars[ws.LAST_DT] = 1.0, s[ws.DT]
        return outcome

    def observe(self, clock: float) -> bool:
        """As the protocol says."""
        ws = self._ws
        if ws.scalars[ws.ON_LINE] and not self._line.follow(clock, 0.0):
            return False
        if not self._errors() < math.inf:
            return False
        np.einsum("ij,ij->j", ws.shares, ws.errors, out=ws.common)
        return True

    def rows(self, cap: float, clock: float, span: float) -> int:
        """The condensed QP of a step that :meth:`step` left open."""
        ws, chain, box = self._ws, self._ws.chain, self._ws.box
        s = ws.scalars.tolist()
        if s != self._settings:
            self._set(s)
        if s[ws.ON_LINE] != 0.0 and not self._line.follow(clock, span):
            return -1
        given = (ws.positions, ws.v_prev, ws.jacobian_T.reshape(-1))
        if not (self._errors() < math.inf and all(np.dot(x, x) < math.inf for x in given)):
            return -1
        self._corrections(s, cap, math.nan)  # each of them by itself
        box.update(ws.positions, ws.v_prev, s[ws.DT])
        chain.invert()
        if chain.singular:
            return -1
        unit, twists, qp = ws.unit, self._directions, ws.qp
        late, grasp_lost, path_lost = unit[6:9].tolist()
        self._six_directions[:] = unit[:6]
        np.multiply(ws.along, -late, out=twists[:, :, 6])
        np.multiply(ws.grasp, -grasp_lost, out=twists[:, :, 7])
        np.multiply(ws.path, -path_lost, out=twists[:, :, 8])
        np.add(ws.grasp + ws.offsets, ws.path + cap * ws.along, out=twists[:, :, 9])
        columns = chain.joint_columns(ws.action @ twists)
        qp.columns[:, :9], qp.base[:] = columns[:, :9], columns[:, 9]
        if chain.redundancy:
            qp.columns[:, 6] -= late * chain.null_part(ws.null_along)
            qp.base += chain.null_part(cap * ws.null_along + ws.null_offset)
            np.multiply(chain.null_basis(), unit[9:], out=qp.columns[:, 9:])
        qp.set_rows(box.lower, box.upper)
        if not np.dot(qp.base, qp.base) + np.dot(qp.norms, qp.norms) < math.inf:
            return -1
        if not box.any_outside:
            return 0
        outside = np.flatnonzero(box.outside)
        ws.outside[: outside.size], ws.recovery[:] = outside, box.recovery
        return outside.size

    def _set(self, s: list[float]) -> None:
        """The matrices that depend on the step's length, the gains, and on what there is."""
        ws, n = self._ws, self._ws.n_arms
        h, grasp, path = s[ws.DT], s[ws.GRASP_GAIN], s[ws.PATH_GAIN]
        per_dt = 0.0
        if s[ws.HAS_PREDICTED] != 0.0:
            per_dt = 1.0 / s[ws.LAST_DT] if s[ws.LAST_DT] != 0.0 else math.nan
        # c_k + b_k + c_p = −K_g (e_k − ē) + (foreseen_k − e_k) / dt − K_p ē, the last from c_p where it is measured
        errors = np.zeros((n, n))
        errors += (grasp if s[ws.HAS_MEASURED] != 0.0 else grasp - path) * ws.shares[:, 0]
        one = np.eye(n)
        errors -= (grasp + per_dt) * one
        M, mine, foreseen = self._mix, slice(2, 2 + n), slice(2 + n, 2 + 2 * n)
        self._path_mix = -path * ws.shares[:, 0]
        M[:n, 1], M[:n, mine], M[:n, foreseen] = 1.0, errors, per_dt * one
        M[n:, 1], M[n:, mine], M[n:, foreseen] = h, one + h * errors, h * per_dt * one
        # With every error at most x, |e_k − ē| ≤ 2 x in every axis.
        gain = _SQRT3 * max(2.0 * grasp, path)
        self._unbound = min(s[ws.SPEED], s[ws.SPIN]) / gain if gain > 0.0 else math.inf
        #                v    v_prev    q   brake  centre
        self._ahead[:] = (
            (1.0, 0.0, 0.0, 0.0, 0.0),
            (1.0, -1.0, 0.0, 0.0, 0.0),
            (h, 0.0, 1.0, 1.0, -1.0),
            (0.0, 0.0, 1.0, 0.0, -1.0),
            (h, 0.0, 1.0, 0.0, 0.0),
            (2.0 * h, -0.5 * h, 1.0, 0.0, 0.0),
        )
        self._room[1] = np.minimum(ws.acceleration * h, _NO_LIMIT)
        self._settings = s

    def _errors(self) -> float:
        """``e_k = log(R⁻¹ O_k)`` of every arm; returns the largest entry, NaN if there is one."""
        ws = self._ws
        M = self._placements
        np.matmul(ws.Y_transposed, ws.placements[ws.tool_joints] if M is None else M, out=self._O)
        np.subtract(self._O_origin, ws.p, out=self._O_origin)
        np.dot(self._O_rows, ws.R, out=self._D_rows)  # two dimensions: several times cheaper than a batch
        np.dot(self._D_flat, _LOG, out=self._linear)
        flat = self._linear_flat
        largest = flat.item(flat.argmax())
        if largest <= _LINEAR:
            ws.errors[:] = self._linear_errors
        elif largest <= _QUADRATIC:
            ws.errors[:] = self._linear_errors
            np.subtract(self._linear_p, 0.5 * cross(self._linear_w, self._linear_p), out=self._errors_p)
        elif largest < math.inf:
            D = self._D
            ws.errors[:] = log6_batch(D[:, :3].transpose(0, 2, 1), D[:, 3])
            largest = float(np.abs(ws.errors).max())
        return largest

    def _corrections(self, s: list[float], cap: float, largest: float) -> None:
        """Twists in the reference object frame, and the errors foreseen for the next step."""
        ws = self._ws
        if s[ws.HAS_MEASURED] != 0.0:
            np.multiply(ws.measured, -s[ws.PATH_GAIN], out=ws.path)
            bound(ws.path[None, :], s[ws.SPEED], s[ws.SPIN])
            ws.result[3] = np.dot(ws.path, ws.path)
        else:
            ws.path[:] = ws.result[3] = 0.0
        if largest <= self._unbound and self._same_on_all_axes:
            self._cap[:] = cap
            np.dot(self._mix, ws.twists, out=self._mixed)
            if largest > _NO_CORRECTION and s[ws.HAS_MEASURED] == 0.0:
                np.dot(self._path_mix, ws.errors, out=ws.path)  # already in the twists, by their matrix
                ws.result[3] = np.dot(ws.path, ws.path)
            return
        e = ws.errors
        common = (ws.shares * e).sum(axis=0)
        np.multiply(e - common, -s[ws.GRASP_GAIN], out=ws.grasp)
        bound(ws.grasp, s[ws.SPEED], s[ws.SPIN])
        if s[ws.HAS_MEASURED] == 0.0:
            np.multiply(common, -s[ws.PATH_GAIN], out=ws.path)
            bound(ws.path[None, :], s[ws.SPEED], s[ws.SPIN])
            ws.result[3] = np.dot(ws.path, ws.path)
        if s[ws.HAS_PREDICTED] != 0.0:
            np.divide(ws.predicted - e, s[ws.LAST_DT], out=ws.offsets)
        else:
            ws.offsets[:] = 0.0
        drift = ws.grasp + ws.offsets + ws.path
        np.add(drift, cap * ws.along, out=self._twists)
        np.add(e, s[ws.DT] * drift, out=self._foreseen)

    def _look_ahead(self) -> float:
        """What the next step starts from; returns the largest excess over a limit, NaN if there is one."""
        ws = self._ws
        if ws.box.accelerates:
            brake = np.abs(ws.velocity, out=self._brake)
            np.multiply(brake, self._per_acceleration, out=brake)
            np.multiply(brake, ws.velocity, out=brake)
        np.dot(self._ahead, ws.motion, out=ws.ahead)
        np.abs(self._tested, out=self._tests)
        np.subtract(self._tests, self._room, out=self._tests)
        flat = self._tests_flat
        worst: float = flat.item(flat.argmax())  # several times cheaper than max()
        return worst

    def _along(self) -> Array:
        """Joint velocities per unit of rate."""
        ws = self._ws
        self._systems.along(np.dot(ws.action, ws.along))
        return ws.along_velocity

    def _at_limits(self, cap: float, h: float) -> Outcome:
        """The nominal command if the box admits it, or the fastest admissible rate with full corrections."""
        ws, box, v = self._ws, self._ws.box, self._ws.velocity
        box.update(ws.positions, ws.v_prev, h)
        if box.any_outside:
            return Outcome.OPEN
        wanted = self._wanted
        wanted[:] = v
        if self._cut_off(wanted, v) <= LIMIT_TOLERANCE:
            ws.result[:3] = cap, -1.0, 0.0
            return Outcome.NOMINAL
        if not self._systems.well_conditioned():
            return Outcome.OPEN
        along = self._along()
        base = wanted - cap * along
        found = rate_interval(base, along, box.lower, box.upper)
        if found is None:
            return Outcome.OPEN
        low, high, j = found
        if not (high >= max(low, 0.0) and low <= 1.0):
            return Outcome.OPEN
        if high < cap:
            rate, side = high, (1.0 if along[j] > 0.0 else -1.0)
        else:
            rate, j, side = max(cap, low), -1, 0.0
        np.multiply(along, rate, out=wanted)
        wanted += base
        if not self._cut_off(wanted, v) <= 2.0 * LIMIT_TOLERANCE:
            return Outcome.OPEN
        ws.result[:3] = rate, j, side
        return Outcome.RAY

    def _cut_off(self, wanted: Array, out: Array) -> float:
        """Bring velocities into the box; returns the largest change, NaN if there is one."""
        box = self._ws.box
        np.maximum(wanted, box.lower, out=out)
        np.minimum(out, box.upper, out=out)
        change = np.abs(wanted - out)
        return float(change[change.argmax()])


def _equally_spaced(placements: Array, joints: npt.NDArray[np.int64]) -> Array | None:
    """A live view of every arm's joint; None where their distances differ."""
    gaps = np.diff(joints)
    if not len(gaps):
        return placements[joints[0] : joints[0] + 1]
    if gaps[0] <= 0 or (gaps != gaps[0]).any():
        return None
    return placements[joints[0] : joints[-1] + 1 : gaps[0]]


def _ranges(low: Array, high: Array) -> tuple[Array, Array]:
    """Centre and half width; a range that is open at one end is cut there, for the box to decide beyond."""
    bounded = np.isfinite(low) & np.isfinite(high)
    half = np.where(bounded, 0.5 * (high - low), np.where(np.isfinite(low) | np.isfinite(high), _OPEN_RANGE, _NO_LIMIT))
    centre = np.where(np.isfinite(low), low + half, np.where(np.isfinite(high), high - half, 0.0))
    return centre, half


def bound(corrections: Array, speed: float, spin: float) -> None:
    """Shrink corrections (n, 6) in place, by one common factor, to ``speed`` [m/s] and ``spin`` [rad/s]."""
    flat = np.abs(corrections).ravel()
    if flat[flat.argmax()] * _SQRT3 <= min(speed, spin):
        return
    linear = np.einsum("ij,ij->i", corrections[:, :3], corrections[:, :3])
    angular = np.einsum("ij,ij->i", corrections[:, 3:], corrections[:, 3:])
    # Roots first: the square of a tiny bound would be 0.
    excess = max(math.sqrt(linear[linear.argmax()]) / speed, math.sqrt(angular[angular.argmax()]) / spin)
    if excess > 1.0:
        corrections /= excess
