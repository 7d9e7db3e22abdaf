"""Retargeting a :class:`ServoPath`: going over to a new target in motion. The core's counterpart is ``servo.cpp``."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from coopqp.control.lookahead.ramp_time import RampTime
from coopqp.core._core import RATE_TOLERANCE, STILL_OBJECT
from coopqp.paths.path import ObjectPath
from coopqp.paths.servo import ServoPath


def object_rests(loop: Any, path: ObjectPath) -> bool:
    """Whether the object rests on its path."""
    return not np.abs(loop.rate * path.twist(loop.clock)).max() > STILL_OBJECT


def retarget_motion(loop: Any, path: ServoPath, ramp_time: RampTime, goal: pin.SE3, rate: float) -> bool:
    """Take the way to a target if the first step keeps to its rate and no joint jumps. True if it is taken.

    The way begins at a rate: at the full one, or at the present one, then its twist is as much larger. If the object
    rests the way begins at rest, and so do the joints: self-motion that goes on there has to come to rest before.
    """
    clock, now, way, memory = loop.clock, loop.rate, path.state(), loop.memory()
    times = ramp_time.at(loop.q, path.pose(clock))
    rests = object_rests(loop, path)
    if not (ramp_time.admits(loop.velocity) if rests else rate > 0.0):
        return False
    rate = 0.0 if rests else rate
    path.set_target(goal, clock=clock, rate=0.0 if rests else now / rate, ramp_times=times, stops=ramp_time.stops)
    loop.look_ahead_again(rate=rate)
    if rests:
        return True
    kept, change = loop.try_step()
    if kept >= rate - RATE_TOLERANCE and ramp_time.admits(change):
        return True
    path.restore(way)
    loop.take_path()
    loop.restore(memory)
    return False
