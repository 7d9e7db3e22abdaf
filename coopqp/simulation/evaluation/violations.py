"""Checks of a monitor: quantities with their bounds; their violations, and the verdict."""

from __future__ import annotations

import enum
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from coopqp.model.cell import RobotCell
from coopqp.spatial import Array


class ViolationKind(enum.Enum):
    """Kind of a violation."""

    FORM = "wrong shape or type"
    NOT_FINITE = "not finite"
    POSITION = "position limit"
    VELOCITY = "velocity limit"
    ACCELERATION = "acceleration limit"
    CONTINUITY = "does not continue the last command"
    CLOCK = "clock and rate disagree"
    RATE = "rate out of range"
    HOLDING = "not at rest while holding"
    CHAIN = "arms out of step"
    PATH = "off the path"
    CLEARANCE = "too close"
    TORQUE = "torque limit"
    SQUEEZE = "internal force"
    FRICTION = "friction of a palm"
    MUTATED = "data were modified"


def owners(cell: RobotCell) -> tuple[list[tuple[str, str]], list[tuple[str, str]]]:
    """Names of the arm and the joint of each joint, and of each arm."""
    return [name.partition("/")[::2] for name in cell.joint_names], [(name, "") for name in cell.arm_names]


class Check(NamedTuple):
    """A quantity of T steps with its bound.

    Attributes:
        kind: kind of its violations.
        values: the quantity of each of K arms or joints (T, K), or of all (T,); NaN is too much.
        bound: the largest value that is allowed.
        who: names of the arm and the joint of each; empty if the quantity concerns all.
        detail: explanation in words.
        rounding: excess over the bound that counts as rounding.
        worst: the field of :class:`Worst` that has the largest value; empty for none.
        largest_only: whether a step has one violation at most, that of the largest value.
    """

    kind: ViolationKind
    values: Array
    bound: float = 0.0
    who: Sequence[tuple[str, str]] = ()
    detail: str = ""
    rounding: float = 0.0
    worst: str = ""
    largest_only: bool = False


@dataclass(frozen=True, slots=True)
class Violation:
    """One violation.

    Attributes:
        kind: kind of the violation.
        step: number of the step since the monitor's reset.
        time: time at the end of the step since the reset [s].
        arm, joint: names of the arm and the joint; empty if the violation concerns all.
        amount: excess over the allowed value [rad, m, rad/s, m/s, N; a share of the limit for accelerations, torques
            and friction].
        detail: explanation in words.
    """

    kind: ViolationKind
    step: int
    time: float
    arm: str = ""
    joint: str = ""
    amount: float = 0.0
    detail: str = ""

    def __str__(self) -> str:
        who = f" {self.arm}{'/' if self.joint else ''}{self.joint}" if self.arm else ""
        more = f" ({self.detail})" if self.detail else ""
        return f"step {self.step} ({self.time:.4f} s):{who} {self.kind.value}, {self.amount:.3g} too much{more}"


@dataclass(frozen=True, kw_only=True)
class Worst:
    """The largest values of a run, inside or outside the tolerances. A negative excess is the distance to the limit.

    Attributes:
        position, velocity: excess over a limit [rad or m, rad/s or m/s]; −inf without limits.
        acceleration: excess over a limit, as a share of the limit.
        chain_m, chain_rad: difference of the commanded object poses of any two arms [m, rad].
        path_m, path_rad: difference of any arm's commanded object pose and the path at the object's clock [m, rad].
        clearance_m: how much closer bodies come than their margin [m].
    """

    position: float = -np.inf
    velocity: float = -np.inf
    acceleration: float = -np.inf
    chain_m: float = 0.0
    chain_rad: float = 0.0
    path_m: float = 0.0
    path_rad: float = 0.0
    clearance_m: float = 0.0


@dataclass(frozen=True)
class Verdict:
    """The result of a monitor.

    Attributes:
        steps: number of checked steps.
        violations: the first violations, at most ``keep`` of :class:`Monitor`.
        counts: total number of violations of each kind.
        worst: the largest values.
    """

    steps: int
    violations: tuple[Violation, ...] = ()
    counts: Mapping[ViolationKind, int] = field(default_factory=lambda: MappingProxyType({}))
    worst: Worst = field(default_factory=Worst)

    @property
    def ok(self) -> bool:
        """True if at least one step was checked and nothing was violated."""
        return self.steps > 0 and not self.counts

    def __str__(self) -> str:
        w = self.worst
        figures = (
            f"{self.steps} steps; chain ≤ {1e3 * w.chain_m:.3g} mm, {np.rad2deg(w.chain_rad):.3g}°; "
            f"path ≤ {1e3 * w.path_m:.3g} mm, {np.rad2deg(w.path_rad):.3g}°"
        )
        if not self.counts:
            return f"kept: {figures}"
        kinds = ", ".join(f"{n} x {kind.value}" for kind, n in self.counts.items())
        return f"violated: {kinds}; {figures}\n" + "\n".join(f"  {v}" for v in self.violations)
