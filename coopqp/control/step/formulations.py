"""The QP of one step: from the wanted motion (terms) and the velocity bounds (box) to matrices, and back.

With the arms' kinematics inverted, every admissible command of a perfect chain is

    v = A⁻¹(σ ν + s) + ρ_g A⁻¹ c_k + ρ_p A⁻¹ c_p + v_0 (+ N z for redundant arms)

so the unknowns are the off-path twist s (6), the path rate σ, the shares ρ_g and ρ_p of the grasp and path
corrections and z: nine plus the redundancy, whatever the number of arms, with a row per joint. That is the
**condensed form**. Where the limits leave no answer, each arm may part from the others by a twist of its own, at a
price above all else. The **full form** keeps the joint velocities as unknowns and the chain as equalities; it is the
reference that the condensed form is tested against.

Variables are scaled so that the condensed Hessian is the identity: a least-distance problem. The core's counterpart is
``program.cpp``.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

import numpy as np

from coopqp.checks import Doc, documented, keep_scalars
from coopqp.constraints.velocity import Rows, no_rows
from coopqp.control.step.self_motion import shrunk_units
from coopqp.control.step.velocity_bounds import VelocityBox
from coopqp.model.chain import Chain
from coopqp.native.constants import CALM, SINGULAR_FLOOR
from coopqp.solvers.problem import QpProblem, QpSolution
from coopqp.spatial import Array, for_twists


@documented
@dataclass(frozen=True, kw_only=True)
class RankWeights:
    """Costs of giving something up, per unit squared; ratios of at least 100 keep the ranks apart."""

    chain: Annotated[float, Doc("cost of the speed at which the arms part [1/(m/s)²]")] = 1e8
    off_path: Annotated[float, Doc("cost of object velocity off the path [1/(m/s)²]")] = 1e4
    recovery: Annotated[float, Doc("cost of a joint outside its limits that is not led back [1/(rad/s)²]")] = 1e6
    clearance: Annotated[
        float, Doc("cost of a row that gives way before the arms part, per unit of the row squared")
    ] = 1e6
    grasp: Annotated[float, Doc("cost of giving up all of the grasp correction")] = 1.0
    path: Annotated[float, Doc("cost of giving up all of the path correction")] = 1e-2
    rate: Annotated[float, Doc("cost of standing still (σ = 0)")] = 1e-4
    posture: Annotated[
        float, Doc("cost of null-space motion other than the wanted one, in units of the joints' speeds")
    ] = 1e-6
    length: Annotated[float, Doc("characteristic length that weighs rotation against translation [m]")] = 0.3

    def __post_init__(self) -> None:
        keep_scalars(self, *self.__dataclass_fields__, low=1e-20, high=1e20)


@dataclass(eq=False)
class StepTerms:
    """Wanted motion of one step; twists of the object in the reference object frame.

    Attributes:
        rotation: R of the reference pose (3, 3).
        along: ν, twist of the object along its path at full rate (6,); of each arm (N, 6) where tools move on it.
        path_correction: c_p (6,).
        grasp_corrections: c_k (N, 6).
        offsets: b_k, defects of the linearisation (N, 6).
        rate_cap: largest admissible σ, in [0, 1].
        null_along, null_offset: null-space reference of the joint velocities (nv,): per unit of σ, and the constant
            part; None without redundant arms.
        admissible: basis Z (6, d) of the twists that every arm can follow, None if all can follow all.
        ranges: index of each arm with fewer than six joints, and the projector (6, 6) on the twists that it can follow.
    """

    rotation: Array
    along: Array
    path_correction: Array
    grasp_corrections: Array
    offsets: Array
    rate_cap: float = 1.0
    null_along: Array | None = None
    null_offset: Array | None = None
    admissible: Array | None = None
    ranges: list[tuple[int, Array]] = field(default_factory=list)

    @property
    def to_world(self) -> Array:
        """Ad(R) (6, 6)."""
        return for_twists(self.rotation)


@dataclass(eq=False)
class Pieces:
    """Joint velocities that each unknown contributes, all (nv,): v = fixed + σ along + ρ_g grasp + ρ_p path."""

    fixed: Array
    along: Array
    grasp: Array
    path: Array

    def command(self, rate: float) -> Array:
        """Velocities with full corrections at a rate."""
        return self.fixed + self.grasp + self.path + rate * self.along


@dataclass(frozen=True, eq=False)
class Answer:
    """A solved step: joint velocities, path speed, and the slack of each priority (see :class:`GivenUp`)."""

    velocity: Array
    rate: float
    grasp_share: float = 1.0
    path_share: float = 1.0
    off_path: Array = field(default_factory=lambda: np.zeros(6))
    chain: float = 0.0


class StepProgram:
    """Builds and reads the QPs of one chain. Nothing is carried from step to step.

    Attributes:
        metric: diagonal W (6,) that makes linear and angular parts of a twist comparable.
        units: of the unknowns of a condensed QP without deficient arms, (9 + redundancy,).
        recovery_scale, relax_scale: units of the unknowns of joints that are led back, of rows that may give way.
    """

    def __init__(self, chain: Chain, weights: RankWeights) -> None:
        self.chain, self.weights = chain, weights
        w = weights
        self.metric = np.array([1.0] * 3 + [w.length**2] * 3)
        self._twist_scale = 1.0 / np.sqrt(w.off_path * self.metric)
        self._share_scale = 1.0 / np.sqrt([w.rate, w.grasp, w.path])
        self._posture_scale = 1.0 / float(np.sqrt(w.posture))
        # Twists by which an arm parts from the others; self-motion beside them costs no less than this share of them.
        self._part_scale = 1.0 / np.sqrt(w.chain * self.metric)
        self._calm_scale = 1.0 / float(np.sqrt(max(w.posture, CALM * w.chain)))
        self.recovery_scale = 1.0 / float(np.sqrt(w.recovery))
        self.relax_scale = 1.0 / float(np.sqrt(w.clearance))
        self.units = np.concatenate(
            [self._twist_scale, self._share_scale, np.full(chain.redundancy, self._posture_scale)]
        )

    def pieces(self, terms: StepTerms) -> Pieces:
        """Split the command into the contributions of the unknowns."""
        parts = np.broadcast_arrays(terms.along, terms.path_correction, terms.grasp_corrections, terms.offsets)
        along, path, grasp, fixed = self.chain.joint_columns(terms.to_world @ np.stack(parts, axis=-1)).T
        if terms.null_along is not None:
            along = along + terms.null_along
        if terms.null_offset is not None:
            fixed = fixed + terms.null_offset
        return Pieces(fixed, along, grasp, path)

    def _twist_basis(self, terms: StepTerms) -> Array:
        """Scaled basis of s in the reference frame, (6, d)."""
        if terms.admissible is None:
            return np.diag(self._twist_scale)
        # s = Z y with ‖s‖_W = ‖y‖ after orthonormalisation in the metric W
        Q, _ = np.linalg.qr(terms.admissible / self._twist_scale[:, None])
        basis: Array = self._twist_scale[:, None] * Q
        return basis

    # -- condensed -----------------------------------------------------------------------------------------------

    def condensed(
        self,
        terms: StepTerms,
        pieces: Pieces,
        box: VelocityBox,
        further: Rows | None = None,
        *,
        relax: bool = False,
        parts: bool = False,
        units: Array | None = None,
    ) -> tuple[QpProblem, Array, Array]:
        """The condensed form. Returns the problem and (base, B) with v = base + B x.

        x = [y (d), (cap − σ), (1 − ρ_g), (1 − ρ_p), z, t, r], each divided by its scale; r of the joints outside and,
        with ``relax``, of the further rows that may give way. With ``parts`` the chain may part by t (6N), the twists
        by which the arms leave the common motion. ``units`` are those of :meth:`units_condensed`.
        """
        S, further = self._twist_basis(terms), _or_none(further, self.chain.nv)
        shares = np.column_stack([pieces.along, pieces.grasp, pieces.path]) * self._share_scale
        slack = self.chain.joint_columns(terms.to_world @ S)
        base = pieces.command(terms.rate_cap)
        null = (self._calm_scale if parts else self._posture_scale) * self.chain.null_basis()
        B = np.hstack([slack, -shares, null if units is None else null * units])
        if parts:
            N = self.chain.n_arms
            own = np.zeros((N, 6, N, 6))
            own[range(N), :, range(N)] = terms.to_world * self._part_scale
            B = np.hstack([B, self.chain.joint_columns(own.reshape(N, 6, 6 * N))])
        base_rows, B_rows = np.concatenate([base, further.G @ base]), np.vstack([B, further.G @ B])
        problem = self.least_distance(
            base_rows, B_rows, box, further, rate_cap=terms.rate_cap, shares_at=S.shape[1], relax=relax
        )
        return problem, base, B

    def least_distance(
        self,
        base: Array,
        B: Array,
        box: VelocityBox,
        further: Rows,
        *,
        rate_cap: float,
        shares_at: int = 6,
        relax: bool = False,
    ) -> QpProblem:
        """The condensed QP: the least x whose rows ``base + B x`` keep the velocity bounds and the further rows.

        Rows have unit norm. ``v_j − recovery_j`` of a joint that is led back is an unknown of its own: squared into the
        cost it would square the conditioning. ``shares_at`` is the index of the unknown (cap − σ).
        """
        rows, own = B.shape
        outside, giving = np.flatnonzero(box.outside), np.flatnonzero(further.soft) if relax else np.arange(0)
        led_back = own + np.arange(outside.size)
        n = own + outside.size + giving.size
        C, A = np.zeros((rows, n)), np.zeros((outside.size, n))
        C[:, :own], A[:, :own] = B, B[outside]
        C[self.chain.nv + giving, n - giving.size + np.arange(giving.size)] = -self.relax_scale * further.soft[giving]
        A[np.arange(outside.size), led_back] = -self.recovery_scale
        norms = _row_norms(C)
        lower, upper = np.concatenate([box.lower, further.lower]), np.concatenate([box.upper, further.upper])
        lb, ub = np.full(n, -np.inf), np.full(n, np.inf)
        lb[shares_at : shares_at + 3] = 0.0
        ub[shares_at : shares_at + 3] = np.array([rate_cap, 1.0, 1.0]) / self._share_scale
        return QpProblem(
            H=np.eye(n),
            g=np.zeros(n),
            A=A / norms[outside, None],
            b=(box.recovery[outside] - base[outside]) / norms[outside],
            C=C / norms[:, None],
            l=(lower - base) / norms,
            u=(upper - base) / norms,
            lb=lb,
            ub=ub,
        )

    def with_velocities(self, problem: QpProblem, parting: Array) -> QpProblem:
        """The condensed form whose chain may part, with the joints' velocities w as unknowns beside x.

        ``C x − w = 0`` in the rows' own scale is weighed so that a twist by which the arms part counts as 1, whatever
        joints it moves. OSQP then needs hundreds of iterations, without it 20 000 and more.

        Args:
            problem: of :meth:`least_distance`.
            parting: its columns of the twists by which the arms part, (nv, 6N).
        """
        n, nv = problem.g.size, self.chain.nv
        C, own = problem.C[:nv], problem.C[nv:]
        U, s, Vt = np.linalg.svd(parting)
        rows = U.T.copy()
        moving = s > SINGULAR_FLOOR * s[0]
        rows[: s.size][moving] /= s[moving, None]
        if s.size == len(Vt) and moving.all():  # each row is that of one twist
            rows[: s.size] = Vt.T @ rows[: s.size]
        wider = CALM * np.eye(n + nv)  # next to nothing for w: some solvers factorise H
        wider[:n, :n] = problem.H
        return QpProblem(
            H=wider,
            g=np.concatenate([problem.g, np.zeros(nv)]),
            A=np.vstack([np.hstack([problem.A, np.zeros((problem.b.size, nv))]), np.hstack([rows @ C, -rows])]),
            b=np.concatenate([problem.b, np.zeros(nv)]),
            C=np.hstack([own, np.zeros((len(own), nv))]),
            l=problem.l[nv:],
            u=problem.u[nv:],
            lb=np.concatenate([problem.lb, problem.l[:nv]]),
            ub=np.concatenate([problem.ub, problem.u[:nv]]),
        )

    def units_condensed(self, solution: QpSolution, B: Array, box: VelocityBox, h: float) -> Array | None:
        """Units of the self-motions that a solution asks for: see :mod:`coopqp.control.step.self_motion`."""
        chain = self.chain
        pull = self.pull(solution, B, box) if chain.redundancy else None
        if pull is None:
            return None
        own = slice(B.shape[1] - chain.redundancy, B.shape[1])
        return shrunk_units(chain, solution.x[own], B[: chain.nv, own], pull, h)

    def pull(self, solution: QpSolution, B: Array, box: VelocityBox) -> Array | None:
        """Multipliers of the joints' velocities (nv,), positive at an upper bound; None if the solver gives none."""
        if solution.y_rows is None or solution.y_eq is None:
            return None
        pull = solution.y_rows[: self.chain.nv].copy()
        pull[box.outside] += solution.y_eq
        scaled: Array = pull / _row_norms(B[: self.chain.nv])
        return scaled

    def read_condensed(self, x: Array, terms: StepTerms, base: Array, B: Array) -> Answer:
        """The step that a solution of :meth:`condensed` stands for."""
        S = self._twist_basis(terms)
        d, own = S.shape[1], B.shape[1]  # r comes after these
        return self._answer(base + B @ x[:own], S @ x[:d], x[d : d + 3], terms)

    def _answer(self, velocity: Array, off_path: Array, shares: Array, terms: StepTerms) -> Answer:
        late, grasp, path = (shares * self._share_scale).tolist()
        return Answer(velocity, terms.rate_cap - late, 1.0 - grasp, 1.0 - path, off_path)

    # -- full ----------------------------------------------------------------------------------------------------

    def full(
        self,
        terms: StepTerms,
        box: VelocityBox,
        further: Rows | None = None,
        *,
        units: Array | None = None,
    ) -> QpProblem:
        """The full form: x = [v (nv), y (d), (cap − σ), (1 − ρ_g), (1 − ρ_p), r], scaled as in the condensed form.

        r is how far the joints outside their limits stay from the velocities that lead them back. (Squaring these
        equalities instead would square their conditioning, and active-set solvers then fail.)
        """
        chain, further, S = self.chain, _or_none(further, self.chain.nv), self._twist_basis(terms)
        outside = np.flatnonzero(box.outside)
        sizes = chain.nv, S.shape[1], 3, outside.size
        ends = np.cumsum(sizes).tolist()
        v, _, shares, led_back = (slice(end - n, end) for end, n in zip(ends, sizes, strict=True))
        n = ends[-1]

        A, b = self._chain_equalities(terms, S, n)
        back = np.zeros((outside.size, n))
        back[np.arange(outside.size), outside] = 1.0
        back[:, led_back] = -self.recovery_scale * np.eye(outside.size)

        H, g = np.zeros((n, n)), np.zeros(n)
        H[range(chain.nv, n), range(chain.nv, n)] = 1.0
        if chain.redundancy:
            G, target = self._posture_rows(terms, n, shares.start)
            if units is not None:
                G, target = G / units[:, None], target / units
            H += self.weights.posture * G.T @ G
            g -= self.weights.posture * G.T @ target

        C = np.zeros((len(further), n))
        C[:, v] = further.G
        lb, ub = np.full(n, -np.inf), np.full(n, np.inf)
        lb[v], ub[v] = box.lower, box.upper
        lb[shares], ub[shares] = 0.0, np.array([terms.rate_cap, 1.0, 1.0]) / self._share_scale
        A, b = np.vstack([A, back]), np.concatenate([b, box.recovery[outside]])
        return QpProblem(H=H, g=g, A=A, b=b, C=C, l=further.lower, u=further.upper, lb=lb, ub=ub)

    def _chain_equalities(self, terms: StepTerms, S: Array, n: int) -> tuple[Array, Array]:
        """``A x = b`` (6N, n) of the closed chain: ``A_k v_k = s + σ ν + ρ_g c_k + ρ_p c_p + b_k``."""
        N, nv, own = self.chain.n_arms, self.chain.nv, self.chain.nv + S.shape[1] + 3
        cap = terms.rate_cap
        wanted = np.broadcast_arrays(terms.along, terms.grasp_corrections, terms.path_correction)
        A = np.zeros((N, 6, n))
        A[:, :, :nv] = terms.to_world.T @ self.chain.dense().reshape(N, 6, nv)
        A[:, :, nv : own - 3] = -S
        A[:, :, own - 3 : own] = np.stack(wanted, axis=-1) * self._share_scale
        b = terms.offsets + cap * terms.along + terms.grasp_corrections + terms.path_correction
        for k, _ in terms.ranges:
            # Rows outside what the arm can do are 0 = 0 up to rounding: leave them out.
            U = np.linalg.svd(A[k, :, :nv], full_matrices=False)[0]
            A[k], b[k] = U @ U.T @ A[k], U @ U.T @ b[k]
        own_ways = self._ways_apart(terms, n, rate_at=own - 3)
        A[list(self.chain.apart)], b[list(self.chain.apart)] = 0.0, 0.0
        return np.vstack([A.reshape(6 * N, n), own_ways[0]]), np.concatenate([b.ravel(), own_ways[1]])

    def _ways_apart(self, terms: StepTerms, n: int, *, rate_at: int) -> tuple[Array, Array]:
        """Equalities of arms that follow their joints' own way: their velocities are given, but for the rate."""
        chain = self.chain
        columns = [j for k in chain.apart for j in chain.moving_columns[k].tolist()]
        A, b = np.zeros((len(columns), n)), np.zeros(len(columns))
        if columns:
            assert terms.null_along is not None
            assert terms.null_offset is not None
            along, offset = terms.null_along[columns], terms.null_offset[columns]
            A[range(len(columns)), columns] = 1.0
            A[:, rate_at] = along * self._share_scale[0]
            b[:] = offset + terms.rate_cap * along
        return A, b

    def _posture_rows(self, terms: StepTerms, n: int, rate_at: int) -> tuple[Array, Array]:
        """G (redundancy, n) and target: z is ``G x``, less the wanted one."""
        # The basis is orthonormal in the joints' units, and orthogonal in them to every least motion of the object.
        dual = (self.chain.null_basis() / self.chain.scale[:, None] ** 2).T
        nothing = np.zeros(self.chain.nv)
        along = nothing if terms.null_along is None else terms.null_along
        offset = nothing if terms.null_offset is None else terms.null_offset
        G = np.zeros((len(dual), n))
        G[:, : self.chain.nv] = dual
        G[:, rate_at] = dual @ along * self._share_scale[0]
        return G, dual @ (offset + terms.rate_cap * along)

    def units_full(self, solution: QpSolution, terms: StepTerms, box: VelocityBox, h: float) -> Array | None:
        """The same of a solution of :meth:`full`."""
        chain, outside = self.chain, int(box.outside.sum())
        if not chain.redundancy or solution.y_box is None or solution.y_eq is None:
            return None
        pull = solution.y_box[: chain.nv].copy()
        pull[box.outside] += solution.y_eq[len(solution.y_eq) - outside :]
        rate_at = chain.nv + self._twist_basis(terms).shape[1]
        G, target = self._posture_rows(terms, solution.x.size, rate_at)
        z = (G @ solution.x - target) / self._posture_scale
        return shrunk_units(chain, z, self._posture_scale * chain.null_basis(), pull, h)

    def read_full(self, x: Array, terms: StepTerms) -> Answer:
        """The step that a solution of :meth:`full` stands for."""
        S, nv = self._twist_basis(terms), self.chain.nv
        end = nv + S.shape[1]
        return self._answer(x[:nv].copy(), S @ x[nv:end], x[end : end + 3], terms)

    def parting(self, answer: Answer, terms: StepTerms) -> float:
        """Largest speed [m/s] at which an arm leaves the common motion of ``answer``."""
        common = (
            answer.off_path
            + answer.rate * terms.along
            + answer.path_share * terms.path_correction
            + answer.grasp_share * terms.grasp_corrections
            + terms.offsets
        )
        parting = self.chain.twists(answer.velocity) @ terms.to_world - common
        parting[list(self.chain.apart)] = 0.0
        return float(np.linalg.norm(parting[:, :3], axis=1).max())


def _row_norms(rows: Array) -> Array:
    norms: Array = np.linalg.norm(rows, axis=1)
    norms[norms < 1e-12] = 1.0
    return norms


def _or_none(further: Rows | None, nv: int) -> Rows:
    return no_rows(nv) if further is None else further
