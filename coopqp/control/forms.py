"""The QP of one step: from what is wanted (terms) and what is allowed (box) to matrices, and back.

With the arms' kinematics inverted, every admissible command of a perfect chain is

    v = A⁻¹(σ ν + s) + ρ_g A⁻¹ c_k + ρ_p A⁻¹ c_p + v_0 (+ N z for redundant arms)

so the unknowns are the off-path twist s (6), the path rate σ, the shares ρ_g and ρ_p of the grasp and path
corrections and z: nine plus the redundancy, whatever the number of arms, with a row per joint. That is the
**condensed form**. The **full form** keeps the joint velocities as unknowns and the chain as equalities; it is the
reference that the condensed form is tested against. The **slack form** lets the chain part, at a price above all
else, for the case in which the limits leave no other answer.

Costs, in the order of rank: chain 1e8, recovery 1e6, off-path 1e4, grasp correction 1, path correction 1e-2, rate
1e-4, comfort 1e-6. Variables are scaled so that the condensed Hessian is the identity: a least-distance problem.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from coopqp.checks import keep_scalars
from coopqp.control.limits import VelocityBox
from coopqp.control.solvers.base import QpProblem
from coopqp.model.chain import Chain
from coopqp.spatial import Array


@dataclass(frozen=True, kw_only=True)
class RankWeights:
    """Costs of giving something up, per unit squared; ratios of at least 100 keep the ranks apart.

    Attributes:
        chain: of the arms parting [1/(m/s)²].
        off_path: of velocity off the path [1/(m/s)²].
        recovery: of a joint outside its limits not being led back [1/(rad/s)²].
        grasp, path: of giving up all of the grasp or path correction.
        rate: of standing still (σ = 0).
        comfort: of null-space motion other than the wanted one, in units of the joints' speeds.
        length: characteristic length that weighs rotation against translation [m].
    """

    chain: float = 1e8
    off_path: float = 1e4
    recovery: float = 1e6
    grasp: float = 1.0
    path: float = 1e-2
    rate: float = 1e-4
    comfort: float = 1e-6
    length: float = 0.3

    def __post_init__(self) -> None:
        keep_scalars(self, *self.__dataclass_fields__, low=1e-20, high=1e20)


@dataclass(eq=False)
class StepTerms:
    """What one step wants; twists of the object in the reference object frame.

    Attributes:
        to_world: Ad(R) (6, 6).
        along: ν, twist of the object along its path at full rate (6,).
        path_correction: c_p (6,).
        grasp_corrections: c_k (N, 6).
        offsets: b_k, what a linearisation leaves out (N, 6).
        rate_cap: largest admissible σ, in [0, 1].
        null_along: null-space part of the joint velocities per unit of σ (nv,), or None.
        null_offset: null-space joint velocities wanted besides (nv,), or None.
        admissible: basis Z (6, d) of the twists that every arm can follow, None if all can follow all.
    """

    to_world: Array
    along: Array
    path_correction: Array
    grasp_corrections: Array
    offsets: Array
    rate_cap: float = 1.0
    null_along: Array | None = None
    null_offset: Array | None = None
    admissible: Array | None = None
    ranges: list[tuple[int, Array]] = field(default_factory=list)

    def twists(self, rate: float) -> Array:
        """World twists (N, 6) that a perfect step at this rate gives each arm."""
        w = self.grasp_corrections + self.offsets
        w += rate * self.along + self.path_correction
        out: Array = w @ self.to_world.T
        return out


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


class CondensedQp:
    """The memory of a condensed QP: filled anew at every step, so what is to be kept has to be copied.

    Attributes:
        base, columns: joint velocities v = base + columns x, (nv,) and (nv, n).
        norms: of the rows of ``columns`` (nv,), 1 where there is nothing.
        problem: the QP, a row of unit norm per joint.
    """

    def __init__(self, joints: int, unknowns: int, outside: int = 0) -> None:
        n = unknowns + outside
        self.base, self.columns, self.norms = np.zeros(joints), np.zeros((joints, n)), np.ones(joints)
        self.problem = QpProblem(
            H=np.eye(n),
            g=np.zeros(n),
            A=np.zeros((outside, n)),
            b=np.zeros(outside),
            C=np.zeros((joints, n)),
            l=np.zeros(joints),
            u=np.zeros(joints),
            lb=np.full(n, -np.inf),
            ub=np.full(n, np.inf),
        )

    def take(self, other: CondensedQp) -> None:
        """Copy all but the bounds of x from one with fewer unknowns, which are the first of this one's."""
        mine, theirs, n = self.problem, other.problem, other.columns.shape[1]
        self.base[:], self.norms[:] = other.base, other.norms
        self.columns[:, :n], mine.C[:, :n] = other.columns, theirs.C
        mine.l[:], mine.u[:] = theirs.l, theirs.u

    def set_rows(self, lower: Array, upper: Array) -> None:
        """The rows of unit norm that keep v in its box, from ``base`` and ``columns``."""
        norms, problem = self.norms, self.problem
        np.sqrt(np.einsum("ij,ij->i", self.columns, self.columns), out=norms)
        norms[norms < 1e-12] = 1.0
        np.divide(self.columns, norms[:, None], out=problem.C)
        np.divide(lower - self.base, norms, out=problem.l)
        np.divide(upper - self.base, norms, out=problem.u)

    def set_bounds(self, first: int, unit: Array, rate_cap: float) -> None:
        """Bounds of (cap − σ), (1 − ρ_g), (1 − ρ_p), from unknown ``first`` on, each divided by its ``unit``."""
        lb, ub = self.problem.lb, self.problem.ub
        lb[first : first + 3] = 0.0
        ub[first], ub[first + 1], ub[first + 2] = rate_cap / unit[0], 1.0 / unit[1], 1.0 / unit[2]

    def lead_back(self, outside: npt.NDArray[np.intp], recovery: Array, unit: float) -> None:
        """The equalities of the joints outside their limits: v_j − recovery_j is an unknown of its own.

        Squared into the cost it would square the conditioning.
        """
        problem, norms, k = self.problem, self.norms[outside], outside.size
        problem.A[:] = problem.C[outside]
        np.fill_diagonal(problem.A[:, problem.A.shape[1] - k :], -unit / norms)
        np.divide((recovery - self.base)[outside], norms, out=problem.b)


@dataclass(frozen=True, eq=False)
class Answer:
    """A solved step: joint velocities and what was given up."""

    velocity: Array
    rate: float
    grasp_share: float
    path_share: float
    off_path: Array
    chain: float = 0.0


class StepProgram:
    """Builds and reads the QPs of one chain. Nothing is carried from step to step but memory.

    Attributes:
        metric: diagonal W (6,) that makes linear and angular parts of a twist comparable.
        units: of the unknowns of a condensed QP without deficient arms, (9 + redundancy,).
        recovery_scale: unit of the unknowns of joints that are led back.
    """

    def __init__(self, chain: Chain, weights: RankWeights) -> None:
        self.chain, self.weights = chain, weights
        w = weights
        self.metric = np.array([1.0] * 3 + [w.length**2] * 3)
        self._twist_scale = 1.0 / np.sqrt(w.off_path * self.metric)
        self._basis = np.diag(self._twist_scale)
        self._share_scale = 1.0 / np.sqrt(np.array([w.rate, w.grasp, w.path]))
        self._comfort_scale = 1.0 / np.sqrt(w.comfort)
        self.recovery_scale = 1.0 / float(np.sqrt(w.recovery))
        comfort = np.full(chain.redundancy, self._comfort_scale)
        self.units = np.concatenate([self._twist_scale, self._share_scale, comfort])
        self._qp: CondensedQp | None = None

    def pieces(self, terms: StepTerms) -> Pieces:
        """Split the command into the contributions of the unknowns."""
        chain = self.chain
        twists = np.empty((chain.n_arms, 6, 4))
        twists[:, :, 0], twists[:, :, 1] = terms.along, terms.path_correction
        twists[:, :, 2], twists[:, :, 3] = terms.grasp_corrections, terms.offsets
        along, path, grasp, fixed = np.ascontiguousarray(chain.joint_columns(terms.to_world @ twists).T)
        if terms.null_along is not None:
            along += terms.null_along
        if terms.null_offset is not None:
            fixed += terms.null_offset
        return Pieces(fixed, along, grasp, path)

    def _twist_basis(self, terms: StepTerms) -> Array:
        """Scaled basis of s in the reference frame, (6, d)."""
        if terms.admissible is None:
            return self._basis
        # s = Z y with ‖s‖_W = ‖y‖ after orthonormalisation in the metric W
        Q, _ = np.linalg.qr(terms.admissible / self._twist_scale[:, None])
        basis: Array = self._twist_scale[:, None] * Q
        return basis

    # -- condensed -----------------------------------------------------------------------------------------------

    def condensed(self, terms: StepTerms, pieces: Pieces, box: VelocityBox) -> tuple[QpProblem, Array, Array]:
        """The condensed form. Returns the problem and (base, B) with v = base + B x, valid until the next call.

        x = [y (d), (cap − σ), (1 − ρ_g), (1 − ρ_p), z, r], each divided by its scale; r of the joints outside.
        """
        S = self._twist_basis(terms)
        d, redundancy = S.shape[1], self.chain.redundancy
        outside = np.flatnonzero(box.outside)
        qp = self.memory(d + 3 + redundancy, outside.size)
        base, B = qp.base, qp.columns
        base[:] = pieces.command(terms.rate_cap)
        B[:, :d] = self.chain.joint_columns(terms.to_world @ S)
        for column, piece in enumerate((pieces.along, pieces.grasp, pieces.path)):
            np.multiply(piece, -self._share_scale[column], out=B[:, d + column])
        if redundancy:
            np.multiply(self.chain.null_basis(), self._comfort_scale, out=B[:, d + 3 : d + 3 + redundancy])
        qp.set_rows(box.lower, box.upper)
        qp.set_bounds(d, self._share_scale, terms.rate_cap)
        if outside.size:
            qp.lead_back(outside, box.recovery, self.recovery_scale)
        return qp.problem, base, B

    def memory(self, unknowns: int, outside: int) -> CondensedQp:
        """The memory of the last QP if its size fits; sizes seldom change."""
        n = unknowns + outside
        if self._qp is None or self._qp.problem.sizes != (n, outside, self.chain.nv):
            self._qp = CondensedQp(self.chain.nv, unknowns, outside)
        return self._qp

    def read_condensed(self, x: Array, terms: StepTerms, base: Array, B: Array) -> Answer:
        """The step that a solution of :meth:`condensed` stands for."""
        S = self._twist_basis(terms)
        d = S.shape[1]
        late, grasp, path = (x[d : d + 3] * self._share_scale).tolist()
        return Answer(base + B @ x, terms.rate_cap - late, 1.0 - grasp, 1.0 - path, S @ x[:d])

    # -- full and slack ------------------------------------------------------------------------------------------

    def full(self, terms: StepTerms, box: VelocityBox, *, slack: bool = False) -> QpProblem:
        """The full form: x = [v (nv), y (d), (cap − σ), (1 − ρ_g), (1 − ρ_p)], the last scaled as in the condensed.

        With ``slack`` the chain may part: x goes on with t (6N), the twists by which the arms leave the common
        motion, scaled so that their cost is of unit weight; in either case it ends with r, how far the joints outside
        their limits stay from the velocities that lead them back, scaled alike. (Squaring these equalities instead
        would square their conditioning, and active-set solvers then fail.)
        """
        chain, nv = self.chain, self.chain.nv
        S = self._twist_basis(terms)
        d = S.shape[1]
        own = nv + d + 3
        outside = np.flatnonzero(box.outside)
        n = own + (6 * chain.n_arms if slack else 0) + outside.size
        to_reference = np.linalg.inv(terms.to_world)
        J = chain.dense()
        A = np.zeros((6 * chain.n_arms + outside.size, n))
        b = np.empty(len(A))
        cap, scale = terms.rate_cap, self._share_scale
        for k in range(chain.n_arms):
            rows = slice(6 * k, 6 * k + 6)
            A[rows, :nv] = to_reference @ J[rows]
            A[rows, nv : nv + d] = -S
            A[rows, nv + d] = terms.along * scale[0]
            A[rows, nv + d + 1] = terms.grasp_corrections[k] * scale[1]
            A[rows, nv + d + 2] = terms.path_correction * scale[2]
            b[rows] = terms.offsets[k] + cap * terms.along + terms.grasp_corrections[k] + terms.path_correction
        for k, _ in terms.ranges:
            # Rows outside what the arm can do are 0 = 0 up to rounding: leave them out.
            U = np.linalg.svd(A[6 * k : 6 * k + 6, :nv], full_matrices=False)[0]
            P = U @ U.T
            A[6 * k : 6 * k + 6] = P @ A[6 * k : 6 * k + 6]
            b[6 * k : 6 * k + 6] = P @ b[6 * k : 6 * k + 6]
        H, g = np.zeros((n, n)), np.zeros(n)
        H[range(nv, n), range(nv, n)] = 1.0
        if slack:
            part = 1.0 / np.sqrt(self.weights.chain)
            scale_t = np.tile([part] * 3 + [part / self.weights.length] * 3, chain.n_arms)
            A[range(6 * chain.n_arms), range(own, n - outside.size)] = scale_t
        for i, j in enumerate(outside):
            A[6 * chain.n_arms + i, [j, n - outside.size + i]] = 1.0, -1.0 / np.sqrt(self.weights.recovery)
            b[6 * chain.n_arms + i] = box.recovery[j]
        if chain.redundancy:
            # Active-set solvers manage ten orders of magnitude between costs, not fourteen.
            comfort = max(self.weights.comfort, 1e-10 * self.weights.chain) if slack else self.weights.comfort
            self._add_comfort(H, g, terms, nv, d, comfort)
        lb, ub = np.full(n, -np.inf), np.full(n, np.inf)
        lb[:nv], ub[:nv] = box.lower, box.upper
        lb[nv + d : own] = 0.0
        ub[nv + d : own] = np.array([cap, 1.0, 1.0]) / scale
        return QpProblem(H=H, g=g, A=A, b=b, C=np.zeros((0, n)), l=np.zeros(0), u=np.zeros(0), lb=lb, ub=ub)

    def _add_comfort(self, H: Array, g: Array, terms: StepTerms, nv: int, d: int, comfort: float) -> None:
        """Cost of z: the null-space part of v, less the wanted one."""
        # The basis is orthonormal in the joints' units, and orthogonal in them to every least motion of the object.
        dual = (self.chain.null_basis() / self.chain.scale[:, None] ** 2).T
        G = np.zeros((len(dual), H.shape[0]))
        G[:, :nv] = dual
        wanted = np.zeros(nv) if terms.null_offset is None else terms.null_offset.copy()
        if terms.null_along is not None:
            wanted += terms.rate_cap * terms.null_along
            G[:, nv + d] = dual @ terms.null_along * self._share_scale[0]
        target = dual @ wanted
        H += comfort * G.T @ G
        g -= comfort * G.T @ target

    def read_full(self, x: Array, terms: StepTerms) -> Answer:
        """The step that a solution of :meth:`full` stands for, with the speed at which the arms part."""
        nv = self.chain.nv
        S = self._twist_basis(terms)
        d = S.shape[1]
        late, grasp, path = (x[nv + d : nv + d + 3] * self._share_scale).tolist()
        return Answer(x[:nv].copy(), terms.rate_cap - late, 1.0 - grasp, 1.0 - path, S @ x[nv : nv + d])

    def parting(self, answer: Answer, terms: StepTerms) -> float:
        """Largest speed [m/s] at which an arm leaves the common motion of ``answer``."""
        common = (
            answer.off_path
            + answer.rate * terms.along
            + answer.path_share * terms.path_correction
            + answer.grasp_share * terms.grasp_corrections
            + terms.offsets
        )
        actual = self.chain.twists(answer.velocity) @ np.linalg.inv(terms.to_world).T
        return float(np.linalg.norm((actual - common)[:, :3], axis=1).max())
