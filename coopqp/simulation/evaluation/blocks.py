"""Consecutive steps as arrays, for a monitor that checks many at once; and faults in the form of a step."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from coopqp.control.interface import ControlStep, Status
from coopqp.model.cell import RobotCell
from coopqp.simulation.evaluation.violations import Violation, ViolationKind
from coopqp.simulation.recording.recording import Recording
from coopqp.spatial import Array, Flags


@dataclass(frozen=True, eq=False)
class Block:
    """T consecutive steps as arrays."""

    q: Array  # (T, nq)
    q_next: Array  # (T, nq)
    velocity: Array  # (T, nv)
    dt: Array  # (T,)
    clock: Array  # (T,)
    clock_next: Array  # (T,)
    rate: Array  # (T,)
    sense: Array  # (T,): 1 along the path, −1 back, 0 away from it, by hand
    holding: Flags  # (T,)
    same_path: Flags  # (T,): the clock continues from the step before
    reference: Array  # (T, 4, 4): pose of the path at clock_next
    duration: Array  # (T,)
    shift: Array | None = None  # (T, N, 6): of the grasps at q_next


def sound_steps(r: Recording, part: slice) -> Flags:
    """Whether the numbers of steps are finite."""
    samples = slice(part.start, part.stop + 1)
    sound = np.isfinite(r.q_command[samples]).all(axis=1) & np.isfinite(r.clock[samples])
    sound &= np.isfinite(r.time[samples])
    return sound[:-1] & sound[1:] & np.isfinite(r.velocity[part]).all(axis=1) & np.isfinite(r.rate[part])


def recorded_block(r: Recording, start: int, end: int, *, goes_on: bool) -> Block:
    """Steps from ``start`` up to ``end``; ``goes_on``: the first one continues the step before."""
    cut, ends = slice(start, end), slice(start + 1, end + 1)
    same_path = np.full(end - start, True)
    same_path[0] = goes_on
    return Block(
        q=r.q_command[cut],
        q_next=r.q_command[ends],
        velocity=r.velocity[cut],
        dt=np.diff(r.time[start : end + 1]),
        clock=r.clock[cut],
        clock_next=r.clock[ends],
        rate=r.rate[cut],
        sense=_sense(r, cut, ends),
        holding=np.isin(r.status[cut], (Status.HOLDING.code, Status.FAULT.code)),
        same_path=same_path,
        reference=r.reference[ends],
        duration=np.full(end - start, float(r.metadata.get("duration") or np.inf)),
        shift=None if r.shift is None else r.shift[cut],
    )


def _sense(r: Recording, cut: slice, ends: slice) -> Array:
    """1 along the path, −1 where the clock falls, 0 by hand."""
    senses: Array = np.where(r.clock[ends] < r.clock[cut], -1.0, 1.0)
    senses[r.status[cut] == Status.JOGGING.code] = 0.0
    return senses


def faults_of(step: ControlStep, cell: RobotCell, number: int, now: float) -> list[Violation]:
    """Wrong shapes and types of a step, and numbers that are not finite."""
    faults = []
    for name, size in (("q", cell.nq), ("q_next", cell.nq), ("velocity", cell.nv)):
        value = getattr(step, name)
        if not isinstance(value, np.ndarray) or value.dtype != np.float64 or value.shape != (size,):
            faults.append(Violation(ViolationKind.FORM, number, now, detail=f"{name} of shape ({size},)"))
        elif not np.isfinite(value).all():
            bad = int(np.flatnonzero(~np.isfinite(value))[0])
            arm, _, joint = cell.joint_names[bad].partition("/") if name == "velocity" else ("", "", "")
            faults.append(Violation(ViolationKind.NOT_FINITE, number, now, arm, joint, np.nan, f"{name}[{bad}]"))
    for name in ("dt", "clock", "clock_next", "rate"):
        value = getattr(step, name)
        if not isinstance(value, float):
            faults.append(Violation(ViolationKind.FORM, number, now, detail=f"{name} is no float"))
        elif not math.isfinite(value):
            faults.append(Violation(ViolationKind.NOT_FINITE, number, now, amount=np.nan, detail=name))
    if step.sense not in (-1, 0, 1):
        faults.append(Violation(ViolationKind.FORM, number, now, detail="sense is not -1, 0 or 1"))
    if not isinstance(step.status, Status) or not isinstance(step.reason, str):
        faults.append(Violation(ViolationKind.FORM, number, now, detail="status or reason"))
    return faults
