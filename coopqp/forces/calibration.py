"""Calibration from a gripped run: where do the bases and the grips really stand? No sensor but the arms' encoders.

While the arms hold one rigid object, the true chain is closed; the measured configurations show with which bases and
grips it is (:mod:`coopqp.forces.loop_residual`). Corrections x of all bases and grips minimise

    Σ_t |whitened r(q_t, x)|² + Σ_i (x_i / prior_i)²

(nonlinear least squares). Where the motion determines nothing the prior decides: those parameters keep their given
values. The first arm is the reference: its base and its grip keep their places.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from coopqp.checks import NOT_NUMBERS, as_count, as_floats, as_options, keep_scalars
from coopqp.errors import CoopqpError, InvalidInputError
from coopqp.forces.loop_residual import Closure
from coopqp.model.cell import RobotCell
from coopqp.model.grasp import Grasp
from coopqp.spatial import Array

#: Share of its prior variance that a direction keeps, from which on the motion does not determine it.
_UNDETERMINED = 0.5
#: Weighed residuals of a closed chain: their mean square, and the largest of them, are below these.
_MEAN_SQUARE, _LARGEST = 3.0, 8.0
#: A correction whose squared size in its own uncertainty is below this is no correction: the 99 % quantile of chi²
#: with 12 degrees of freedom.
_INSIGNIFICANT = 26.217
#: A step of the weighed residuals that noise makes less than once in 10 000 runs of 200 samples.
_STEP = 5.5
#: Least entry of a direction that is named, as a share of its largest.
_NAMED = 0.3
_COORDINATES = [
    (part, how, axis) for part in ("base", "grip") for how in ("shift", "turn") for axis in ("x", "y", "z")
]  # fmt: skip


class CalibrationError(CoopqpError):
    """Measurements do not allow a calibration: the arms do not hold one object, or the chain is not closed."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CalibrationOptions:
    """Settings of a calibration. Priors are standard deviations of each component.

    Attributes:
        encoder_noise: amplitude of the uniform noise of measured joint positions [rad or m], as in
            :class:`coopqp.simulation.Disturbances`.
        base_position, base_angle: errors of base placements [m, rad].
        grip_position, grip_angle: errors of the tools' placements on the object [m, rad].
        samples: configurations that are used at most, spread evenly.
    """

    encoder_noise: float = 1e-4
    base_position: float = 2e-3
    base_angle: float = float(np.deg2rad(0.2))
    grip_position: float = 2e-3
    grip_angle: float = float(np.deg2rad(0.3))
    samples: int = 200

    def __post_init__(self) -> None:
        keep_scalars(self, "encoder_noise", "base_position", "base_angle", "grip_position", "grip_angle")
        object.__setattr__(self, "samples", as_count(self.samples, "CalibrationOptions: samples"))

    def prior(self, arms: int) -> Array:
        """Standard deviations of (b_0, g_0, b_1, …) (12 N,)."""
        sizes = [self.base_position, self.base_angle, self.grip_position, self.grip_angle]
        return np.tile(np.repeat(sizes, 3), arms)


@dataclass(frozen=True, eq=False)
class ArmCorrection:
    """Correction of one arm relative to the first arm.

    Attributes:
        arm: name.
        base: correction of its base placement, in its base frame (6,) [m, rad]: ``T_world_base · exp(base)``.
        grip: correction of its tool on the object, in the tool frame (6,): ``T_object_tool · exp(grip)``.
        base_deviation, grip_deviation: their standard deviations (6,), after the run.
        significant: the correction is more than its uncertainty. Else the base and the grip stay as given.
    """

    arm: str
    base: Array
    grip: Array
    base_deviation: Array
    grip_deviation: Array
    significant: bool


@dataclass(frozen=True, eq=False)
class Calibration:
    """A cell and a grasp that fit the measurements, and how sure that is.

    Attributes:
        cell, grasp: corrected; those of the first arm, and of arms with no significant correction, are as before.
        corrections: one per arm from the second on.
        before, after: largest distance [m] and angle [rad] between the object poses of two arms, at each used sample,
            with the given and with the corrected model (T, 2).
        samples: indices of the used samples (T,).
        undetermined: directions that the motion does not determine, in words.
        determined_share: share of the directions that it determines.
        slip: sample from which on the arms' views of the object are shifted against those before, as by a slip, and by
            how much [m]; None if there is no such sample.
    """

    cell: RobotCell
    grasp: Grasp
    corrections: tuple[ArmCorrection, ...]
    before: Array
    after: Array
    samples: Array
    undetermined: tuple[str, ...]
    determined_share: float
    slip: tuple[int, float] | None

    def explain(self) -> str:
        """Lines of text: loop residual before and after, corrections with deviations, undetermined parameters."""
        lines = [
            f"closure: {_mm(self.before[:, 0].max())} mm, {_deg(self.before[:, 1].max())}° before; "
            f"{_mm(self.after[:, 0].max())} mm, {_deg(self.after[:, 1].max())}° after ({len(self.samples)} samples)"
        ]
        for found in self.corrections:
            if not found.significant:
                lines.append(f"{found.arm}: no more than its own uncertainty; its base and grip stay as given")
                continue
            for part, value, spread in (
                ("base", found.base, found.base_deviation),
                ("grip", found.grip, found.grip_deviation),
            ):
                lines.append(
                    f"{found.arm}, {part}: {_three(1e3 * value[:3])} ± {_three(1e3 * spread[:3])} mm, "
                    f"{_three(np.rad2deg(value[3:]))} ± {_three(np.rad2deg(spread[3:]))}°"
                )
        if self.slip is not None:
            lines.append(
                f"the arms' views of the object shift by {_mm(self.slip[1])} mm at sample {self.slip[0]}: did a grip "
                "slip? Bases and grips then hold for neither part of the run"
            )
        if self.undetermined:
            lines.append(f"not determined by this motion, kept as believed ({len(self.undetermined)}):")
            lines += [f"  {name}" for name in self.undetermined]
        return "\n".join(lines)


def calibrate(
    cell: RobotCell, grasp: Grasp, configurations: Any, *, options: CalibrationOptions | Mapping[str, Any] | None = None
) -> Calibration:
    """Base placements and grips with which the chain is closed at measured configurations.

    The arms held one rigid object all the time, and the grips did not slip: a slip that bases and grips can
    explain stays unseen, one that they cannot is told (:attr:`Calibration.slip`). A correction that is no more than its
    own uncertainty is not made. :func:`coopqp.simulation.calibrate_runs` asks the recordings.

    Args:
        cell, grasp: the model that the run was made with.
        configurations: measured configurations (T, nq); of all arms at the same times.
        options: :class:`CalibrationOptions`, or a dictionary of its fields.

    Raises:
        InvalidInputError: bad arguments, or a cell of one arm.
        CalibrationError: no bases and grips close the chain within the noise of the joints.
    """
    from scipy.optimize import least_squares  # here, since it takes long to import

    grasp.check_arms(cell)
    settings = as_options(CalibrationOptions, options, "calibrate: options")
    rows = _configurations(cell, configurations)
    used = np.unique(np.linspace(0, len(rows) - 1, min(len(rows), settings.samples)).round().astype(int))
    noise = np.full(cell.nv, settings.encoder_noise / np.sqrt(3.0))
    closure, prior = Closure(cell, grasp, rows[used], noise), settings.prior(len(cell))
    found = least_squares(
        lambda z: np.concatenate([closure.residuals(prior * z), z]),
        np.zeros(len(prior)),
        jac=lambda z: np.vstack([closure.jacobian(prior * z) * prior, np.eye(len(prior))]),
        method="trf",
        xtol=1e-12,
        ftol=1e-12,
        gtol=1e-10,
    )
    x = prior * found.x
    _check_closed(closure, x, used)
    bases, tools = closure.corrected(x)
    covariance, directions = _certainty(closure, found.jac, prior)
    spread = np.sqrt(np.diag(covariance))
    corrections = []
    kept = np.zeros(len(x))
    for k in range(1, len(cell)):
        own = slice(12 * k - 12, 12 * k)
        base = pin.log6(cell.arms[k].T_world_base.actInv(bases[k])).vector
        grip = pin.log6(grasp.T_object_tool[k].actInv(tools[k])).vector
        change = np.concatenate([base, grip])
        significant = float(change @ np.linalg.solve(covariance[own, own], change)) > _INSIGNIFICANT
        if significant:
            kept[12 * k : 12 * k + 12] = change
        corrections.append(ArmCorrection(cell.arm_names[k], base, grip, spread[own][:6], spread[own][6:], significant))
    bases, tools = closure.corrected(kept)
    return Calibration(
        RobotCell([arm.placed(B) for arm, B in zip(cell.arms, bases, strict=True)]),
        Grasp(tuple(tools)),
        tuple(corrections),
        closure.distances(np.zeros(len(x))),
        closure.distances(kept),
        used,
        tuple(_in_words(cell, direction) for direction in directions),
        1.0 - len(directions) / (12 * len(cell) - 12),
        _slip(closure, x, used),
    )


def undetermined_by(
    cell: RobotCell, grasp: Grasp, configurations: Any, *, options: CalibrationOptions | Mapping[str, Any] | None = None
) -> tuple[str, ...]:
    """Directions that a motion would leave undetermined, in words; before it is made.

    Args:
        cell, grasp, options: as in :func:`calibrate`.
        configurations: configurations of the motion (T, nq), such as planned ones.
    """
    grasp.check_arms(cell)
    settings = as_options(CalibrationOptions, options, "undetermined_by: options")
    rows, prior = _configurations(cell, configurations), settings.prior(len(cell))
    noise = np.full(cell.nv, settings.encoder_noise / np.sqrt(3.0))
    closure = Closure(cell, grasp, rows, noise)
    J = np.vstack([closure.jacobian(np.zeros(len(prior))) * prior, np.eye(len(prior))])
    return tuple(_in_words(cell, direction) for direction in _certainty(closure, J, prior)[1])


def _configurations(cell: RobotCell, configurations: Any) -> Array:
    if len(cell) < 2:
        raise InvalidInputError("one arm closes no chain", "calibrate", "Give a cell of two arms or more.")
    try:
        rows = as_floats(configurations)
    except NOT_NUMBERS as error:
        raise InvalidInputError("configurations are no numbers", "calibrate", "Give an array (T, nq).") from error
    if rows.ndim != 2 or len(rows) < 2:
        raise InvalidInputError(
            f"configurations of shape {rows.shape}", "calibrate", f"Give (T, {cell.nq}), two or more."
        )
    return np.array([cell.check_configuration(q, f"calibrate: configurations[{i}]") for i, q in enumerate(rows)])


def _check_closed(closure: Closure, x: Array, used: Array) -> None:
    """Raise CalibrationError unless the joints' noise explains the residuals."""
    left = closure.residuals(x).reshape(len(used), -1)
    square, worst = float((left**2).mean()), np.abs(left).max(axis=1)
    if square <= _MEAN_SQUARE and worst.max() <= _LARGEST:
        return
    apart, i = closure.distances(x)[:, 0], int(worst.argmax())
    raise CalibrationError(
        f"the chain is not closed: with the best bases and grips the arms still part by {_mm(apart.max())} mm (most at "
        f"sample {used[i]}), {np.sqrt(square):.1f} times what the encoders' noise explains. Do all arms hold one rigid "
        "object, without slip, and are their own kinematics right? Give the real encoder_noise."
    )


def _slip(closure: Closure, x: Array, used: Array) -> tuple[int, float] | None:
    """The sample with the largest step of the residuals, if noise does not make it, and the shift of the object [m].

    For residuals of unit variance the difference of the means of m samples and the n others, times √(m n / (m + n)),
    has unit variance.
    """
    left = closure.residuals(x).reshape(len(used), -1)
    count = np.arange(1, len(used))[:, None]
    sums = np.cumsum(left - left.mean(axis=0), axis=0)[:-1]
    steps = np.abs(sums) / np.sqrt(count * (len(used) - count) / len(used))
    if steps.max() <= _STEP:
        return None
    at = int((steps**2).sum(axis=1).argmax())
    r = closure.errors(x)
    shift = r[at + 1 :].mean(axis=0) - r[: at + 1].mean(axis=0)
    return int(used[at + 1]), float(np.linalg.norm(shift[:, :3], axis=1).max())


def _certainty(closure: Closure, J: Array, prior: Array) -> tuple[Array, Array]:
    """Covariance (12 N − 12, 12 N − 12) relative to the first arm, and an undetermined direction per row.

    With the prior covariance P = L Lᵀ and that after the run C, the eigenvalues of L⁻¹ C L⁻ᵀ are the shares of the
    prior variance that are left, from 0 (determined) to 1 (nothing is learned).
    """
    M = closure.gauge() * prior
    R: Array = np.asarray(np.linalg.qr(J, mode="r"))
    half = np.linalg.solve(R.T, M.T)  # C = halfᵀ half
    C, P = half.T @ half, M @ M.T
    L = np.linalg.cholesky(P)
    inner = np.linalg.solve(L, np.linalg.solve(L, C).T)
    shares, vectors = np.linalg.eigh(0.5 * (inner + inner.T))
    loose = (L @ vectors[:, shares > _UNDETERMINED]) / np.sqrt(np.diag(P))[:, None]
    if loose.shape[1]:
        from scipy.linalg import qr

        # Basis of the loose directions with the fewest large entries: one own coordinate each.
        _, _, pivots = qr(loose.T, pivoting=True, mode="economic")
        loose = np.linalg.solve(loose[pivots[: loose.shape[1]]].T, loose.T).T
    return C, loose.T


def _in_words(cell: RobotCell, direction: Array) -> str:
    """A direction (12 N − 12,), in units of the priors, by its largest coordinates."""
    big = np.abs(direction).max()
    order = [i for i in np.argsort(-np.abs(direction).round(6), kind="stable") if abs(direction[i]) >= _NAMED * big]
    sign = np.sign(direction[order[0]])
    words = []
    for i in order:
        k, j = divmod(int(i), 12)
        part, how, axis = _COORDINATES[j]
        share = sign * direction[i] / big
        factor = "" if i == order[0] else f"{share:+.1f} "
        way = "along" if how == "shift" else "about"
        words.append(f"{factor}{how} of the {part} of {cell.arm_names[k + 1]} {way} {axis}")
    return " with ".join(words[:4]) + (" …" if len(words) > 4 else "")


def _mm(metres: float) -> str:
    return f"{1e3 * metres:.3g}"


def _deg(radians: float) -> str:
    return f"{np.rad2deg(radians):.2g}"


def _three(values: Array) -> str:
    return "(" + ", ".join(f"{value:.2f}" for value in values.round(2) + 0.0) + ")"
