"""Words about a step: slowed or blocked, the object's distance from its path, the parts that were given up."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

from coopqp.control.command import NOTHING, GivenUp, Status, off_path
from coopqp.control.linearised import LinearisedAnswer
from coopqp.control.loop_state import LoopState
from coopqp.control.options import QPOptions
from coopqp.control.rate_cap import RATE_ROUNDING
from coopqp.model.limits import BindingLimit, LimitKind
from coopqp.planning.preview import PathPreview

#: An object that comes to a stop for good counts as blocked from this many times the rate on.
ARRIVING = 10.0


def slow_status(
    s: LoopState,
    rate: float,
    binding: tuple[BindingLimit, ...],
    preview: PathPreview | None,
    blocked_rate: float,
    *,
    outside: bool,
    dt: float,
) -> Status:
    """Whether an object that goes on at a rate below 1 is slowed or blocked; ``outside`` if a joint is."""
    rising = rate > s.rate + RATE_ROUNDING
    ends = any(b.kind is LimitKind.POSITION for b in binding) or (preview is not None and preview.ends)
    arriving = ends and not rising and not outside
    if rate >= blocked_rate * (ARRIVING if arriving else 1.0):
        return Status.SLOWED
    # Without a limit the bound on the rate's rise, or the unknown path ahead, keeps the rate small. From rest the
    # accelerations do: then the rate grows, or a joint is on its way back into its limits.
    accelerating = any(b.kind is LimitKind.ACCELERATION for b in binding)
    slowed = not binding or (accelerating and (rising or outside))
    if preview is not None and not ends and rate > 0.0:  # joints that stop slowly go on after a corner
        slowed = slowed or preview.reaches_corner(s.clock - dt, 2.0 * dt)
    return Status.SLOWED if slowed else Status.BLOCKED


def away_from_path(s: LoopState, found: LinearisedAnswer, options: QPOptions) -> str:
    """A sentence: the object's measured distance from its path; empty if it is within the options' bounds."""
    error = found.common if s.drift is None else found.common + s.drift
    x, y, z, *turn = error.tolist()
    distance, angle = math.hypot(x, y, z), math.hypot(*turn)
    if not (distance > options.off_path_distance or angle > options.off_path_angle):
        return ""
    distance = float(np.linalg.norm(pin.exp6(error).translation))  # at most as long as the twist's
    return off_path(distance * (distance > options.off_path_distance), angle * (angle > options.off_path_angle))


def given_up(found: LinearisedAnswer, rate: float, restricted: tuple[str, ...]) -> GivenUp:
    """The parts that a step gave up; ``restricted`` are the names of arms with few joints."""
    answer = found.answer
    if rate == 1.0 and answer.exact and not restricted:
        return NOTHING
    return GivenUp(
        chain=answer.chain,
        grasp=1.0 - answer.grasp_share,
        off_path=tuple(answer.off_path.tolist()),
        path=1.0 - answer.path_share,
        rate=1.0 - rate,
        restricted=restricted,
    )
