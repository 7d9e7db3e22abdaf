"""What the limits make of one border of the preview's cells, in NumPy: the fallback and oracle of the compiled one."""

from __future__ import annotations

from typing import Protocol, final

import numpy as np

from coopqp.model.cell import JointLimits
from coopqp.spatial import Array


class BorderArrays:
    """The memory of a border.

    Inputs set before each call: ``slope`` q′ and ``before``, that of the border before (nv,), ``positions`` (nv,).
    Constants: ``low``, ``high``, ``per_speed`` 1/(η v_max), ``per_bend`` 1/(κ η a_max), ``acceleration`` η a_max and
    ``slope_change``, what a slope may change by in a cell (nv,); ``caps_speed``, whether the speed limits z.
    Outputs: ``curvature`` q″ (nv,) and ``result``, see the index constants.
    """

    #: Largest |q′|; largest change of a slope, less ``slope_change``; by how much, and where, full rate uses up the
    #: speed and the curvature's share of the acceleration; z_cap; largest |q′| over the acceleration that the curvature
    #: leaves; whether all joints are inside their position limits.
    FASTEST, CHANGE, SPEED_USE, SPEED_JOINT, BEND_USE, BEND_JOINT, CAP, TIGHTEST, INSIDE = range(9)

    def __init__(
        self,
        slope: Array,
        limits: JointLimits,
        *,
        per_speed: Array,
        per_bend: Array,
        acceleration: Array,
        slope_change: Array,
        caps_speed: bool,
    ) -> None:
        self.slope, self.low, self.high = slope, limits.lower, limits.upper
        self.per_speed, self.per_bend = per_speed, per_bend
        self.acceleration, self.slope_change = acceleration, slope_change
        self.caps_speed = caps_speed
        self.before, self.curvature, self.positions = (np.zeros(slope.size) for _ in range(3))
        self.result = np.zeros(9)


class Border(Protocol):
    """One border over such arrays."""

    def __init__(self, arrays: BorderArrays) -> None: ...

    def evaluate(self, span: float) -> None:
        """Curvature and bounds from the slopes at both ends of a cell of ``span`` [s of the clock]."""
        ...


@final
class NumpyBorder:
    """See :class:`Border`."""

    def __init__(self, arrays: BorderArrays) -> None:
        self._arrays = arrays

    def evaluate(self, span: float) -> None:
        """As the protocol says."""
        a = self._arrays
        speed = np.abs(a.slope)
        fastest = float(speed[speed.argmax()])
        np.maximum(speed, np.abs(a.before), out=speed)
        np.divide(a.slope - a.before, span, out=a.curvature)
        bend = np.abs(a.curvature)
        change = bend * span - a.slope_change
        # How often each joint's limit is used up at full rate: z may be 1 over the square, or over the curvature's.
        use_speed, use_bend = speed * a.per_speed, bend * a.per_bend
        j_speed, j_bend = int(use_speed.argmax()), int(use_bend.argmax())
        by_speed, by_bend = float(use_speed[j_speed]), float(use_bend[j_bend])
        cap = 1.0 / max(by_speed * by_speed if a.caps_speed else 0.0, by_bend, 1.0)
        bend *= -cap
        bend += a.acceleration  # what the curvature leaves
        tightest = float((speed / bend).max())
        inside = bool(((a.positions <= a.high) & (a.positions >= a.low)).all())
        a.result[:] = fastest, change.max(), by_speed, j_speed, by_bend, j_bend, cap, tightest, inside
