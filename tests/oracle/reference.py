"""A reference of one step, in NumPy and qpsolvers, readable beside docs/derivations.md section by section.

It has nothing of the core: kinematics are Pinocchio's frames, gradients are differences, the QP is in full form. It
knows fixed grasps, arms of any number of joints and joints that arms share, and it knows nothing ahead of the object.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin
from bounds import brake_share, braking_rows, velocity_bounds
from closed_chain import Array, ClosedChain, closing, errors
from priorities import LENGTH, Answer, Wanted, answer


@dataclass(frozen=True)
class Settings:
    """What an author of a controller may set; see :class:`coopqp.QPOptions`."""

    grasp_gain: float = 20.0
    path_gain: float = 20.0
    correction_speed: float = 0.1
    correction_spin: float = 0.4
    posture_gain: float = 1.0
    shortcut: bool = True
    fails: bool = False


@dataclass
class Step:
    """What a step commands: joint velocities (nv,), the configuration that they lead to, σ, the clock after it."""

    v: Array
    q_next: Array
    rate: float
    clock_next: float
    answer: Answer


class Reference:
    """A run, step by step.

    Args:
        cell: the arms.
        T_object_tool: places of the tools on the object.
        path: has ``pose(clock)`` and ``duration``.
        q: configuration at rest to start at (nq,); no joint may turn without end.
        dt: length of a step [s].
        settings: see there.
        weights: W_k of the common error (N, 6); the first arm's alone by default.
    """

    def __init__(
        self, cell: Any, T_object_tool: Any, path: Any, q: Array, *, dt: float, settings: Settings,
        weights: Array | None = None,
    ) -> None:  # fmt: skip
        self.chain, self.limits, self.path = ClosedChain(cell, T_object_tool), cell.limits, path
        self.dt, self.o = dt, settings
        self.W = np.eye(self.chain.n)[:, :1] * np.ones(6) if weights is None else weights
        self.q, self.rest = np.array(q, dtype=float), np.array(q, dtype=float)
        self.v = self.v_before = np.zeros(self.chain.nv)
        self.clock, self.slope, self.first = 0.0, 0.0, True
        self.accelerates = bool(np.isfinite(self.limits.acceleration).any())
        at_rest = float(np.linalg.norm(path.twist(0.0))) < 1e-6  # a path that begins at rest is begun at its full speed
        self.rate = 1.0 if at_rest or not self.accelerates else 0.0
        self.expected: Array | None = None
        self.correcting: Array | None = None
        self.foreseen = np.zeros((self.chain.n, 6))

    def step(self) -> Step:
        """One step."""
        h, o, R = self.dt, self.o, self.path.pose(self.clock)
        O = self.chain.carried(self.q)
        e = errors(O, R)
        mean = (self.W * e).sum(axis=0)
        rows = braking_rows(self.chain, self.limits, self.q, self.x, self.v, h, O[0].translation)
        cap, path_error = 1.0, mean
        keep = brake_share(self.limits, self.x, self.v, h) if self.accelerates else 1.0
        if keep < 1.0:
            cap, path_error = keep * self.rate, self._kept(mean, keep)
        cap = min(cap, (self.path.duration - self.clock) / h)
        # Corrections: bounded, and never more than the whole error in a step.
        grasp = _bounded(min(o.grasp_gain, 1.0 / h) * (mean - e), o)
        path = _bounded(-min(o.path_gain, 1.0 / h) * path_error, o)
        offsets = np.zeros_like(e) if self.expected is None else (self.expected - e) / h
        # ν: the mean twist along the path over the expected length of the step.
        pace = min(cap, max(self.rate + self.slope * h, 0.0))
        span = min(h * max(pace, 1e-3), self.path.duration - self.clock)
        along, past, foreseen = self._mean_twist(R, span), None, self.foreseen
        want = Wanted(np.zeros(0), np.tile(along, (self.chain.n, 1)), path, grasp, offsets, cap, *self._posture())
        found, used, start = self._linearised(R, O, want, rows)
        for _ in range(4):  # another length was answered: over that one, or by a secant over that which answers itself
            way = min(h * max(found.rate, 1e-3), self.path.duration - self.clock)
            weight = np.array([1.0] * 3 + [0.3] * 3)
            change = (self._mean_twist(R, way) - along) * weight
            same = abs(way - span) <= 1e-6 * way or found.rate * h * np.linalg.norm(change) <= 1e-10
            if not found.rate > 0.0 or same:
                break
            excess = span - way
            if found.rate < cap - 1e-9 and past is None:
                at = along * weight  # the path is where the answer leads, if all joints keep their share of it
                slope = excess * (at @ at) - way * (at @ change)
                way -= way * (at @ change) * excess / slope if slope * excess > 0.0 else 0.0
            elif found.rate < cap - 1e-9 and past is not None and span != past[0]:
                slope = (excess - past[1]) / (span - past[0])
                way = span - excess / slope if slope > 0.0 else way
            past = (span, excess)
            span = min(max(way, 1e-3 * h), h, self.path.duration - self.clock)
            along = self._mean_twist(R, span)
            want, self.foreseen = replace(want, along=np.tile(along, (self.chain.n, 1))), foreseen
            found, used, start = self._linearised(R, O, want, rows)
        # ê: what is expected of the next step; the reference goes on along all of ν.
        made = found.grasp * used.grasp + used.offsets + found.path * used.path + found.off_path
        expected = e + h * (made + found.rate * (used.along - along))
        self.expected = None if found.parts or found.braked else expected
        q_next, rate = self.chain.moved(self.q, h * found.v), min(max(found.rate, 0.0), 1.0)
        self.correcting = found.path * used.path + found.off_path
        jumped = self.first and not self.accelerates
        self.slope, self.rate = 0.0 if jumped else (rate - self.rate) / h, rate
        self.v_before = 2.0 * start - found.v if self.first else self.v
        self.v, self.q, self.first = found.v, q_next, False
        self.clock += rate * h
        if self.path.duration - self.clock < 1e-9 * self.path.duration:
            self.clock = self.path.duration
        return Step(found.v, q_next, rate, self.clock, found)

    def _mean_twist(self, R: pin.SE3, span: float) -> Array:
        """The mean twist (6,) along the path over a time from now on, in the frame of the reference R."""
        if not span > 1e-12:
            return np.zeros(6)
        return np.asarray(pin.log6(R.actInv(self.path.pose(self.clock + span))).vector) / span

    @property
    def x(self) -> Array:
        """One position of each joint (nv,) [rad or m]."""
        return self.chain.positions(self.q)

    def _kept(self, error: Array, keep: float) -> Array:
        """The path error, so that its correction is at most a share of the last one: all joints brake."""
        error = error.copy()
        for part in (slice(0, 3), slice(3, 6)):
            now = self.o.path_gain * float(np.linalg.norm(error[part]))
            last = 0.0 if self.correcting is None else keep * float(np.linalg.norm(self.correcting[part]))
            error[part] *= min(last / now, 1.0) if now > 0.0 else 1.0
        return error

    def _posture(self) -> tuple[Array, Array]:
        """The wanted null-space motion of redundant arms, back to where they started."""
        chain, v = self.chain, np.zeros(self.chain.nv)
        for part in chain.parts:
            joints = chain.joints(part)
            if len(joints) > 6 * len(part):
                v[joints] = self.o.posture_gain * pin.difference(chain.model, self.q, self.rest)[joints]
        speed = np.where(np.isfinite(self.limits.velocity), self.limits.velocity, 1.0)
        return np.zeros(chain.nv), v / max(float(np.abs(v / (0.2 * speed)).max()), 1.0)

    def _linearised(self, R: pin.SE3, O: list[pin.SE3], want: Wanted, rows: Any) -> tuple[Answer, Wanted, Array]:
        """The answer about the predicted midpoint; first and long steps are linearised again about their answer.

        Returns the answer, the wanted motion that it answers, and the first answer's velocities.
        """
        h, guess, foreseen = self.dt, 2.0 * self.v - self.v_before, self.foreseen
        box = velocity_bounds(self.limits, self.x, self.v, h)
        found, used, A = self._about(R, want, guess, box, rows)
        defects, start = want.offsets, found.v
        move = h * float(np.abs(found.v).max())
        long = move > 0.03 or h * float(np.abs(found.v - guess).max()) * move > 1e-6
        best, least = (found, used, defects), np.inf
        if self.first or long:
            for number in range(1, 5):
                made = self._made(R, O, found.v)
                missed = h * float(np.abs(A @ found.v - made - defects).max())
                if missed < least:
                    best, least = (found, used, defects), missed
                if number == 4 or (number >= 1 + long and missed <= 1e-13):
                    break
                J = self.chain.jacobians(self.chain.moved(self.q, 0.5 * h * found.v), R.translation)
                defects = _in_axes(R, J) @ found.v - made
                again = replace(want, offsets=want.offsets - foreseen + defects)
                found, used, A = self._about(R, again, found.v, box, rows)
                if used.ranges:
                    defects = closing(defects, used.ranges)
        self.foreseen = best[2] if best[0] is not None else foreseen
        if best[0].parts or best[0].braked:
            self.foreseen = np.zeros_like(foreseen)
        return best[0], best[1], start

    def _about(self, R: pin.SE3, want: Wanted, v: Array, box: Any, rows: Any) -> tuple[Answer, Wanted, Array]:
        """The answer of the chain, linearised in the middle of the step that velocities v make."""
        chain = self.chain
        middle = chain.moved(self.q, 0.5 * self.dt * v)
        J = chain.jacobians(middle, R.translation)
        A = _in_axes(R, J)
        N = chain.null_space(J)
        project = N @ (N / chain.units[:, None] ** 2).T
        want = replace(want, A=A, null_along=project @ want.null_along, null_offset=project @ want.null_offset)
        ranges = chain.followed(A)
        if ranges:
            values, vectors = np.linalg.eigh(sum(np.eye(6) - P for _, P in ranges))
            Z = vectors[:, values < 1e-8]
            metric = np.array([1.0] * 3 + [LENGTH**2] * 3)
            project = Z @ np.linalg.solve(Z.T @ (metric[:, None] * Z), Z.T * metric)
            want = replace(
                want, along=want.along @ project.T, path=project @ want.path, grasp=closing(want.grasp, ranges),
                offsets=closing(want.offsets, ranges), basis=Z, ranges=ranges,
            )  # fmt: skip
        found = answer(
            chain, middle, J, R, want, box, rows, self.v, self.limits.acceleration, self.dt,
            shortcut=self.o.shortcut, fails=self.o.fails,
        )  # fmt: skip
        return found, want, A

    def _made(self, R: pin.SE3, O: list[pin.SE3], v: Array) -> Array:
        """The twists of the object that joint velocities really make in the step, as each arm carries it (N, 6)."""
        after = self.chain.carried(self.chain.moved(self.q, self.dt * v))
        return (
            np.array([pin.log6(R.actInv(b) * R.actInv(a).inverse()).vector for a, b in zip(O, after, strict=True)])
            / self.dt
        )


def _in_axes(R: pin.SE3, J: Array) -> Array:
    """A_k of J_k (N, 6, nv)."""
    return np.kron(np.eye(2), R.rotation.T) @ J


def _bounded(twists: Array, o: Settings) -> Array:
    """Shrunk by one common factor to the largest speeds of a correction."""
    linear, angular = (np.linalg.norm(part, axis=-1).max() for part in (twists[..., :3], twists[..., 3:]))
    return twists / max(linear / o.correction_speed, angular / o.correction_spin, 1.0)
