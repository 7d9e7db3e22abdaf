"""The path of a tool that moves on an object that moves, as pieces whose motion has exact bounds.

Where object and tool both move on straight segments over one common share u, the tool's frame is at
``F(u) = R(u) A S(u)``, and its twist and its bounds follow in closed form. That is so where one of them rests, and
where both have the same time law over the same time. Elsewhere only samples are known.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import final

import numpy as np
import pinocchio as pin

from coopqp.constraints.samples import PathSamples
from coopqp.core._core import SEGMENT
from coopqp.model.cell import RobotCell
from coopqp.paths.geometry import MotionBounds, Piece
from coopqp.paths.grasp_motion import GraspPiece
from coopqp.paths.path import ObjectPath
from coopqp.paths.segments import Segments
from coopqp.paths.time_law import TimeLaw
from coopqp.planning.branch_checks import ToolPath, tool_path
from coopqp.spatial import Array, cross, rotations

#: Times that differ by less than this are the same [s].
_SAME = 1e-9


def tools_move(path: ObjectPath) -> bool:
    """Whether tools move on the object along a path."""
    motion = getattr(path, "grasps", None)
    return motion is not None and bool(motion.moves)


def why_no_scene(cell: RobotCell, path: ObjectPath) -> str:
    """Why distances cannot be told along a path; empty where they can: a scene places the object by the first tool."""
    motion = getattr(path, "grasps", None)
    if motion is None or not motion.moves:
        return ""
    if motion.leads:
        return "an arm follows a way of its joints"
    first = f"the tool of arm '{cell.arm_names[0]}' moves on the object, and a scene places the object by it"
    return first if motion.arms[0] else ""


@final
@dataclass(frozen=True, eq=False)
class ToolPiece(Piece):
    """A tool on a straight segment in the object frame, the object on one in the world, from one share u to another.

    ``F(u) = R_0 exp(u φ) … A S_0 exp(u ψ)``: with ``a(u)`` the tool frame's origin in the object frame, linear in u,
    its origin in the world is ``x = p + R a``. With the constant ``ω = R_0 φ`` in the world and w the tool's turning
    in the object frame, constant as well:

        x′ = d + ω × R a + R a′,    x‴ = ω × (ω × (ω × R a)) + 3 ω × (ω × R a′)
        Ω = ω + R w,                Ω′ = ω × R w,    Ω″ = ω × (ω × R w)

    Attributes:
        object: the numbers of the object's segment (29,).
        A: the frame of the tool's motion on the object.
        tool: the numbers of the tool's segment in it (29,).
        X: what comes behind the tool's segment.
        low, high: shares u at both ends.
    """

    object: Array
    A: pin.SE3
    tool: Array
    X: pin.SE3
    low: float
    high: float
    length: float = 1.0

    def _parts(self, s: Array) -> tuple[Array, Array, Array, Array]:
        """u (K,), R (K, 3, 3) of the object, a (K, 3) and the tool's rotation on the object (K, 3, 3)."""
        o, t = self.object, self.tool
        u = self.low + (self.high - self.low) * s / self.length
        R = o[:9].reshape(3, 3) @ rotations(u[:, None] * o[12:15])
        Q = self.A.rotation @ t[:9].reshape(3, 3) @ rotations(u[:, None] * t[12:15])
        origin = self.A.translation + (t[9:12] + u[:, None] * t[15:18]) @ self.A.rotation.T
        return u, R, origin, Q

    def poses(self, s: Array) -> tuple[Array, Array]:
        """See :class:`Piece`."""
        u, R, origin, Q = self._parts(s)
        F = R @ Q
        p = self.object[9:12] + u[:, None] * self.object[15:18] + (R @ origin[:, :, None])[:, :, 0]
        return F @ self.X.rotation, p + F @ self.X.translation

    def _twists_at_frame(self, s: Array) -> tuple[Array, Array, Array]:
        """Twists of the frame F at its origin, their derivatives, and from there to the tool (K, 3), per share u."""
        o, t = self.object, self.tool
        _, R, origin, Q = self._parts(s)
        omega = np.tile(o[:9].reshape(3, 3) @ o[12:15], (len(s), 1))
        moving = np.tile(self.A.rotation @ t[15:18], (len(s), 1))  # a′
        turning = np.tile(self.A.rotation @ t[:9].reshape(3, 3) @ t[12:15], (len(s), 1))  # w
        Ra, Rm, Rw = ((R @ v[:, :, None])[:, :, 0] for v in (origin, moving, turning))
        V = np.hstack([o[15:18] + cross(omega, Ra) + Rm, omega + Rw])
        dV = np.hstack([cross(omega, cross(omega, Ra)) + 2.0 * cross(omega, Rm), cross(omega, Rw)])
        return V, dV, R @ Q @ self.X.translation

    def twists(self, s: Array) -> tuple[Array, Array]:
        """See :class:`Piece`."""
        V, dV, r = self._twists_at_frame(s)
        whirl = cross(V[:, 3:], r)
        V, dV = V.copy(), dV.copy()
        V[:, :3] += whirl
        dV[:, :3] += cross(dV[:, 3:], r) + cross(V[:, 3:], whirl)
        per = (self.high - self.low) / self.length
        return V * per, dV * per**2

    def bounds(self, low: Array, high: Array) -> MotionBounds:
        """See :class:`Piece`.

        With r from F to the tool, of constant length, ``x_t = x + r`` and
        ``r‴ = Ω″ × r + 2 Ω′ × (Ω × r) + Ω × (Ω′ × r) + Ω × (Ω × (Ω × r))``, so ‖r‴‖ ≤ (‖Ω″‖ + 3 ‖Ω′‖ ‖Ω‖ + ‖Ω‖³) ‖r‖.
        """
        o, t = self.object, self.tool
        sizes = (float(np.linalg.norm(v)) for v in (o[12:15], o[15:18], t[15:18], t[12:15], self.X.translation))
        omega, way, moving, turning, r = sizes
        lever = np.maximum(*(np.linalg.norm(self._parts(end)[2], axis=1) for end in (low, high)))  # |a| is convex
        both = omega + turning
        change, change_2 = omega * turning, omega**2 * turning
        per = (self.high - self.low) / self.length
        ones = np.ones(len(low))
        third = omega**3 * lever + 3.0 * omega**2 * moving + (change_2 + 3.0 * change * both + both**3) * r
        return MotionBounds(
            (way + omega * lever + moving + both * r) * per,
            both * per * ones,
            third * per**3,
            change_2 * per**3 * ones,
        )

    def numbers(self) -> Array:
        """See :class:`Piece`: both segments, A and X and the shares, which :func:`piece_of` does not read."""
        placed = [np.append(T.rotation.ravel(), T.translation) for T in (self.A, self.X)]
        return np.concatenate([self.object, self.tool, *placed, [self.low, self.high]])


def tool_on_object(
    path: ObjectPath, samples: PathSamples, k: int, X: pin.SE3, *, begin: float = 0.0, end: float | None = None
) -> ToolPath:
    """The path of tool k, which moves on the object: at knots of pieces that can be proved, else at samples.

    Args:
        path: of the object.
        samples: the path as arm k sees it, see :meth:`PathSamples.of_arm`.
        k: the arm.
        X: its T_object_tool of the grasp.
        begin, end: clocks of a part of the path [s]; by default all of it.
    """
    end = path.duration if end is None else end
    segments = _segments(path, k, X, begin, end)
    if segments is None and (begin > 0.0 or end < path.duration):
        inside = (samples.clocks >= begin - _SAME) & (samples.clocks <= end + _SAME)
        poses = tuple(T for T, here in zip(samples.poses, inside.tolist(), strict=True) if here)
        samples = PathSamples(samples.clocks[inside], poses)
    return tool_path(None, samples, X) if segments is None else tool_path(segments, samples, pin.SE3.Identity())


def _segments(path: ObjectPath, k: int, X: pin.SE3, begin: float, end: float) -> Segments | None:
    numbers, motion = path.packed(), path.grasps
    if numbers is None or motion is None:
        return None
    rows = np.asarray(numbers[3 + int(numbers[1]) :])[: SEGMENT * int(numbers[2])].reshape(-1, SEGMENT)
    pieces = motion.arms[k]
    marks = {begin, end, *rows[:, 18].tolist(), *(c for piece in pieces for c in (piece.start, piece.end))}
    clocks = sorted(clock for clock in marks if begin <= clock <= end)
    clocks = [a for a, b in itertools.pairwise(clocks) if b - a > _SAME] + [end]
    made: list[ToolPiece] = []
    laws: list[_Law] = []
    for a, b in itertools.pairwise(clocks):
        row = rows[max(int(np.searchsorted(rows[:, 18], a + _SAME, side="right")) - 1, 0)]
        piece = motion.piece(k, a + _SAME)
        found = common_share(row, piece, a, b)
        if found is None:
            return None
        (own, tool, low, high), law = found
        A, B = (piece.A, piece.B) if piece is not None else (pin.SE3.Identity(), pin.SE3.Identity())
        made.append(ToolPiece(own, A, tool, B * X, low, high))
        laws.append(law)

    def when(s: Array) -> Array:
        """Clocks [s] at numbers of pieces, and shares of them."""
        i = np.clip(np.floor(s).astype(int), 0, len(made) - 1)
        out = np.empty(len(s))
        for j in np.unique(i).tolist():
            here = i == j
            out[here] = laws[j].clocks(made[j].low + (made[j].high - made[j].low) * (s[here] - j))
        return np.minimum(out, end)

    def where(at: Array) -> Array:
        """Numbers of pieces, and shares of them, at clocks [s]."""
        i = np.clip(np.searchsorted(clocks, at, side="right") - 1, 0, len(made) - 1)
        shares = [
            (laws[j].share(clock) - made[j].low) / (made[j].high - made[j].low)
            for j, clock in zip(i.tolist(), at.tolist(), strict=True)
        ]
        return i + np.clip(shares, 0.0, 1.0)

    starts = np.array(clocks)
    quintic = np.array([law.kind == 1.0 for law in laws])
    return Segments(tuple(made), starts[:-1], np.diff(starts), quintic, when=when, where=where)


@dataclass(frozen=True)
class _Law:
    """A time law of a segment: its number in :meth:`ObjectPath.packed`, start and duration [s], and first speed."""

    kind: float
    start: float
    duration: float
    first: float

    @staticmethod
    def of(segment: Array) -> _Law:
        """That of a segment (29,)."""
        return _Law(*(float(segment[i]) for i in (20, 18, 19, 21)))

    def share(self, clock: float) -> float:
        """u at a clock [s]."""
        x = (clock - self.start) / self.duration
        if self.kind == 3.0:
            x = min(max(x, 0.0), 1.0)
            return x * (self.first + (1.0 - self.first) * x)
        return (TimeLaw.QUINTIC if self.kind == 1.0 else TimeLaw.LINEAR).value_at(x)

    def clocks(self, u: Array) -> Array:
        """Clocks [s] at shares u (K,)."""
        if self.kind == 3.0:  # x (w + (1 − w) x) = u
            w = self.first
            x = 2.0 * u / (w + np.sqrt(np.maximum(w * w + 4.0 * (1.0 - w) * u, 0.0)) + 1e-300)
        else:
            x = TimeLaw.QUINTIC.inverse(u) if self.kind == 1.0 else u
        out: Array = self.start + self.duration * x
        return out


def common_share(
    row: Array, piece: GraspPiece | None, a: float, b: float
) -> tuple[tuple[Array, Array, float, float], _Law] | None:
    """Both segments over one share u, its ends, and its time law. None: there is none.

    What rests from ``a`` to ``b`` [s] stands still at its place.
    """
    moves = [_moves(row, a, b), piece is not None and _moves(piece.segment, a, b)]
    tool = _standing(np.eye(3), np.zeros(3)) if piece is None else piece.segment
    if not moves[0]:
        row = _at_rest(row, a, b)
    if not moves[1] and piece is not None:
        tool = _at_rest(piece.segment, a, b)
    if not any(moves):
        return (row, tool, 0.0, 1.0), _Law(0.0, a, b - a, 0.0)
    leads = row if moves[0] else tool
    other = tool if moves[0] else row
    if all(moves):
        same = leads[20] == other[20] and np.abs(leads[[18, 19, 21]] - other[[18, 19, 21]]).max() < _SAME
        if not same:
            return None
    if leads[20] not in (0.0, 1.0, 3.0):
        return None
    law = _Law.of(leads)
    return (row, tool, law.share(a), law.share(b)), law


def _moves(segment: Array, a: float, b: float) -> bool:
    inside = segment[18] < b - _SAME and segment[18] + segment[19] > a + _SAME
    return bool(inside and np.abs(segment[12:18]).max() > 0.0)


def _at_rest(segment: Array, a: float, b: float) -> Array:
    """A segment that stands where another one is between two clocks outside of its motion."""
    u = 0.0 if segment[18] >= b - _SAME else 1.0
    return _standing(segment[:9].reshape(3, 3) @ pin.exp3(u * segment[12:15]), segment[9:12] + u * segment[15:18])


def _standing(R: Array, p: Array) -> Array:
    return np.concatenate([R.ravel(), p, np.zeros(6), [0.0, 1.0, 0.0], np.zeros(8)])
