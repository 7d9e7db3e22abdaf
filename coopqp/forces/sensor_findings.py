"""What presses say about each wrist sensor, in numbers and in words."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np
import pinocchio as pin

from coopqp.forces.internal import load_shares
from coopqp.forces.sensor_fit import SensorFit
from coopqp.model.grasp import Grasp
from coopqp.spatial import Array

#: Below this share of its gain a sensor is dead; gains within this range are right.
_DEAD, _GAINS = 0.2, (0.65, 1.35)
#: Axes may be turned by this [rad], and forces may drift by this [N/s].
_TURNED, _DRIFT = np.deg2rad(20.0), 2.0
#: Axes turned by less than this [rad], and gains this close to 1, are as told: a fit is no better. Nor is it beyond
#: so many standard deviations of the axes, up to this [rad].
_AS_MEANT, _SURE, _UNSURE = (np.deg2rad(5.0), 0.08), 3.0, np.deg2rad(15.0)
#: Share of lost samples, and of the readings that no arm explains, up to which a sensor is right.
_LOST, _MISFIT = 0.45, 0.35
#: Range of a gain that means N·mm.
_MILLI = (600.0, 1600.0)
#: A sensor's rest at large wrenches may be off by this share of them: servos are not told any better.
_STIFFNESS_DOUBT = 0.05
#: What arms press must cancel within the object, up to this share, for their sensors to agree with each other.
_BALANCED = 0.15
#: Least weight from which gains are found [N], and how far it may be off what most sensors say.
_WEIGHS, _AGREE = 20.0, 0.3


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class SensorFinding:
    """One wrist sensor, as presses show it.

    Attributes:
        arm: whose sensor it is taken for.
        sits_at: the arm whose wrenches it reads.
        rotation: R (3, 3): it reads ``g R f`` of a force f in its tool's axes.
        force_gain, torque_gain: g of forces and of torques; negative for a wrong sign, 0 for dead.
        bias: what it reads beside the wrench at rest, in its own axes (6,) [N, N·m].
        drift: how fast that grows (6,) [N/s, N·m/s].
        delay: age of a wrench when it arrives [s].
        noise: standard deviation of its forces [N].
        lost: share of its samples that were lost.
        problems: what is wrong with it, in words; empty if nothing is.
        undecided: no arm, axes and gains explain what it reads.
        late: its wrenches come too late, and nothing else is wrong.
    """

    arm: str
    sits_at: str
    rotation: Array
    force_gain: float
    torque_gain: float
    bias: Array
    drift: Array
    delay: float
    noise: float
    lost: float
    problems: tuple[str, ...]
    undecided: bool
    late: bool

    @property
    def dead(self) -> bool:
        """It reads no forces, or no torques."""
        return min(abs(self.force_gain), abs(self.torque_gain)) < _DEAD

    @property
    def fine(self) -> bool:
        """Nothing is wrong, and all is decided."""
        return not self.problems and not self.undecided

    def explain(self) -> str:
        """What was found, in words."""
        return f"the sensor of arm {self.arm}: {', '.join(self.problems) or 'right'}"


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class SensorJudgement:
    """All wrist sensors of a cell, as presses show them.

    Attributes:
        findings: one per sensor, in the order of the arms.
        stiffer: ρ, the servos' real stiffness over the one that is told.
        arms_stiffer: the same of each arm beside ρ (N,), with a geometric mean of 1.
    """

    findings: tuple[SensorFinding, ...]
    stiffer: float
    arms_stiffer: Array

    @property
    def fine(self) -> bool:
        """All sensors are right."""
        return all(f.fine for f in self.findings)

    @property
    def latest(self) -> float:
        """Largest delay of a sensor that is late and otherwise right [s]; 0 if none is."""
        return max((f.delay for f in self.findings if f.late), default=0.0)

    def explain(self) -> str:
        """What was found of each sensor that is not right, in words."""
        return "; ".join(f.explain() for f in self.findings if not f.fine) or "all sensors are right"


def judge(
    fit: SensorFit,
    grasp: Grasp,
    names: tuple[str, ...],
    *,
    servos: Array,
    servo_slopes: Array,
    weight: Array | None,
    unbalanced: float,
    tolerance: float,
    latest: float,
) -> SensorJudgement:
    """Say what is wrong with each sensor.

    Args:
        fit: the finished fit.
        grasp: how the arms hold.
        names: of the arms.
        servos: wrenches that the servos show at rest, with the stiffness that is told, at the tools (N, 6) [N, N·m].
        servo_slopes: how fast they grow (N, 6) [N/s, N·m/s].
        weight: the load that the drives carry, in the object frame (6,) [N, N·m]; None if it is not known.
        unbalanced: what the readings' changes do not cancel within the object, as a share of them.
        tolerance: accepted bias [N].
        latest: largest accepted delay [s].
    """
    n = len(names)
    to_object, shares = load_shares(grasp)
    stiffer = _stiffness(fit, to_object, servos, weight)
    gains = fit.gains / stiffer
    agree = unbalanced < _BALANCED and (fit.arms == np.arange(n)).all() and (fit.gains > 0.0).all()
    # How far servos and loads at rest are in doubt: what servos do that no model tells; sensors that differ as they do.
    servos_doubt, load_doubt = _STIFFNESS_DOUBT + float(np.sqrt(np.median(fit.misfit))), np.zeros(n)
    if agree:
        middle = np.median(gains, axis=0)
        servos_doubt += abs(float(middle[0] / middle[1]) - 1.0)
        load_doubt = np.abs(gains[:, 0] / middle[0] - 1.0)
        gains = gains / gains[:, :1] * float(middle[0])
    alive = np.abs(gains) > _DEAD
    gains = np.where(alive, gains, 0.0)  # what noise leaves of a dead gain tells nothing of the wrench
    turned = np.array([np.linalg.norm(pin.log3(R)) for R in fit.rotations])
    unsure = np.minimum(_SURE * fit.doubts, _UNSURE)
    as_meant = turned < np.maximum(_AS_MEANT[0], unsure)
    rotations = np.where(as_meant[:, None, None], np.eye(3), fit.rotations)
    maps = np.zeros((n, 6, 6))
    for k in range(n):
        for g, at in zip(gains[k], (0, 3), strict=True):
            maps[k, at : at + 3, at : at + 3] = (1.0 if abs(g - 1.0) < max(_AS_MEANT[1], unsure[k]) else g) * rotations[
                k
            ]
    at_rest = (stiffer * fit.stiffer[:, None] * servos)[fit.arms]
    felt = np.array([np.linalg.pinv(M) @ b for M, b in zip(maps, fit.offsets, strict=True)]) - at_rest
    in_order = np.zeros_like(felt)
    in_order[fit.arms] = felt
    load = (to_object @ in_order.ravel()).reshape(n, 6).sum(axis=0) if weight is None else weight
    carried = np.linalg.solve(to_object, shares @ load).reshape(n, 6)[fit.arms]
    biases = fit.offsets - np.einsum("kij,kj->ki", maps, at_rest + carried)
    drifts = fit.slopes - np.einsum("kij,kj->ki", maps, (stiffer * fit.stiffer[:, None] * servo_slopes)[fit.arms])
    found = []
    for k, name in enumerate(names):
        undecided = bool(fit.misfit[k] > _MISFIT)
        said = [] if undecided else _wrong(fit, k, names, gains[k], alive[k])
        if not said and not undecided:
            accepted = tolerance + servos_doubt * float(np.linalg.norm(at_rest[k, :3]))
            accepted += float(load_doubt[k] * np.linalg.norm(carried[k, :3]))
            said = _off(biases[k], drifts[k], accepted)
        late = bool(fit.delays[k] > latest and alive[k].any() and not undecided)
        if late:
            after, most = 1e3 * fit.delays[k], 1e3 * latest
            said.append(f"its wrenches come {after:.0f} ms after their causes, above {most:.0f} ms: give delay")
        if fit.lost[k] > _LOST:
            said.append(f"{100.0 * fit.lost[k]:.0f} % of its samples are lost")
        if undecided:
            said.append("undecided: no arm, axes and gain explain what it reads")
        found.append(
            SensorFinding(
                arm=name,
                sits_at=names[fit.arms[k]],
                rotation=fit.rotations[k],
                force_gain=float(gains[k, 0]),
                torque_gain=float(gains[k, 1]),
                bias=biases[k],
                drift=drifts[k],
                delay=float(fit.delays[k]),
                noise=float(fit.noise[k, 0]),
                lost=float(fit.lost[k]),
                problems=tuple(said),
                undecided=undecided,
                late=late and len(said) == 1,
            )
        )
    return SensorJudgement(findings=tuple(found), stiffer=stiffer, arms_stiffer=fit.stiffer)


def _stiffness(fit: SensorFit, to_object: Array, servos: Array, weight: Array | None) -> float:
    """ρ: what most sensors say, or what gives the weight that is known where they do not agree with it.

    Of two sensors without a weight, the one is right by which the servos are more as told.
    """
    n = len(fit.arms)
    sizes: Array = np.abs(fit.gains[:, 0])
    nearest = int(np.abs(np.log(np.maximum(sizes, 1e-300))).argmin())  # to what is told: a gain may be far too large
    alive = sizes > _DEAD * sizes[nearest]
    heard = sizes[alive & (sizes > 0.0)]
    most = float(np.median(heard)) if len(heard) else 1.0
    if n == 2 and len(heard):
        most = float(heard[np.abs(np.log(heard)).argmin()])
    if weight is None or np.linalg.norm(weight[:3]) < _WEIGHS or not alive.all():
        return max(most, 1e-6)
    forces = np.zeros((n, 6))
    for k, a in enumerate(fit.arms):
        forces[a, :3] = fit.rotations[k].T @ fit.offsets[k, :3] / fit.gains[k, 0]
        forces[a, :3] -= fit.stiffer[a] * servos[a, :3]  # what the drives carry, not the servos
    total = (to_object @ forces.ravel()).reshape(n, 6).sum(axis=0)[:3]
    size = float(np.linalg.norm(weight[:3]))
    along = float(total @ weight[:3]) / size
    if along <= 0.0:
        return most
    weighed = size / along
    return most if n > 2 and abs(weighed / most - 1.0) < _AGREE else weighed


def _wrong(fit: SensorFit, k: int, names: tuple[str, ...], gains: Array, alive: Array) -> list[str]:
    """What is wrong with the arm, axes, signs and gains of sensor k."""
    if not alive.any():
        return ["it is dead"]
    said = []
    if fit.arms[k] != k:
        said.append(f"it reads the wrenches of arm {names[fit.arms[k]]}")
    kinds = ("forces", "torques")
    said += [f"its {kind} are dead" for kind, lives in zip(kinds, alive, strict=True) if not lives]
    flipped = [kind for kind, g, lives in zip(kinds, gains, alive, strict=True) if g < 0.0 and lives]
    if flipped:
        said.append(f"its {' and '.join(flipped)} have the wrong sign")
    for kind, g in zip(kinds, np.abs(gains), strict=True):
        if g > _DEAD and not _GAINS[0] <= g <= _GAINS[1]:
            milli = kind == "torques" and _MILLI[0] < g < _MILLI[1]
            said.append("its torques come in N·mm" if milli else f"its {kind} are {g:.2g} times the real ones")
    turn = pin.log3(fit.rotations[k])
    angle = float(np.linalg.norm(turn))
    if angle > _TURNED:
        axis = ", ".join(f"{x:.2g}" for x in np.round(turn / angle, 2) + 0.0)
        said.append(f"its axes are turned by {np.rad2deg(angle):.0f}° about ({axis}) of the tool")
    return said


def _off(bias: Array, drift: Array, most: float) -> list[str]:
    """What is wrong with the level of a sensor."""
    said, size, pace = [], float(np.linalg.norm(bias[:3])), float(np.linalg.norm(drift[:3]))
    if pace > _DRIFT:
        said.append(f"it drifts by {pace:.1f} N/s")
    elif size > most:
        said.append(f"it reads {size:.0f} N too much at rest (tolerance {most:.0f} N)")
    return said
