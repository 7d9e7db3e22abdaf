"""One linearised step, the definition of the core's: errors, corrections, linearisation, answer."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from typing import final

import numpy as np
import pinocchio as pin

from coopqp.constraints.velocity import Rows
from coopqp.control.options import QPOptions
from coopqp.control.step.formulations import StepTerms
from coopqp.control.step.priorities import StepAnswer, StepSolver
from coopqp.control.step.velocity_bounds import VelocityBox
from coopqp.model.chain import Chain
from coopqp.native.constants import BENT_STEP, EXTRA_AT_START, LONG_STEP, SETTLED
from coopqp.spatial import Array, largest, log6_batch

#: Common twists that arms with few joints lack by less than this share, squared, close no chain: they would be large.
CLOSING = 1e-3


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
        foreseen: the defects b_k that the last step made up for (N, 6), or 0.
        last_dt: length of the step that foresaw them [s].
        asked: by how much the grasps were asked to shift since, without the mean of all (N, 6); None for nothing.
        null_along, null_offset: wishes of redundant arms per unit of rate, and besides (nv,).
        further: further rows.
        first: there is no motion yet to predict the step's midpoint with.
        hold: the arms are held: joints without limits brake.
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
    foreseen: Array | float
    last_dt: float
    asked: Array | None
    null_along: Array
    null_offset: Array
    further: Rows
    first: bool
    hold: bool = False


@dataclass(eq=False)
class LinearisedAnswer:
    """The answer of a step, and the values that the next step starts from.

    Attributes:
        answer: the command and what was given up for it.
        stand_in: assumed velocity before the first step (nv,).
        predicted: errors foreseen for the next step (N, 6).
        foreseen: the defects b_k that this step made up for (N, 6).
        correction: off-path twist of the object by the path correction, and besides (6,).
        terms: the wanted motion of the step.
        common: mean of the errors e_k, by the arms' shares (6,).
        closes: share of what is between the arms' views of the object that the step corrects; 0 where it is not known.
        makes_up: the step makes up for all that the grasps were asked to shift.
    """

    answer: StepAnswer
    stand_in: Array
    predicted: Array
    foreseen: Array
    correction: Array
    terms: StepTerms
    common: Array
    closes: float
    makes_up: bool


@dataclass(eq=False)
class _Linearisation:
    """The answer of one linearisation.

    Attributes:
        answer, terms: the command, and the wanted motion that it answers.
        foreseen: the defects b_k that it makes up for (N, 6).
    """

    answer: StepAnswer
    terms: StepTerms
    foreseen: Array


@final
class LinearisedStep:
    """Steps of one chain under one box and solver."""

    def __init__(self, chain: Chain, box: VelocityBox, shares: Array, solver: StepSolver, options: QPOptions) -> None:
        self._chain, self._box, self._mean = chain, box, averaging(shares)
        self._solver, self._options, self._cell = solver, options, chain.cell

    def answer(self, s: StepInput) -> LinearisedAnswer:
        """The best admissible command."""
        h = s.h
        common: Array = self._mean.dot(s.errors.ravel())
        wanted, closes = self._terms(s, common)
        self._box.update(s.positions, s.v, h, hold=s.hold)
        guess = 2.0 * s.v - s.v_before
        found = self._about(s, wanted, guess)
        start, long = found.answer.velocity, is_long(found.answer.velocity, guess, h)
        least, extra = max(self._options.iterations, 1 + long), EXTRA_AT_START if s.first or long else 0
        if self._options.iterations + extra > 1:
            found = self._settled(s, wanted, found, least, self._options.iterations + extra)
        answer, terms, foreseen = found.answer, found.terms, found.foreseen
        grasp, correction = terms.grasp_corrections, terms.path_correction
        if not answer.exact:
            grasp, correction = answer.grasp_share * grasp, answer.path_share * correction + answer.off_path
        # The reference goes on along all of the path's twist, also where few joints follow only a part of it.
        lost = answer.rate * (terms.along - s.along)
        predicted = s.errors + h * (grasp + terms.offsets + correction + lost)
        # The velocities at the start and the middle of the first step serve as the velocities of two steps.
        stand_in = 2.0 * start - answer.velocity if s.first else s.v
        made = answer.chain == 0.0 and not answer.braked and not self._chain.deficient
        closes = answer.grasp_share * closes if made else 0.0
        return LinearisedAnswer(answer, stand_in, predicted, foreseen, correction, terms, common, closes, made)

    def _settled(self, s: StepInput, wanted: StepTerms, found: _Linearisation, least: int, most: int) -> _Linearisation:
        """The linearisation, of so many, each about the answer of the one before, whose answer misses least of what it
        was to make: near singularities a further one may miss more."""
        best, smallest = found, math.inf
        for done in itertools.count(1):
            v = found.answer.velocity
            made = self._made(s, v)
            missed = s.h * largest(np.abs(self._defect(v, made, wanted) - found.foreseen))
            if missed < smallest:
                best, smallest = found, missed
            if done >= most or (done >= least and missed <= SETTLED):
                break
            found = self._about(s, wanted, v, made)
        return best

    def _about(self, s: StepInput, wanted: StepTerms, guess: Array, made: Array | None = None) -> _Linearisation:
        """The answer of the chain, linearised at the middle of the way that velocities ``guess`` (nv,) make.

        It foresees the defect of the step before. Where the motion is known that ``guess`` makes (N, 6), it makes up
        for that motion's defect, and for what the step before has left beyond the defect that it foresaw.
        """
        chain, foreseen = self._chain, wanted.offsets
        if s.asked is not None:
            foreseen = foreseen - s.asked / s.h
        chain.linearise(self._cell.moved(s.q, 0.5 * s.h * guess), s.pose.translation)
        if made is not None:
            foreseen = self._defect(guess, made, wanted)
            wanted = replace(wanted, offsets=wanted.offsets - s.foreseen + foreseen)
        terms = self._completed(s, wanted)
        if chain.deficient:
            foreseen = closing(foreseen, terms.ranges)
        return _Linearisation(self._solver.answer(terms, s.v, s.h, s.further), terms, foreseen)

    def _terms(self, s: StepInput, common: Array) -> tuple[StepTerms, float]:
        """Corrections, bounded by one common factor; a gain never takes away more than the whole error in a step.

        What the grasps were asked to shift is no error: the offsets make up for it. Also the share of the arms' errors
        among each other that is taken away.
        """
        o, errors, gain = self._options, s.errors, min(self._options.grasp_gain, 1.0 / s.h)
        grasp = gain * (common - errors)
        offsets = np.zeros(grasp.shape) if s.predicted is None else (s.predicted - errors) / s.last_dt
        if s.asked is not None:
            grasp += gain * (self._mean.dot(s.asked.ravel()) - s.asked)
            offsets += s.asked / s.h - s.asked / s.last_dt  # they are in the errors, too
        excess = over(grasp, o.correction_speed, o.correction_spin)
        path = -min(o.path_gain, 1.0 / s.h) * (common if s.measured is None else s.measured)
        terms = StepTerms(
            s.pose.rotation,
            s.along,
            bounded(path, o.correction_speed, o.correction_spin),
            grasp / excess if excess > 1.0 else grasp,
            offsets,
            s.cap,
        )
        return terms, s.h * gain / max(excess, 1.0)

    def _completed(self, s: StepInput, terms: StepTerms) -> StepTerms:
        """With the parts that depend on the linearisation: null-space motion, and what arms with few joints can do."""
        chain = self._chain
        if chain.redundancy:
            terms.null_along = chain.null_part(s.null_along)
            terms.null_offset = chain.null_part(s.null_offset)
        if not chain.deficient:
            return terms
        Z, ranges = chain.admissible_twists(terms.to_world.T)
        metric = np.array([1.0] * 3 + [self._options.weights.length**2] * 3)
        project = Z @ np.linalg.solve(Z.T @ (metric[:, None] * Z), Z.T * metric)
        return replace(
            terms,
            along=project @ terms.along,
            path_correction=project @ terms.path_correction,
            grasp_corrections=closing(terms.grasp_corrections, ranges),
            offsets=closing(terms.offsets, ranges),
            admissible=Z,
            ranges=ranges,
        )

    def _made(self, s: StepInput, v: Array) -> Array:
        """Mean twists of the object in the step that v really makes, as each arm carries it (N, 6), in the world frame
        about the reference origin."""
        before, after = s.carried, self._chain.carried(self._cell.moved(s.q, s.h * v))
        R = after[:, :3].transpose(0, 2, 1) @ before[:, :3]  # displacement O₁ O₀⁻¹ about the reference origin
        about = s.pose.translation
        p = after[:, 3] - about - np.einsum("kij,kj->ki", R, before[:, 3] - about)
        twists: Array = log6_batch(R, p) / s.h
        return twists

    def _defect(self, v: Array, made: Array, terms: StepTerms) -> Array:
        """b_k = A_k v less the twists that v really makes, (N, 6) in the reference object frame."""
        defect: Array = (self._chain.twists(v) - made) @ terms.to_world
        return defect


def closing(twists: Array, ranges: list[tuple[int, Array]]) -> Array:
    """Twists of the arms (N, 6), moved by one common twist so that arms with few joints can follow them, without what
    those still cannot follow.

    With P_k the projector on what arm k can follow, w = −(Σ (1 − P_k))⁺ Σ (1 − P_k) c_k brings all c_k + w closest to
    their ranges. Each projected alone, twists that all have in common would lead the arms apart.
    """
    lost = [(k, np.eye(6) - P) for k, P in ranges]
    common = sum((L @ twists[k] for k, L in lost), start=np.zeros(6))
    forbidden = sum((L for _, L in lost), start=np.zeros((6, 6)))
    closed: Array = twists - np.linalg.pinv(forbidden, rcond=CLOSING, hermitian=True) @ common
    for k, P in ranges:
        closed[k] = P @ closed[k]
    return closed


def averaging(shares: Array) -> Array:
    """S (6, 6N): ``S e`` is the mean of errors e of all arms (N, 6), in one row, by the arms' shares (N, 6)."""
    return np.hstack([np.diag(row) for row in shares])


def bounded(twists: Array, speed: float, spin: float) -> Array:
    """Twists (…, 6), shrunk by one common factor to a linear and an angular speed."""
    excess = over(twists, speed, spin)
    return twists / excess if excess > 1.0 else twists


def over(twists: Array, speed: float, spin: float) -> float:
    """The largest of twists (…, 6) as a multiple of a linear and an angular speed; 1 or less where none is faster."""
    entries = twists.ravel()
    if entries.dot(entries) <= min(speed, spin) ** 2:
        return 1.0
    square = twists * twists
    linear, angular = square[..., :3].sum(axis=-1).max(), square[..., 3:].sum(axis=-1).max()
    return math.sqrt(max(linear / speed**2, angular / spin**2))


def is_long(v: Array, guess: Array, h: float) -> bool:
    """Whether one linearisation, about the velocities ``guess``, is not enough for ``v`` (nv,)."""
    move = largest(np.abs(v)) * h
    return move > LONG_STEP or largest(np.abs(v - guess)) * h * move > BENT_STEP
