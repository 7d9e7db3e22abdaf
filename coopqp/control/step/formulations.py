"""The QP of one step: from the wanted motion (terms) and the allowed velocities (box) to matrices, and back.

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
from typing import Annotated

import numpy as np
import numpy.typing as npt

from coopqp.checks import Doc, documented, keep_scalars
from coopqp.constraints.velocity import Rows
from coopqp.control.step.velocity_bounds import VelocityBox
from coopqp.model.chain import Chain
from coopqp.solvers.problem import QpProblem
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
    comfort: Annotated[
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
        along: ν, twist of the object along its path at full rate (6,).
        path_correction: c_p (6,).
        grasp_corrections: c_k (N, 6).
        offsets: b_k, defects of the linearisation (N, 6).
        rate_cap: largest admissible σ, in [0, 1].
        null_along: null-space part of the joint velocities per unit of σ (nv,), or None.
        null_offset: null-space joint velocities wanted besides (nv,), or None.
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

    def twists(self, rate: float) -> Array:
        """World twists (N, 6) that a perfect step at this rate gives each arm."""
        w = self.grasp_corrections + self.offsets
        w += rate * self.along + self.path_correction
        out: Array = w.reshape(-1, 3).dot(self.rotation.T)
        return out.reshape(w.shape)


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
    """The memory of a condensed QP of one size: filled anew at every step, so copy what is to be kept.

    Unknowns: x, then one for every joint that is led back and one for every row that may give way.

    Args:
        rows: joints and further rows.
        unknowns: of x.
        outside: joints that are led back.
        soft: rows that may give way.
    """

    def __init__(self, rows: int, unknowns: int, outside: int = 0, soft: int = 0) -> None:
        n = unknowns + outside + soft
        self.sizes = rows, unknowns, outside, soft
        self.problem = QpProblem(
            H=np.eye(n),
            g=np.zeros(n),
            A=np.zeros((outside, n)),
            b=np.zeros(outside),
            C=np.zeros((rows, n)),
            l=np.zeros(rows),
            u=np.zeros(rows),
            lb=np.full(n, -np.inf),
            ub=np.full(n, np.inf),
        )

    def fill(self, base: Array, columns: Array, lower: Array, upper: Array, lead_back: LeadBack) -> QpProblem:
        """Rows of unit norm for ``lower ≤ base + columns x ≤ upper``, and equalities of the joints that are led back.

        ``v_j − recovery_j`` of such a joint is an unknown of its own: squared into the cost it would square the
        conditioning.
        """
        problem, (_, unknowns, outside, soft) = self.problem, self.sizes
        square = np.einsum("ij,ij->i", columns, columns)
        if soft:
            square[lead_back.soft] += lead_back.soft_units**2
        norms = np.sqrt(square)
        norms[norms < 1e-12] = 1.0
        problem.C[:, :unknowns] = columns / norms[:, None]
        problem.l[:], problem.u[:] = (lower - base) / norms, (upper - base) / norms
        if outside:
            j = lead_back.outside
            problem.A[:, :unknowns] = problem.C[j, :unknowns]
            np.fill_diagonal(problem.A[:, unknowns : unknowns + outside], -lead_back.unit / norms[j])
            problem.b[:] = (lead_back.recovery[j] - base[j]) / norms[j]
        for i, row in enumerate(lead_back.soft[:soft]):
            problem.C[row, unknowns + outside + i] = -lead_back.soft_units[i] / norms[row]
        return problem

    def set_bounds(self, first: int, unit: Array, rate_cap: float) -> None:
        """Bounds of (cap − σ), (1 − ρ_g), (1 − ρ_p), from unknown ``first`` on, each divided by its ``unit``."""
        lb, ub = self.problem.lb, self.problem.ub
        lb[first : first + 3] = 0.0
        ub[first], ub[first + 1], ub[first + 2] = rate_cap / unit[0], 1.0 / unit[1], 1.0 / unit[2]


@dataclass(frozen=True, eq=False)
class LeadBack:
    """Joints outside their limits and rows that may give way: each has an unknown of its own.

    Attributes:
        outside: indices of the joints.
        recovery: velocities that lead them back (nv,).
        unit: of their unknowns.
        soft: indices of the rows.
        soft_units: of their unknowns.
    """

    outside: npt.NDArray[np.intp]
    recovery: Array
    unit: float
    soft: npt.NDArray[np.intp]
    soft_units: Array


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
        recovery_scale, relax_scale: units of the unknowns of joints that are led back, of rows that may give way.
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
        self.relax_scale = 1.0 / float(np.sqrt(w.clearance))
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

    def condensed(
        self, terms: StepTerms, pieces: Pieces, box: VelocityBox, further: Rows | None = None, *, relax: bool = False
    ) -> tuple[QpProblem, Array, Array]:
        """The condensed form. Returns the problem and (base, B) with v = base + B x, valid until the next call.

        x = [y (d), (cap − σ), (1 − ρ_g), (1 − ρ_p), z, r], each divided by its scale; r of the joints outside and, with
        ``relax``, of the further rows that may give way.
        """
        S = self._twist_basis(terms)
        d, redundancy, nv = S.shape[1], self.chain.redundancy, self.chain.nv
        base, B = pieces.command(terms.rate_cap), np.zeros((nv, d + 3 + redundancy))
        B[:, :d] = self.chain.joint_columns(terms.to_world @ S)
        for column, piece in enumerate((pieces.along, pieces.grasp, pieces.path)):
            np.multiply(piece, -self._share_scale[column], out=B[:, d + column])
        if redundancy:
            np.multiply(self.chain.null_basis(), self._comfort_scale, out=B[:, d + 3 :])
        if further is not None and len(further):
            base, B = np.concatenate([base, further.G @ base]), np.vstack([B, further.G @ B])
        problem = self.fill(base, B, box, further, relax=relax)
        self.set_bounds(d, terms.rate_cap)
        return problem, base[:nv], B[:nv]

    def fill(
        self, base: Array, B: Array, box: VelocityBox, further: Rows | None = None, *, relax: bool = False
    ) -> QpProblem:
        """The condensed QP of base and columns, of joints and further rows, but for the bounds of x."""
        lower, upper = box.lower, box.upper
        soft, softness = np.zeros(0, dtype=np.intp), np.zeros(0)
        if further is not None and len(further):
            lower, upper = np.concatenate([lower, further.lower]), np.concatenate([upper, further.upper])
            if relax:
                gives_way = np.flatnonzero(further.soft)
                soft, softness = self.chain.nv + gives_way, further.soft[gives_way]
        outside = np.flatnonzero(box.outside)
        sizes = *B.shape, outside.size, soft.size
        if self._qp is None or self._qp.sizes != sizes:  # sizes seldom change
            self._qp = CondensedQp(*sizes)
        lead_back = LeadBack(outside, box.recovery, self.recovery_scale, soft, self.relax_scale * softness)
        return self._qp.fill(base, B, lower, upper, lead_back)

    def set_bounds(self, first: int, rate_cap: float) -> None:
        """Bounds of the shares of the QP that was filled last, from unknown ``first`` on."""
        if self._qp is not None:
            self._qp.set_bounds(first, self._share_scale, rate_cap)

    def read_condensed(self, x: Array, terms: StepTerms, base: Array, B: Array) -> Answer:
        """The step that a solution of :meth:`condensed` stands for."""
        S = self._twist_basis(terms)
        d = S.shape[1]
        late, grasp, path = (x[d : d + 3] * self._share_scale).tolist()
        own = x[: B.shape[1]]  # after these come the unknowns of joints that are led back, of rows that give way
        return Answer(base + B @ own, terms.rate_cap - late, 1.0 - grasp, 1.0 - path, S @ x[:d])

    # -- full and slack ------------------------------------------------------------------------------------------

    def full(
        self, terms: StepTerms, box: VelocityBox, further: Rows | None = None, *, slack: bool = False
    ) -> QpProblem:
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
        own_rows = further if further is not None and len(further) else None
        soft = np.flatnonzero(own_rows.soft) if slack and own_rows is not None else np.zeros(0, dtype=np.intp)
        last = own + (6 * chain.n_arms if slack else 0) + outside.size
        n = last + soft.size
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
            A[range(6 * chain.n_arms), range(own, last - outside.size)] = scale_t
        for i, j in enumerate(outside):
            A[6 * chain.n_arms + i, [j, last - outside.size + i]] = 1.0, -1.0 / np.sqrt(self.weights.recovery)
            b[6 * chain.n_arms + i] = box.recovery[j]
        if chain.redundancy:
            # Active-set solvers manage ten orders of magnitude between costs, not fourteen.
            comfort = max(self.weights.comfort, 1e-10 * self.weights.chain) if slack else self.weights.comfort
            self._add_comfort(H, g, terms, nv, d, comfort)
        lb, ub = np.full(n, -np.inf), np.full(n, np.inf)
        lb[:nv], ub[:nv] = box.lower, box.upper
        lb[nv + d : own] = 0.0
        ub[nv + d : own] = np.array([cap, 1.0, 1.0]) / scale
        C, low, high = np.zeros((0, n)), np.zeros(0), np.zeros(0)
        if own_rows is not None:
            C, low, high = np.zeros((len(own_rows), n)), own_rows.lower, own_rows.upper
            C[:, :nv] = own_rows.G
            C[soft, range(last, n)] = -self.relax_scale * own_rows.soft[soft]
        return QpProblem(H=H, g=g, A=A, b=b, C=C, l=low, u=high, lb=lb, ub=ub)

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
