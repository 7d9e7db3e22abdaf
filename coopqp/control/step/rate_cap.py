"""The largest rate of a step along the path, and the limit that sets it."""

from __future__ import annotations

from typing import final

import numpy as np

from coopqp.control.lookahead.options import PreviewOptions
from coopqp.control.lookahead.preview import PathPreview
from coopqp.control.monitoring.watch import Watch
from coopqp.control.options import QPOptions
from coopqp.control.speed_override import brake_without_horizon
from coopqp.control.step.state import LoopState, Observed
from coopqp.control.step.velocity_bounds import VelocityBox
from coopqp.model.cell import RobotCell
from coopqp.model.limits import BindingLimit, LimitKind
from coopqp.native.constants import BRAKING_SHARE, RATE_ROUNDING

#: The limit that stands for the override.
OVERRIDE = BindingLimit("", "", LimitKind.OVERRIDE)


@final
class RateCap:
    """The largest rate of a step of the plain loop.

    Args:
        cell: the arms.
        box: limits of the joints, which brake ahead of them.
        options: of the controller.
        dt: nominal length of a step [s].

    Attributes:
        slope: largest change of σ by the speed override and of the share of the null-space motion, where no joint
            needs a slower one [1/s].
    """

    def __init__(self, cell: RobotCell, box: VelocityBox, options: QPOptions, *, dt: float) -> None:
        self._cell, self._box = cell, box
        self.slope = (options.preview or PreviewOptions()).slope(accelerates=box.accelerates, dt=dt)
        self._rise = None if options.preview is None else self.slope

    def find(
        self, s: LoopState, seen: Observed, preview: PathPreview | None
    ) -> tuple[float, tuple[BindingLimit, ...], float]:
        """The rate cap of a step, the limits that make it, and the share of their speed that braking joints keep.

        The cap is the least of those by the look-ahead, joints that brake without one, the supervision, the largest
        rise since the last step and the speed override.
        """
        watch, h = seen.watch, seen.h
        cap, keep = 1.0, 1.0
        binding: tuple[BindingLimit, ...] = ()
        if preview is not None:
            cap, ahead = preview.cap(s.clock, h, self._most(s, watch, h))
            if preview.trouble:
                watch.lower(Watch.holding(preview.trouble))
            if ahead is not None:
                binding = (ahead,)
        no_horizon = preview is None or preview.no_horizon
        # A correction that can end within a step need not brake ahead: it would stop and start in turn beside a limit.
        corrects = s.correcting is not None and not self._box.stops_at_once(s.v, h)
        if self._box.accelerates and (no_horizon or corrects):
            keep, late = self._box.brake_share(self._cell.positions(s.q), s.v, h)
            if keep < 1.0 and no_horizon and keep * s.rate < cap:
                cap, binding = keep * s.rate, (self._cell.joint_limit(late, LimitKind.POSITION),)
        if watch.rate_cap < cap:
            cap = watch.rate_cap
            out_of_step = BindingLimit(self._cell.arm_names[watch.arm], "", LimitKind.OUT_OF_STEP)
            binding = () if watch.arm < 0 else (out_of_step,)
        if s.rate < 1.0 and self._rise is not None:
            most, limit = (np.inf, None) if preview is None else preview.rise(s.clock)
            rise = s.rate + min(self._rise, most) * h
            if rise < cap - RATE_ROUNDING:
                cap, binding = rise, () if limit is None or most > self._rise else (limit,)
        by_override = self._by_override(s, h, preview)
        if by_override < cap:
            cap, binding = by_override, (OVERRIDE,)
        return cap, binding, keep

    def _most(self, s: LoopState, watch: Watch, h: float) -> float:
        """A rate that a step will not exceed, whatever the path ahead allows."""
        most, risen = min(watch.rate_cap, max(s.reins.share, s.rate)), s.rate + self.slope * h
        return min(most, risen) if s.rate < 1.0 and risen < 1.0 - RATE_ROUNDING else most

    def _by_override(self, s: LoopState, h: float, preview: PathPreview | None) -> float:
        """The largest rate by the speed override, which is reached as fast as the joints can follow."""
        share = s.reins.share
        if share >= s.rate or not s.v.any():
            return share
        if not self._box.accelerates:
            fall = self.slope
        elif preview is None or preview.no_horizon or not preview.knows:
            fall = brake_without_horizon(s.v, BRAKING_SHARE * self._box.limits.acceleration, s.rate)
        else:
            fall = preview.brake(s.clock, h, s.rate)
        return max(share, s.rate - fall * h)
