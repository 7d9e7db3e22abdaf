"""A program: phases in a row on one clock, as a path of the object with grasps that move."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, final

import numpy as np
import pinocchio as pin

from coopqp.checks import ArrayLike, as_scalar, read_only, require
from coopqp.core._core import SEGMENT
from coopqp.errors import InvalidInputError, UnknownNameError
from coopqp.model.cell import RobotCell
from coopqp.model.grasp import Grasp
from coopqp.model.inverse_kinematics import inverse_kinematics
from coopqp.paths.grasp_motion import ATTACH_M, ATTACH_RAD, GraspMotion, GraspPiece, still_from
from coopqp.paths.guarded import GuardedPath, is_known
from coopqp.paths.joint_path import JointPiece
from coopqp.paths.moving_grasps import HOLD_ON, grasp_at, refuse_motion
from coopqp.paths.path import HoldPath, ObjectPath, SegmentedPath
from coopqp.paths.section import breakpoints
from coopqp.programs.joint_ways import joint_piece
from coopqp.programs.roles import FollowsJoints, Holds, Role, Span, Waits
from coopqp.programs.search import SearchedWay, configuration_at_end
from coopqp.spatial import Array, as_placement

#: Phases may begin this far from where the one before ends [m, rad].
_TOGETHER = 1e-6
#: Twists that differ by more than this make a corner [m/s, rad/s].
_CORNER = 1e-6
#: A time this close to the end of a phase is its end [s].
_END = 1e-12


@final
@dataclass(frozen=True, eq=False)
class Phase:
    """A part of a program.

    Attributes:
        name: for messages.
        path: the object's path in the world, over the phase's own clock; one that is searched; None: it rests.
        arms: what each arm does, by its name; those that are not named hold the object.
        duration: of a phase without a path [s]; by default the longest that a role needs.
        until: the signal that the object waits for at the end of the phase; None for none.
    """

    name: str
    path: ObjectPath | SearchedWay | None = None
    arms: Mapping[str, Role] = field(default_factory=dict)
    duration: float | None = None
    until: str | None = None

    def __post_init__(self) -> None:
        where = f"Phase '{self.name}'"
        if not isinstance(self.name, str) or not self.name:
            raise InvalidInputError(f"its name is {self.name!r}", "Phase", "Give a word or two.")
        if isinstance(self.path, SearchedWay):
            moving = [name for name, role in self.arms.items() if not isinstance(role, (Holds, Waits))]
            if moving:
                raise InvalidInputError(
                    f"its way is searched, and arm '{moving[0]}' moves on the object",
                    where,
                    "Let it move in a phase before or after: here arms hold or wait.",
                )
        elif self.path is not None:
            GuardedPath(self.path).check(f"{where}: path")
            if not (np.isfinite(self.path.duration) and self.path.known_ahead) or self.path.grasps is not None:
                raise InvalidInputError(
                    "its path has no end, is not known ahead, or moves grasps of its own",
                    f"{where}: path",
                    "Give a path of the object that ends.",
                )
        if self.path is not None and self.duration is not None:
            raise InvalidInputError("a path and a duration", where, "Give one of both.")
        if self.duration is not None:
            object.__setattr__(self, "duration", as_scalar(self.duration, f"{where}: duration"))
        for name, role in self.arms.items():
            require(role, Role, f"{where}: arms['{name}']", "Give Holds(), Waits(), Travels(…), Works(…), …")
        if self.until is not None and (not isinstance(self.until, str) or not self.until):
            raise InvalidInputError(f"until is {self.until!r}", where, "Give the name of a signal.")
        object.__setattr__(self, "arms", dict(self.arms))

    @property
    def seconds(self) -> float:
        """Its duration [s].

        Raises:
            InvalidInputError: nothing says how long it is, or a role needs longer.
        """
        if isinstance(self.path, SearchedWay):
            raise InvalidInputError("its way is not searched yet", f"Phase '{self.name}'", "Ask the program's spans.")
        needed = max((role.duration for role in self.arms.values() if role.duration is not None), default=None)
        given = self.duration if self.path is None else float(self.path.duration)
        where = f"Phase '{self.name}'"
        if given is None and needed is None:
            raise InvalidInputError("nothing says how long it is", where, "Give a path, or a duration [s].")
        if given is not None and needed is not None and needed > given + 1e-9:
            raise InvalidInputError(
                f"a tool works for {needed:.4g} s, and the phase is {given:.4g} s long",
                where,
                "Give the phase that duration, or the tool a shorter path.",
            )
        return float(needed if given is None else given)  # type: ignore[arg-type]


@final
@dataclass(frozen=True)
class PhaseSpan:
    """A phase on the program's clock.

    Attributes:
        name: its name.
        start, end: clocks [s].
        holding: names of the arms that hold the object.
        until: the signal that is waited for at its end; None for none.
    """

    name: str
    start: float
    end: float
    holding: tuple[str, ...]
    until: str | None


@final
class Program(SegmentedPath):
    """Phases in a row on one clock: a path of the object on which arms let go, travel, work, or open the part.

    Whatever takes a path takes a program. Motion goes through a phase's end without a stop, unless the object rests
    there or a gate is shut: ``until`` names a signal that :meth:`coopqp.QPController.signal` gives. A signal that is
    given early keeps its gate open.

    Args:
        cell, grasp: the arms, and how they hold the object when the program begins.
        phases: at least one.
        signals: seconds after the start of a run at which signals come by themselves, by name.
        attach_m, attach_rad: how far from its grasp a tool may be where it attaches [m, rad], as the others hold the
            object: measured, or where nothing is measured as commanded. Within, the grip latches where the tool is;
            beyond, the arms hold until the tool is there.
        q_start: configuration (nq,) near the start, for phases that search their ways: they begin in its branches. By
            default any branches in which the arms hold the object where a search begins.

    Attributes:
        phases: as given, with the ways that were searched.
        spans: each phase on the program's clock.

    Raises:
        InvalidInputError: a phase begins where the one before does not end, no arm holds the object, or a role does not
            fit. The message names the phase and the arm.
        UnknownNameError: no such arm, or no gate waits for a signal.
    """

    def __init__(
        self,
        cell: RobotCell,
        grasp: Grasp,
        phases: Sequence[Phase],
        *,
        signals: Mapping[str, float] | None = None,
        attach_m: float = ATTACH_M,
        attach_rad: float = ATTACH_RAD,
        q_start: ArrayLike | None = None,
    ) -> None:
        grasp.check_arms(cell)
        self.attach_m = as_scalar(attach_m, "Program: attach_m")
        self.attach_rad = as_scalar(attach_rad, "Program: attach_rad")
        self.phases = tuple(phases)
        if not self.phases:
            raise InvalidInputError("no phase", "Program", "Give at least one.")
        for phase in self.phases:
            require(phase, Phase, "Program: phases", "Give Phase(…).")
            for name in phase.arms:
                if name not in cell.arm_names:
                    raise UnknownNameError("arm", name, cell.arm_names)
        self._names = tuple(phase.name for phase in self.phases)
        repeated = {name for name in self._names if self._names.count(name) > 1}
        if repeated:
            raise InvalidInputError(
                f"two phases are named '{min(repeated)}'", "Program: phases", "Give each a name of its own."
            )
        self._search(cell, grasp, q_start)
        self._place(cell, grasp)
        if cell.groups:
            refuse_motion(self, "Program", HOLD_ON)
        known = {name for _, name in self.gates}
        for name in signals or {}:
            if name not in known:
                raise UnknownNameError("signal", name, sorted(known))
        times = {n: as_scalar(t, f"Program: signals['{n}']", open_low=False) for n, t in (signals or {}).items()}
        self.signals = times

    def _search(self, cell: RobotCell, grasp: Grasp, q_start: ArrayLike | None) -> None:
        """Search the ways that phases ask for, one after the other."""
        made = list[Phase]()
        for phase in self.phases:
            if isinstance(phase.path, SearchedWay):
                where = f"Program: phase '{phase.name}'"
                q = None if q_start is None else cell.check_configuration(q_start, "Program: q_start")
                if made:
                    before = Program(cell, grasp, made)
                    q = None if q is None else configuration_at_end(cell, grasp, before, q)
                    held, start = before.grasp_at(grasp, before.duration), before.pose(before.duration)
                elif phase.path.start is None:
                    raise InvalidInputError("its way has no start", where, "Give Search(start=T_world_object).")
                else:
                    held, start = grasp, as_placement(phase.path.start, f"{where}: start")
                if q is not None:
                    q = inverse_kinematics(cell, held, start, q)
                phase = replace(phase, path=phase.path.found(cell, held, start, q, where))
            made.append(phase)
        self.phases = tuple(made)

    def _place(self, cell: RobotCell, grasp: Grasp) -> None:
        starts, paths = [0.0], list[ObjectPath]()
        for phase in self.phases:
            seconds = phase.seconds
            assert not isinstance(phase.path, SearchedWay)
            resting = HoldPath(self._begins(paths), duration=seconds) if phase.path is None else phase.path
            self._check_joint(phase, paths, resting)
            paths.append(resting)
            starts.append(starts[-1] + seconds)
        self._paths, self._starts, self.duration = paths, starts[:-1], starts[-1]
        gates = zip(self.phases, starts[1:], strict=True)
        self.gates = tuple((end, phase.until) for phase, end in gates if phase.until is not None)
        self.of_segments = all(is_known(path) and path.packed() is not None for path in paths)
        self.grasps = self._motion(cell, grasp)
        self.spans = tuple(
            PhaseSpan(
                phase.name,
                a,
                b,
                tuple(n for n, h in zip(cell.arm_names, self.grasps.holds(a), strict=True) if h),
                phase.until,
            )
            for phase, a, b in zip(self.phases, starts[:-1], starts[1:], strict=True)
        )
        self._breaks = self._breakpoints()

    def _begins(self, paths: list[ObjectPath]) -> pin.SE3:
        """Where an object that rests in a phase is."""
        if paths:
            return paths[-1].pose(paths[-1].duration)
        for phase in self.phases:
            if isinstance(phase.path, ObjectPath):
                return phase.path.pose(0.0)
        raise InvalidInputError("no phase has a path", "Program", "Give the first one HoldPath(T_world_object).")

    def _check_joint(self, phase: Phase, paths: list[ObjectPath], path: ObjectPath) -> None:
        if not paths:
            return
        before = paths[-1]
        away = np.asarray(pin.log6(before.pose(before.duration).actInv(path.pose(0.0))).vector)
        if np.abs(away).max() > _TOGETHER:
            raise InvalidInputError(
                f"it begins {1e3 * np.linalg.norm(away[:3]):.3g} mm and {np.rad2deg(np.linalg.norm(away[3:])):.3g}° "
                "from where the phase before ends",
                f"Program: phase '{phase.name}'",
                "Begin its path there.",
            )

    def _motion(self, cell: RobotCell, grasp: Grasp) -> GraspMotion:
        n = len(cell)
        moved, pieces = [pin.SE3.Identity()] * n, [list[GraspPiece]() for _ in range(n)]
        led = [list[JointPiece]() for _ in range(n)]
        holding, contact = [True] * n, list[tuple[float, tuple[bool, ...]]]()
        for phase, start in zip(self.phases, self._starts, strict=True):
            after = list(holding)
            for k, name in enumerate(cell.arm_names):
                role = phase.arms.get(name, Holds())
                where = f"Program: phase '{phase.name}', arm '{name}'"
                made = role.pieces(Span(start, phase.seconds, grasp.T_object_tool[k], moved[k], where))
                pieces[k] += made
                if isinstance(role, FollowsJoints):
                    way = joint_piece(self, cell.arms[k], role.path, grasp.T_object_tool[k], moved[k], start, where)
                    led[k].append(way)
                    pieces[k] += [still_from(start, moved[k]), still_from(way.end, way.pose(way.end))]
                    moved[k] = way.pose(way.end)
                if made:
                    moved[k] = made[-1].pose(start + phase.seconds)
                if isinstance(role, Holds) and not holding[k]:
                    raise InvalidInputError(
                        "it does not hold the object when the phase begins",
                        where,
                        "Let it travel to its place in a phase before (Travels), or wait (Waits).",
                    )
                holding[k] = role.holds and holding[k]
                after[k] = holding[k] if role.holds_after is None else role.holds_after
            if not any(holding):
                raise InvalidInputError(
                    "no arm holds the object", f"Program: phase '{phase.name}'", "Let one hold it: Holds()."
                )
            contact.append((start, tuple(holding)))
            holding = after
        contact.append((self.duration, tuple(holding)))
        ways = tuple(map(tuple, led)) if any(led) else ()
        return GraspMotion(tuple(map(tuple, pieces)), tuple(contact), self.attach_m, self.attach_rad, ways)

    def _breakpoints(self) -> list[float]:
        assert self.grasps is not None
        found = set(self.grasps.breakpoints)
        for i, (path, start) in enumerate(zip(self._paths, self._starts, strict=True)):
            found |= {start + clock for clock in breakpoints(path, 0.0, path.duration)}
            if i:
                before, end = self._paths[i - 1], self._paths[i - 1].duration
                jump = path.twist(0.0) - before.twist(end - min(1e-9, 0.5 * end))
                if np.abs(jump).max() > _CORNER:
                    found.add(start)
        return sorted(clock for clock in found if _END < clock < self.duration - _END)

    # -- a path ----------------------------------------------------------------------------------------------------

    def _at(self, clock: float) -> tuple[ObjectPath, float]:
        i = max(bisect_right(self._starts, clock) - 1, 0)
        return self._paths[i], clock - self._starts[i]

    def pose(self, clock: float) -> pin.SE3:
        """T_world_object at ``clock`` [s]."""
        path, local = self._at(clock)
        return path.pose(local)

    def twist(self, clock: float) -> Array:
        """Body twist at ``clock`` [m/s, rad/s]."""
        path, local = self._at(clock)
        return path.twist(local)

    def next_breakpoint(self, clock: float) -> float:
        """See :meth:`ObjectPath.next_breakpoint`."""
        i = bisect_right(self._breaks, clock + 1e-9)
        return self._breaks[i] if i < len(self._breaks) else self.duration

    def packed(self) -> Array | None:
        """The segments of all phases, where all paths are the library's own."""
        return self._numbers if self.of_segments else None

    @cached_property
    def _numbers(self) -> Array:
        rows = []
        for path, start in zip(self._paths, self._starts, strict=True):
            numbers = path.packed()
            assert numbers is not None
            for row in numbers[3 + int(numbers[1]) :][: SEGMENT * int(numbers[2])].reshape(-1, SEGMENT):
                if row[18] < path.duration - _END:
                    made = row.copy()
                    made[18] += start
                    rows.append(made)
        return read_only(np.concatenate([[self.duration, len(self._breaks), len(rows)], self._breaks, *rows]))

    # -- phases ----------------------------------------------------------------------------------------------------

    def phase_at(self, clock: float) -> PhaseSpan:
        """The phase at a clock of the program [s]; at the end of one the next."""
        return self.spans[max(bisect_right(self._starts, clock) - 1, 0)]

    def grasp_at(self, grasp: Grasp, clock: float) -> Grasp:
        """How the tools are placed on the object at a clock [s], beginning with a grasp."""
        return grasp_at(grasp, self, clock)

    def record(self) -> list[dict[str, Any]]:
        """The phases as plain data for JSON: name, start_s, end_s, holding, until."""
        return [
            {"name": s.name, "start_s": s.start, "end_s": s.end, "holding": list(s.holding), "until": s.until}
            for s in self.spans
        ]
