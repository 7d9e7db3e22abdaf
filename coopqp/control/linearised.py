"""One linearised step, the definition of the core's: errors, corrections, linearisation, answer."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import final

import numpy as np
import pinocchio as pin

from coopqp.control.constraints import Rows
from coopqp.control.forms import StepTerms
from coopqp.control.limits import VelocityBox
from coopqp.control.options import QPOptions
from coopqp.control.ranks import StepAnswer, StepSolver
from coopqp.model.chain import Chain
from coopqp.spatial import Array, largest, log6_batch

#: Linearisations that the first step may have beyond the others.
EXTRA_AT_START = 3
#: The first step has settled when its change of velocity moves the joints by less than this [rad²].
SETTLED = 1e-13


@dataclass(eq=False)
class StepInput:
    """The input of one step.

    Attributes:
        q, positions: commanded configuration (nq,), and one position per joint (nv,).
        carried, errors: the object there as each arm carries it (N, 4, 3), and its errors e_k (N, 6).
        v, v_before: joint velocities of the last two steps (nv,).
        h: length of the step [s].
        cap: largest rate.
        pose: reference pose R of the object.
        along: ν, twist along the path (6,).
        measured: the object's error for the path correction (6,); None for the commanded one.
        predicted: errors foreseen for this step (N, 6); None if nothing was foreseen.
        last_dt: length of the step that foresaw them [s].
        null_along, null_offset: wishes of redundant arms per unit of rate, and besides (nv,).
        further: further rows.
        first: there is no motion yet to predict the step's midpoint with.
    """

    q: Array
    positions: Array
    carried: Array
    errors: Array
    v: Array
    v_before: Array
    h: float
    cap: float
    pose: pin.SE3
    along: Array
    measured: Array | None
    predicted: Array | None
    last_dt: float
    null_along: Array
    null_offset: Array
    further: Rows
    first: bool


@dataclass(eq=False)
class LinearisedAnswer:
    """The answer of a step, and the values that the next step starts from.

    Attributes:
        answer: the command and what was given up for it.
        stand_in: assumed velocity before the first step (nv,).
        predicted: errors foreseen for the next step (N, 6).
        correction: off-path twist of the object by the path correction, and besides (6,).
        terms: the wanted motion of the step.
        common: mean of the errors e_k, by the arms' shares (6,).
    """

    answer: StepAnswer
    stand_in: Array
    predicted: Array
    correction: Array
    terms: StepTerms
    common: Array


@final
class LinearisedStep:
    """Steps of one chain under one box and solver."""

    def __init__(self, chain: Chain, box: VelocityBox, shares: Array, solver: StepSolver, options: QPOptions) -> None:
        self._chain, self._box, self._mean = chain, box, averaging(shares)
        self._solver, self._options, self._cell = solver, options, chain.cell

    def answer(self, s: StepInput) -> LinearisedAnswer:
        """The best admissible command."""
        chain, h, about = self._chain, s.h, s.pose.translation
        common: Array = self._mean.dot(s.errors.ravel())
        terms = self._terms(s, common)
        self._box.update(s.positions, s.v, h)
        guess = 2.0 * s.v - s.v_before
        start = guess
        for iteration in range(self._options.iterations + EXTRA_AT_START):
            chain.linearise(self._cell.moved(s.q, 0.5 * h * guess), about)
            if iteration:
                terms.offsets = self._defect(s, guess, terms)
            self._complete(s, terms)
            answer = self._solver.answer(terms, s.v, h, s.further)
            if iteration == 0:
                start = answer.velocity
            settled = not s.first or _settled(answer.velocity, guess, h)
            if iteration + 1 >= self._options.iterations and settled:
                break
            guess = answer.velocity
        grasp, correction = terms.grasp_corrections, terms.path_correction
        if not answer.exact:
            grasp, correction = answer.grasp_share * grasp, answer.path_share * correction + answer.off_path
        predicted = s.errors + h * (grasp + terms.offsets + correction)
        # The velocities at the start and the middle of the first step serve as the velocities of two steps.
        stand_in = 2.0 * start - answer.velocity if s.first else s.v
        return LinearisedAnswer(answer, stand_in, predicted, correction, terms, common)

    def _terms(self, s: StepInput, common: Array) -> StepTerms:
        """Corrections, bounded by one common factor; a gain never takes away more than the whole error in a step."""
        o, errors = self._options, s.errors
        grasp = min(o.grasp_gain, 1.0 / s.h) * (common - errors)
        path = -min(o.path_gain, 1.0 / s.h) * (common if s.measured is None else s.measured)
        return StepTerms(
            s.pose.rotation,
            s.along,
            bounded(path, o.correction_speed, o.correction_spin),
            bounded(grasp, o.correction_speed, o.correction_spin),
            np.zeros(grasp.shape) if s.predicted is None else (s.predicted - errors) / s.last_dt,
            s.cap,
        )

    def _complete(self, s: StepInput, terms: StepTerms) -> None:
        """Update the parts that depend on the linearisation: null-space motion, arms with few joints."""
        chain = self._chain
        if chain.redundancy:
            terms.null_along = chain.null_part(s.null_along)
            terms.null_offset = chain.null_part(s.null_offset)
        if chain.deficient:
            Z, ranges = chain.admissible_twists(terms.to_world.T)
            metric = np.array([1.0] * 3 + [self._options.weights.length**2] * 3)
            project = Z @ np.linalg.solve(Z.T @ (metric[:, None] * Z), Z.T * metric)
            terms.along, terms.path_correction = project @ terms.along, project @ terms.path_correction
            for k, P in ranges:
                terms.grasp_corrections[k] = P @ terms.grasp_corrections[k]
                terms.offsets[k] = P @ terms.offsets[k]
            terms.admissible, terms.ranges = Z, ranges

    def _defect(self, s: StepInput, v: Array, terms: StepTerms) -> Array:
        """b_k = A_k v − log(step that v really makes)/dt, (N, 6) in the reference object frame."""
        before, after = s.carried, self._chain.carried(self._cell.moved(s.q, s.h * v))
        R = after[:, :3].transpose(0, 2, 1) @ before[:, :3]  # displacement O₁ O₀⁻¹ about the reference origin
        about = s.pose.translation
        p = after[:, 3] - about - np.einsum("kij,kj->ki", R, before[:, 3] - about)
        made = log6_batch(R, p) / s.h
        defect: Array = (self._chain.twists(v) - made) @ terms.to_world
        return defect


def averaging(shares: Array) -> Array:
    """S (6, 6N): ``S e`` is the mean of errors e of all arms (N, 6), in one row, by the arms' shares (N, 6)."""
    return np.hstack([np.diag(row) for row in shares])


def bounded(twists: Array, speed: float, spin: float) -> Array:
    """Twists (…, 6), shrunk by one common factor to a linear and an angular speed."""
    entries = twists.ravel()
    if entries.dot(entries) <= min(speed, spin) ** 2:
        return twists
    square = twists * twists
    linear, angular = square[..., :3].sum(axis=-1).max(), square[..., 3:].sum(axis=-1).max()
    excess = math.sqrt(max(linear / speed**2, angular / spin**2))
    return twists / excess if excess > 1.0 else twists


def _settled(v: Array, guess: Array, h: float) -> bool:
    return largest(np.abs(v - guess)) * largest(np.abs(v)) * h * h <= SETTLED
