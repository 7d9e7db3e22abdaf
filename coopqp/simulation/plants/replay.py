"""Replay of a known joint motion: a recording with another step or time law, or the exact inverse kinematics."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, final

import numpy as np
import pinocchio as pin

from coopqp.checks import as_scalar, as_step
from coopqp.control.interface import ControlStep, Status
from coopqp.errors import InvalidInputError
from coopqp.model.cell import RobotCell
from coopqp.model.chain import Chain
from coopqp.model.grasp import Grasp
from coopqp.model.inverse_kinematics import inverse_kinematics, newton
from coopqp.paths.path import ObjectPath
from coopqp.paths.time_law import TimeLaw, as_time_law
from coopqp.simulation.plants.physics_options import Interpolation
from coopqp.spatial import Array

if TYPE_CHECKING:
    from coopqp.simulation.recording.recording import Recording

#: Function from the object's clock [s] to a configuration (nq,).
Motion = Callable[[float], Array]


@final
class Replay:
    """A :class:`~coopqp.control.interface.Controller` that commands a known motion q(τ), open loop.

    ``time_law="quintic"`` warps the clock τ: the configurations are the same, the start and the end are at rest.

    Args:
        cell, grasp, path: cell, grasp and path of the motion; the path defines the duration.
        motion: function from a clock τ in [0, duration] to a configuration (nq,).
        dt: length of a step [s].
        time_law: time law of the clock; ``"linear"`` keeps the original timing.
    """

    def __init__(
        self,
        cell: RobotCell,
        grasp: Grasp,
        path: ObjectPath,
        motion: Motion,
        *,
        dt: float,
        time_law: TimeLaw | str = TimeLaw.LINEAR,
    ) -> None:
        grasp.check_arms(cell)
        self.cell, self.grasp, self.path = cell, grasp, path
        self.dt, self.time_law = as_step(dt, "Replay: dt"), as_time_law(time_law)
        self._motion = motion
        self._time, self._q = 0.0, np.asarray(motion(0.0), dtype=float)

    def reset(self, q: Any) -> None:
        """Start again at the start of the motion. ``q`` (nq,) is only checked."""
        self.cell.check_configuration(q, "Replay.reset")
        self._time, self._q = 0.0, np.asarray(self._motion(0.0), dtype=float)

    def step(self, q_measured: Any = None, *, dt: float | None = None) -> ControlStep:
        """Command the next step of the motion. ``q_measured`` is not used."""
        h = self.dt if dt is None else as_scalar(dt, "Replay.step: dt")
        before = self._clock(self._time)
        self._time += h
        after = self._clock(self._time)
        q, q_next = self._q, np.asarray(self._motion(after), dtype=float)
        self._q = q_next
        return ControlStep(
            cell=self.cell,
            grasp=self.grasp,
            path=self.path,
            q=q,
            velocity=pin.difference(self.cell.model, q, q_next) / h,
            q_next=q_next,
            dt=h,
            clock=before,
            clock_next=after,
            rate=1.0,
            status=Status.TRACKING,
        )

    def _clock(self, time: float) -> float:
        T = self.path.duration
        return T if T - time < 1e-9 * T else T * self.time_law.value_at(time / T)


def recorded_motion(cell: RobotCell, recording: Recording, *, interpolation: Interpolation = "cubic") -> Motion:
    """q(τ) from the commands of a recording over the object's clock.

    ``"cubic"`` is the piecewise cubic through the commands with slopes by central differences (continuous velocity).

    Raises:
        InvalidInputError: the clock never advances, so q is not a function of it.
    """
    from scipy.interpolate import CubicHermiteSpline, make_interp_spline  # takes long to import

    clock = np.asarray(recording.clock)
    moves = np.concatenate([[True], np.diff(clock) > 0.0])  # leave commands at rest out
    knots, x = clock[moves], cell.positions(np.asarray(recording.q_command)[moves])
    if len(knots) < 2:
        raise InvalidInputError("the clock never advances", "recorded_motion", "Give a recording that moves.")
    x[:, cell.continuous] = np.unwrap(x[:, cell.continuous], axis=0)
    if interpolation == "cubic":
        along = CubicHermiteSpline(knots, x, np.gradient(x, knots, axis=0, edge_order=2 if len(knots) > 2 else 1))
    else:
        along = make_interp_spline(knots, x, k=1)
    return lambda tau: cell.configuration(along(np.clip(tau, knots[0], knots[-1])))


def exact_motion(cell: RobotCell, grasp: Grasp, path: ObjectPath, q_start: Any) -> Motion:
    """q(τ) by inverse kinematics of the path's pose at τ, starting from the last result.

    The motion raises UnreachableError if an arm does not reach its grasp.
    """
    start = cell.check_configuration(q_start, "exact_motion: q_start")
    chain, last = Chain(cell, grasp), start

    def motion(tau: float) -> Array:
        nonlocal last
        pose = path.pose(tau)
        q, errors = newton(chain, pose, start if tau <= 0.0 else last, tolerance=1e-12, max_iter=20)
        if not np.abs(errors).max() <= 1e-9:
            # More iterations, and an error that names the arm.
            q = inverse_kinematics(cell, grasp, pose, last, limits=False)
        last = q
        return q

    return motion
