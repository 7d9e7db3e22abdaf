"""Before the motion: all robots are connected and ready, and the controller begins where they stand."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from coopqp.drivers.driver import STANDS, DriverError
from coopqp.drivers.robots import turned
from coopqp.drivers.timing import LoopTime
from coopqp.drivers.watch import RobotWatch
from coopqp.model.cell import RobotCell, slides
from coopqp.spatial import Array

#: A joint that stands this far outside its limits is led inwards; one that stands further is not driven [rad or m].
OUTSIDE = 2e-3
#: So many states of a robot are waited for before the motion.
_PERIODS = 6


def connect(watches: Sequence[RobotWatch], time: LoopTime, *, longest: float, period: float) -> None:
    """Connect all robots, and wait for their first states for ``longest`` [s].

    Raises:
        DriverError: a robot cannot be reached, or tells no state.
    """
    for watch in watches:
        watch.robot.driver.connect()
    limit = time.now() + longest
    while True:
        now = time.now()
        for watch in watches:
            watch.read(time)
        silent = [watch for watch in watches if watch.state is None]
        if not silent:
            return
        if now > limit:
            use = f" of use ({silent[0].refusal})" if silent[0].refusal else ""
            raise DriverError(
                f"robot '{silent[0].robot.name}' tells no state{use} within {longest:g} s. Look at its address, its "
                "network and whether its program runs."
            )
        time.sleep_until(now + period)


def tell_targets(watches: Sequence[RobotWatch]) -> bool:
    """Whether all robots tell what their servos track."""
    return all(watch.state is not None and watch.state.target is not None for watch in watches)


def unready(cell: RobotCell, watches: Sequence[RobotWatch], *, wrenches: bool) -> list[str]:
    """Why robots are not driven as they are, a sentence each; ``wrenches``: the controller needs them."""
    said = []
    for watch in watches:
        said += _outside(cell, watch)
        if watch.condition() in STANDS:
            said.append(f"robot '{watch.robot.name}' says {watch.condition().value}. Release it first.")
        if unlike := watch.unlike_told():
            said.append(unlike)
        name, arms = watch.robot.name, watch.robot.arms
        silent = [arm for arm in arms if watch.wrench(arm) is None] if wrenches and watch.state is not None else []
        if silent and silent != list(arms):
            said.append(f"robot '{name}' tells no wrench of arm '{silent[0]}', and a ForceController needs it.")
        elif silent and len(arms) > 1:
            said.append(
                f"robot '{name}' tells no wrenches by arm, and a ForceController needs one for each of "
                f"{', '.join(arms)}."
            )
        elif silent:
            said.append(f"robot '{name}' tells no wrench, and a ForceController needs one for each arm.")
    return said


def _outside(cell: RobotCell, watch: RobotWatch) -> list[str]:
    """The joint of a robot that stands furthest outside its limits, by more than a servo's inexactness."""
    joints, state = watch.robot.joints, watch.state
    if state is None:
        return []
    lower, upper = cell.limits.lower[joints], cell.limits.upper[joints]
    x = state.q if state.target is None else np.array([state.q, state.target])
    excess = np.atleast_2d(np.maximum(lower - x, x - upper)).max(axis=0)
    k = int(np.argmax(excess))
    if not excess[k] > OUTSIDE:
        return []
    j, out, where = joints[k], float(excess[k]), float(state.q[k])
    inward = -1.0 if where > upper[k] else 1.0
    turns = 0 if slides(cell)[j] else math.ceil(max(out - OUTSIDE, 0.0) / math.tau)
    inside = turns and lower[k] <= where + inward * turns * math.tau <= upper[k]
    by_turns = f", {turns} whole turn{'s' * (turns > 1)} from inside them" if inside else ""
    amount, limits = (
        (f"{1e3 * out:.1f} mm", f"{lower[k]:.3f} to {upper[k]:.3f} m")
        if slides(cell)[j]
        else (f"{np.rad2deg(out):.2f}°", f"{np.rad2deg(lower[k]):.0f}° to {np.rad2deg(upper[k]):.0f}°")
    )
    return [
        f"joint {cell.joint_names[j]} stands {amount} outside its limits of {limits}{by_turns}. Move it inside by "
        "hand, or give the robot's own limits."
    ]


def stand(
    cell: RobotCell,
    watches: Sequence[RobotWatch],
    time: LoopTime,
    *,
    rest_time: float,
    period: float,
    tolerance: float,
) -> tuple[list[Array], Array]:
    """Configurations (nq,) that are measured in a time [s]; and what the servos track (nv,), measured where untold.

    The time is long enough to see how often each robot tells its state.

    Raises:
        DriverError: a joint is in two places that are further apart than the tolerance [rad or m].
    """
    readings, targets, first = [], np.full(cell.nv, np.nan), np.full(cell.nv, np.nan)
    spread = np.zeros((2, cell.nv))
    until = time.now() + max(rest_time, *(_PERIODS * watch.robot.driver.period for watch in watches))
    while True:
        now = time.now()
        x = np.full(cell.nv, np.nan)
        for watch in watches:
            watch.read(time)
            assert watch.state is not None
            joints = watch.robot.joints
            x[joints] = watch.state.q
            targets[joints] = watch.state.q if watch.state.target is None else watch.state.target
        readings.append(cell.configuration_of(x))
        first = np.where(np.isnan(first), x, first)
        away = turned(cell, x - first)
        spread = np.array([np.minimum(spread[0], away), np.maximum(spread[1], away)])
        wide = spread[1] - spread[0]
        if wide.max() > tolerance:
            j = int(np.argmax(wide))
            name = next(watch.robot.name for watch in watches if j in watch.robot.joints)
            unit = "mm" if slides(cell)[j] else "mrad"
            raise DriverError(
                f"not driven: robot '{name}' does not stand: joint {cell.joint_names[j]} was in places "
                f"{1e3 * wide[j]:.1f} {unit} apart. Bring it to rest. Does another robot tell joints of the same names?"
            )
        if now >= until:
            return readings, targets
        time.sleep_until(now + period)


def begin(
    controller: Any, watches: Sequence[RobotWatch], readings: Sequence[Array], targets: Array, *, tolerance: float
) -> Array:
    """Reset the controller where the robots stand; return its first command (nv,) [rad or m].

    It is counted on from what the servos hold, turn for turn.

    Raises:
        DriverError: it is further than the tolerance from where a servo is.
    """
    cell: RobotCell = controller.cell
    q = cell.average(readings)
    if tell_targets(watches):
        controller.reset(q, commanded=cell.configuration_of(targets))
    else:
        controller.reset(q)
    moves = turned(cell, cell.positions(getattr(controller, "controller", controller).commanded) - targets)
    away = np.abs(moves)
    if away.max() > tolerance:
        j = int(np.argmax(away))
        unit = "mm" if slides(cell)[j] else "mrad"
        raise DriverError(
            f"not driven: the first command of joint {cell.joint_names[j]} is {1e3 * away[j]:.1f} {unit} from where "
            f"its servo is, and may be {1e3 * tolerance:.1f}. Move the arms to the start."
        )
    first: Array = targets + moves
    return first
