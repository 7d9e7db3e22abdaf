"""Data that a plain loop hands from step to step, and from one part of a step to the next."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import pinocchio as pin

from coopqp.constraints.cause import Cause
from coopqp.control.interface import Status
from coopqp.control.monitoring.commanded import Apart
from coopqp.control.monitoring.watch import Watch
from coopqp.control.speed_override import SpeedOverride
from coopqp.control.step.linearised import LinearisedAnswer, StepInput
from coopqp.model.limits import BindingLimit
from coopqp.spatial import Array


@dataclass(eq=False)
class LoopState:
    """The state that one step hands to the next.

    Attributes:
        q, v, v_before: commanded configuration (nq,), and the velocities of the last two steps (nv,).
        predicted, foreseen: errors foreseen for the next step (N, 6), or None; and the defects of the linearisation
            that the last step made up for (N, 6).
        drift: filtered difference of the object's measured from its commanded error (6,); None before the first
            measurement.
        correcting: off-path twist of the last step (6,), or None where it was negligible.
        clock: the object's clock [s].
        rate, rate_slope: σ of the last step, and its change per second in it [1/s].
        last_dt: its length [s].
        status: its status.
        outdated: by how much the object has gone on under a status that only lasts (:func:`.verdict.lasting`) [s].
        mismatch: of the arms' views of the object, by the start or by shifts of the grasps, as far as it is still to be
            corrected (N, 6); None if nothing is.
        grasp_shift: by how much the grasps have given way so far (N, 6).
        asked_shift: by how much more since the last step, without the mean of all (N, 6); None for nothing.
        latched: keeps the object's measured pose without a jump where other arms hold it than before (6,).
        taken: the clock up to which changes of contact are taken [s].
        started, chain_held: a step was made since the start; the commands had led the arms too far apart in it.
        stride, stride_left, travelled: the end of every so many steps is kept, 0: of none; after how many the next one
            is; clock, σ, joint positions and velocities (nv,) of those that were not read.
        first: no step was made yet on this path.
        lost: the path failed in the last step.
        away: distance of the object as the first arm holds it from a user's own path [m]; infinite at its start.
        fault, fault_arm, fault_cause: why the controller is in fault, by which arm, and the cause; empty,
            −1 and None if it is not.
        reins: override and pause, set by the operator.
    """

    q: Array
    v: Array
    v_before: Array
    predicted: Array | None = None
    foreseen: Array | float = 0.0
    drift: Array | None = None
    correcting: Array | None = None
    clock: float = 0.0
    rate: float = 1.0
    rate_slope: float = 0.0
    last_dt: float = 0.0
    status: Status = Status.TRACKING
    outdated: float = 0.0
    mismatch: Array | None = None
    grasp_shift: Array | float = 0.0
    asked_shift: Array | None = None
    latched: Array | float = 0.0
    taken: float = 0.0
    stride: int = 0
    stride_left: int = 0
    travelled: list[tuple[float, float, Array, Array]] = field(default_factory=list)
    started: bool = False
    chain_held: bool = False
    first: bool = True
    lost: bool = False
    away: float = math.inf
    fault: str = ""
    fault_arm: int = -1
    fault_cause: Cause | None = None
    reins: SpeedOverride = field(default_factory=SpeedOverride)


@dataclass(eq=False)
class Observed:
    """One sample.

    Attributes:
        h: length of the step [s].
        pose: the object's reference.
        carried, errors: poses of the object as each arm carries it, as commanded, and its errors (N, 6).
        watch: result of the supervision.
        apart: how far the commands lead the arms apart.
        measured: the object's measured error (6,); None for the commanded one.
        lost: the path failed.
    """

    h: float
    pose: pin.SE3
    carried: list[pin.SE3]
    errors: Array
    watch: Watch = field(default_factory=Watch)
    apart: Apart = field(default_factory=Apart)
    measured: Array | None = None
    lost: bool = False


@dataclass(eq=False)
class Proposal:
    """A command that is not committed: the step's input, its answer, and what caps the rate."""

    observed: Observed
    given: StepInput
    found: LinearisedAnswer
    binding: tuple[BindingLimit, ...]
