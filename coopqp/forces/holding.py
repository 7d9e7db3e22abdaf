"""Which arms hold the object, which of them bear its load, and the maps of wrenches and grasps that follow from it.

An arm that does not hold makes no internal force: its sensor reads its tool alone, it has no share of the load, and its
grasp gives way to nothing. The drives hand the load over ahead of a release and after an attachment, in HAND_OVER_S;
so do the shares S here. What an arm still exerts that is to let go is internal, all of it, and is relaxed before.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeAlias, final

import numpy as np
import pinocchio as pin

from coopqp.forces.force_options import ForceOptions
from coopqp.forces.frictional_contacts import palm_rows, pressing
from coopqp.forces.internal import load_shares
from coopqp.model.cell import RobotCell
from coopqp.model.grasp import Grasp
from coopqp.paths.grasp_motion import HAND_OVER_S, GraspMotion
from coopqp.spatial import Array, skew

#: Attributes that change.
_VARYING = ("holds", "bears", "moved", "load_shares", "_goal", "_way", "_left", "_late", "hands_over")
#: A share of the way, and a difference of shares, below which the load has been handed over.
_ROUNDING, _SETTLED = 1e-10, 1e-4
#: Which arms do something (N,); M of each, by which its tool has moved on the object; the arms' shares in the object's
#: pose (N, 6) while some of them hold it.
Holds: TypeAlias = tuple[bool, ...]
Moved: TypeAlias = Sequence[pin.SE3]
SharesOf: TypeAlias = Callable[[Holds], Array]


@final
class Holding:
    """The arms that hold the object, and the maps that follow.

    Args:
        cell, grasp: the arms, and where their tools are on the object at first.
        options: settings.
        shares_of: the shares of the arms in the object's pose.

    Attributes:
        holds: which arms hold the object (N,).
        bears: which arms bear its load, or soon will alone (N,).
        moved: M of each arm, by which its tool has moved on the object; it counts for those that hold.
        grasp: where the tools are that hold.
        hands_over: the load goes over to other arms.
        to_object: wrenches at the tools, to the object frame (6 N, 6 N).
        load_shares: S, the load to its shares in the object frame (6 N, 6).
        relative: displacements of the arms, to displacements of their grasps (6 N, 6 N).
        felt: F, the wrenches that count, in the object frame (6 N, 6 N).
        inward: how the grasps move where the arms press, towards each other (N, 6).
    """

    def __init__(self, cell: RobotCell, grasp: Grasp, options: ForceOptions, shares_of: SharesOf) -> None:
        self._cell, self._options, self._shares_of, n = cell, options, shares_of, len(cell)
        self._nominal = grasp
        self._minded = options.minded(n)
        #: Whether arms keep their places in some directions.
        self.in_part = options.palms is None and not bool(self._minded.all())
        self.start(*everywhere(n))

    def start(self, holds: Holds, bears: Holds, moved: Moved) -> None:
        """These arms hold the object and bear its load, from the start on."""
        self.holds, self.bears, self.moved = holds, bears, moved
        self._place()
        self.load_shares = self._goal = self._late = self._shares()
        self._left, self._way, self.hands_over = 0.0, np.zeros_like(self._goal), False

    def take(self, holds: Holds, bears: Holds, moved: Moved) -> bool:
        """Other arms hold the object from now on, or bear its load; false where nothing changes."""
        changed = holds != self.holds
        if not changed and bears == self.bears:
            return False
        if changed:
            self.holds, self.moved = holds, moved
            self._place()
        self.bears = bears
        self._goal = self._shares()
        free = np.repeat(~np.array(holds), 6)
        if np.any(self.load_shares[free]):  # it let go at once
            self.load_shares = self._goal
            self._late = self._late * ~free[:, None]
        self._left, self._way, self.hands_over = 1.0, self._goal - self.load_shares, True
        return True

    def hand_on(self, dt: float) -> bool:
        """Go on to the shares of the arms that bear the load, for a time [s]; false where that is done."""
        if not self.hands_over:
            return False
        part = min(dt / HAND_OVER_S, self._left)
        self._left -= part if self._left - part > _ROUNDING else self._left
        self.load_shares = self.load_shares + part * self._way if self._left > 0.0 else self._goal
        self._late = self._late + dt / (dt + self._options.filter_time) * (self.load_shares - self._late)
        if not self._left and np.abs(self._late - self._goal).max() < _SETTLED:
            self._late, self.hands_over = self._goal, False
        return True

    @property
    def everywhere(self) -> bool:
        """Whether all arms hold the object."""
        return all(self.holds)

    @property
    def first(self) -> int:
        """The first arm that holds the object."""
        return self.holds.index(True)

    def _place(self) -> None:
        """What follows from the arms that hold, and from where."""
        self.grasp = self._nominal.moved_by(self.moved)
        n, holding = len(self._cell), np.repeat(np.array(self.holds, dtype=float), 6)
        self.to_object = load_shares(self.grasp)[0]
        felt = np.zeros((6 * n, 6 * n))
        for k, (X, mind) in enumerate(zip(self.grasp.T_object_tool, self._minded, strict=True)):
            own = slice(6 * k, 6 * k + 6)
            felt[own, own] = (X.actionInverse.T * mind) @ X.action.T
        self.felt = felt
        if self._options.palms is not None:  # each arm makes up for what its own servos yield: the object stays
            self.relative = np.eye(6 * n)
        else:
            shares = self._shares_of(self.holds)
            self.relative = np.eye(6 * n) - np.tile(np.hstack([np.diag(s) for s in shares]), (n, 1))
        if not self.everywhere:
            self.relative = holding[:, None] * self.relative * holding
        points = np.array([X.translation for X in self.grasp.T_object_tool])
        middle = points[np.array(self.holds)].mean(axis=0)
        inward = np.concatenate([middle - points, np.zeros_like(points)], axis=1)
        moves = self.relative if not self.in_part else self.relative @ self.felt.T
        inward = (moves @ inward.ravel()).reshape(-1, 6)
        self.inward = inward / max(float(np.linalg.norm(inward[:, :3], axis=1).max()), 1e-9)

    def _shares(self) -> Array:
        """S of the arms that bear the load; the others have none."""
        bears = np.array(self.bears)
        if bears.all():
            return load_shares(self.grasp)[1]
        own = Grasp(tuple(X for X, k in zip(self.grasp.T_object_tool, self.bears, strict=True) if k))
        shares = np.zeros((6 * len(bears), 6))
        shares[np.repeat(bears, 6)] = load_shares(own)[1]
        return shares

    def put(self, views: dict[str, Array], pressed: float) -> None:
        """Put the maps into the memory of the relaxation.

        Args:
            views: of the memory, see :func:`coopqp.control.core.force_memory.relaxation_views`.
            pressed: with which the palms press, over the squeeze that is asked for.
        """
        o, n = self._options, len(self._cell)
        total = np.tile(np.eye(6), n)
        kept = np.eye(6 * n) - self.load_shares @ total
        views["holding"][:] = self.holds
        views["internal_of"][:] = self.felt @ kept @ self.to_object
        if o.palms is not None:
            press = o.squeeze * pressing(o.palms) * np.array(self.holds)[:, None]
            views["squeezed"][:] = (views["internal_of"] @ press.ravel()).reshape(-1, 6)
            views["target"][:], views["palms"][:] = pressed * views["squeezed"], palm_rows(o.palms)
        if o.payload is None:
            views["unfed_of"][:] = kept @ self.to_object
        else:
            views["unfed_of"][:] = self.to_object
            views["carries"][:] = self._late @ np.vstack([np.eye(3), skew(o.payload.centre)])

    # -- copies --------------------------------------------------------------------------------------------------

    def kept(self) -> dict[str, Any]:
        """The state of a copy."""
        return {name: getattr(self, name) for name in _VARYING}

    def restore(self, kept: dict[str, Any]) -> None:
        """Go on from what :meth:`kept` returned."""
        vars(self).update(kept)
        self._place()


def everywhere(arms: int) -> tuple[Holds, Holds, Moved]:
    """All arms hold the object, and bear its load, where they held it at first."""
    return (True,) * arms, (True,) * arms, [pin.SE3.Identity()] * arms


def bearing(holds: Holds, motion: GraspMotion, clock: float, sense: int) -> Holds:
    """Which of the arms that hold (N,) bear the load: those that do not let go soon, if there are any.

    Args:
        holds: the arms that hold now.
        motion: of the program.
        clock: of the program [s].
        sense: 1 along the program, −1 back along it, 0 away from it.
    """
    soon = motion.holds(clock + sense * HAND_OVER_S) if sense else holds
    bears = tuple(a and b for a, b in zip(holds, soon, strict=True))
    return bears if any(bears) else holds
