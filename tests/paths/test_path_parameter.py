"""Clocks at marks of a path's way: the path is where its geometry says."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from coopqp import LinePath, ObjectPath, WaypointPath


def corners() -> list[pin.SE3]:
    pin.seed(3)
    start = pin.SE3.Random()
    return [start * pin.exp6(x * np.array([0.3, -0.1, 0.2, 0.2, 0.1, -0.3])) for x in (0.0, 1.0, 0.4, 0.4, 2.0)]


@pytest.mark.parametrize("law", ["linear", "quintic"])
@pytest.mark.parametrize("several", [False, True])
def test_a_path_is_at_each_mark_at_the_mark_s_clock(law: str, several: bool) -> None:
    poses = corners()  # one twice: there the object rests
    path: ObjectPath = LinePath(poses[0], poses[1], duration=2.0, time_law=law)
    if several:
        path = WaypointPath(poses, durations=[1.0, 2.0, 0.5, 3.0], time_law=law)
    way = path.geometry()
    assert way is not None
    marks = np.linspace(0.0, way.length, 23)
    clocks = path.clocks(marks)
    assert clocks[0] == pytest.approx(0.0, abs=1e-9)
    assert clocks[-1] == pytest.approx(path.duration)
    assert (np.diff(clocks) > 0.0).all()
    for mark, clock in zip(marks, clocks, strict=True):
        assert way.pose(float(mark)).isApprox(path.pose(float(clock)), 1e-6)
