"""The fastest way through a program: each phase under the limits of all joints, resting objects included.

The parameter is the share u that object and tools have in common (:mod:`coopqp.planning.tools_on_object`), so a phase
in which the object rests and arms move is timed like any other. All come to rest at the end of each phase.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from coopqp.checks import ArrayLike, as_count, as_scalar, require
from coopqp.core._core import FAR_FROM_WAY, SEGMENT
from coopqp.errors import InvalidInputError, UnreachableError
from coopqp.model.batch import ArmKinematics
from coopqp.model.branches import AT_LIMIT
from coopqp.model.cell import RobotCell
from coopqp.model.grasp import Grasp
from coopqp.paths.geometry import PathGeometry, Straight
from coopqp.paths.joint_path import JointPath, JointPiece
from coopqp.paths.path import HoldPath, ObjectPath
from coopqp.paths.timed import SpeedProfile, TimedPath
from coopqp.planning.knots import Knots, arm_knots
from coopqp.planning.parametrise import fastest, require_toppra
from coopqp.planning.timing import SHARE, binding_limits, limits_along, motion_over_clock, use_between
from coopqp.planning.tools_on_object import ToolPiece, common_share
from coopqp.programs.program import Phase, Program
from coopqp.programs.roles import Follows, FollowsJoints, Holds, Role, Waits
from coopqp.spatial import Array

#: Knots of a phase, largest excess of limits between them, and rounds in which knots are added there.
KNOTS, _EXCESS, _ROUNDS = 200, 2e-3, 6
#: How far from a clock both of its sides are seen [s].
_BESIDE = 1e-6
#: Times that differ by less than this are the same [s].
_SAME = 1e-9


@dataclass(frozen=True, eq=False)
class _Stretch:
    """A part of a phase from rest to rest: the pieces of all tools over one share u, and what of it moves."""

    start: float
    end: float
    pieces: tuple[ToolPiece | _JointPart, ...]

    @property
    def moves(self) -> bool:
        return any(isinstance(p, _JointPart) or _object_moves(p) or _tool_moves(p) for p in self.pieces)

    @property
    def bends(self) -> list[float]:
        """Shares at both sides of those where accelerations along a way of joints jump."""
        clocks = [x for p in self.pieces if isinstance(p, _JointPart) and not p.straight for x in p.led.way.clocks]
        shares = [(clock + side * _BESIDE) / (self.end - self.start) for clock in clocks for side in (-1.0, 1.0)]
        return [share for share in shares if 0.0 < share < 1.0]


@dataclass(frozen=True, eq=False)
class _JointPart:
    """A part of a way of an arm's joints over its share u: straight from row to row, or its own clock."""

    led: JointPiece
    start: float
    end: float

    @property
    def straight(self) -> bool:
        return self.led.way.speeds is None

    def motion(self, s: Array) -> tuple[Array, Array, Array]:
        """Positions (K, n) at shares (K,), and their first and second derivatives."""
        first, last = self.led.at(self.start)[0], self.led.at(self.end - _SAME)[0]
        if self.straight:
            ways = np.broadcast_to(last - first, (len(s), len(first)))
            return first + s[:, None] * ways, ways, np.zeros_like(ways)
        span, h = self.end - self.start, 0.1 * _BESIDE
        clocks = (self.start + span * s).tolist()
        x = np.array([self.led.at(clock)[0] for clock in clocks])
        speed = np.array([self.led.at(clock)[1] for clock in clocks])
        sides = [np.array([self.led.at(clock + way)[1] for clock in clocks]) for way in (h, -h)]
        return x, span * speed, span**2 * (sides[0] - sides[1]) / (2.0 * h)


def _object_moves(piece: ToolPiece) -> bool:
    return bool(np.abs(piece.object[12:18]).max() > 0.0)


def _tool_moves(piece: ToolPiece) -> bool:
    return bool(np.abs(piece.tool[12:18]).max() > 0.0)


@dataclass(frozen=True, eq=False)
class _ToolMotion:
    """A tool along a piece, as :func:`coopqp.planning.knots.arm_knots` takes a motion."""

    s: Array
    piece: ToolPiece

    def tool(self, X: pin.SE3) -> tuple[Array, Array, Array]:
        """T_world_tool as rows (K, 12), its twists and their derivatives (K, 6)."""
        del X  # it is in the piece
        R, p = self.piece.poses(self.s)
        return np.concatenate([R.reshape(-1, 9), p], axis=1), *self.piece.twists(self.s)


def time_program(
    cell: RobotCell,
    grasp: Grasp,
    program: Program,
    *,
    q_start: ArrayLike,
    share: float = SHARE,
    knots: int = KNOTS,
) -> Program:
    """The same program with each phase as fast as the joints' speeds and accelerations allow, from rest to rest.

    Args:
        cell, grasp: the arms, and how they hold the object when the program begins.
        program: the program. Its phases need one time law for all that moves in them at a time, as roles have by
            default; a phase with corners comes back as one phase for each part between them, numbered. Arms
            that follow ways of their joints go on with the others, from row to row.
        q_start: configuration (nq,) near its start; it decides the branches.
        share: share of the limits that is used, in (0, 1].
        knots: number of knots of each part.

    Raises:
        InvalidInputError: bad arguments, joints without acceleration limits, or a phase whose motions do not begin and
            end together; the message names it.
        UnreachableError: an arm cannot follow a phase, or leaves its position limits.
        UndecidedError: the parametrisation fails numerically.
        MissingExtraError: toppra is missing: install coopqp[planning].
    """
    where = "time_program"
    require_toppra()
    require(program, Program, f"{where}: program", "Give a Program.")
    grasp.check_arms(cell)
    share, count = as_scalar(share, f"{where}: share", high=1.0), as_count(knots, f"{where}: knots")
    if not np.isfinite(cell.limits.acceleration).all():
        name = cell.joint_names[int(np.flatnonzero(~np.isfinite(cell.limits.acceleration))[0])]
        raise InvalidInputError(
            f"joint {name} has no acceleration limit", where, "Give cell.with_limits(acceleration=…)."
        )
    x, phases = cell.positions(cell.check_configuration(q_start, f"{where}: q_start")), list[Phase]()
    for phase, span in zip(program.phases, program.spans, strict=True):
        parts = _stretches(grasp, program, span.start, span.end, phase.name)
        for i, part in enumerate(parts):
            profile = None
            if part.moves:
                profile, x = _timed(cell, part, x, share, count, phase.name)
            name = phase.name if len(parts) == 1 else f"{phase.name} {i + 1}"
            phases.append(_phase(cell, phase, part, profile, share, name, last=part is parts[-1]))
    reach = {"attach_m": program.attach_m, "attach_rad": program.attach_rad}
    made = Program(cell, grasp, phases, signals=dict(program.signals), **reach)
    made.planned_share = share
    return made


def _stretches(grasp: Grasp, program: Program, start: float, end: float, name: str) -> list[_Stretch]:
    """The parts of a phase."""
    numbers, motion = program.packed(), program.grasps
    if numbers is None or motion is None:
        raise InvalidInputError(
            "its path is not made of straight segments", f"time_program: phase '{name}'", "Give lines or waypoints."
        )
    rows = np.asarray(numbers[3 + int(numbers[1]) :])[: SEGMENT * int(numbers[2])].reshape(-1, SEGMENT)
    marks = {start, end, *rows[:, 18].tolist()}
    moving = [p for pieces in motion.arms for p in pieces if np.abs(p.segment[12:18]).max() > 0.0]
    marks |= {clock for piece in moving for clock in (piece.start, piece.end)}
    marks |= {led.start + rest for ways in motion.led for led in ways for rest in led.way.rests.tolist()}
    clocks = sorted(clock for clock in marks if start - _SAME <= clock <= end + _SAME)
    clocks = [a for a, b in itertools.pairwise(clocks) if b - a > _SAME] + [end]
    found = []
    for a, b in itertools.pairwise(clocks):
        row = rows[max(int(np.searchsorted(rows[:, 18], a + _SAME, side="right")) - 1, 0)]
        pieces = list[ToolPiece | _JointPart]()
        for k, X in enumerate(grasp.T_object_tool):
            if (led := motion.leading(k, a + _SAME)) is not None:
                pieces.append(_JointPart(led, a, b))
                continue
            piece = motion.piece(k, a + _SAME)
            common = common_share(row, piece, a, b)
            A, B = (piece.A, piece.B) if piece is not None else (pin.SE3.Identity(), pin.SE3.Identity())
            if common is None or abs(common[0][2]) > 1e-6 or abs(common[0][3] - 1.0) > 1e-6:
                raise InvalidInputError(
                    "what moves in it does not begin and end together, or not by one time law",
                    f"time_program: phase '{name}'",
                    "Cut it in phases at whose ends all rest.",
                )
            pieces.append(ToolPiece(common[0][0], A, common[0][1], B * X, 0.0, 1.0))
        found.append(_Stretch(a, b, tuple(pieces)))
    return found


def _timed(
    cell: RobotCell, part: _Stretch, x: Array, share: float, count: int, name: str
) -> tuple[SpeedProfile, Array]:
    """The fastest profile over u, and where the joints are at its end (nv,)."""
    s = np.union1d(np.linspace(0.0, 1.0, count), part.bends)
    for _ in range(_ROUNDS):
        knots = _knots(cell, part, s, x, name)
        limited = limits_along(cell, _NO_GRASP, knots, share=share)
        z = fastest(limited)
        over = use_between(limited, z) > 1.0 + _EXCESS
        if not over.any():
            break
        s = np.sort(np.concatenate([s, (s[:-1] + 0.5 * np.diff(s))[over]]))
    names, use = binding_limits(cell, limited, z)
    return SpeedProfile(knots.s, z, tuple(names), use), knots.q[-1]


#: Limits without a payload need no grasp.
_NO_GRASP: Grasp = Grasp((pin.SE3.Identity(),))


def _knots(cell: RobotCell, part: _Stretch, s: Array, x: Array, name: str) -> Knots:
    q = np.tile(x, (len(s), 1))
    slope, curvature = np.zeros_like(q), np.zeros_like(q)
    for arm, own, piece in zip(cell.arms, cell.v_slices, part.pieces, strict=True):
        kinematics = ArmKinematics(arm)
        columns = own.start + kinematics.columns
        if isinstance(piece, _JointPart):
            q[:, columns], slope[:, columns], curvature[:, columns] = piece.motion(s)
            if np.abs(q[0, columns] - x[columns]).max() > FAR_FROM_WAY:
                raise UnreachableError(
                    f"arm '{arm.name}' does not come to the way of its joints in phase '{name}', but to another "
                    "branch. Begin the way where the arm is then, or start from another branch."
                )
            continue
        found = arm_knots(kinematics, piece.X, _ToolMotion(s, piece), x[columns])  # type: ignore[arg-type]
        if found.reached < len(s) - 1:
            raise UnreachableError(
                f"arm '{arm.name}' follows phase '{name}' only to {100.0 * s[max(found.reached, 0)]:.0f} % of its way. "
                "Start from another branch (coopqp.find_start), or change the phase."
            )
        q[:, columns], slope[:, columns], curvature[:, columns] = found.q, found.slope, found.curvature
    outside = np.minimum(q - cell.limits.lower, cell.limits.upper - q)
    outside[:, cell.continuous] = np.inf
    if outside.min() < -AT_LIMIT:
        joint = cell.joint_names[int(outside.min(axis=0).argmin())]
        arm_name, _, own_name = joint.partition("/")
        raise UnreachableError(
            f"arm {arm_name} leaves the limits of {own_name} in phase '{name}'. Start from another branch "
            "(coopqp.find_start), or change the phase."
        )
    return Knots(s, q, slope, curvature)


def _phase(
    cell: RobotCell,
    phase: Phase,
    part: _Stretch,
    profile: SpeedProfile | None,
    share: float,
    name: str,
    *,
    last: bool,
) -> Phase:
    """A part of a phase by its profile; with none it rests as long as before."""
    path, arms = None, dict[str, Role]()
    for arm, piece in zip(cell.arm_names, part.pieces, strict=True):
        role = phase.arms.get(arm, Holds())
        after = role.holds_after if last else None
        if isinstance(piece, _JointPart):
            assert profile is not None
            arms[arm] = FollowsJoints(_joint_path(piece, profile))
            continue
        if profile is not None and _tool_moves(piece):
            arms[arm] = Follows(_along(piece.tool, profile, share), piece.A, holds=role.holds, holds_after=after)
        elif not role.holds:
            still = pin.SE3.Identity()
            arms[arm] = Waits() if after is None else Follows(_resting(part, profile), still, False, after)
        if profile is not None and _object_moves(piece):
            path = _along(piece.object, profile, share)
    seconds = part.end - part.start if profile is None else profile.duration
    until = phase.until if last else None
    return Phase(name, path=path, duration=None if path is not None else seconds, arms=arms, until=until)


def _joint_path(part: _JointPart, profile: SpeedProfile) -> JointPath:
    """A part of a way by a profile over its share."""
    x, slopes, _ = part.motion(profile.s)
    made = motion_over_clock(profile, x, slopes)
    return JointPath.through(made.clocks, made.x, made.slopes)


def _resting(part: _Stretch, profile: SpeedProfile | None) -> ObjectPath:
    seconds = part.end - part.start if profile is None else profile.duration
    return HoldPath(pin.SE3.Identity(), duration=seconds)


def _along(segment: Array, profile: SpeedProfile, share: float) -> TimedPath:
    """A segment by a profile over its share."""
    line = Straight(segment[:9].reshape(3, 3), segment[9:12], segment[12:15], segment[15:18], 1.0)
    return TimedPath(PathGeometry((line,)), profile, planned_share=share)
