"""The verdict on a step: its status and cause, the object's distance from its path, the slack of each priority."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

from coopqp.constraints.cause import Cause, cause_of_limits
from coopqp.control.interface import NOTHING, GivenUp, Status, off_path
from coopqp.control.lookahead.preview import PathPreview
from coopqp.control.options import QPOptions
from coopqp.control.step.linearised import LinearisedAnswer
from coopqp.control.step.state import LoopState
from coopqp.model.limits import BindingLimit, LimitKind
from coopqp.model.shapes import by_depth
from coopqp.native.constants import ARRIVING, RATE_ROUNDING, RESTING_SPEED, RESTING_SPIN, STILL_BLOCKED, STILL_SLOWED
from coopqp.spatial import Array


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


def lasting(
    s: LoopState, status: Status, rate: float, binding: tuple[BindingLimit, ...], *, h: float, no_horizon: bool
) -> Status:
    """``status``, or that of the last step, which lasts a moment: else it would flicker near rates of 0 and 1.

    ``no_horizon`` where nothing is known ahead of a step of length ``h`` [s].
    """
    last, more, most = s.status, 0.0, 0.0
    if last is Status.BLOCKED and status is Status.SLOWED and binding:
        more, most = rate * h, STILL_BLOCKED
    elif last is Status.SLOWED and status is Status.TRACKING and no_horizon:
        more, most = h, STILL_SLOWED
    if more > 0.0 and s.outdated + more <= most:
        s.outdated += more
        return last
    if last is not Status.BLOCKED or status is not last:
        s.outdated = 0.0
    return status


def rests(off_path: Array) -> bool:
    """Whether an object whose clock stands rests: it may leave its path (6,) that slowly; errors are corrected."""
    speed, spin = float(np.linalg.norm(off_path[:3])), float(np.linalg.norm(off_path[3:]))
    return speed <= RESTING_SPEED and spin <= RESTING_SPIN


def cause_of(
    status: Status, watched: Cause | None, binding: tuple[BindingLimit, ...], *, measured: bool
) -> Cause | None:
    """Why a status is not TRACKING; None if it is.

    Args:
        status: of the step.
        watched: cause of what the supervision found; None if it found nothing. A hold without one is the solver's.
        binding: limits that the step runs against.
        measured: measurements have a share in the object's distance from its path.
    """
    if status is Status.TRACKING:
        return None
    if status is Status.PAUSED:
        return Cause.OPERATOR
    if status in (Status.HOLDING, Status.FAULT):
        return watched or Cause.SOLVER
    # Without a limit the bound on the rate's rise slows the object, and a path that it was given away from it is far.
    rest = Cause.LIMIT if status is not Status.OFF_PATH else Cause.TRACKING if measured else Cause.INPUT
    return cause_of_limits(binding) or watched or rest


def too_close(inside: tuple[BindingLimit, ...]) -> str:
    """A sentence: the two bodies that are deepest inside their margin; empty without any."""
    if not inside:
        return ""
    others = len(inside) - 1
    more = f", and {others} other pair{'s' * (others > 1)}" if others else ""
    names, distance = " and ".join(inside[0].between), inside[0].distance or 0.0
    if distance < 0.0:
        return f"{names} overlap{by_depth(distance)}{more}"
    return f"{names} are {1e3 * distance:.1f} mm from each other, inside their margin{more}"


def away_from_path(s: LoopState, linearised: LinearisedAnswer, options: QPOptions) -> str:
    """A sentence: the object's measured distance from its path; empty if it is within the options' bounds."""
    error = linearised.common if s.drift is None else linearised.common + s.drift
    x, y, z, *turn = error.tolist()
    distance, angle = math.hypot(x, y, z), math.hypot(*turn)
    if not (distance > options.off_path_distance or angle > options.off_path_angle):
        return ""
    distance = float(np.linalg.norm(pin.exp6(error).translation))  # at most as long as the twist's
    return off_path(distance * (distance > options.off_path_distance), angle * (angle > options.off_path_angle))


def given_up(linearised: LinearisedAnswer, rate: float, restricted: tuple[str, ...]) -> GivenUp:
    """The slack of each priority in a step; ``restricted`` are the names of arms with few joints."""
    answer = linearised.answer
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
