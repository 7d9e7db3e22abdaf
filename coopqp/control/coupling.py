"""Two groups of arms with clocks of their own, held together by their overrides: for what needs no micrometres.

Each group is slowed by how far its clock is ahead of the other's. What one does on the part of the other is off by the
difference of the clocks times the speed along the path; each step says how much that is. Whoever needs micrometres puts
all arms into one chain, as a program does: there is one clock then.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import final

import numpy as np

from coopqp.checks import ArrayLike, as_scalar, require
from coopqp.control.interface import ControlStep, amend
from coopqp.control.qp import QPController
from coopqp.errors import InvalidInputError
from coopqp.paths.guarded import GuardedPath
from coopqp.paths.moving_grasps import grasp_at

#: By how much a group may be faster than the other, so that both can speed up, and the gain of their difference [1/s].
_FASTER, _GAIN = 0.02, 20.0
#: A bound below this is not said [m].
_SAID = 1e-6


@final
class Coupling:
    """Two controllers that step together, see :func:`couple`.

    Attributes:
        controllers: the two.
        lag: by how much the clock of the second is behind that of the first [s].
        bound: the lag times the speed of the faster tool along its path [m].
    """

    def __init__(self, controllers: Sequence[QPController]) -> None:
        first, second = self.controllers = tuple(controllers)
        if first is second or first.dt != second.dt:
            raise InvalidInputError(
                "the same controller twice, or steps of two lengths", "couple", "Give two with one dt."
            )
        self._asked, self._rates = 1.0, [0.0, 0.0]
        self.lag = self.bound = 0.0

    def set_override(self, share: float) -> None:
        """The largest rate σ of both, see :meth:`coopqp.QPController.set_override`."""
        self._asked = as_scalar(share, "set_override: share", open_low=False, high=1.0)

    def pause(self) -> None:
        """See :meth:`coopqp.QPController.pause`, for both."""
        for controller in self.controllers:
            controller.pause()

    def resume(self) -> None:
        """See :meth:`coopqp.QPController.resume`, for both."""
        for controller in self.controllers:
            controller.resume()

    def step(
        self, first: ArrayLike | None = None, second: ArrayLike | None = None, *, dt: float | None = None
    ) -> tuple[ControlStep, ControlStep]:
        """A step of both: the reason of each says by how much what they do together may be off.

        Args:
            first, second: measured configurations (nq,) of the two groups, as for :meth:`coopqp.QPController.step`.
            dt: length of the step [s], if not the nominal one.
        """
        made = []
        clocks = [controller.program_clock for controller in self.controllers]
        ends = [controller.path.duration for controller in self.controllers]
        for i, (controller, q) in enumerate(zip(self.controllers, (first, second), strict=True)):
            ahead = clocks[i] - clocks[1 - i]
            waits = clocks[1 - i] < ends[1 - i]  # one that has arrived holds nobody back
            share = self._rates[1 - i] + _FASTER - _GAIN * ahead if waits else 1.0
            controller.lower_rate(min(max(share, 0.0), self._asked))
            made.append(controller.step(q, dt=dt))
        self._rates = [step.rate for step in made]
        self.lag = made[0].clock_next - made[1].clock_next
        self.bound = abs(self.lag) * max(map(_speed, self.controllers, made))
        if self.bound > _SAID:
            for i, step in enumerate(made):
                where = "ahead of" if (self.lag > 0.0) == (i == 0) else "behind"
                said = (
                    f"its clock is {1e3 * abs(self.lag):.2g} ms {where} the other group's: "
                    f"up to {1e3 * self.bound:.2g} mm at this speed"
                )
                amend(step, reason="; ".join(filter(None, (step.reason, said))))
        return made[0], made[1]


def couple(first: QPController, second: QPController) -> Coupling:
    """Hold the clocks of two groups of arms together by their overrides: each waits for the other.

    Both are started (``reset``) before, and step with :meth:`Coupling.step` from then on. Their paths have the same
    clock where they belong together. The coupling sets their overrides, and no gear may.

    Raises:
        InvalidInputError: no two QPControllers with the same length of a step.
    """
    for controller in (first, second):
        require(controller, QPController, "couple", "Give two QPControllers.")
    return Coupling((first, second))


def _speed(controller: QPController, step: ControlStep) -> float:
    """Largest speed of a tool per second of the clock at the end of a step [m/s]."""
    path = GuardedPath(controller.path)
    motion = path.motion(min(step.clock_next, path.duration - 1e-9))
    if motion is None:
        return np.inf
    twists = np.tile(motion, (len(controller.cell), 1)) if motion.ndim == 1 else motion[0] + motion[1:]
    tools = grasp_at(controller.grasp, controller.path, step.clock_next).T_object_tool
    points = np.array([X.translation for X in tools])
    return float(np.linalg.norm(twists[:, :3] + np.cross(twists[:, 3:], points), axis=1).max())
