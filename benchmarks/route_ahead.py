"""A body is put in the way of an object in motion, half a second ahead: does it go round without a stop, and clear?"""

from __future__ import annotations

import common  # first: it limits BLAS to one thread
import numpy as np
from common import Record
from route_cases import at, two_ur10

from coopqp import Clearance, CollisionScene, LinePath, QPController, Replanner, Status, inverse_kinematics
from coopqp.collision import Body, Box
from coopqp.scenarios import Scenario

assert common

#: Name of the rows; speed of the object [m/s]; how far ahead it would come inside the margin of the body [s].
NAME, SPEED, AHEAD = "body ahead", 0.3, 0.5
#: Period [s], margin [m], acceleration limit [rad/s²], half the bar's width [m], longest run [s].
_DT, _MARGIN, _ACCELERATION, _HALF, _LONGEST = 0.004, 0.01, 5.0, 0.03, 10.0
#: A rate below this is a stop.
_STOPS = 0.02
_AWAY = at((5.0, 0.0, 0.0))


def run(seed: int) -> Record:
    """One run: two UR10 move a bar by 0.6 m, a block of random size is put below it, into its way.

    Its check is ROUND where the object went round without a stop, STOPPED where it came to rest on its way, or TOUCHED.
    """
    rng = np.random.default_rng(seed)
    cell, grasp, near = two_ur10()
    cell = cell.with_limits(acceleration=_ACCELERATION)
    start, goal = at((0.0, -0.3, 0.55)), at((0.0, 0.3, 0.55))
    path = LinePath(start, goal, duration=0.6 / SPEED, time_law="linear")
    q = inverse_kinematics(cell, grasp, start, near)
    task = Scenario("two_ur10", cell, grasp, path, q, _DT, object_size=(0.8, 0.06, 0.06), object_mass=3.0)
    width, depth, height = rng.uniform(0.05, 0.2), rng.uniform(0.04, 0.1), 0.4
    block = Body("block", Box((width, depth, height)), _AWAY)
    scene = CollisionScene.of(task, moving=[block], margin=_MARGIN)
    controller = QPController(cell, grasp, path, dt=_DT, constraints=[Clearance(scene)])
    replanner = Replanner(controller, scene, simulated=True, seed=seed)
    controller.reset(q)
    # Its top is from just below the bar, inside its margin, to above the bar's top.
    x, over, when = rng.uniform(-0.2, 0.2), rng.uniform(-0.5 * _MARGIN, 2.0 * _HALF), rng.uniform(0.3, 0.8)
    T, standing = _AWAY, scene
    least, slowest, taken, touched, appeared = np.inf, np.inf, np.nan, False, 0.0
    now = 0.0  # the object's clock
    for k in range(round(_LONGEST / _DT)):
        if T is _AWAY and k * _DT >= when:
            ahead = SPEED * AHEAD + _HALF + _MARGIN + 0.5 * depth
            y, appeared = float(path.pose(now).translation[1]) + ahead, k * _DT
            T = at((x, y, 0.55 - _HALF + over - 0.5 * height))
            standing = scene.standing({"block": T})
        replanner.move("block", T)
        step = controller.step()
        now = step.clock_next
        if T is not _AWAY:
            least = min(least, standing.distances(step.q_next)[0].distance)
            slowest = min(slowest, 0.0 if step.status is Status.BLOCKED else step.rate)
        if replanner.watch(step):
            taken = (k + 1) * _DT
        if step.finished:
            break
    stopped = not step.finished or slowest < _STOPS
    touched = least <= 0.0
    return {
        "problem": NAME, "seed": seed, "engine": "coopqp", "found": bool(step.finished and replanner.found),
        "first_s": taken - appeared if replanner.found else _LONGEST, "total_s": (k + 1) * _DT,
        "length_m": None, "check": "TOUCHED" if touched else "STOPPED" if stopped else "ROUND",
        "duration_s": (k + 1) * _DT, "clearance_mm": 1e3 * least,
    }  # fmt: skip
