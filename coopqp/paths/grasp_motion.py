"""How the tools move on the object along a path: grasps that are functions of the object's clock.

Tool k is at ``X_k(τ) = M_k(τ) X_k``, with the grasp's placement ``X_k`` and a motion ``M_k`` in the object frame that
begins at the identity. ``M_k`` consists of pieces ``A S(τ) B`` with constant A and B, where S is a segment of one of
the library's own paths: an arc about a pin at P is ``P S(τ) P⁻¹`` with a turning S. See docs/derivations.md.
"""

from __future__ import annotations

import itertools
from bisect import bisect_right
from dataclasses import dataclass, replace
from functools import cached_property
from typing import final

import numpy as np
import pinocchio as pin

from coopqp.core._core import GRASP_PIECE
from coopqp.paths.joint_path import JointPiece
from coopqp.paths.time_law import TimeLaw
from coopqp.shown import Brief
from coopqp.spatial import Array, adjoint, rotations

#: Where a segment's numbers have its start [s], its duration [s] and its time law.
_START, _DURATION, _LAW = 18, 19, 20
#: Time laws that a motion of a grasp may have: linear, quintic, even acceleration.
LAWS = (0.0, 1.0, 3.0)
#: Twists that differ by more than this make a corner [m/s, rad/s].
_CORNER = 1e-9
#: How far from its grasp a tool may be where it attaches [m, rad].
ATTACH_M, ATTACH_RAD = 0.002, 0.02
#: Drives hand the load over in this time, ahead of a release and after an attachment [s].
HAND_OVER_S = 0.2


@final
@dataclass(frozen=True, eq=False)
class GraspPiece:
    """A piece ``A S(τ) B`` of the motion of one tool on the object; before and after, it rests at its ends.

    Attributes:
        A, B: the constant placements.
        segment: the numbers of S (29,), see :meth:`ObjectPath.packed`.
    """

    A: pin.SE3
    B: pin.SE3
    segment: Array

    @property
    def start(self) -> float:
        """Clock at which it begins [s]."""
        return float(self.segment[_START])

    @property
    def end(self) -> float:
        """Clock at which it ends [s]."""
        return float(self.segment[_START] + self.segment[_DURATION])

    def _share(self, clock: float) -> tuple[float, float]:
        """u and u′ [1/s] of the straight way."""
        s = self.segment
        x, law = (clock - s[_START]) / s[_DURATION], s[_LAW]
        if law != LAWS[2]:
            of = TimeLaw.LINEAR if law == 0.0 else TimeLaw.QUINTIC
            return of.value_at(x), of.slope_at(x) / float(s[_DURATION])
        inside, first = min(max(x, 0.0), 1.0), float(s[21])
        rate = first + 2.0 * (1.0 - first) * x if 0.0 <= x < 1.0 else 0.0
        return float(inside * (first + (1.0 - first) * inside)), float(rate / s[_DURATION])

    def _placed(self, u: float) -> pin.SE3:
        s = self.segment
        return pin.SE3(s[:9].reshape(3, 3).dot(pin.exp3(u * s[12:15])), s[9:12] + u * s[15:18])

    def pose(self, clock: float) -> pin.SE3:
        """M at ``clock`` [s]."""
        return self.A * self._placed(self._share(clock)[0]) * self.B

    def twist(self, clock: float) -> Array:
        """``M′ M⁻¹`` at ``clock``: the twist (6,) [m/s, rad/s] of the tool on the object, in the object frame.

        With the body twist t of S it is ``Ad(A S) t``.
        """
        u, rate = self._share(clock)
        if rate == 0.0:
            return np.zeros(6)
        S, s = self._placed(u), self.segment
        body = np.concatenate([S.rotation.T @ s[15:18], s[12:15]]) * rate
        twist: Array = adjoint(self.A * S) @ body
        return twist


@final
@dataclass(frozen=True, eq=False, repr=False)
class GraspMotion(Brief):
    """The motions of all tools on the object over a path's clock, and which arms hold the object.

    Attributes:
        arms: the pieces of each arm's motion in the order of their clocks; none where its grasp is fixed. Between two
            pieces, and after the last one, a tool rests.
        contact: clocks [s] from which on the arms hold, or not (N,), in their order; the first is at 0.
        attach_m, attach_rad: how far from its grasp a tool may be where it attaches [m, rad].
        led: of each arm the parts on which it follows its joints' own way; empty where no arm does.
    """

    arms: tuple[tuple[GraspPiece, ...], ...]
    contact: tuple[tuple[float, tuple[bool, ...]], ...]
    attach_m: float = ATTACH_M
    attach_rad: float = ATTACH_RAD
    led: tuple[tuple[JointPiece, ...], ...] = ()

    def __len__(self) -> int:
        return len(self.arms)

    @cached_property
    def _starts(self) -> list[list[float]]:
        return [[piece.start for piece in pieces] for pieces in self.arms]

    @property
    def moves(self) -> bool:
        """Whether any tool moves on the object."""
        return any(self.arms)

    def piece(self, k: int, clock: float) -> GraspPiece | None:
        """The piece of arm k at a clock [s], or the one before; None if it has none."""
        pieces = self.arms[k]
        return pieces[max(bisect_right(self._starts[k], clock) - 1, 0)] if pieces else None

    @property
    def leads(self) -> bool:
        """Whether an arm follows its joints' own way somewhere."""
        return any(self.led)

    def leading(self, k: int, clock: float) -> JointPiece | None:
        """The way of its joints that arm k follows at a clock [s]; None where it goes with the object."""
        if not self.led:
            return None
        return next((piece for piece in self.led[k] if piece.start <= clock < piece.end), None)

    def apart(self, clock: float) -> tuple[int, ...]:
        """The arms that follow their joints' own way at a clock [s]."""
        return tuple(k for k in range(len(self.led)) if self.leading(k, clock) is not None)

    def moved(self, k: int, clock: float) -> pin.SE3:
        """M of arm k at ``clock`` [s]."""
        piece = self.leading(k, clock) or self.piece(k, clock)
        return pin.SE3.Identity() if piece is None else piece.pose(clock)

    def placements(self, clock: float) -> tuple[pin.SE3, ...]:
        """M of all arms at ``clock`` [s]."""
        return tuple(self.moved(k, clock) for k in range(len(self)))

    def twists(self, clock: float) -> Array:
        """``M′ M⁻¹`` of all arms at ``clock`` (N, 6) [m/s, rad/s], in the object frame."""
        found = np.zeros((len(self), 6))
        for k in range(len(self)):
            piece = self.leading(k, clock) or self.piece(k, clock)
            if piece is not None:
                found[k] = piece.twist(clock)
        return found

    def shifts(self, clock: float) -> Array:
        """The logarithms of all M at ``clock`` (N, 6) [m, rad], as recordings and monitors take them."""
        return np.array([pin.log6(M).vector for M in self.placements(clock)])

    def holds(self, clock: float) -> tuple[bool, ...]:
        """Which arms hold the object at ``clock`` [s] (N,)."""
        return self.contact[max(bisect_right([at for at, _ in self.contact], clock + 1e-12) - 1, 0)][1]

    @cached_property
    def holding_fixed(self) -> bool:
        """Whether no tool moves on the object while its arm holds it."""
        for k, pieces in enumerate(self.arms):
            moving = [piece for piece in pieces if np.abs(piece.segment[12:18]).max() > 0.0]
            for piece in moving:
                marks = [at for at in self.changes if piece.start < at < piece.end]
                if any(self.holds(clock)[k] for clock in (piece.start, *marks)):
                    return False
        return True

    @cached_property
    def changes(self) -> tuple[float, ...]:
        """Clocks [s] at which other arms hold the object than before."""
        pairs = itertools.pairwise(self.contact)
        return tuple(at for (_, before), (at, holds) in pairs if holds != before)

    @cached_property
    def breakpoints(self) -> tuple[float, ...]:
        """Clocks [s] at which the twist of a tool on the object jumps."""
        found = set[float]()
        for k, pieces in enumerate(self.arms):
            for at in {clock for piece in pieces for clock in (piece.start, piece.end)}:
                before, after = (self.piece(k, clock) for clock in (at - 1e-9, at))
                assert before is not None
                assert after is not None
                if np.abs(after.twist(at + 1e-12) - before.twist(at - 1e-9)).max() > _CORNER + 1e-6:
                    found.add(at)
        found |= {clock for ways in self.led for way in ways for clock in (way.start, way.end)}
        return tuple(sorted(found))

    def section(self, begin: float, end: float) -> GraspMotion:
        """The part from one clock to another [s], over the section's own clock; backwards where it ends before."""
        sense = 1 if end > begin else -1
        low, high = min(begin, end), max(begin, end)
        arms = []
        for k, pieces in enumerate(self.arms):
            touched = [p for p in pieces if p.start < high and p.end > low]
            if pieces and not touched:
                touched = [_still(self.moved(k, begin))]
            made = [GraspPiece(p.A, p.B, of_section(p.segment[None], begin, sense)[0]) for p in touched]
            arms.append(tuple(made[::sense]))
        marks = [(at, holds) for at, holds in self.contact if low < at < high]
        if sense > 0:
            contact = [(0.0, self.holds(begin)), *((at - begin, holds) for at, holds in marks)]
        else:  # what held before each mark holds after it on the way back
            contact = [(0.0, self.holds(begin - 1e-9))]
            contact += [(begin - at, self.holds(at - 1e-9)) for at, _ in reversed(marks)]
        led = tuple(
            tuple(way.section(begin, sense) for way in ways if way.start < high and way.end > low)[::sense]
            for ways in self.led
        )
        return replace(self, arms=tuple(arms), contact=tuple(contact), led=led)

    def still(self, clock: float) -> GraspMotion:
        """All tools at rest on the object where they are at a clock [s]."""
        arms = tuple((_still(self.moved(k, clock)),) if pieces else () for k, pieces in enumerate(self.arms))
        return replace(self, arms=arms, contact=((0.0, self.holds(clock)),), led=())

    def packed(self) -> Array:
        """As numbers for the compiled core: how many pieces each arm has (N), then 53 a piece: A, B, the segment; the
        number of ways of joints, and these.
        """
        every = [piece for pieces in self.arms for piece in pieces]
        rows = np.empty((len(every), GRASP_PIECE))
        for row, p in zip(rows, every, strict=True):
            placed = [x for T in (p.A, p.B) for x in (T.rotation.ravel(), T.translation)]
            row[:] = np.concatenate([*placed, p.segment])
        ways = [way.packed(k) for k, own in enumerate(self.led) for way in own]
        return np.concatenate([[float(len(pieces)) for pieces in self.arms], rows.ravel(), [len(ways)], *ways])


def _still(M: pin.SE3) -> GraspPiece:
    return still_from(0.0, M)


def still_from(clock: float, M: pin.SE3) -> GraspPiece:
    """A piece of a tool that rests at M from a clock on [s]."""
    segment = np.concatenate([np.eye(3).ravel(), np.zeros(9), [clock, 1.0, 1.0], np.zeros(8)])
    return GraspPiece(M, pin.SE3.Identity(), segment)


def of_section(segments: Array, begin: float, sense: int) -> Array:
    """Numbers of segments (n, 29) on a section that begins at a clock [s]; backwards for a sense of −1.

    Time laws are their own mirror images, as is even acceleration.
    """
    made = segments[::sense].copy()
    if sense > 0:
        made[:, _START] -= begin
        return made
    made[:, _START] = begin - (made[:, _START] + made[:, _DURATION])
    even = made[:, _LAW] == LAWS[2]
    made[even, 21] = 2.0 - made[even, 21]
    made[:, :9] = (made[:, :9].reshape(-1, 3, 3) @ rotations(made[:, 12:15])).reshape(-1, 9)
    made[:, 9:12] += made[:, 15:18]
    made[:, 12:18] *= -1.0
    return made
