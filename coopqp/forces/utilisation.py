"""Demands of a motion on the arms: torques, wrenches, and the share of each limit that it uses, at every sample."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from coopqp.checks import NOT_NUMBERS, as_floats
from coopqp.errors import InvalidInputError
from coopqp.forces.load_sharing import LoadShare
from coopqp.forces.shared_load import SharedLoad
from coopqp.model.cell import RobotCell
from coopqp.model.limits import BindingLimit
from coopqp.spatial import Array


@dataclass(frozen=True, eq=False)
class LoadUse:
    """The load of the arms along a motion, at T samples.

    Attributes:
        cell: the arms.
        time: (T,) [s].
        joint, grip, internal: share of limits that is used, as in :class:`SharedLoad`, (T, nv), (T, N), (T, N).
        share: share of the load that the limits leave (T,).
        torques: joint torques (T, nv) [N·m or N].
        wrenches: wrenches on the object in its own frame (T, N, 6) [N, N·m].
        binding: limits that bind at each sample.
    """

    cell: RobotCell
    time: Array
    joint: Array
    grip: Array
    internal: Array
    share: Array
    torques: Array
    wrenches: Array
    binding: tuple[tuple[BindingLimit, ...], ...]

    @property
    def feasible(self) -> bool:
        """True if the arms carry the whole load at every sample."""
        return bool((self.share == 1.0).all())

    def figures(self) -> dict[str, str]:
        """The figures of the motion as text: the least share, the most used joint and grip, and what binds first."""
        i, j = _first_largest(self.joint)
        out = {
            "load carried": f"{100.0 * self.share.min():.1f} %",
            "torque, most used": f"{100.0 * self.joint[i, j]:.1f} % ({self.cell.joint_names[j]}, {self.time[i]:.2f} s)",
        }
        for what, use in (("grip", self.grip), ("internal force", self.internal)):
            i, k = _first_largest(use)
            out[f"{what}, most used"] = f"{100.0 * use[i, k]:.1f} % ({self.cell.arm_names[k]}, {self.time[i]:.2f} s)"
        short = np.flatnonzero(self.share < 1.0)
        if short.size:
            names = ", ".join(map(str, self.binding[short[0]]))
            out["too heavy from"] = f"{self.time[short[0]]:.2f} s on ({names})"
        return out


def load_use(load: LoadShare, time: Any, q: Any) -> LoadUse:
    """Share the load along a motion, for example ``recording.time`` and ``recording.q_command``.

    Velocities and accelerations are central differences of the samples: give commands, not noisy measurements.

    Args:
        load: how the load is shared.
        time: times of the samples (T,) [s], increasing.
        q: configurations (T, nq).

    Raises:
        InvalidInputError: fewer than three samples, or samples that do not fit together.
        UnreachableError, UndecidedError: as in :meth:`LoadShare.share`.
    """
    t, rows = _samples(load.cell, time, q)
    model = load.cell.model
    step = np.diff(t)[:, None]
    mean = np.array([pin.difference(model, a, b) for a, b in itertools.pairwise(rows)]) / step
    velocity, acceleration = np.zeros((len(t), model.nv)), np.zeros((len(t), model.nv))
    both = step[:-1] + step[1:]
    velocity[1:-1] = (mean[:-1] * step[1:] + mean[1:] * step[:-1]) / both
    acceleration[1:-1] = 2.0 * (mean[1:] - mean[:-1]) / both
    velocity[[0, -1]], acceleration[[0, -1]] = mean[[0, -1]], acceleration[[1, -2]]
    found: list[SharedLoad] = []
    for x, v, dv in zip(rows, velocity, acceleration, strict=True):
        V, a = load.object_motion(x, v, dv)
        found.append(load.share(x, twist=V, acceleration=a, joint_velocity=v, joint_acceleration=dv))

    def all_of(name: str) -> Array:
        return np.array([getattr(one, name) for one in found])

    return LoadUse(
        cell=load.cell,
        time=t,
        joint=all_of("joint_use"),
        grip=all_of("grip_use"),
        internal=all_of("internal_use"),
        share=all_of("share"),
        torques=all_of("torques"),
        wrenches=all_of("wrenches"),
        binding=tuple(one.binding for one in found),
    )


def _first_largest(use: Array) -> tuple[int, int]:
    """Where the largest entry of (T, m) stands, the first of those that differ by rounding."""
    i, j = np.unravel_index(int(use.round(6).argmax()), use.shape)
    return int(i), int(j)


def _samples(cell: RobotCell, time: Any, q: Any) -> tuple[Array, Array]:
    try:
        t, rows = as_floats(time), as_floats(q)
    except NOT_NUMBERS as error:
        raise InvalidInputError("time or q are no numbers", "load_use", "Give arrays (T,) and (T, nq).") from error
    if t.ndim != 1 or len(t) < 3 or rows.shape != (len(t), cell.nq) or not (np.diff(t) > 0.0).all():
        raise InvalidInputError(
            f"time {t.shape} and q {rows.shape} are no motion of {cell.nq} numbers",
            "load_use",
            "Give three samples or more, with times that increase.",
        )
    return t, np.array([cell.check_configuration(x, "load_use: q") for x in rows])
