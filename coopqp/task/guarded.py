"""A user's own path, asked with care: whatever it raises or returns, a step gets a pose or a reason."""

from __future__ import annotations

from typing import final

import numpy as np
import pinocchio as pin

from coopqp.checks import NOT_NUMBERS, as_vector
from coopqp.errors import CoopqpError, InvalidInputError
from coopqp.spatial import Array, as_placement
from coopqp.task.path import HoldPath, LinePath, ObjectPath, ServoPath, WaypointPath

#: Entries this large make a pose invalid [m].
FARTHEST = 1e9
#: Breakpoints that are asked for, at most.
_MOST_BREAKPOINTS = 10_000
#: What a user's code may raise.
_RAISED = (
    ArithmeticError, AssertionError, AttributeError, BufferError, LookupError, MemoryError, OSError, RuntimeError,
    SystemError, *NOT_NUMBERS, CoopqpError,
)  # fmt: skip


def is_known(path: ObjectPath) -> bool:
    """Whether the path is one of the library's own, which neither raise nor return nonsense."""
    return isinstance(path, (LinePath, WaypointPath, HoldPath, ServoPath))


@final
class GuardedPath:
    """Poses and twists of a path; of a user's own path checked, with what is wrong in :attr:`problem`."""

    def __init__(self, path: ObjectPath) -> None:
        self.path, self._own = path, not is_known(path)
        self.problem = ""

    def pose(self, clock: float) -> pin.SE3 | None:
        """T_world_object at ``clock`` [s]; None if the path fails, :attr:`problem` says how."""
        if not self._own:
            return self.path.pose(clock)
        self.problem = ""
        try:
            pose = as_placement(self.path.pose(clock), "pose")
        except InvalidInputError as error:
            self.problem = f"the path's pose at its clock {clock:.6g} s is no placement: {error.what}"
        except _RAISED as error:
            self.problem = f"the path raised {type(error).__name__} at its clock {clock:.6g} s: {str(error)[:200]}"
        else:
            if np.abs(pose.translation).max() < FARTHEST:
                return pose
            self.problem = f"the path's pose at its clock {clock:.6g} s is {np.abs(pose.translation).max():.3g} m away"
        return None

    def twist(self, clock: float) -> Array | None:
        """Body twist at ``clock`` [m/s, rad/s]; None if the path fails."""
        if not self._own:
            return self.path.twist(clock)
        try:
            return as_vector(self.path.twist(clock), 6, "twist")
        except InvalidInputError as error:
            self.problem = f"the path's twist at its clock {clock:.6g} s is no twist: {error.what}"
        except _RAISED as error:
            self.problem = f"the path raised {type(error).__name__} at its clock {clock:.6g} s: {str(error)[:200]}"
        return None

    def breakpoints(self) -> list[float]:
        """Clocks at which the twist jumps before the end [s]; none from where the path cannot tell."""
        found: list[float] = []
        clock = 0.0
        while len(found) < _MOST_BREAKPOINTS:
            try:
                ahead = float(self.path.next_breakpoint(clock))
            except _RAISED:
                break
            if not clock < ahead < self.path.duration:
                break
            found.append(ahead)
            clock = ahead
        return found

    def trouble(self, *clocks: float) -> str:
        """Empty, or what is wrong with the path's poses at these clocks."""
        if not self._own:
            return ""
        for clock in clocks:
            if self.pose(clock) is None:
                return self.problem
        return ""

    def check(self, where: str) -> None:
        """Ask a user's path along its duration, before anything moves.

        Raises:
            InvalidInputError: it raises, or returns something else than poses and the twists that belong to them.
        """
        path = self.path
        if not isinstance(path, ObjectPath):
            raise InvalidInputError(f"the path is a {type(path).__name__}", where, "Give an ObjectPath.")
        if not self._own:
            return
        duration = getattr(path, "duration", None)
        if not isinstance(duration, (int, float)) or not duration > 0.0:
            raise InvalidInputError(f"the path's duration is {duration!r}", where, "Give seconds > 0.")
        span = min(float(duration), 1.0)
        for share in (0.0, 0.25, 0.5, 0.75, 1.0) if path.known_ahead else (0.0,):
            clock = share * span
            pose, twist = self.pose(clock), self.twist(clock)
            if pose is None or twist is None:
                raise InvalidInputError(
                    self.problem, where, "pose(clock) gives T_world_object, twist(clock) six numbers."
                )
