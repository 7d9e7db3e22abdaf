"""The cooperative QP controller: the chain holds, the object stays on its path, a command always comes.

A step observes (is the input to be believed, are the arms in step), proposes (the rate that the path ahead allows, what
the step wants, and the strictly ranked answer: the nominal command if it is admissible; else the fastest rate on the
path; else the QP; else the QP whose chain may part; else a synchronised brake) and commits. The compiled core does it
where it can (:mod:`coopqp.control.core`); :mod:`coopqp.control.plain` is its definition. See docs/derivations.md.
"""

from __future__ import annotations

import copy
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, final

import numpy as np
import pinocchio as pin

from coopqp.checks import as_options, as_scalar, require
from coopqp.control.command import ControlStep, amend, check_start, outside_limits
from coopqp.control.constraints import Constraints, listed
from coopqp.control.core import make_loop
from coopqp.control.options import QPOptions
from coopqp.control.plain import PlainLoop, held_at
from coopqp.control.turn import alone
from coopqp.errors import InvalidInputError
from coopqp.model.cell import RobotCell
from coopqp.model.grasp import Grasp
from coopqp.model.state import CellState
from coopqp.spatial import Placement
from coopqp.task.guarded import GuardedPath, is_known
from coopqp.task.path import HoldPath, ObjectPath, ServoPath


@final
class QPController:
    """Cooperative QP controller for any number of arms that hold one object.

    A copy (``copy.copy``, ``copy.deepcopy``, pickle) goes on bit for bit where the original stands, with another solver
    than the default one up to the solver's accuracy. ``copy.copy`` shares a path and constraints of the user's own.

    Args:
        cell, grasp, path: what moves, how it holds, and where to.
        dt: nominal length of a step [s].
        options: settings, or a dictionary of them.
        constraints: further constraints, see :class:`coopqp.VelocityConstraint` and :class:`coopqp.RateBound`.

    Attributes:
        kernel: what runs a step: "compiled" or "plain".
        solver: name of the solver that a QP step uses.

    Raises:
        InvalidInputError, UnknownNameError, MissingExtraError: bad settings, an unknown or missing solver, a path or a
            constraint that is none.
    """

    def __init__(
        self,
        cell: RobotCell,
        grasp: Grasp,
        path: ObjectPath,
        *,
        dt: float,
        options: QPOptions | Mapping[str, Any] | None = None,
        constraints: Sequence[Any] = (),
    ) -> None:
        require(grasp, Grasp, "QPController: grasp", "Give a Grasp of the placements.")
        grasp.check_arms(cell)
        GuardedPath(path).check("QPController: path")
        self._build(cell, grasp, path, dt, options, constraints)

    def _build(
        self,
        cell: RobotCell,
        grasp: Grasp,
        path: ObjectPath,
        dt: float,
        options: QPOptions | Mapping[str, Any] | None,
        constraints: Sequence[Any],
    ) -> None:
        self.cell, self.grasp, self.path = cell, grasp, path
        self.dt = as_scalar(dt, "QPController: dt")
        self.options = as_options(QPOptions, options, "QPController: options")
        self.constraints = listed(constraints)
        self._checked = Constraints(cell, self.constraints)
        self._loop = make_loop(cell, grasp, dt=self.dt, options=self.options, constraints=self._checked)
        self.kernel, self.solver = self._loop.kernel, self._loop.solver.name
        self._started = self._outside = False
        self._take(path)

    @property
    def _turn(self) -> Any:
        return self._loop

    def _take(self, path: ObjectPath) -> None:
        self.path = path
        self._loop.follow(path)
        self._find_fast_step()

    def _find_fast_step(self) -> None:
        path = self.path
        #: The core's own step, where nothing needs Python.
        self._fast: Callable[[Any, Any], ControlStep | None] | None = None
        if (
            self._started
            and not self._outside
            and not isinstance(self._loop, PlainLoop)
            and is_known(path)
            and not self.constraints
        ):
            self._fast = self._loop.step

    # -- starting --------------------------------------------------------------------------------------------------

    @alone
    def reset(self, q: Any) -> None:
        """Start at ``q`` (nq,), at rest, the object's clock at 0; ends a fault. Errors as :class:`Controller`.

        A later reset with a :class:`ServoPath` starts where the arms hold the object, and rests there until the next
        target. With any other path the arms have to be at its start: :meth:`follow` one that starts where they are.
        """
        o = self.options
        again = self._started and isinstance(self.path, ServoPath)
        path = HoldPath(self._held_at(q)) if again else self.path
        start = check_start(
            self.cell, self.grasp, path, q, tolerance_m=o.start_tolerance_m, tolerance_rad=o.start_tolerance_rad
        )
        self._checked.check(start, self.dt)
        if isinstance(self.path, ServoPath) and again:
            self.path.restart(path.pose(0.0))
        self._started, self._outside = True, bool(outside_limits(self.cell, start))
        self._loop.start(start)
        self._take(self.path)
        self._loop.start_path(rate=self._first_rate())

    def _first_rate(self) -> float | None:
        """The rate that a path begins with: full where the object rests at its start; None for the loop's own."""
        twist = GuardedPath(self.path).twist(0.0)
        return 1.0 if twist is not None and not np.any(twist) else None

    def _held_at(self, q: Any) -> pin.SE3:
        """Where the arms hold the object at ``q``: by their shares in the common error, from the first one's view."""
        return held_at(self.grasp, self.options.common_error.shares(self.cell), CellState(self.cell, q))

    @alone
    def follow(self, path: ObjectPath) -> None:
        """Go on from the present command along another path, its clock at 0; the motion is not interrupted.

        The path should start where the object is; what is missing is made up for by the path correction.

        Raises:
            InvalidInputError: the path is none; the old one goes on.
        """
        GuardedPath(path).check("follow")
        self._take(path)
        if self._started:
            self._loop.start_path(rate=self._first_rate())

    @alone
    def retarget(self, T_world_object: Placement) -> None:
        """Move the target of a :class:`ServoPath`.

        Raises:
            InvalidInputError: the path is no ServoPath, or the pose is not one; the old target stays.
        """
        if not isinstance(self.path, ServoPath):
            raise InvalidInputError(
                f"the path is a {type(self.path).__name__}", "retarget", "Build the controller with a ServoPath."
            )
        self.path.set_target(T_world_object, clock=self._loop.clock)
        self._loop.look_ahead_again()

    # -- the step --------------------------------------------------------------------------------------------------

    def step(self, q_measured: Any = None, *, dt: float | None = None) -> ControlStep:
        """Compute the command of one period.

        The chain error is taken from the *commanded* configuration and the object's error from the measured one:
        once the object is gripped the measured chain error hides in servo deflection, and feeding it back into an
        integrated command would wind up without bound.

        Args:
            q_measured: measured configuration (nq,); None where commands are followed exactly.
            dt: length of this step [s], if not the nominal one.

        Raises:
            InvalidInputError: before the first :meth:`reset`. Never for run-time data: those lead to a status.
            BusyError: another thread is in a call of this controller; nothing was changed.
        """
        fast = self._fast
        if fast is not None:
            try:
                step = fast(q_measured, dt)
            except (ValueError, TypeError, BufferError):  # q_measured is no plain array
                return self._slow(q_measured, dt)
            return self._finish() if step is None else step
        if not self._started:
            raise InvalidInputError("step before reset", "QPController", "Call reset(q) first.")
        return self._slow(q_measured, dt)

    @alone
    def _finish(self) -> ControlStep:
        assert not isinstance(self._loop, PlainLoop)  # only the core leaves a step open
        return self._loop.finish()

    @alone
    def _slow(self, q_measured: Any, dt: Any) -> ControlStep:
        if isinstance(self._loop, PlainLoop):
            began = time.perf_counter()
            step = self._loop.commit(self._loop.propose(self._loop.observe(q_measured, dt)), began)
        else:
            step = self._loop.careful_step(q_measured, dt)
        if self._outside:  # it started there: say so until it is inside
            where = outside_limits(self.cell, step.q)
            if where:
                amend(step, reason="; ".join(filter(None, (step.reason, where))))
            else:
                self._outside = False
                self._find_fast_step()
        return step

    # -- copies ----------------------------------------------------------------------------------------------------

    @alone
    def __getstate__(self) -> dict[str, Any]:
        names = ("cell", "grasp", "path", "dt", "options", "constraints", "kernel")
        state = {name: getattr(self, name) for name in names}
        return state | {"outside": self._outside, "memory": self._loop.memory() if self._started else None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        kernel, outside, memory = state.pop("kernel"), state.pop("outside"), state.pop("memory")
        self._build(**state)  # the path may fail for a while: that is no reason not to be copied
        if self.kernel != kernel:
            raise InvalidInputError(
                f"the copied controller ran the {kernel} kernel, this one runs the {self.kernel} one",
                "QPController",
                "Build both with the same QPOptions(kernel=…).",
            )
        if memory is not None:
            self._started, self._outside = True, outside
            self._take(self.path)
            self._loop.restore(memory)

    def __copy__(self) -> QPController:
        state = self.__getstate__()
        if isinstance(self.path, ServoPath):  # its target moves
            state["path"] = copy.deepcopy(self.path)
        return self._copied(state)

    def __deepcopy__(self, memo: dict[int, Any]) -> QPController:
        state = self.__getstate__()
        for name in ("path", "constraints"):
            state[name] = copy.deepcopy(state[name], memo)
        return self._copied(state)

    @staticmethod
    def _copied(state: dict[str, Any]) -> QPController:
        other = object.__new__(QPController)
        other.__setstate__(state)
        return other
