"""Settings of the cooperative controller."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, Any

import numpy as np

from coopqp.checks import Doc, Refusing, as_options, documented, keep_scalars
from coopqp.control.lookahead.options import PreviewOptions
from coopqp.control.monitoring.options import SupervisionOptions
from coopqp.control.step.start import START_TOLERANCE_M, START_TOLERANCE_RAD
from coopqp.errors import InvalidInputError
from coopqp.model.common_error import CommonError
from coopqp.model.posture import PostureOptions
from coopqp.solvers.base import QpSolver


@documented
@dataclass(frozen=True, kw_only=True)
class RankWeights(Refusing):
    """Costs of giving something up, per unit squared; ratios of at least 100 keep the ranks apart."""

    removed = {"comfort": "Give posture."}  # noqa: RUF012  # of version 0.1

    chain: Annotated[float, Doc("cost of the speed at which the arms part [1/(m/s)²]")] = 1e8
    off_path: Annotated[float, Doc("cost of object velocity off the path [1/(m/s)²]")] = 1e4
    recovery: Annotated[float, Doc("cost of a joint outside its limits that is not led back [1/(rad/s)²]")] = 1e6
    clearance: Annotated[
        float, Doc("cost of a row that gives way before the arms part, per unit of the row squared")
    ] = 1e6
    grasp: Annotated[float, Doc("cost of giving up all of the grasp correction")] = 1.0
    path: Annotated[float, Doc("cost of giving up all of the path correction")] = 1e-2
    rate: Annotated[float, Doc("cost of standing still (σ = 0)")] = 1e-4
    posture: Annotated[
        float, Doc("cost of null-space motion other than the wanted one, in units of the joints' speeds")
    ] = 1e-6
    length: Annotated[float, Doc("characteristic length that weighs rotation against translation [m]")] = 0.3

    def __post_init__(self) -> None:
        keep_scalars(self, *vars(self), low=1e-20, high=1e20)


@documented
@dataclass(frozen=True, kw_only=True)
class QPOptions(Refusing):
    """Settings of the cooperative controller."""

    removed = {  # noqa: RUF012  # of version 0.2
        "kernel": "Leave it out: the core makes every step.",
        "form": "Leave it out: the QP of a step is the condensed one.",
        "iterations": "Leave it out: long steps are linearised again by themselves; a shorter dt is more accurate.",
    }

    solver: Annotated[
        str | QpSolver,
        Doc(
            'name of the QP solver: "auto" (ldp, which is part of the core), "ldp", '
            '"daqp", "proxqp", "osqp" or another of qpsolvers; a program may also give a solver object'
        ),
    ] = "auto"
    solver_settings: Annotated[Any, Doc("settings of the solver of that name")] = None
    grasp_gain: Annotated[
        float, Doc("gain K_g of the grasp correction [1/s]; a step never corrects more than the whole error (K dt ≤ 1)")
    ] = 20.0
    path_gain: Annotated[float, Doc("gain K_p of the path correction [1/s], in the same way")] = 20.0
    correction_speed: Annotated[float, Doc("largest speed of each correction [m/s]")] = 0.1
    correction_spin: Annotated[float, Doc("largest angular speed of each correction [rad/s]")] = 0.4
    measurement_time: Annotated[
        float,
        Doc(
            "time constant of the filter of the measured object error [s]; while h of N arms hold the object it counts "
            "(N/h)² times"
        ),
    ] = 0.02
    common_error: Annotated[
        CommonError, Doc("weights that define the object pose; the first arm defines it by default")
    ] = field(default_factory=CommonError.leader)
    weights: Annotated[RankWeights, Doc("costs of the ranks")] = field(default_factory=RankWeights)
    shortcut: Annotated[bool, Doc("skip the QP if the nominal command or a lower rate on the path is admissible")] = (
        True
    )
    preview: Annotated[PreviewOptions | None, Doc("settings of the path preview; None for no preview")] = field(
        default_factory=PreviewOptions
    )
    posture: Annotated[PostureOptions, Doc("goals of the null-space motion of redundant arms")] = field(
        default_factory=PostureOptions
    )
    supervision: Annotated[
        SupervisionOptions, Doc("thresholds of the comparison of measured and commanded configurations")
    ] = field(default_factory=SupervisionOptions)
    blocked_rate: Annotated[float, Doc("rate σ below which the object counts as blocked")] = 1e-3
    off_path_distance: Annotated[
        float, Doc("distance of the object from its path beyond which its status says so [m]")
    ] = 1e-3
    off_path_angle: Annotated[
        float, Doc("angle between the object and its path beyond which its status says so [rad]")
    ] = np.deg2rad(0.1)
    start_tolerance_m: Annotated[float, Doc("accepted distance of any arm from the grasp at reset [m]")] = (
        START_TOLERANCE_M
    )
    start_tolerance_rad: Annotated[float, Doc("accepted angle of any arm from the grasp at reset [rad]")] = (
        START_TOLERANCE_RAD
    )

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
