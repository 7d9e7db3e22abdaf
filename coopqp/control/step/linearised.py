"""One linearised step: errors, corrections, linearisation, answer. The core's counterpart is ``step.cpp``."""

from __future__ import annotations

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
from coopqp.control.step.views import errors_after, ways_between
from coopqp.model.chain import Chain
from coopqp.native.constants import BENT_STEP, CLOSING, EXTRA_AT_START, LONG_STEP, SETTLED
from coopqp.spatial import Array


@dataclass(eq=False)
class StepInput:
    """The input of one step.

    Attributes:
        q, positions: commanded configuration (nq,), and one position per joint (nv,).
        carried, errors: poses of the object there as each arm carries it, and its errors e_k (N, 6).
        v, v_before: joint velocities of the last two steps (nv,).
        h: length of the step [s].
        cap: largest rate.
        pose: reference pose R of the object.
        span: share of the clock that the step is expected to take [s].
        along: ν, mean twist along the path over it (6,); (N, 6) where tools move on the object.
        measured: the object's error for the path correction (6,); None for the commanded one.
        predicted: errors that the last step expected for this one (N, 6); None if it expected none.
        foreseen: the defects b_k that the last step made up for (N, 6), or 0.
        last_dt: length of the last step [s].
        asked: shift of the grasps since then, without the mean of all (N, 6); None for none.
        null_along, null_offset: null-space reference of redundant arms (nv,): the part that is proportional to the
            rate, per unit of it, and the constant part.
        further: further rows.
        first: there is no motion yet to predict the step's midpoint with.
        hold: the arms are held: joints without limits brake.
    """

    q: Array
    positions: Array
    carried: list[pin.SE3]
    errors: Array
    v: Array
    v_before: Array
    h: float
    cap: float
    pose: pin.SE3
    span: float
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
        predicted: errors that are expected for the next step (N, 6).
        foreseen: the defects b_k that this step made up for (N, 6).
        correction: twist of the object off the path: path correction and slack s (6,).
        terms: the wanted motion of the step.
        common: mean of the errors e_k, by the arms' shares (6,).
        closes: share of the differences between the arms' views of the object that the step takes away; 0 where it is
            not known.
        makes_up: the step makes up for all shifts of the grasps.
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
        defects: b_k that it makes up for (N, 6).
    """

    answer: StepAnswer
    terms: StepTerms
    defects: Array


@final
class LinearisedStep:
    """Steps of one chain under one box and solver."""

    def __init__(self, chain: Chain, box: VelocityBox, shares: Array, solver: StepSolver, options: QPOptions) -> None:
        self._chain, self._box, self._shares = chain, box, shares
        self._solver, self._options, self._cell = solver, options, chain.cell

    def answer(self, s: StepInput) -> LinearisedAnswer:
        """The best admissible command."""
        h, common = s.h, mean_error(self._shares, s.errors)
        wanted, closes = self._terms(s, common)
        self._box.update(s.positions, s.v, h, hold=s.hold)
        guess = 2.0 * s.v - s.v_before
        step = self._about(s, wanted, guess)
        start, long = step.answer.velocity, is_long(step.answer.velocity, guess, h)
        least, extra = max(self._options.iterations, 1 + long), EXTRA_AT_START if s.first or long else 0
        if self._options.iterations + extra > 1:
            step = self._settled(s, wanted, step, least, self._options.iterations + extra)
        answer, terms = step.answer, step.terms
        correction = answer.grasp_share * terms.grasp_corrections
        path_correction = answer.path_share * terms.path_correction + answer.off_path
        # The reference goes on along all of the path's twist, also where few joints follow only a part of it.
        lost = answer.rate * (terms.along - s.along)
        predicted = errors_after(s.errors, h * (correction + terms.offsets + path_correction + lost))
        # The velocities at the start and the middle of the first step serve as the velocities of two steps.
        stand_in = 2.0 * start - answer.velocity if s.first else s.v
        made = answer.chain == 0.0 and not answer.braked and not self._chain.deficient
        closes = answer.grasp_share * closes if made else 0.0
        return LinearisedAnswer(answer, stand_in, predicted, step.defects, path_correction, terms, common, closes, made)

    def _settled(self, s: StepInput, wanted: StepTerms, step: _Linearisation, least: int, most: int) -> _Linearisation:
        """The best of ``least`` to ``most`` linearisations, each about the answer of the one before.

        The best one's command misses its twists by least: near singularities a further one may miss more.
        """
        best, smallest = step, math.inf
        for number in range(1, most + 1):
            v = step.answer.velocity
            made = self._twists_made(s, v)
            missed = s.h * np.abs(self._defects(v, made, wanted) - step.defects).max()
            if missed < smallest:
                best, smallest = step, missed
            if number == most or (number >= least and missed <= SETTLED):
                break
            step = self._about(s, wanted, v, made)
        return best

    def _about(self, s: StepInput, wanted: StepTerms, guess: Array, made: Array | None = None) -> _Linearisation:
        """The answer of the chain, linearised at the middle of the step that velocities ``guess`` (nv,) make.

        It makes up for the defect of the step before. Where the twists are known that ``guess`` makes (N, 6), it makes
        up for their defect, and for what the step before has left beyond the defect that it foresaw.
        """
        chain, defects = self._chain, wanted.offsets
        if s.asked is not None:
            defects = defects - s.asked / s.h
        chain.linearise(self._cell.moved(s.q, 0.5 * s.h * guess), s.pose.translation)
        if made is not None:
            defects = self._defects(guess, made, wanted)
            wanted = replace(wanted, offsets=wanted.offsets - s.foreseen + defects)
        terms = self._completed(s, wanted)
        if chain.deficient:
            defects = closing(defects, terms.ranges)
        return _Linearisation(self._solver.answer(terms, s.v, s.h, s.further), terms, defects)

    def _terms(self, s: StepInput, common: Array) -> tuple[StepTerms, float]:
        """The wanted motion, and the share of the arms' errors among each other that it takes away.

        Corrections are bounded by one common factor; a gain never takes away more than the whole error in a step. What
        the grasps were asked to shift is no error: the offsets make up for it.
        """
        o, errors, gain = self._options, s.errors, min(self._options.grasp_gain, 1.0 / s.h)
        grasp = gain * (common - errors)
        offsets = np.zeros(grasp.shape) if s.predicted is None else ways_between(errors, s.predicted) / s.last_dt
        if s.asked is not None:
            grasp += gain * (mean_error(self._shares, s.asked) - s.asked)
            offsets += s.asked / s.h - s.asked / s.last_dt  # they are in the errors, too
        factor = max(excess(grasp, o.correction_speed, o.correction_spin), 1.0)
        path = -min(o.path_gain, 1.0 / s.h) * (common if s.measured is None else s.measured)
        path = bounded(path, o.correction_speed, o.correction_spin)
        return StepTerms(s.pose.rotation, s.along, path, grasp / factor, offsets, s.cap), s.h * gain / factor

    def _completed(self, s: StepInput, terms: StepTerms) -> StepTerms:
        """With the parts that depend on the linearisation: null-space motion, and what arms with few joints can do."""
        chain = self._chain
        if chain.redundancy or chain.apart:
            terms.null_along = chain.null_part(s.null_along)
            terms.null_offset = chain.null_part(s.null_offset)
        if not chain.deficient:
            return terms
        Z, ranges = chain.admissible_twists(terms.to_world.T)
        metric = np.array([1.0] * 3 + [self._options.weights.length**2] * 3)
        project = Z @ np.linalg.solve(Z.T @ (metric[:, None] * Z), Z.T * metric)
        return replace(
            terms,
            along=project @ terms.along if terms.along.ndim == 1 else closing(terms.along, ranges),
            path_correction=project @ terms.path_correction,
            grasp_corrections=closing(terms.grasp_corrections, ranges),
            offsets=closing(terms.offsets, ranges),
            admissible=Z,
            ranges=ranges,
        )

    def _twists_made(self, s: StepInput, v: Array) -> Array:
        """Mean twists of the object in the step that velocities v really make, as each arm carries it (N, 6)."""
        before = [s.pose.actInv(own) for own in s.carried]
        after = [s.pose.actInv(own) for own in self._chain.carried(self._cell.moved(s.q, s.h * v))]
        return np.array([pin.log6(b * a.inverse()).vector for a, b in zip(before, after, strict=True)]) / s.h

    def _defects(self, v: Array, made: Array, terms: StepTerms) -> Array:
        """b_k = A_k v less the twists that v really makes (N, 6)."""
        defects: Array = self._chain.twists(v) @ terms.to_world - made
        defects[list(self._chain.apart)] = 0.0
        return defects


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


def mean_error(shares: Array, errors: Array) -> Array:
    """The object's error (6,): the mean of the errors of all arms (N, 6), by the arms' shares (N, 6)."""
    mean: Array = (shares * errors).sum(axis=0)
    return mean


def bounded(twists: Array, speed: float, spin: float) -> Array:
    """Twists (…, 6), shrunk by one common factor to a linear and an angular speed."""
    return twists / max(excess(twists, speed, spin), 1.0)


def excess(twists: Array, speed: float, spin: float) -> float:
    """The largest of twists (…, 6) as a multiple of a linear and an angular speed."""
    linear, angular = (np.linalg.norm(part, axis=-1).max() for part in (twists[..., :3], twists[..., 3:]))
    return max(float(linear) / speed, float(angular) / spin)


def is_long(v: Array, guess: Array, h: float) -> bool:
    """Whether one linearisation, about the velocities ``guess``, is not enough for ``v`` (nv,)."""
    move = h * np.abs(v).max()
    return bool(move > LONG_STEP or h * np.abs(v - guess).max() * move > BENT_STEP)
