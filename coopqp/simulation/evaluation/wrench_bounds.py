"""Bounds of the arms' wrenches on the object, for a monitor; computed in another way than a controller's."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from coopqp.checks import NOT_NUMBERS, ArrayLike, as_floats, as_tuple, keep_scalars
from coopqp.errors import InvalidInputError
from coopqp.simulation.evaluation.violations import ViolationKind
from coopqp.spatial import Array

if TYPE_CHECKING:
    from coopqp.forces.grips import Grip
    from coopqp.model.grasp import Grasp

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


class Excess(NamedTuple):
    """Excesses of wrenches: the kind, the arm's number (−1 for all), the excess, and its unit."""

    kind: ViolationKind
    arm: int
    amount: float
    unit: str


def excesses(bounds: WrenchBounds, grasp: Grasp, wrenches: ArrayLike) -> list[Excess]:
    """Excesses over the bounds in one sample.

    Args:
        bounds: accepted wrenches.
        grasp: placements of the tools.
        wrenches: wrench of each arm on the object, at the origin and in the axes of its tool (N, 6) [N, N·m]; NaN for
            a missing one. The internal forces are checked if none is missing.
    """
    try:
        w = as_floats(wrenches)
    except NOT_NUMBERS:
        w = np.zeros(0)
    if w.shape != (len(grasp), 6):
        return [Excess(ViolationKind.FORM, -1, 0.0, f"wrenches of shape ({len(grasp)}, 6)")]
    came = [bool(np.isfinite(own).all()) for own in w]
    out: list[Excess] = []
    if all(came) and bounds.internal_force < math.inf:
        over: Array = np.linalg.norm(_internal(grasp, w)[:, :3], axis=1) - bounds.internal_force
        out += [Excess(ViolationKind.SQUEEZE, int(k), float(over[k]), "N") for k in np.flatnonzero(over > 0.0)]
    for k, palm in enumerate(bounds.palms or ()):
        used = _used(palm, w[k]) if came[k] else 0.0
        if used > 1.0:
            out.append(Excess(ViolationKind.FRICTION, k, used - 1.0, "share of the friction"))
    return out


def _internal(grasp: Grasp, wrenches: Array) -> Array:
    """Wrenches at the tools less the least ones that carry the same load (N, 6): its normal equations."""
    metric = np.tile([1.0] * 3 + [_TORQUE**2] * 3, len(grasp))
    maps = np.hstack([X.actionInverse.T for X in grasp.T_object_tool])
    carry = np.linalg.solve((maps / metric) @ maps.T, maps @ wrenches.ravel())
    return wrenches - (maps.T @ carry / metric).reshape(-1, 6)


def _used(palm: Grip, wrench: Array) -> float:
    """Share of a palm's friction and pad that is used: Howe and Cutkosky's ellipsoid, and the pressure on the pad."""
    n, f, m = np.asarray(palm.normal), wrench[:3], wrench[3:]
    pressed = float(n @ f)
    if not pressed > 0.0:
        return math.inf
    across, turning, tilting = float(np.linalg.norm(np.cross(n, f))), 0.0, 0.0
    if palm.radius > 0.0:
        turning = float(n @ m) / (2.0 / 3.0 * palm.radius)
        tilting = float(np.linalg.norm(np.cross(n, m))) / palm.radius
    return max(math.hypot(across, turning) / (float(palm.friction or 0.0) * pressed), tilting / pressed)
