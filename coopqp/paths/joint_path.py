"""A way of one arm's joints over a clock, for arms that do not hold the object; and pieces of it along a path."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import final

import numpy as np
import pinocchio as pin

from coopqp.checks import ArrayLike, as_floats, as_scalar
from coopqp.core._core import WAY_HEAD
from coopqp.errors import InvalidInputError
from coopqp.paths.elbows import Elbows
from coopqp.paths.time_law import TimeLaw
from coopqp.spatial import Array

#: Over this time twists of a tool are taken from its poses [s].
_TICK = 1e-6


@final
@dataclass(frozen=True, eq=False)
class JointPath:
    """Positions of the joints that move one arm's tool, over a clock; they rest at both ends.

    Args:
        positions: where the joints rest (m, n) [rad or m], in the order of the arm's joints; the first row is where the
            arm is when the path begins. From row to row all joints go together, by the quintic time law.
        durations: of each of the m − 1 ways [s]; one number is that of each.

    Raises:
        InvalidInputError: fewer than two rows, or other durations than one a way, > 0.
    """

    positions: ArrayLike
    durations: ArrayLike
    _through: Elbows | None = None

    def __post_init__(self) -> None:
        rows = as_floats(self.positions)
        if rows.ndim != 2 or len(rows) < 2 or not rows.shape[1] or not np.isfinite(rows).all():
            raise InvalidInputError(
                f"positions of shape {rows.shape}, or not finite",
                "JointPath",
                "Give rows of joint positions, two at least.",
            )
        times = as_floats(self.durations)
        times = np.full(len(rows) - 1, times) if times.ndim == 0 else times
        if times.shape != (len(rows) - 1,) or not (np.isfinite(times).all() and (times > 0.0).all()):
            raise InvalidInputError(
                f"durations of shape {times.shape}, or not > 0", "JointPath", f"Give {len(rows) - 1} durations [s]."
            )
        object.__setattr__(self, "positions", rows)
        object.__setattr__(self, "durations", times)

    @staticmethod
    def through(clocks: ArrayLike, positions: ArrayLike, speeds: ArrayLike | None = None) -> JointPath:
        """Cubics without overshoot through samples of a way, such as a planner gives; at rest at both ends.

        Args:
            clocks: rising from 0 (K,) [s].
            positions: there (K, n) [rad or m].
            speeds: there (K, n) [rad/s or m/s]; by default the ones by which nothing overshoots.

        Raises:
            InvalidInputError: clocks that do not rise from 0, positions that are not one row a clock, or speeds of
                another shape.
        """
        where = "JointPath.through"
        found = Elbows.through(clocks, positions)
        as_scalar(found.clocks[0], f"{where}: clocks[0]", low=-1e-12, high=1e-12)
        slopes = found.slopes.copy()
        if speeds is not None:
            slopes = as_floats(speeds).copy()
            if slopes.shape != found.x.shape or not np.isfinite(slopes).all():
                remedy = f"Give finite ones of shape {found.x.shape}."
                raise InvalidInputError(f"speeds of shape {slopes.shape}, or not finite", where, remedy)
        slopes[0] = slopes[-1] = 0.0
        return JointPath(found.x, np.diff(found.clocks), Elbows(found.clocks, found.x, slopes))

    def begun(self, x: Array) -> JointPath:
        """The same way, begun exactly at positions (n,) near its first."""
        rows = self.rows.copy()
        rows[0] = x
        through = self._through
        return JointPath(rows, self.durations, None if through is None else replace(through, x=rows))

    @property
    def speeds(self) -> Array | None:
        """Speeds at its rows (m, n); None where the joints rest at each row and go straight to the next."""
        return None if self._through is None else self._through.slopes

    @property
    def rests(self) -> Array:
        """Clocks at which the joints rest between parts that are straight, or that have one time law [s]."""
        return self.clocks if self._through is None else self.clocks[[0, -1]]

    @property
    def rows(self) -> Array:
        """The positions that were given (m, n) [rad or m]."""
        return np.asarray(self.positions)

    @property
    def farthest(self) -> Array:
        """Positions (m, n) between which all others lie [rad or m]: its rows, and where joints go beyond them."""
        return self.rows if self._through is None else np.vstack([self.rows, self._through.turning_points()])

    @cached_property
    def clocks(self) -> Array:
        """Clocks of its rows (m,), from 0 [s]."""
        return np.concatenate([[0.0], np.cumsum(self.durations)])

    @property
    def duration(self) -> float:
        """Its duration [s]."""
        return float(self.clocks[-1])

    def at(self, clock: float) -> tuple[Array, Array]:
        """Positions and speeds (n,) at a clock [s]; those of an end beyond it."""
        if not 0.0 <= clock < self.duration:
            return self.rows[0 if clock < 0.0 else -1].copy(), np.zeros(self.rows.shape[1])
        if self._through is not None:
            return self._through.at(clock)
        starts, x = self.clocks, self.rows
        i = min(int(np.searchsorted(starts, clock, side="right")) - 1, len(x) - 2)
        span = float(starts[i + 1] - starts[i])
        share, way = (clock - float(starts[i])) / span, x[i + 1] - x[i]
        return x[i] + TimeLaw.QUINTIC.value_at(share) * way, TimeLaw.QUINTIC.slope_at(share) / span * way


@final
@dataclass(frozen=True, eq=False)
class JointPiece:
    """A part of a path on which an arm follows its joints' own way, and its tool goes where they lead it.

    Attributes:
        start, end: clocks at its ends [s].
        way: the joints' way.
        moved: M of the tool at a clock of the program [s].
        origin, sense: the program's clock is ``origin + sense · clock``.
        begins: the program's clock at which the way begins [s].
    """

    start: float
    end: float
    way: JointPath
    moved: Callable[[float], pin.SE3]
    begins: float
    origin: float = 0.0
    sense: int = 1

    def at(self, clock: float) -> tuple[Array, Array]:
        """Positions of the joints and their speeds (n,) at a clock [s]."""
        x, speed = self.way.at(self.origin + self.sense * clock - self.begins)
        return x, self.sense * speed

    def pose(self, clock: float) -> pin.SE3:
        """M at a clock [s]."""
        return self.moved(self.origin + self.sense * min(max(clock, self.start), self.end))

    def twist(self, clock: float) -> Array:
        """``M′ M⁻¹`` at a clock (6,) [m/s, rad/s], from poses beside it."""
        a, b = max(clock - _TICK, self.start), min(clock + _TICK, self.end)
        if not b > a:
            return np.zeros(6)
        change: Array = np.asarray(pin.log6(self.pose(b) * self.pose(a).inverse()).vector) / (b - a)
        return change

    def packed(self, arm: int) -> Array:
        """As numbers for the compiled core, of arm number ``arm``: see ``ways.cpp``."""
        way, straight = self.way, self.way.speeds is None
        speeds = np.zeros_like(way.rows) if way.speeds is None else way.speeds
        head = np.empty(WAY_HEAD)
        head[:] = [arm, self.start, self.end, self.origin, self.sense, self.begins, len(way.rows), straight]
        return np.concatenate([head, way.clocks, way.rows.ravel(), speeds.ravel()])

    def section(self, begin: float, sense: int) -> JointPiece:
        """The same on a section of the path that begins at a clock [s]; backwards for a sense of −1."""
        ends = sorted(sense * (clock - begin) for clock in (self.start, self.end))
        origin = self.origin + self.sense * begin
        return JointPiece(ends[0], ends[1], self.way, self.moved, self.begins, origin, self.sense * sense)
