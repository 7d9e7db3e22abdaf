"""What is odd about a start: joints outside their limits, arms off the grasp, the object off its path."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from coopqp.control.command import outside_limits
from coopqp.model.cell import RobotCell
from coopqp.model.grasp import Grasp
from coopqp.model.state import CellState
from coopqp.spatial import Array

#: A start this far off the grasp or the path is said [m, rad].
_SAID_FROM = 5e-5, np.deg2rad(5e-3)
#: A path with a square of its speed below this rests [m²/s²].
_STILL = 1e-12


def odd_start(cell: RobotCell, grasp: Grasp, shares: Array, pose: pin.SE3 | None, q: Array) -> tuple[str, ...]:
    """What is odd about a configuration, in words; empty if nothing is.

    Args:
        cell, grasp: what moves, and how it holds.
        shares: of the arms in the common error (N, 6).
        pose: the path's, None if it is not to be judged.
        q: configuration (nq,).
    """
    found = [outside_limits(cell, q)]
    O = grasp.carried(CellState(cell, q))
    reference = O[0] if pose is None else pose
    errors = np.array([pin.log6(reference.actInv(other)).vector for other in O])
    common = (shares * errors).sum(axis=0)
    off = errors - common
    worst = np.linalg.norm(off[:, :3], axis=1) / _SAID_FROM[0] + np.linalg.norm(off[:, 3:], axis=1) / _SAID_FROM[1]
    arm = int(worst.argmax())
    if _off(off[arm]):
        found.append(f"arm {cell.arm_names[arm]} started off its grasp: it is {_off(off[arm])} off")
    if pose is not None and _off(common):
        found.append(f"the object started off its path: it is {_off(common)} off")
    return tuple(words for words in found if words)


def _off(error: Array) -> str:
    """A distance and an angle in words; empty if both are too small to be said."""
    d, a = float(np.linalg.norm(error[:3])), float(np.linalg.norm(error[3:]))
    parts = [f"{1e3 * d:.2f} mm"] if d > _SAID_FROM[0] else []
    parts += [f"{np.rad2deg(a):.2f}°"] if a > _SAID_FROM[1] else []
    return " and ".join(parts)


def rate_into(rate: float, now: Array, ahead: Array, *, length: float) -> float | None:
    """The rate on another path that comes closest to the object's present motion; None if it starts from rest.

    Args:
        rate: σ on the present path.
        now, ahead: twists of both paths at rate 1, in the object's own frame (6,) [m/s, rad/s].
        length: weighs rotation against translation [m].
    """
    metric = np.array([1.0] * 3 + [length**2] * 3)
    before, square = float(now @ (metric * now)), float(ahead @ (metric * ahead))
    if rate == 0.0 or (square < _STILL <= before):
        return None
    if before < _STILL and square < _STILL:  # both rest there, whatever the rate
        return rate
    return min(max(rate * float(ahead @ (metric * now)) / square, 0.0), 1.0)
