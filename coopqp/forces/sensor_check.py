"""The check of the wrist sensors before the object moves: press, listen, fit, judge."""

from __future__ import annotations

import copy
from typing import Any, final

import numpy as np
import pinocchio as pin

from coopqp.control.monitoring.stress import servo_wrenches
from coopqp.forces.internal import load_shares
from coopqp.forces.presses import PRESS_FORCE, REST_TIME, PressPlan, of_grip
from coopqp.forces.sensor_findings import SensorJudgement, judge
from coopqp.forces.sensor_fit import SensorFit
from coopqp.model.cell import RobotCell
from coopqp.model.chain import Chain
from coopqp.model.grasp import Grasp
from coopqp.spatial import Array, for_twists

#: Range of the size of presses, over the one for the stiffness that is told.
_SCALES = (0.05, 2.0)
#: By how much servos may push more than at the start, beside the presses [N]: then the arms have to relax first.
_GROWN = 20.0
#: Time of a step for one part of the fit [s]; a part takes about a millisecond.
_PART_TIME = 2.5e-3
#: Readings of noise alone count as this share of what the first press should cause.
_HEARD = 0.1


@final
class SensorCheck:
    """Presses between the arms at rest, and what the sensors and the servos say about them.

    Call :meth:`press` once a step, until :attr:`judgement` is there.

    Args:
        cell, grasp: the arms, and how they hold the object.
        softness: one over Kp of the servos (nv,) [rad/(N·m) or m/N].
        q: configuration at rest (nq,).
        load: wrench on the object that the drives carry by feed-forward, in the object frame (6,) [N, N·m]; None if it
            is not known.
        tolerance: accepted bias of a sensor [N].
        latest: largest accepted delay of a sensor [s].

    Attributes:
        judgement: what was found; None before the end.
        disturbed: forces grow by themselves, as where the object does: nothing will be found.
    """

    def __init__(
        self,
        cell: RobotCell,
        grasp: Grasp,
        *,
        softness: Array,
        q: Array,
        load: Array | None,
        tolerance: float,
        latest: float,
    ) -> None:
        self._cell, self._grasp, self._chain = cell, grasp, Chain(cell, grasp)
        self._softness, self._load, self._tolerance, self._latest = softness, load, tolerance, latest
        compliances, shared = self._compliances(q)
        self._plan = PressPlan(grasp, compliances, shared)
        self._stiffness, self._at_rest, self._shared = of_grip(compliances, shared), compliances, shared
        self._to_object = load_shares(grasp)[0]
        self._to_tools = np.array([X.action.T for X in grasp.T_object_tool])
        self._time, self._scale = 0.0, 0.0
        self._times: list[float] = []
        self._readings: list[Array] = []
        self._motions: list[Array] = []
        self._expected: list[Array] = []
        self._servos: list[Array] = []
        self._fit: SensorFit | None = None
        self.judgement: SensorJudgement | None = None
        self.disturbed = False

    @property
    def began(self) -> bool:
        """The arms have begun to press."""
        return self._time > REST_TIME

    def press(self, wrenches: Array | None, commanded: Array, measured: Array, dt: float) -> Array:
        """Take the readings of a step, and say where the grasps go next.

        Args:
            wrenches: at the tools (N, 6) [N, N·m]; None or NaN for missing ones.
            commanded, measured: configurations at the time of the wrenches (nq,).
            dt: length of this step [s].

        Returns:
            How far each grasp is to stand from its place at rest at the end of the step (N, 6) [m, rad].
        """
        if self._time < self._plan.duration:
            self._hear(wrenches, commanded, measured)
            self._time += dt
            grown = self._servos[-1] - self._expected[-1] - self._servos[0] + self._expected[0]
            stiffer = 1.0 / self._scale if self._scale > 0.0 else 1.0
            self.disturbed = bool(stiffer * np.linalg.norm(grown[:, :3], axis=1).max() > _GROWN)
            if self._scale == 0.0 and self._time >= self._plan.ends_first:
                self._scale = self._size()
            return self._plan.shift(self._time, self._scale)
        if self._fit is None:
            heard = np.array(self._times), np.array(self._readings), np.array(self._motions)
            self._fit = SensorFit(*heard, self._at_rest, self._to_tools, self._shared)
        elif self.judgement is None and any(self._fit.go_on() for _ in range(max(int(dt / _PART_TIME), 1))):
            self.judgement = self._judge(self._fit)
        return np.zeros((len(self._cell), 6))

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "_chain"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._chain = Chain(self._cell, self._grasp)

    def __deepcopy__(self, memo: dict[int, Any]) -> SensorCheck:
        """The model is shared; what was heard is never changed, but grows."""
        other = object.__new__(SensorCheck)
        own = self.__getstate__()
        own |= {name: list(own[name]) for name in ("_times", "_readings", "_motions", "_expected", "_servos")}
        other.__setstate__(own | {"_fit": copy.deepcopy(self._fit)})
        return other

    def _compliances(self, q: Array) -> tuple[Array, Array | None]:
        """C of each arm's own joints (N, 6, 6), and of those that arms share (6 N, 6 N), in the object frame, at q."""
        chain = self._chain
        O = chain.carried(q)[0]
        chain.evaluate(q, about=O.translation)
        R = self._R = for_twists(O.rotation)
        return R.T @ chain.compliances(self._softness) @ R, chain.shared_compliance(self._softness, R)

    def _hear(self, wrenches: Array | None, commanded: Array, measured: Array) -> None:
        n, chain = len(self._cell), self._chain
        O = chain.carried(commanded)
        parted = chain.errors(O, O[0])
        caused = (self._stiffness @ parted.ravel()).reshape(n, 6)
        compliances, shared = self._compliances(measured)
        bent = chain.twists(pin.difference(self._cell.model, measured, commanded)) @ self._R
        self._times.append(self._time)
        self._readings.append(np.full((n, 6), np.nan) if wrenches is None else np.array(wrenches))
        self._motions.append(parted)
        self._expected.append(self._at_tools(caused))
        self._servos.append(self._at_tools(servo_wrenches(compliances, bent, shared)))

    def _at_tools(self, wrenches: Array) -> Array:
        return np.array([A @ w for A, w in zip(self._to_tools, wrenches, strict=True)])

    def _size(self) -> float:
        """Size of the presses by the answer to the first one: as strong as meant, also with other servos than told."""
        y, w = np.array(self._readings)[:, :, :3], np.array(self._expected)[:, :, :3]
        answers = []
        for k in range(y.shape[1]):
            heard = np.isfinite(y[:, k]).all(axis=1)
            if heard.sum() > 10:
                own = y[heard, k]
                noise = 0.5 * np.diff(own, axis=0).var(axis=0).sum()
                meant = w[heard, k].var(axis=0).sum()
                answers.append(np.sqrt(max(own.var(axis=0).sum() - noise, 0.0) / max(meant, 1e-12)))
        stiffer = float(np.median(answers)) if answers else 1.0
        return float(np.clip(1.0 / max(stiffer, _HEARD), *_SCALES))

    def _judge(self, fit: SensorFit) -> SensorJudgement:
        times, servos = np.array(self._times), np.array(self._servos)
        caused = np.array(self._expected)
        t = times - 0.5 * (times[0] + times[-1])
        level = servos - caused
        mean = level.mean(axis=0)
        slopes = np.einsum("t,tki->ki", t, level - mean) / (t @ t)
        return judge(
            fit,
            self._grasp,
            self._cell.arm_names,
            servos=mean,
            servo_slopes=slopes,
            weight=self._load,
            unbalanced=self._unbalanced(fit),
            tolerance=self._tolerance,
            latest=self._latest,
        )

    def _unbalanced(self, fit: SensorFit) -> float:
        """What the readings' changes leave of the net force on the object, as a share of their size.

        By the readings, and by the presses with the gains that were found, which noise does not hide.
        """
        G = of_grip(self._at_rest / fit.stiffer[:, None, None], self._shared)
        motions = np.array(self._motions)
        wrenches = (motions.reshape(len(motions), -1) @ G.T).reshape(motions.shape)
        caused = np.repeat(fit.gains, 3, axis=1) * np.einsum("kij,tkj->tki", self._to_tools, wrenches)
        told = (caused.reshape(len(caused), -1) @ self._to_object.T).reshape(caused.shape)[:, :, :3]
        by_gains = float(np.sqrt(told.sum(axis=1).var(axis=0).sum() / max(told.var(axis=0).sum(), 1e-12)))
        y = np.array(self._readings)
        y = y[np.isfinite(y).all(axis=(1, 2))]
        if len(y) < 20:
            return 1.0
        forces = (y.reshape(len(y), -1) @ self._to_object.T).reshape(y.shape)[:, :, :3]
        noise = (3.0 * fit.noise[:, 0] ** 2).sum()
        net = max(forces.sum(axis=1).var(axis=0).sum() - noise, 0.0)
        each = forces.var(axis=0).sum() - noise
        return max(float(np.sqrt(net / each)), by_gains) if each > 0.05 * PRESS_FORCE**2 else 1.0
