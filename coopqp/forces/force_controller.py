"""A cooperative controller whose arms relax the forces between them."""

from __future__ import annotations

import copy
import enum
import math
from collections.abc import Mapping
from typing import Any, final

import numpy as np

from coopqp.checks import ArrayLike, as_options, as_scalar, require
from coopqp.control.command import ControlStep, Status, short_text
from coopqp.control.core.relax_plain import HEARD, SILENT
from coopqp.control.pseudo_inverse import PseudoInverseController
from coopqp.control.qp import QPController
from coopqp.control.turn import alone
from coopqp.errors import InvalidInputError
from coopqp.forces.force_options import ForceOptions
from coopqp.forces.load import LoadShare
from coopqp.forces.palms import least_squeeze, palm_use, squeeze_needed
from coopqp.forces.relaxation import Relaxation
from coopqp.spatial import Array, Placement
from coopqp.task.path import ObjectPath

#: The rate that forces allow falls from 1 to 0 and rises again in these times [s], so that it makes no forces itself.
_FALL, _RISE = 0.6, 2.0
#: Time for which palms press steadily before the object moves [s].
_STEADY = 0.5
#: Share of the squeeze that may be missing when the object begins to move.
_PRESSED = 0.1
#: Share of a palm's friction in use above which the object slows down; at 1 it rests.
_FRICTION_SLOWS = 0.9
#: Palms press at least so many times what the felt load needs, and how fast they press harder [N/s].
_SPARE, _FIRMER = 1.2, 100.0
#: Attributes that a step changes, but those of the relaxation and of the controller within.
_VARYING = (
    "_asked", "_stage", "_since", "_cap", "_rate", "_used", "_pressed", "_needed", "_differences", "_compared", "_last",
    "_fault",
)  # fmt: skip


class _Stage(enum.Enum):
    """What the arms do, in this order."""

    CHECK = "the sensors are compared with the servos"
    PRESS = "the arms press a little to learn how stiff they are"
    RELAX = "the arms relax before the object moves"
    MOVE = "the object moves"


def _is_length(dt: Any) -> bool:
    return isinstance(dt, (int, float)) and 0.0 < dt < math.inf


@final
class ForceController:
    """A cooperative controller whose arms relax the forces between them, see :mod:`coopqp.forces.relaxation`.

    At first the object rests. The sensors are compared with the servos; the arms press a little, to learn how stiff
    they are; they relax. Then the object moves, more slowly where an internal force grows. What holds the object, with
    the reason: a sensor that does not agree with its servos, wrenches that do not come, and a grasp that cannot give
    way any further. :meth:`reset` ends the first two.

    A copy (``copy.copy``, ``copy.deepcopy``, pickle) goes on where the original stands.

    Args:
        controller: the controller that moves the arms: a QPController, or for comparison the PseudoInverseController,
            which cannot pause or take another path. Give commands to this one instead.
        options: settings, or a dictionary of them.

    Attributes:
        cell, grasp, path, dt: as of the controller; the grasp is what the arms are told, without what they give way.
        minds_wrenches: true: :func:`coopqp.simulate` gives it the plant's wrenches.

    Raises:
        InvalidInputError: bad settings, also those with which forces would swing.
    """

    minds_wrenches = True

    def __init__(
        self, controller: QPController | PseudoInverseController, options: ForceOptions | Mapping[str, Any]
    ) -> None:
        kinds = (QPController, PseudoInverseController)
        require(controller, kinds, "ForceController: controller", "Give a QPController or PseudoInverseController.")
        self._build(controller, as_options(ForceOptions, options, "ForceController: options"))

    def _build(self, controller: QPController | PseudoInverseController, options: ForceOptions) -> None:
        self.controller, self.options = controller, options
        self.cell, self.grasp, self.path, self.dt = controller.cell, controller.grasp, controller.path, controller.dt
        self._asked = controller.override
        self._relaxation = Relaxation(
            self.cell,
            self.grasp,
            self.options,
            dt=controller.dt,
            shares=controller.shares,
            kernel=controller.kernel,
        )
        self._check_squeeze()
        self._shifted = controller.take_shift(self._relaxation.shift)
        self._begin()

    def _check_squeeze(self) -> None:
        """Refuse palms that could not hold the object at rest along its path."""
        o = self.options
        if o.palms is None:
            return
        if o.payload is None:
            raise InvalidInputError("palms without a payload", "ForceOptions", "Say what they hold.")
        load, path = LoadShare(self.cell, self.grasp, o.payload, internal_force=o.squeeze), self.path
        clocks = np.linspace(0.0, path.duration, 21) if path.known_ahead and np.isfinite(path.duration) else [0.0]
        least = least_squeeze(o.palms, self.grasp, [load.wrench(path.pose(float(t)).rotation) for t in clocks])
        if o.squeeze < least:
            raise InvalidInputError(
                f"the palms would lose the object: they press with {o.squeeze:g} N, and need {least:.1f} N at least",
                "ForceOptions: squeeze",
                f"Give {1.2 * least:.0f} N or more.",
            )

    def _begin(self) -> None:
        n = len(self.cell)
        self._stage, self._since, self._cap, self._rate = _Stage.CHECK, 0.0, 1.0, 0.0
        self._used, self._pressed, self._needed = 0.0, self.options.squeeze, 0.0
        self._differences, self._compared = np.zeros((n, 6)), 0
        self._last: ControlStep | None = None
        self._fault = ""

    # -- as of the controller ------------------------------------------------------------------------------------

    @property
    def _turn(self) -> Any:
        return self.controller._turn

    @property
    def _qp(self) -> QPController:
        """The controller within, for what only that one can do."""
        controller = self.controller
        if not isinstance(controller, QPController):
            raise InvalidInputError(f"a {type(controller).__name__}", "ForceController", "This needs a QPController.")
        return controller

    def __repr__(self) -> str:
        return short_text(self)

    @alone
    def reset(self, q: ArrayLike, *, clock: float = 0.0) -> None:
        """Start at ``q`` (nq,), at rest; see :meth:`coopqp.QPController.reset`.

        The arms hold the object where they are, as far as the reach of the grasps allows. So no force comes of the
        start itself.

        Raises:
            InvalidInputError: as of the controller; nothing is then changed.
        """
        shift = self._relaxation.found(self.cell.check_configuration(q, "ForceController.reset: q"))
        self.controller.shift_grasp(shift)
        try:
            if clock == 0.0:
                self.controller.reset(q)
            else:  # only a QPController begins in mid-path
                self._qp.reset(q, clock=clock)
            self._relaxation.begin(shift)
            self._begin()
        finally:
            self._shifted = self.controller.take_shift(self._relaxation.shift)
            self._shifted()

    def follow(self, path: ObjectPath, *, clock: float = 0.0) -> None:
        """Take another path; see :meth:`coopqp.QPController.follow`."""
        self._qp.follow(path, clock=clock)
        self.path = path

    def retarget(self, T_world_object: Placement) -> None:
        """Move the target of a servo path; see :meth:`coopqp.QPController.retarget`."""
        self._qp.retarget(T_world_object)

    def set_override(self, share: float) -> None:
        """The largest rate of the object; see :meth:`coopqp.QPController.set_override`."""
        self._asked = as_scalar(share, "set_override: share", open_low=False, high=1.0)

    def pause(self) -> None:
        """Bring the object to rest until :meth:`resume`; the arms go on to relax."""
        self._qp.pause()

    def resume(self) -> None:
        """Go on after :meth:`pause`."""
        self._qp.resume()

    # -- what is felt --------------------------------------------------------------------------------------------

    @property
    def internal(self) -> Array:
        """Internal wrench of each arm on the object, filtered (N, 6) [N, N·m], in the object frame."""
        return self._relaxation.internal.copy()

    @property
    def shift(self) -> Array:
        """By how much each grasp has given way, in the object frame (N, 6) [m, rad]."""
        return self._relaxation.shift.copy()

    @property
    def stiffer(self) -> float:
        """How many times as stiff as said the servos are, as the arms felt it; at least 1."""
        return self._relaxation.stiffer

    # -- the step ------------------------------------------------------------------------------------------------

    @alone
    def step(
        self, q_measured: ArrayLike | None = None, *, wrenches: ArrayLike | None = None, dt: float | None = None
    ) -> ControlStep:
        """The command of one period; see :meth:`coopqp.QPController.step`.

        Args:
            q_measured: measured configuration (nq,). Without it the object does not begin to move.
            wrenches: of the arms on the object, each at the origin and in the axes of its tool (N, 6) [N, N·m]; None or
                NaN where none came.
            dt: length of this step [s], if not the nominal one.

        Raises:
            InvalidInputError: before the first :meth:`reset`, or wrenches of another shape; nothing is then changed.
        """
        w = self._taken(wrenches)
        length = self.dt if dt is None or not _is_length(dt) else float(dt)
        relaxation, last, stage = self._relaxation, self._last, self._stage
        gives = last is not None and (stage is _Stage.MOVE or stage is _Stage.RELAX) and not self._fault
        if gives and last is not None and relaxation.aged:
            relaxation.look(last.q_next)
        heard = relaxation.step(w, length, self._rate if stage is _Stage.MOVE else 0.0, gives)
        if heard == SILENT and not self._fault:
            silent = relaxation.silent
            k = int(silent.argmax())
            self._fault = f"no wrench of arm {self.cell.arm_names[k]} for {1e3 * silent[k]:.0f} ms"
        if stage is not _Stage.MOVE and not self._fault:
            self._prepare(q_measured, length, heard == HEARD)
        if gives or stage is _Stage.PRESS:
            self._shifted()
        share, why = self._share(length)
        if share != self.controller.override:
            self.controller.set_override(share)
        step = self._last = self.controller.step(q_measured, dt=dt)
        self._rate = step.rate
        return self._told(step, why) if why else step

    def _taken(self, wrenches: ArrayLike | None) -> Array | None:
        """The wrenches as an array (N, 6) that the core can read."""
        if wrenches is None:
            return None
        w = np.ascontiguousarray(wrenches, dtype=float)
        n = len(self.cell)
        if w.shape != (n, 6):
            raise InvalidInputError(
                f"wrenches of shape {w.shape}", "ForceController.step: wrenches", f"Give one per arm, ({n}, 6)."
            )
        return w

    def _prepare(self, q_measured: ArrayLike | None, dt: float, heard: bool) -> None:
        """One step of what the arms do before the object moves."""
        o, relaxation = self.options, self._relaxation
        if self._stage is _Stage.CHECK and self._last is not None and heard:
            self._compare(q_measured, self._last.q_next)
            if self._fault:
                return
        self._since += dt
        if self._stage is _Stage.PRESS:
            if relaxation.press(dt):
                self._go_on(_Stage.RELAX)
        elif self._stage is _Stage.RELAX:
            if o.palms is not None and relaxation.size > _PRESSED * o.squeeze:
                self._since = 0.0
            waited = self._since > (2.0 * o.relax_time if o.palms is None else _STEADY)
            if waited and relaxation.size < max(o.move_below, 2.0 * o.dead_band, _PRESSED * o.squeeze):
                self._go_on(_Stage.MOVE)

    def _compare(self, q_measured: ArrayLike | None, commanded: Array) -> None:
        """Compare the sensors with the servos at rest; in the end, say which sensor is wrong."""
        q = None if q_measured is None else np.asarray(q_measured, dtype=float)
        if q is None or q.shape != (self.cell.nq,) or not np.isfinite(q).all():
            return  # the controller says so
        self._differences += self._relaxation.off_servos(commanded, q)
        self._compared += 1
        if self._since < self.options.check_time:
            return
        off = np.linalg.norm(self._differences[:, :3] / self._compared, axis=1)
        k = int(off.argmax())
        if off[k] > self.options.sensor_tolerance and not self._fault:
            self._fault = (
                f"the force sensor of arm {self.cell.arm_names[k]} does not agree with its servos: {off[k]:.0f} N "
                f"apart (tolerance {self.options.sensor_tolerance:g} N)"
            )
        self._go_on(_Stage.PRESS)

    def _go_on(self, stage: _Stage) -> None:
        self._stage, self._since = stage, 0.0

    # -- copies --------------------------------------------------------------------------------------------------

    def __getstate__(self) -> dict[str, Any]:
        own = {name: copy.deepcopy(getattr(self, name)) for name in _VARYING}
        return {
            "controller": self.controller,
            "options": self.options,
            "own": own,
            "relaxation": copy.deepcopy(self._relaxation.memory()),
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        self._build(state["controller"], state["options"])
        vars(self).update(state["own"])
        self._relaxation.restore(state["relaxation"])
        self._shifted()

    def __copy__(self) -> ForceController:
        other = object.__new__(ForceController)
        other.__setstate__(self.__getstate__() | {"controller": copy.copy(self.controller)})
        return other

    # -- how fast, and why ---------------------------------------------------------------------------------------

    def _share(self, dt: float) -> tuple[float, str]:
        """The largest rate of the object now, and why it is less than what the operator asks for."""
        o, size = self.options, self._relaxation.size
        if self._fault:
            return 0.0, self._fault
        if self._stuck:
            return 0.0, f"the grasps cannot give way any further: {self._most()}"
        if self._stage is not _Stage.MOVE:
            return 0.0, f"{self._stage.value}: {self._most()}"
        if o.palms is not None:
            self._press_harder(dt)
            use = palm_use(o.palms, self._relaxation.seen)
            k = int(use.argmax())
            self._used += dt / (dt + o.filter_time) * (min(float(use[k]), 2.0) - self._used)
            if self._used > _FRICTION_SLOWS:
                share = max((1.0 - self._used) / (1.0 - _FRICTION_SLOWS), 0.0)
                self._cap = min(max(share, self._cap - dt / _FALL), self._cap + dt / _RISE)
                what = f"{100.0 * self._used:.0f} % of the friction at the palm of arm {self.cell.arm_names[k]}"
                return min(self._cap, self._asked), what
        cap = min(max((o.hold_from - size) / (o.hold_from - o.slow_from), 0.0), 1.0)
        self._cap = min(max(cap, self._cap - dt / _FALL), self._cap + dt / _RISE)
        if self._cap >= self._asked:
            return self._asked, ""
        return self._cap, f"{self._most()} (slower from {o.slow_from:g} N on)"

    def _press_harder(self, dt: float) -> None:
        """Raise the squeeze where the load that is felt needs more; it never falls again."""
        o = self.options
        needed = min(squeeze_needed(o.palms or (), self._relaxation.seen), o.most_squeeze)
        self._needed += dt / (dt + o.filter_time) * (needed - self._needed)
        wanted = min(_SPARE * self._needed, o.most_squeeze)
        if wanted > self._pressed:
            self._pressed = min(wanted, self._pressed + _FIRMER * dt)
            self._relaxation.squeeze(self._pressed / o.squeeze)

    def _most(self) -> str:
        """The largest internal force, and where it is."""
        k = int(np.linalg.norm(self._relaxation.internal[:, :3], axis=1).argmax())
        return f"{self._relaxation.size:.0f} N at the grasp of arm {self.cell.arm_names[k]}"

    @property
    def _stuck(self) -> bool:
        return self._relaxation.saturated and self._relaxation.size > self.options.slow_from

    def _told(self, step: ControlStep, why: str) -> ControlStep:
        """The step with the reason that the forces give."""
        status = step.status
        if (self._fault or self._stuck) and status.precedence < Status.HOLDING.precedence:
            status = Status.HOLDING
        return step.replaced(status=status, reason="; ".join(filter(None, (why, step.reason))))
