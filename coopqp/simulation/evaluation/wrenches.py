"""Forces and torques of a run, and the bounds of the arms' wrenches; computed in another way than a controller's."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from coopqp.checks import as_tuple, keep_scalars
from coopqp.errors import CoopqpError, InvalidInputError
from coopqp.forces.grips import Grip
from coopqp.model.cell import RobotCell
from coopqp.model.grasp import Grasp
from coopqp.simulation.evaluation.violations import Check, ViolationKind, owners
from coopqp.simulation.recording.recording import Recording, RecordingError
from coopqp.spatial import Array

#: Weight of torques against forces where a load is shared [1/m].
_TORQUE = 10.0


@dataclass(frozen=True, kw_only=True, eq=False)
class WrenchBounds:
    """Bounds of the wrenches of the arms on the object while it moves.

    Attributes:
        internal_force: largest internal force of an arm: its force less its share of the load [N].
        palms: one palm per arm, which must stay inside its friction cone and on its pad; None for grips.

    Raises:
        InvalidInputError: a force that is not positive, or a grip that is no palm.
    """

    internal_force: float = math.inf
    palms: tuple[Grip, ...] | None = None

    def __post_init__(self) -> None:
        if self.internal_force != math.inf:
            keep_scalars(self, "internal_force")
        if self.palms is not None:
            palms = as_tuple(self.palms, "WrenchBounds: palms", "Give one Grip per arm.")
            object.__setattr__(self, "palms", palms)
            if any(getattr(palm, "kind", None) != "palm" for palm in palms):
                raise InvalidInputError("no palm", "WrenchBounds: palms", 'Give Grip(kind="palm", …) for each arm.')

    def check_arms(self, arms: int) -> None:
        """Check that there is one palm for each arm.

        Raises:
            InvalidInputError: another number of palms.
        """
        if self.palms is not None and len(self.palms) != arms:
            raise InvalidInputError(f"{len(self.palms)} palms for {arms} arms", "WrenchBounds", "Give one per arm.")


def internal_forces(grasp: Grasp, wrenches: Array) -> Array:
    """Sizes (…, N) [N] of forces: of wrenches (…, N, 6) at the tools, less the least ones that carry the same load."""
    metric = np.tile([1.0] * 3 + [_TORQUE**2] * 3, len(grasp))[:, None]
    maps = np.hstack([X.actionInverse.T for X in grasp.T_object_tool])
    flat = wrenches.reshape(-1, len(metric)).T
    carried = maps.T @ np.linalg.solve((maps / metric.T) @ maps.T, maps @ flat) / metric
    size: Array = np.linalg.norm((flat - carried).T.reshape(wrenches.shape)[..., :3], axis=-1)
    return size


def friction_use(palms: Sequence[Grip], wrenches: Array) -> Array:
    """Share of each palm's friction and pad that wrenches (…, N, 6) use (…, N); inf where a palm does not press.

    It is the larger of Howe and Cutkosky's ellipsoid and of the pressure at the pad's edge.
    """
    out = np.empty(wrenches.shape[:-1])
    for k, palm in enumerate(palms):
        n, f, m = np.asarray(palm.normal), wrenches[..., k, :3], wrenches[..., k, 3:]
        pressed, across, tilting = f @ n, np.linalg.norm(np.cross(n, f), axis=-1), np.zeros(out.shape[:-1])
        if palm.radius > 0.0:
            across = np.hypot(across, m @ n / (2.0 / 3.0 * palm.radius))
            tilting = np.linalg.norm(np.cross(n, m), axis=-1) / palm.radius
        with np.errstate(divide="ignore", invalid="ignore"):
            used = np.maximum(across / (float(palm.friction or 0.0) * pressed), tilting / pressed)
        out[..., k] = np.where(pressed > 0.0, used, math.inf)
    return out


def wrench_checks(cell: RobotCell, internal: Array, limit: float, palm_use: Array | None) -> list[Check]:
    """Internal forces (T, N) with their limit [N], and the used friction of palms (T, N); None without palms."""
    arms = owners(cell)[1]
    squeeze = Check(ViolationKind.SQUEEZE, internal, limit, arms, "N")
    if palm_use is None:
        return [squeeze]
    return [squeeze, Check(ViolationKind.FRICTION, palm_use, 1.0, arms, "share of the friction")]


# -- recorded runs -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class RunLoads:
    """Forces and torques after each of the T steps of a run.

    Attributes:
        time: (T,) [s].
        torque_use: share of each joint's largest torque that is used (T, nv); 0 without limit.
        palm_use: share of each palm's friction and pad that is used (T, N); None for grips.
        internal: size of each arm's internal force on the object (T, N) [N].
        internal_limit: the largest accepted one [N]; inf for any.
        moves: index of the first step in which the object moves; T if it never does.
    """

    time: Array
    torque_use: Array
    internal: Array
    internal_limit: float
    moves: int
    palm_use: Array | None = None

    def checks(self, cell: RobotCell) -> list[Check]:
        """The loads with their bounds: torques always, internal forces and palms where the object moves."""
        moving = np.arange(len(self.time))[:, None] >= self.moves
        palm_use = None if self.palm_use is None else np.where(moving, self.palm_use, 0.0)
        return [
            Check(ViolationKind.TORQUE, self.torque_use, 1.0, owners(cell)[0], "share of the limit"),
            *wrench_checks(cell, np.where(moving, self.internal, 0.0), self.internal_limit, palm_use),
        ]


def read_loads(cell: RobotCell, recording: Recording) -> RunLoads | None:
    """The loads of a run; None if it was recorded without them.

    Raises:
        InvalidInputError: the recording is of another cell.
        RecordingError: the entry ``load`` of its metadata is damaged.
    """
    wrenches, torques = recording.wrenches, recording.torques
    if wrenches is None or torques is None or not recording.n_steps:
        return None
    if torques.shape[1] != cell.nv or wrenches.shape[1] != len(cell):
        raise InvalidInputError("forces of another cell", "recording", "Use the cell that the run was made with.")
    entry = recording.metadata.get("load", {})
    try:
        given = entry.get("torque_limits") or [None] * cell.nv
        limits = np.array([np.inf if x is None else float(x) for x in given])
        cap = entry.get("internal_force")
        largest = np.inf if cap is None else float(cap)
        palms = None if entry.get("palms") is None else [Grip(**one) for one in entry["palms"]]
        if len(limits) != cell.nv or (palms is not None and [p.kind for p in palms] != ["palm"] * len(cell)):
            raise ValueError("not one limit for each joint, or one palm for each arm")
        use = np.abs(torques) / limits
    except (CoopqpError, TypeError, ValueError, OverflowError, AttributeError) as error:
        raise RecordingError(f"'load' in the recording's metadata is damaged ({error}).") from error
    moving = np.flatnonzero(recording.rate > 0.0)
    return RunLoads(
        time=recording.time[1:],
        torque_use=use,
        internal=internal_forces(recording.grasp, wrenches),
        internal_limit=largest,
        palm_use=None if palms is None else friction_use(palms, wrenches),
        moves=int(moving[0]) if moving.size else recording.n_steps,
    )
