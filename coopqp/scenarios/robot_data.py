"""Cells of well-known robots from the package ``example-robot-data`` (extra ``robots``), loaded by path."""

from __future__ import annotations

from coopqp.paths.path import TimeLaw
from coopqp.paths.scenario import Scenario
from coopqp.scenarios.stations import Station, facing, moved, put_together
from coopqp.scenarios.units import Seconds


def panda_bar(*, geometry: bool = True, duration: Seconds = 3.0, time_law: TimeLaw | str = TimeLaw.QUINTIC) -> Scenario:
    """Two seven-joint pandas with locked fingers and their acceleration limits move a bar of 1 m and 3 kg.

    Args:
        geometry: also load the meshes (about half a second, once).
        duration: duration of the path [s].
        time_law: time law of the path.

    Raises:
        MissingExtraError: ``example-robot-data`` is not installed.
    """
    path = moved(0.30, (0.06, 0.10, 0.20), (0.30, 0.15, 0.20), duration, time_law)
    return put_together(
        "panda_bar", facing("panda", 0.40), path, object_size=(1.00, 0.04, 0.04), object_mass=3.0, geometry=geometry
    )


def ur5_table(*, geometry: bool = True, duration: Seconds = 3.0, time_law: TimeLaw | str = TimeLaw.QUINTIC) -> Scenario:
    """Four UR5 along the long sides of a table top of 1.2 x 0.8 m and 12 kg move it.

    Args:
        geometry: also load the meshes (about half a second, once).
        duration: duration of the path [s].
        time_law: time law of the path.

    Raises:
        MissingExtraError: ``example-robot-data`` is not installed.
    """
    path = moved(0.30, (0.08, 0.05, 0.15), (0.15, -0.12, 0.10), duration, time_law)
    stations = [
        Station("ur5", f"ur5_{k + 1}", (x, y), -90.0 if y > 0.0 else 90.0)
        for k, (x, y) in enumerate(((-0.5, -0.4), (0.5, -0.4), (0.5, 0.4), (-0.5, 0.4)))
    ]
    return put_together(
        "ur5_table", stations, path, object_size=(1.20, 0.80, 0.03), object_mass=12.0, geometry=geometry
    )
