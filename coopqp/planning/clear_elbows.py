"""Plans whose redundant arms keep clear of bodies by a motion of their elbows, which is timed and then led.

Where the elbows' least motion does not keep clear, the check of a path has another one, found as a controller evades. A
mean of both that is proved to keep clear is smoothed and timed, so a controller that is led along it has nothing to
evade, and every step has the planned rate.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import numpy as np

from coopqp.errors import UndecidedError, UnreachableError
from coopqp.paths.certificate import PathVerdict
from coopqp.paths.timed import SpeedProfile, TimedPath
from coopqp.planning.check import PathCheck, check_motion, check_path, places_along
from coopqp.planning.knots import Lead
from coopqp.planning.timing import TimedMotion
from coopqp.spatial import Array

if TYPE_CHECKING:
    from coopqp.collision.scene import CollisionScene

#: Samples of a motion of the elbows along the whole path.
_SAMPLES = 240
#: Standard deviations of the means that smooth it, as shares of the path.
_WIDTHS = (0.1, 0.03, 0.01)
#: Parts of the evading motion in that of the elbows; the first one that keeps clear is taken.
_PARTS = (0.25, 0.5, 0.75, 1.0)
#: How much slower than planned the path is looked at for an evading motion: slowly elbows evade further.
_SLOWER = (1.0, 4.0, 16.0)
#: Least clearance of a motion that is led [m]: a run keeps to it within 0.1 mm.
_LEAST = 1e-4


def clear_plan(
    check: PathCheck, motion: TimedMotion, scene: CollisionScene, timing: Callable[[Lead], TimedMotion]
) -> tuple[TimedPath, PathCheck] | None:
    """A timed path with elbows that are proved to keep clear, and its check; None if none is found.

    Args:
        check: of the path as it was timed with the elbows' least motion, from a given start.
        motion: that motion.
        scene: the bodies.
        timing: times the path with elbows that are led.
    """
    for lead in _leads(check, motion, scene):
        try:
            led = timing(lead)
        except (UnreachableError, UndecidedError):  # this one cannot be followed
            continue
        own = check_motion(check.cell, check.grasp, led.path, led.x, scene)
        if own is None or own.verdict is not PathVerdict.CERTIFIED:
            continue
        if own.clearance is not None and own.clearance.proved >= _LEAST:
            path = led.path.kept_clear()
            return path, own.on(path)
    return None


def _leads(check: PathCheck, motion: TimedMotion, scene: CollisionScene) -> Iterator[Lead]:
    """Motions of the elbows to try, the fastest first."""
    geometry, profile = motion.path.geometry(), motion.path.profile
    s = np.linspace(0.0, geometry.length, _SAMPLES)
    least = np.array([np.interp(s, profile.s, row) for row in motion.x.T]).T
    for slower in _SLOWER:
        found = check
        if slower > 1.0:
            path = TimedPath(geometry, SpeedProfile(profile.s, profile.squares / slower**2))
            found = check_path(check.cell, check.grasp, path, q_start=check.q_start, scene=scene)
        way = found.proved_trajectory()
        if way is None:
            continue
        evading = way.positions(places_along(geometry, s))[0]
        for width in _WIDTHS:
            for part in _PARTS if width == _WIDTHS[0] else _PARTS[-1:]:
                yield smooth(s, least + part * (evading - least), width)


def smooth(s: Array, x: Array, width: float) -> Lead:
    """A motion through the mean of rows (K, nv) over their neighbours, with the same ends, bent smoothly."""
    from scipy.interpolate import CubicSpline  # takes long to import
    from scipy.ndimage import gaussian_filter1d

    n = len(s)
    wide = np.pad(x, ((n - 1, n - 1), (0, 0)), mode="reflect", reflect_type="odd")
    spline = CubicSpline(s, gaussian_filter1d(wide, width * n, axis=0)[n - 1 : 2 * n - 1])

    def lead(at: Array) -> Array:
        return spline(at)

    return lead
