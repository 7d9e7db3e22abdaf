"""Settings of the cooperative controller."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from coopqp.checks import as_count, as_options, keep_scalars
from coopqp.control.command import START_TOLERANCE_M, START_TOLERANCE_RAD
from coopqp.control.forms import RankWeights
from coopqp.control.solvers import QpSolver
from coopqp.control.supervision import SupervisionOptions
from coopqp.errors import InvalidInputError, UnknownNameError
from coopqp.planning.preview_options import PreviewOptions
from coopqp.task.common_error import CommonError
from coopqp.task.posture import PostureOptions


@dataclass(frozen=True, kw_only=True)
class QPOptions:
    """Settings of the cooperative controller.

    Attributes:
        solver: name of the QP solver, see :func:`coopqp.control.solvers.available_solvers`; ``"auto"`` for the
            :func:`~coopqp.control.solvers.default_solver`; or a solver.
        solver_settings: settings object of the solver of that name.
        grasp_gain, path_gain: K_g, K_p [1/s]; a step never corrects more than the whole error (K dt ≤ 1).
        correction_speed, correction_spin: upper bound of each correction [m/s, rad/s].
        measurement_time: time constant of the filter of the measured object error [s].
        common_error: weights that define the object pose; the first arm defines it by default (master–slave).
        weights: costs of the ranks.
        form: form of the QP, ``"condensed"`` or ``"full"``.
        shortcut: skip the QP if the nominal command or a lower rate on the path is admissible.
        iterations: number of linearisations of a step; use 2 if accuracy matters more than time.
        preview: settings of the path preview; None for no preview.
        posture: goals of the null-space motion of redundant arms.
        supervision: thresholds of the comparison of measured and commanded configurations.
        kernel: ``"auto"`` for the compiled core if it is installed and knows the robot, ``"compiled"`` or ``"plain"``.
        blocked_rate: rate σ below which the object counts as blocked.
        off_path_distance, off_path_angle: distance of the object from its path beyond which its status says so
            [m, rad].
        start_tolerance_m, start_tolerance_rad: accepted error of any arm at reset [m, rad].
    """

    solver: str | QpSolver = "auto"
    solver_settings: Any = None
    grasp_gain: float = 20.0
    path_gain: float = 20.0
    correction_speed: float = 0.1
    correction_spin: float = 0.4
    measurement_time: float = 0.02
    common_error: CommonError = field(default_factory=CommonError.master)
    weights: RankWeights = field(default_factory=RankWeights)
    form: Literal["condensed", "full"] = "condensed"
    shortcut: bool = True
    iterations: int = 1
    preview: PreviewOptions | None = field(default_factory=PreviewOptions)
    posture: PostureOptions = field(default_factory=PostureOptions)
    supervision: SupervisionOptions = field(default_factory=SupervisionOptions)
    kernel: str = "auto"
    blocked_rate: float = 1e-3
    off_path_distance: float = 1e-3
    off_path_angle: float = np.deg2rad(0.1)
    start_tolerance_m: float = START_TOLERANCE_M
    start_tolerance_rad: float = START_TOLERANCE_RAD

    def __post_init__(self) -> None:
        keep_scalars(self, "grasp_gain", "path_gain", "measurement_time", open_low=False)
        keep_scalars(self, "correction_speed", "correction_spin", "blocked_rate")
        keep_scalars(self, "off_path_distance", "off_path_angle")
        keep_scalars(self, "start_tolerance_m", "start_tolerance_rad")
        for name, kind in _PARTS.items():
            part = getattr(self, name)
            if isinstance(part, Mapping) and kind is not CommonError:
                part = as_options(kind, part, f"QPOptions: {name}")
                object.__setattr__(self, name, part)
            if not isinstance(part, kind) and not (name == "preview" and part is None):
                raise InvalidInputError(
                    f"{name} is a {type(part).__name__}", "QPOptions", f"Give a {kind.__name__}, or nothing."
                )
        if self.form not in ("condensed", "full"):
            raise UnknownNameError("form", str(self.form), ("condensed", "full"), "QPOptions")
        if self.kernel not in ("auto", "compiled", "plain"):
            raise UnknownNameError("kernel", str(self.kernel), ("auto", "compiled", "plain"), "QPOptions")
        object.__setattr__(self, "iterations", as_count(self.iterations, "QPOptions: iterations"))
        if self.iterations > 5:
            raise InvalidInputError(f"iterations is {self.iterations}", "QPOptions", "Give 1 to 5.")

    def on(self, share: float | None) -> QPOptions:
        """These options on a path that was planned with a share of the limits; None if it was not planned.

        Half of what its share leaves is for corrections. Redundant arms then move by least motion, as they were
        planned, without posture.
        """
        if share is None:
            return self
        preview = self.preview
        if preview is not None:
            margin = max(preview.margin, 0.5 * (1.0 + share))
            preview = replace(preview, margin=margin, curvature_share=1.0, doubt=0.0)
        return replace(self, preview=preview, posture=PostureOptions(gain=0.0))


#: Fields that are groups of options, with their types.
_PARTS: dict[str, type] = {
    "common_error": CommonError,
    "weights": RankWeights,
    "preview": PreviewOptions,
    "posture": PostureOptions,
    "supervision": SupervisionOptions,
}
