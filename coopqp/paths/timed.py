"""A path with a speed profile of its own: when the object is where on a geometry."""

from __future__ import annotations

import itertools
from bisect import bisect_right
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, final

import numpy as np
import pinocchio as pin

from coopqp.checks import as_scalar, read_only
from coopqp.errors import InvalidInputError, said
from coopqp.model.limits import BindingLimit, LimitKind
from coopqp.paths.elbows import Elbows
from coopqp.paths.geometry import PathGeometry, Straight, piece_of
from coopqp.paths.path import ObjectPath
from coopqp.shown import Brief
from coopqp.spatial import Array


@dataclass(frozen=True, eq=False, repr=False)
class SpeedProfile(Brief):
    """Speed along a geometry: the square of ṡ is linear in s between grid points, so s̈ is constant there.

    Attributes:
        s: the grid points (K,) [m], increasing from 0.
        squares: ṡ² at each (K,) [m²/s²]; 0 at both ends, and not at two grid points in a row.
        binding: the most used limit between grid points, K − 1 of them; None where it is not known.
        use: share of that limit that is used (K − 1,); NaN where it is not known.

    Raises:
        InvalidInputError: numbers that make no profile.
    """

    s: Array
    squares: Array
    binding: tuple[BindingLimit | None, ...] = ()
    use: Array | None = None

    def __post_init__(self) -> None:
        s, squares = (np.array(x, dtype=float) for x in (self.s, self.squares))
        if s.ndim != 1 or s.shape != squares.shape or len(s) < 2 or not np.isfinite(s).all() or s[0] != 0.0:
            raise InvalidInputError("its grid points do not begin at 0", "SpeedProfile", "Give s and squares alike.")
        if not (np.diff(s) > 0.0).all() or not (np.isfinite(squares) & (squares >= 0.0)).all():
            raise InvalidInputError("grid points do not rise, or squares are negative", "SpeedProfile", "Sort them.")
        if squares[0] or squares[-1] or (squares[1:] + squares[:-1] <= 0.0).any():
            raise InvalidInputError(
                "it does not rest at its ends, or it rests on the way", "SpeedProfile", "Give squares 0 … > 0 … 0."
            )
        size = len(s) - 1
        binding = tuple(self.binding) or (None,) * size
        use = np.full(size, np.nan) if self.use is None else np.array(self.use, dtype=float)
        if len(binding) != size or use.shape != (size,):
            raise InvalidInputError(f"{len(binding)} limits for {size} intervals", "SpeedProfile", "Give one each.")
        for name, value in (("s", s), ("squares", squares), ("use", use)):
            object.__setattr__(self, name, read_only(value))
        object.__setattr__(self, "binding", binding)

    @cached_property
    def clocks(self) -> Array:
        """Clocks of the grid points (K,) [s]."""
        speeds = np.sqrt(self.squares)
        return np.concatenate([[0.0], np.cumsum(2.0 * np.diff(self.s) / (speeds[1:] + speeds[:-1]))])

    @property
    def duration(self) -> float:
        """Duration of the motion [s]."""
        return float(self.clocks[-1])

    def sections(self) -> list[dict[str, Any]]:
        """Binding limits over time, as plain data: from when to when [s], and the arm, the joint and the limit."""
        out: list[dict[str, Any]] = []
        ends = self.clocks.tolist()
        for limit, run in itertools.groupby(enumerate(self.binding), key=lambda item: item[1]):
            own = [i for i, _ in run]
            if limit is not None:
                span = {"from_s": ends[own[0]], "to_s": ends[own[-1] + 1]}
                out.append({**span, "arm": limit.arm, "joint": limit.joint, "limit": limit.kind.value})
        return out

    def bound_by(self, sections: Iterable[Mapping[str, Any]]) -> SpeedProfile:
        """The same profile with the limits that :meth:`sections` described."""
        binding: list[BindingLimit | None] = [None] * (len(self.s) - 1)
        for section in sections:
            i, j = (int(np.abs(self.clocks - section[key]).argmin()) for key in ("from_s", "to_s"))
            limit = BindingLimit(str(section["arm"]), str(section["joint"]), LimitKind(section["limit"]))
            binding[i:j] = [limit] * (j - i)
        return SpeedProfile(self.s, self.squares, tuple(binding))

    @cached_property
    def slopes(self) -> Array:
        """s̈ between grid points (K − 1,) [m/s²]."""
        return 0.5 * np.diff(self.squares) / np.diff(self.s)


@final
class TimedPath(ObjectPath):
    """A geometry with a speed profile. The object rests at both ends and at the geometry's corners.

    Args:
        geometry: where the object goes.
        profile: how fast; it ends where the geometry ends.
        planned_share: share of the joints' limits that it was planned with, in (0, 1]; None if it was not.
        keeps_clear: True if the planned motion of redundant arms is proved to keep clear of the bodies of a scene.
        elbows: the planned motion of redundant arms, along which they are led; None: they move as little as they can.

    Attributes:
        profile: the speed profile.

    Raises:
        InvalidInputError: profile and geometry do not fit each other.
    """

    def __init__(
        self,
        geometry: PathGeometry,
        profile: SpeedProfile,
        *,
        planned_share: float | None = None,
        keeps_clear: bool = False,
        elbows: Elbows | None = None,
    ) -> None:
        if abs(profile.s[-1] - geometry.length) > 1e-9 * geometry.length:
            raise InvalidInputError(
                f"the profile ends at {profile.s[-1]:g} m and the geometry at {geometry.length:g} m",
                "TimedPath",
                "Give the profile of this geometry.",
            )
        rests = np.interp(geometry.marks[list(geometry.corners)], profile.s, profile.squares)
        if (rests > 1e-12).any():
            raise InvalidInputError("it moves at a corner", "TimedPath", "Give a profile that rests at each corner.")
        if planned_share is not None:
            self.planned_share = as_scalar(planned_share, "TimedPath: planned_share", high=1.0)
        self._geometry, self.profile, self.keeps_clear = geometry, profile, bool(keeps_clear)
        self.duration, self.elbows = profile.duration, elbows
        self._clocks, self._s = profile.clocks.tolist(), profile.s.tolist()
        self._speeds, self._slopes = np.sqrt(profile.squares).tolist(), profile.slopes.tolist()

    def geometry(self) -> PathGeometry:
        """Where the path goes."""
        return self._geometry

    def kept_clear(self) -> TimedPath:
        """The same path, whose planned motion is proved to keep clear."""
        share, elbows = self.planned_share, self.elbows
        return TimedPath(self._geometry, self.profile, planned_share=share, keeps_clear=True, elbows=elbows)

    def clocks(self, s: Array) -> Array:
        """Clocks (K,) [s] at which the path is at s (K,) [m]."""
        p = self.profile
        i = np.clip(np.searchsorted(p.s, s, side="right") - 1, 0, len(p.s) - 2)
        away = np.clip(s - p.s[i], 0.0, None)
        speeds = np.sqrt(np.maximum(p.squares[i] + 2.0 * p.slopes[i] * away, 0.0)) + np.sqrt(p.squares[i])
        return np.asarray(p.clocks[i] + 2.0 * away / np.where(speeds > 0.0, speeds, 1.0))

    def at(self, clock: float) -> tuple[float, float, float]:
        """s [m], ṡ [m/s] and s̈ [m/s²] at ``clock`` [s]; s̈ is 0 before and after."""
        if not clock > 0.0:
            if clock != clock:
                raise InvalidInputError("the clock is NaN", "TimedPath", "Give a finite time [s].")
            return 0.0, 0.0, 0.0
        if clock >= self.duration:
            return self._s[-1], 0.0, 0.0
        i = bisect_right(self._clocks, clock) - 1
        t, slope = clock - self._clocks[i], self._slopes[i]
        speed = self._speeds[i] + slope * t
        return min(self._s[i] + 0.5 * (self._speeds[i] + speed) * t, self._s[i + 1]), max(speed, 0.0), slope

    def pose(self, clock: float) -> pin.SE3:
        """T_world_object at ``clock`` [s]."""
        return self._geometry.pose(self.at(clock)[0])

    def twist(self, clock: float) -> Array:
        """Body twist at ``clock`` [m/s, rad/s]."""
        s, speed, _ = self.at(clock)
        if speed == 0.0:
            return np.zeros(6)
        R, V = self._geometry.pose(s).rotation, self._geometry.twist(s)
        return (V.reshape(2, 3) @ R).ravel() * speed

    def packed(self) -> Array | None:
        """See :meth:`ObjectPath.packed`: a segment for each interval of even acceleration on a line.

        None where a piece is no straight one, which only Python knows.
        """
        return self._numbers

    @cached_property
    def _numbers(self) -> Array | None:
        if not all(isinstance(piece, Straight) for piece in self._geometry.pieces):
            return None
        segments: list[Array] = []
        for piece, mark in zip(self._geometry.pieces, self._geometry.marks.tolist(), strict=False):
            assert isinstance(piece, Straight)
            end = mark + piece.length
            inner = self.profile.s[(self.profile.s > mark) & (self.profile.s < end)]
            ends = np.concatenate([[mark], inner, [end]])
            clocks, (R, p) = self.clocks(ends), piece.poses(ends - mark)
            for i, (T, gone) in enumerate(zip(np.diff(clocks), np.diff(ends), strict=True)):
                if T > 0.0:
                    speed = self._speed_at(0.5 * (ends[i] + ends[i + 1]), 0.5 * (clocks[i] + clocks[i + 1]), T)
                    law = [clocks[i], T, 3.0, min(max(speed * T / gone, 0.0), 2.0)]
                    share = gone / piece.length
                    whole = [R[i].ravel(), p[i], share * piece.turn, share * piece.way]
                    segments.append(np.concatenate([*whole, law, np.zeros(7)]))
        return read_only(np.concatenate([[self.duration, 0.0, len(segments)], *segments]))

    def _speed_at(self, middle: float, clock: float, span: float) -> float:
        """ṡ [m/s] half a span [s] before a clock; s is ``middle`` between the two knots that hold both."""
        slope = self._slopes[min(bisect_right(self._s, middle), len(self._slopes)) - 1]
        return self.at(clock)[1] - 0.5 * span * float(slope)

    def record(self) -> dict[str, Any]:
        """The path as plain lists of numbers, from which :meth:`of_record` makes it again, bit for bit."""
        return {
            "pieces": [piece.numbers().tolist() for piece in self._geometry.pieces],
            "s": self.profile.s.tolist(),
            "squares": self.profile.squares.tolist(),
            "planned_share": self.planned_share,
            "keeps_clear": self.keeps_clear,
            "elbows": None if self.elbows is None else self.elbows.record(),
            "binding": self.profile.sections(),
        }

    @staticmethod
    def of_record(record: Mapping[str, Any]) -> TimedPath:
        """The path that :meth:`record` describes.

        Raises:
            InvalidInputError: it describes none.
        """
        try:
            pieces = tuple(piece_of(np.asarray(piece, dtype=float)) for piece in record["pieces"])
            s, squares = (np.asarray(record[name], dtype=float) for name in ("s", "squares"))
            share, clear = record["planned_share"], bool(record.get("keeps_clear", False))
            elbows = None if record.get("elbows") is None else Elbows.of_record(record["elbows"])
            profile = SpeedProfile(s, squares).bound_by(record.get("binding", ()))
        except InvalidInputError:
            raise
        except (KeyError, TypeError, ValueError) as error:
            raise InvalidInputError(
                f"the record of a timed path is damaged ({said(error)})", "TimedPath", "Make it with TimedPath.record."
            ) from error
        if not pieces:
            raise InvalidInputError("the record has no piece", "TimedPath", "Make it with TimedPath.record.")
        return TimedPath(PathGeometry(pieces), profile, planned_share=share, keeps_clear=clear, elbows=elbows)
