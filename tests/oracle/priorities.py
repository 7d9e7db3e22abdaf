"""The levels of a step as one QP in full form, and the order of the attempts: docs/derivations.md, "Substitution".

The unknowns are all joint velocities, the object's velocity off its path, and what is given up; the closed chain is a
set of equalities. Nothing is eliminated, and a solver of qpsolvers finds the answer.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin
import qpsolvers
from bounds import STEP, Bounds, Rows
from closed_chain import Array, ClosedChain

#: Costs of giving something up, per unit squared.
CHAIN, RECOVERY, CLEARANCE, OFF_PATH, GRASP, PATH, RATE, POSTURE = 1e8, 1e6, 1e6, 1e4, 1.0, 1e-2, 1e-4, 1e-6
#: Weighs rotation against translation [m].
LENGTH = 0.3
#: Velocities within this of a bound are admissible [rad/s or m/s].
TOLERANCE = 1e-9


@dataclass
class Wanted:
    """What a step wants, as twists of the object in the axes of R; see docs/notation.md for the symbols.

    Attributes:
        A: of all arms (N, 6, nv).
        along, path: ν (N, 6) and c_p (6,).
        grasp, offsets: c_k and b_k (N, 6).
        cap: largest σ.
        null_along, null_offset: wanted motion in the null-space (nv,), per unit of σ and constant.
        basis: twists off the path that all arms can follow (6, d).
        ranges: of arms with fewer than six joints, see :meth:`ClosedChain.followed`.
    """

    A: Array
    along: Array
    path: Array
    grasp: Array
    offsets: Array
    cap: float
    null_along: Array
    null_offset: Array
    basis: Array = field(default_factory=lambda: np.eye(6))
    ranges: list[tuple[int, Array]] = field(default_factory=list)


@dataclass
class Answer:
    """Joint velocities (nv,), σ, the shares ρ_g and ρ_p, s (6,), whether the chain parts, whether all brake, whether
    self-motion costs more than its posture."""

    v: Array
    rate: float
    grasp: float = 1.0
    path: float = 1.0
    off_path: Array = field(default_factory=lambda: np.zeros(6))
    parts: bool = False
    braked: bool = False
    bent: bool = False


def answer(
    chain: ClosedChain, q: Array, J: Array, R: pin.SE3, want: Wanted, box: Bounds, rows: Rows, v: Array, a: Array,
    h: float, *, shortcut: bool = True, fails: bool = False,
) -> Answer:  # fmt: skip
    """The first attempt with an answer: nominal command, rate line search, QP, QP whose chain parts, brake.

    Args:
        chain, q, J, R: kinematics, a configuration (nq,), its Jacobians about the origin of the reference pose in world
            axes (N, 6, nv), and that pose.
        want, box, rows: the wanted motion, velocity bounds and further rows.
        v, a, h: the last velocities (nv,), acceleration limits (nv,), length of the step [s].
        shortcut: make the first two attempts.
        fails: no solver has an answer.
    """
    world = np.kron(np.eye(2), R.rotation)

    def joints(twists: Array) -> Array:
        return chain.least_motion(J, (np.broadcast_to(twists, (chain.n, 6)) @ world.T)[:, :, None])[:, 0]

    fixed = joints(want.offsets + want.grasp + want.path) + want.null_offset
    along = joints(want.along) + want.null_along
    if shortcut and not box.outside.any():
        found = on_path(fixed, along, want.cap, box, rows)
        if found is not None:
            return found
    for giving in () if fails else ((), ("rows",), ("rows", "chain")):
        if giving == ("rows",) and not len(rows.G):
            continue
        found = program(chain, q, J, R, want, box, rows, giving, h)
        if found is not None:
            return found
    return brake(chain, J, world, want, box, rows, v, a, h)


def on_path(fixed: Array, along: Array, cap: float, box: Bounds, rows: Rows) -> Answer | None:
    """Full corrections at the largest admissible σ, each joint and row leaves an interval of it."""
    base, slope = np.concatenate([fixed, rows.G @ fixed]), np.concatenate([along, rows.G @ along])
    lower = np.concatenate([box.lower, np.full(len(rows.G), -np.inf)])
    upper = np.concatenate([box.upper, rows.upper])
    if ((base + cap * slope <= upper + TOLERANCE) & (base + cap * slope >= lower - TOLERANCE)).all():
        rate = cap
    else:
        still = np.abs(slope) < 1e-12
        if (still & ((base > upper + TOLERANCE) | (base < lower - TOLERANCE))).any():
            return None
        ends = np.sort([(bound - base)[~still] / slope[~still] for bound in (lower, upper)], axis=0)
        low, high = float(ends[0].max()), float(ends[1].min())
        if low > high or high < 0.0 or low > 1.0:
            return None
        rate = high if high < cap else max(cap, low)
    return Answer(np.clip(fixed + rate * along, box.lower, box.upper), min(max(rate, 0.0), 1.0))


def program(
    chain: ClosedChain, q: Array, J: Array, R: pin.SE3, want: Wanted, box: Bounds, rows: Rows, giving: tuple[str, ...],
    h: float,
) -> Answer | None:  # fmt: skip
    """The QP. Unknowns, each but v in units of the root of its cost: v, s, what is given up of σ, ρ_g and ρ_p, the
    null-space motion beside the wanted one, velocities by which joints outside are not led back; and with ``giving``
    what rows and the chain give way by.
    """
    nv, N = chain.nv, chain.n
    metric = np.array([1.0] * 3 + [LENGTH] * 3)
    Q, _ = np.linalg.qr(want.basis * metric[:, None])
    S = Q / (np.sqrt(OFF_PATH) * metric[:, None])
    units = 1.0 / np.sqrt([RATE, GRASP, PATH])
    out = np.flatnonzero(box.outside)
    basis = chain.null_space(J)
    dual = (basis / chain.units[:, None] ** 2).T
    sizes = [nv, S.shape[1], 3, len(dual), len(out), len(rows.G) * ("rows" in giving), 6 * N * ("chain" in giving)]
    ends = np.cumsum(sizes)
    s, up, null, back, soft, part = (slice(ends[i], ends[i + 1]) for i in range(6))
    n = int(ends[-1])
    # A_k v − s + (1 − σ/cap …) = σ ν + ρ_g c_k + ρ_p c_p + b_k, with σ = cap − its share and ρ = 1 − theirs
    E, e = np.zeros((N, 6, n)), want.offsets + want.cap * want.along + want.grasp + want.path
    E[:, :, :nv], E[:, :, s] = want.A, -S
    E[:, :, up] = np.stack(np.broadcast_arrays(want.along, want.grasp, want.path), axis=-1) * units
    if "chain" in giving:
        E[:, :, part] = np.kron(np.eye(N), np.diag(1.0 / (np.sqrt(CHAIN) * metric))).reshape(N, 6, 6 * N)
    for k, P in want.ranges:
        E[k], e[k] = P @ E[k], P @ e[k]
    B = np.zeros((len(out), n))
    B[range(len(out)), out] = 1.0
    B[:, back] = -np.eye(len(out)) / np.sqrt(RECOVERY)
    Z, posture = np.zeros((len(dual), n)), max(POSTURE, 1e-10 * CHAIN) if "chain" in giving else POSTURE
    dual *= np.sqrt(posture)
    Z[:, :nv], Z[:, up.start], Z[:, null] = dual, dual @ want.null_along * units[0], -np.eye(len(dual))
    H = np.diag(np.repeat([0.0, 1.0], [nv, n - nv]))
    C = np.zeros((len(rows.G), n))
    C[:, :nv] = rows.G
    if "rows" in giving:
        C[:, soft] = -np.diag(rows.soft) / np.sqrt(CLEARANCE)
    lb, ub = np.full(n, -np.inf), np.full(n, np.inf)
    lb[:nv], ub[:nv], lb[up], ub[up] = box.lower, box.upper, 0.0, np.array([want.cap, 1.0, 1.0]) / units
    equal = np.vstack([E.reshape(6 * N, n), B, Z])
    value = np.concatenate([e.ravel(), box.back[out], dual @ (want.null_offset + want.cap * want.null_along)])
    found, pull = _solve(H, C, rows.upper, equal, value, lb, ub)
    bent = False
    if found is not None and len(dual) and "chain" not in giving:
        pull[out] += np.sqrt(RECOVERY) * found[back]  # a joint that is led back pulls with what it lacks
        more = bending(chain, q, J, R, basis / np.sqrt(posture), found[null], pull[:nv], h)
        bent = bool(more.any())
        if bent:
            H[null, null] += more
            found, _ = _solve(H, C, rows.upper, equal, value, lb, ub)
    if found is None or (np.maximum(found[:nv] - box.upper, box.lower - found[:nv]) > 1e-5).any():
        return None
    v, (late, grasp, path) = np.clip(found[:nv], box.lower, box.upper), found[up] * units
    rate = min(max(want.cap - late, 0.0), want.cap)
    return Answer(v, rate, 1.0 - grasp, 1.0 - path, S @ found[s], parts="chain" in giving, bent=bent)


def bending(
    chain: ClosedChain, q: Array, J: Array, R: pin.SE3, per: Array, z: Array, pull: Array, h: float
) -> Array:  # fmt: skip
    """By how much more the Hessian of z must be (r, r), so that no limit shakes the self-motion to and fro.

    The Lagrangian's second derivative along w = N z: past the time T the joints have bent by b = −A⁺ Ȧ(w) w, and
    multipliers λ of the velocities are worth λᵀ b. All self-motions of arms that move together cost as much.

    Args:
        chain, q, J, R: see :func:`answer`.
        per: N, joint velocities for units of z (nv, r), part by part.
        z: self-motion that the QP has found (r,).
        pull: λ (nv,), positive at upper bounds.
        h: length of the step [s].
    """
    w, more, at = per @ z, np.zeros((len(z), len(z))), 0
    before, after = (np.array(chain.jacobians(chain.moved(q, way * w), R.translation)) for way in (-STEP, STEP))
    bend = -chain.least_motion(J, ((after - before) @ w / (2.0 * STEP))[:, :, None])[:, 0]
    for part in chain.parts:
        joints = chain.joints(part)
        own = slice(at, at := at + len(joints) - 6 * len(part))
        size = float(z[own] @ z[own])
        cost = max(0.05, 5.0 * h) * float(pull[joints] @ bend[joints]) / size if size > 0.0 else 0.0
        if cost > 1.0:
            more[own, own] = (cost - 1.0) * np.eye(own.stop - own.start)
    return more


def _solve(H: Array, C: Array, u: Array, E: Array, e: Array, lb: Array, ub: Array) -> tuple[Array | None, Array]:
    """x of least ½ xᵀ H x, or None without one: the equalities' null-space is searched, in which the QP is convex.

    With the multipliers of the bounds of x, positive at upper ones.
    """
    U, s, Vt = np.linalg.svd(E)
    rank = int((s > 1e-10 * s[0]).sum())
    x0, Z = Vt[:rank].T @ ((U[:, :rank].T @ e) / s[:rank]), Vt[rank:].T
    none = np.zeros(len(x0))
    if np.abs(E @ x0 - e).max() > 1e-8:
        return None, none
    one = np.eye(len(x0))
    G, d = np.vstack([C, one, -one]), np.concatenate([u, ub, -lb])
    some = np.isfinite(d)
    problem = qpsolvers.Problem(Z.T @ H @ Z, Z.T @ H @ x0, (G @ Z)[some], (d - G @ x0)[some])
    solution = qpsolvers.solve_problem(problem, solver="daqp", primal_tol=1e-10, dual_tol=1e-13)
    if not solution.found or not np.isfinite(solution.x).all():
        return None, none
    y = np.zeros(len(d))
    y[some] = solution.z
    upper, lower = y[len(C) :].reshape(2, -1)
    return x0 + Z @ solution.x, upper - lower


def brake(
    chain: ClosedChain, J: Array, world: Array, want: Wanted, box: Bounds, rows: Rows, v: Array, a: Array, h: float
) -> Answer:  # fmt: skip
    """Without a solver all arms brake together: along the path, else along their present motion, else all alike."""
    metric = np.array([1.0] * 3 + [LENGTH**2] * 3)
    present, along = (want.A @ v).mean(axis=0), want.along.mean(axis=0)
    length = float(along @ (metric * along))
    rate = max(float(along @ (metric * present)) / length, 0.0) if length > 0.0 else 0.0

    def joints(twists: Array) -> Array:
        return chain.least_motion(J, (np.broadcast_to(twists, (chain.n, 6)) @ world.T)[:, :, None])[:, 0]

    null = v - joints(want.A @ v)
    for motion in (joints(rate * want.along) + null, joints(present) + null):
        for base in (joints(want.offsets + want.grasp), joints(want.offsets)):
            shares = _shares(base, motion, box)
            if shares is None or shares[1] < max(shares[0], 0.0):
                continue
            share = max(shares[0], 0.0)
            if (rows.G @ (base + share * motion) <= rows.upper + TOLERANCE).all():
                v_next = np.clip(base + share * motion, box.lower, box.upper)
                return Answer(v_next, min(share * rate, 1.0), 0.0, 0.0, braked=True)
    moving = np.abs(v) > 1e-12
    tightest = float((a[moving] * h / np.abs(v[moving])).min()) if moving.any() else np.inf
    v_next = np.clip(v * (1.0 - min(tightest, 1.0)) if moving.any() else 0.0 * v, box.lower, box.upper)
    return Answer(v_next, 0.0, 0.0, 0.0, braked=True)


def _shares(base: Array, motion: Array, box: Bounds) -> tuple[float, float] | None:
    """Least and largest share of a motion that keeps the bounds."""
    still = np.abs(motion) < 1e-12
    if (still & ((base > box.upper + TOLERANCE) | (base < box.lower - TOLERANCE))).any():
        return None
    if still.all():
        return -np.inf, np.inf
    ends = np.sort([(bound - base)[~still] / motion[~still] for bound in (box.lower, box.upper)], axis=0)
    return float(ends[0].max()), float(ends[1].min())
