"""The cases of behaviour.py: their runs, and the results of an oracle that is independent of the controllers."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any, Literal, TypeAlias

import numpy as np
import pinocchio as pin

from coopqp import Grasp, LinePath, ObjectPath, RobotCell
from coopqp.errors import MissingExtraError
from coopqp.paths import TimeLaw
from coopqp.scenarios import (
    SCENARIOS,
    Scenario,
    at_limit,
    at_singularity,
    dual_arm7,
    fast_lift,
    mixed_cell,
    panda_bar,
    paper_lift,
    ring,
)
from coopqp.spatial import Array

#: Plain values that identify a run of a case; the run is built from them.
Key: TypeAlias = tuple[Any, ...]

#: Acceleration limit in the cases with a limit [rad/s²].
ACCELERATION = 5.0
#: Grasp mismatch of one slave in its object frame [m]: 5 mm.
MISMATCH = (0.003, 0.004, 0.0)
#: Initial excess of a joint over its limit [rad].
OUTSIDE = 0.010
#: Number of steps that a blocked object waits.
DWELL = 100


@dataclass(frozen=True, kw_only=True, eq=False)
class Run:
    """One run of a case.

    Attributes:
        variant: description in words.
        task: the scenario.
        longest: largest duration of the run [s].
        options: options of the cooperative controller, besides the solver.
        back: after a standstill or at the end of the path, return to the start if the controller can.
        outside: index of the joint that starts outside its limit.
        expected: arm and joints that should block, and the clock of the block [s]; no joints means the whole arm.
        targets: largest values (or truth values) of the record's keys for the cooperative QP.
    """

    variant: str
    task: Scenario
    longest: float
    options: dict[str, Any] = field(default_factory=dict)
    back: bool = False
    outside: int | None = None
    expected: tuple[str, tuple[str, ...], float] | None = None
    targets: dict[str, float | bool] = field(default_factory=dict)


def arms_along(cell: RobotCell, grasp: Grasp, path: ObjectPath, q: Array, clocks: Array) -> Iterator[Array | str]:
    """Configuration at each clock by Newton's method, arm by arm, directly from Pinocchio's frames.

    If an arm cannot follow, its name is the last item.
    """
    data, q = cell.model.createData(), q.copy()
    for clock in clocks:
        for k, targets in enumerate(grasp.tool_targets(path.pose(float(clock)))):
            frame, s = cell.tool_frames[k], cell.v_slices[k]
            for _ in range(8):
                pin.framesForwardKinematics(cell.model, data, q)
                error = pin.log6(data.oMf[frame].actInv(targets)).vector
                if np.abs(error).max() < 1e-9:
                    break
                J = pin.computeFrameJacobian(cell.model, data, q, frame, pin.LOCAL)[:, s]
                v = np.zeros(cell.nv)
                v[s] = np.linalg.lstsq(J, error, rcond=None)[0]
                q = pin.integrate(cell.model, q, v * min(1.0, 0.3 / max(np.abs(v).max(), 1e-12)))
            else:
                yield cell.arm_names[k]
                return
        yield q.copy()


def first_crossing(task: Scenario, step: float = 0.004) -> tuple[str, tuple[str, ...], float]:
    """Arm, joints and clock of the first position limit along the path, by :func:`arms_along`."""
    cell = task.cell
    clocks = np.arange(0.0, task.path.duration, step)
    last = cell.positions(task.q_start)
    for clock, q in zip(clocks, arms_along(cell, task.grasp, task.path, task.q_start, clocks), strict=False):
        if isinstance(q, str):
            return q, (), float(clock)
        x = cell.positions(q)
        over = np.maximum(x - cell.limits.upper, cell.limits.lower - x)
        crossed = np.flatnonzero(over > 0.0)
        if crossed.size:
            share = 1.0 - over[crossed] / np.abs(x - last)[crossed]  # linear interpolation in the last interval
            first = crossed[share < share.min() + 1e-3]  # mirrored arms cross together
            names = [cell.joint_names[j].partition("/") for j in first]
            clock_of = float(clock) - step * (1.0 - float(share.min()))
            return names[0][0], tuple(f"{arm}/{joint}" for arm, _, joint in names), clock_of
        last = x
    raise ValueError("no limit is met along the path")


# -- the cases -------------------------------------------------------------------------------------------------------

_EXACT = {"chain_mm": 1e-3, "path_mm": 1e-3}
_NOMINAL = {"chain_mm": 5e-3, "path_mm": 1e-2, "finished": True}


def _fast(acceleration: float, shortcut: bool) -> Run:
    task = fast_lift()
    name = "" if np.isinf(acceleration) else f", {acceleration:g} rad/s²"
    return Run(
        variant=f"1 rad/s{name}{'' if shortcut else ', QP at every step'}",
        task=replace(task, cell=task.cell.with_limits(acceleration=acceleration)),
        longest=10.0,
        options={} if shortcut else {"shortcut": False},
        targets={**_EXACT, "finished": True},
    )


def _mismatch(acceleration: float) -> Run:
    task = paper_lift(time_law=TimeLaw.QUINTIC)
    tools = list(task.grasp.T_object_tool)
    tools[1] = pin.SE3(np.eye(3), np.array(MISMATCH)) * tools[1]
    cell = task.cell.with_limits(velocity=1.0, acceleration=acceleration)
    return Run(
        variant=f"5 mm, {acceleration:g} rad/s²",
        task=replace(task, grasp=Grasp(tuple(tools)), cell=cell, dt=0.002),
        longest=6.0,
        targets={"chain_final_mm": 1e-3, "chain_rise_mm": 1e-4, "finished": True},
    )


def _outside(joint: int, side: Literal["upper", "lower"], acceleration: float) -> Run:
    task = paper_lift(time_law=TimeLaw.QUINTIC)
    bound = getattr(task.cell.limits, side).copy()
    bound[joint] = task.q_start[joint] + (-OUTSIDE if side == "upper" else OUTSIDE)
    cell = task.cell.with_limits(velocity=1.0, acceleration=acceleration, **{side: bound})
    return Run(
        variant=f"{cell.joint_names[joint]} {side}, {acceleration:g} rad/s²",
        task=replace(task, cell=cell, dt=0.002),
        longest=4.5,
        outside=joint,
        targets={"chain_mm": 0.05, "recovery_ratio": 1.35},
    )


def _limit(number: int) -> Run:
    rng = np.random.default_rng(number)
    rotation = rng.normal(size=3) * (0.5 if number % 2 else 0.0)
    task = at_limit(
        direction=tuple(rng.normal(size=3)),
        rotation=tuple(rotation),
        margin=rng.uniform(0.1, 0.5, size=18),
        acceleration=ACCELERATION,
    )
    expected = first_crossing(task)
    return Run(
        variant=f"direction {number + 1}",
        task=task,
        longest=expected[2] + 2.0,
        expected=expected,
        targets={**_EXACT, "named": True},
    )


def _singular(kind: Literal["wrist", "elbow", "reach"], arm: int, acceleration: float, miss: float) -> Run:
    task = at_singularity(kind, arm, acceleration=acceleration, miss=miss)
    stops = kind != "wrist"
    missed = f", missed by {miss:g} rad" if miss else ""
    return Run(
        variant=f"{kind} of {task.cell.arm_names[arm]}{missed}, {acceleration:g} rad/s²",
        task=task,
        longest=8.0,
        back=True,
        expected=(task.cell.arm_names[arm], (), np.nan) if stops else None,
        targets={"chain_mm": 0.02, "path_mm": 0.01, "came_back": True, **({"named": True} if stops else {})},
    )


#: Target of the cooperative QP's largest ε_p [mm] for N steps.
_EPS_P = {40: 0.003, 400: 3e-6, 1000: 2e-7}


def _paper(steps: int) -> Run:
    task = paper_lift()
    return Run(
        variant=f"N = {steps}",
        task=replace(task, dt=task.path.duration / steps),
        longest=10.0,
        targets={"eps_p_mm": _EPS_P[steps], "finished": True},
    )


def _nominal(make: Callable[..., Scenario], acceleration: float | None, shortcut: bool = True) -> Run:
    task = make()
    if acceleration is not None:
        task = replace(task, cell=task.cell.with_limits(acceleration=acceleration))
    limited = "" if acceleration is None else f", {acceleration:g} rad/s²"
    return Run(
        variant=f"{task.name}{limited}{'' if shortcut else ', QP at every step'}",
        task=task,
        longest=10.0,
        options={} if shortcut else {"shortcut": False},
        targets=dict(_NOMINAL),
    )


_BOTH = (np.inf, ACCELERATION)


def _keys(case: str, quick: bool) -> list[Key]:
    if case == "fast":
        return [(np.inf, True), (np.inf, False)] if quick else [(a, s) for a in _BOTH for s in (True, False)]
    if case == "mismatch":
        return [(a,) for a in _BOTH]
    if case == "outside":
        if quick:
            return [(j, "upper" if j % 2 else "lower", _BOTH[j % 2]) for j in (1, 4, 8, 12)]
        return [(j, side, a) for j in range(18) for side in ("upper", "lower") for a in _BOTH]
    if case == "limit":
        return [(i,) for i in range(50)]
    if case == "singular":
        if quick:
            return [("wrist", 0, np.inf, 0.0), ("elbow", 1, ACCELERATION, 0.0), ("reach", 2, np.inf, 0.0)]
        passing = [("wrist", k, a, m) for k in range(3) for a in _BOTH for m in (0.0, 0.01, 1e-4)]
        return passing + [(kind, k, a, 0.0) for kind in ("elbow", "reach") for k in range(3) for a in _BOTH]
    if case == "paper":
        return [(n,) for n in (40, 400, *([] if quick else [1000]))]
    if case == "redundant":
        robots: list[Callable[..., Scenario]] = [dual_arm7]
        try:
            SCENARIOS["panda_bar"]()
            robots.append(panda_bar)
        except MissingExtraError:
            pass
        return [(make, None) for make in robots] if quick else [(m, a) for m in robots for a in (None, ACCELERATION)]
    make = {"mixed": mixed_cell, "ring": ring}[case]
    return [(make, None)] if quick else [(make, None), (make, ACCELERATION), (make, None, False)]


_BUILD: dict[str, Callable[..., Run]] = {
    "fast": _fast,
    "mismatch": _mismatch,
    "outside": _outside,
    "limit": _limit,
    "singular": _singular,
    "paper": _paper,
    "redundant": _nominal,
    "mixed": _nominal,
    "ring": _nominal,
}
#: The cases, in the order of the runs.
CASES = tuple(_BUILD)


def keys_of(case: str, *, quick: bool) -> list[Key]:
    """The keys of the runs of a case, for :func:`build`."""
    return _keys(case, quick)


def build(case: str, key: Key) -> Run:
    """Build one run."""
    return _BUILD[case](*key)


def way_back(task: Scenario, clock: float) -> LinePath:
    """A path of 2 s from the path's pose at ``clock`` to its start."""
    return LinePath(task.path.pose(clock), task.path.pose(0.0), duration=2.0)
