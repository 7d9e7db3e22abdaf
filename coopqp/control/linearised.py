"""One step in plain steps: errors, terms, linearisation, answer. What the kernels fuse, and where they do not apply.

The first step of a motion, steps with several linearisations, arms with fewer than six joints, and whatever a kernel
leaves open come here.
"""

from __future__ import annotations

from typing import final

import numpy as np
import pinocchio as pin

from coopqp.control.core import Workspace
from coopqp.control.core.reference import bound
from coopqp.control.forms import StepTerms
from coopqp.control.options import QPOptions
from coopqp.control.ranks import StepAnswer, StepSolver
from coopqp.spatial import Array, log6_batch

#: Linearisations that the first step may have beyond the others.
_EXTRA_AT_START = 3
#: The first step's velocity has settled where its change times itself moves the joints by less than this [rad²].
_SETTLED = 1e-13


@final
class LinearisedStep:
    """Steps over a workspace whose inputs are set; leaves there what the next step starts from, as a kernel does."""

    def __init__(self, workspace: Workspace, solver: StepSolver, options: QPOptions) -> None:
        self._ws, self._solver, self._options = workspace, solver, options
        self._chain, self._box = workspace.chain, workspace.box
        self._cell = workspace.chain.cell

    def answer(
        self, q: Array, v: Array, v_before: Array, h: float, cap: float, *, first: bool
    ) -> tuple[StepAnswer, Array]:
        """The best admissible command, and the velocity at the start of the step (nv,).

        Args:
            q, v, v_before: commanded configuration, and the velocities of the last two steps.
            h: length of the step [s].
            cap: largest rate.
            first: there is no motion yet to predict the step's midpoint with: linearise again until it settles.
        """
        chain, ws = self._chain, self._ws
        pose = pin.SE3(ws.R, ws.p)
        O = chain.carried(q)
        ws.errors[:] = chain.errors(O, pose)
        terms = self._terms(cap, pose)
        self._box.update(ws.positions, v, h)
        guess = 2.0 * v - v_before
        start = guess
        for iteration in range(self._options.iterations + _EXTRA_AT_START):
            chain.linearise(self._cell.moved(q, 0.5 * h * guess))
            if iteration:
                terms.offsets = self._defect(q, O, guess, h, terms)
            self._complete(terms, pose)
            answer = self._solver.answer(terms, v, h)
            answer.correction = terms.path_correction
            if iteration == 0:
                start = answer.velocity
            settled = not first or _settled(answer.velocity, guess, h)
            if iteration + 1 >= self._options.iterations and settled:
                break
            guess = answer.velocity
        s = ws.scalars
        s[ws.HAS_PREDICTED], s[ws.LAST_DT] = answer.chain == 0.0 and not answer.braked, h
        drift = answer.grasp_share * terms.grasp_corrections + terms.offsets
        drift += answer.path_share * terms.path_correction + answer.off_path
        ws.predicted[:] = ws.errors + h * drift
        return answer, start

    def _terms(self, cap: float, pose: pin.SE3) -> StepTerms:
        ws, s = self._ws, self._ws.scalars
        common = (ws.shares * ws.errors).sum(axis=0)
        grasp = -s[ws.GRASP_GAIN] * (ws.errors - common)
        path = -s[ws.PATH_GAIN] * (ws.measured if s[ws.HAS_MEASURED] else common)
        bound(grasp, s[ws.SPEED], s[ws.SPIN])
        bound(path[None, :], s[ws.SPEED], s[ws.SPIN])
        return StepTerms(
            to_world=np.asarray(pose.action),
            along=ws.along.copy(),
            path_correction=path,
            grasp_corrections=grasp,
            offsets=(ws.predicted - ws.errors) / s[ws.LAST_DT] if s[ws.HAS_PREDICTED] else np.zeros_like(grasp),
            rate_cap=cap,
        )

    def _complete(self, terms: StepTerms, pose: pin.SE3) -> None:
        """What depends on the linearisation: null-space motion, and what arms with few joints allow."""
        chain, ws = self._chain, self._ws
        if chain.redundancy:
            terms.null_along = chain.null_part(ws.null_along)
            terms.null_offset = chain.null_part(ws.null_offset)
        if chain.deficient:
            Z, ranges = chain.admissible_twists(np.asarray(pose.inverse().action))
            metric = np.array([1.0] * 3 + [self._options.weights.length**2] * 3)
            project = Z @ np.linalg.solve(Z.T @ (metric[:, None] * Z), Z.T * metric)
            terms.along, terms.path_correction = project @ terms.along, project @ terms.path_correction
            for k, P in ranges:
                terms.grasp_corrections[k] = P @ terms.grasp_corrections[k]
                terms.offsets[k] = P @ terms.offsets[k]
            terms.admissible, terms.ranges = Z, ranges

    def _defect(self, q: Array, before: Array, v: Array, h: float, terms: StepTerms) -> Array:
        """b_k = A_k v − log(step that v really makes)/dt, (N, 6) in the reference object frame."""
        after = self._chain.carried(self._cell.moved(q, h * v))
        R = after[:, :3].transpose(0, 2, 1) @ before[:, :3]  # spatial displacement O₁ O₀⁻¹
        p = after[:, 3] - np.einsum("kij,kj->ki", R, before[:, 3])
        made = log6_batch(R, p) / h
        defect: Array = (self._chain.twists(v) - made) @ np.linalg.inv(terms.to_world).T
        return defect


def _settled(v: Array, guess: Array, h: float) -> bool:
    return float(np.abs(v - guess).max()) * float(np.abs(v).max()) * h * h <= _SETTLED
