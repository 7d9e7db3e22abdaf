"""The tasks that coopqp and its peers do side by side.

Cases of cost are of arms round a ring:

``nominal``   2 s within all limits; the loop goes on from its own command;
``measured``  the same, closed on readings: the command of one sample ago with noise, so that measured never equals
              commanded and nothing can be skipped;
``watched``   the same readings, and the force at the grasps is read from the servos;
``qp``        nominal, with a QP at every step;
``zigzag``    round corners at 0.6 m/s with joints limited to 1 rad/s: slowed at most steps.

Peers do ``nominal``, ``measured`` and ``zigzag``; they know neither forces nor a step without a QP.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import common  # first: it limits BLAS to one thread
import numpy as np
import pinocchio as pin

from coopqp import QPOptions, SupervisionOptions
from coopqp.model.chain import Chain
from coopqp.model.grasp import Grasp
from coopqp.model.inverse_kinematics import inverse_kinematics
from coopqp.scenarios import Scenario, fast_lift, paper_lift

#: Cases of behaviour (the paper's three arms, 1 rad/s) and of cost (arms around a ring).
BEHAVIOUR = ("fast", "mismatch", "outside")
COST = ("nominal", "measured", "watched", "qp", "zigzag")
#: Cases of cost that peers do.
PEER_COST = ("nominal", "measured", "zigzag")
#: Cases whose loop is closed on readings.
READ = ("measured", "watched")
#: Noise of a reading, either way [rad].
NOISE = 1e-4
#: Stiffness of the servos where they are watched [N·m/rad]: noise makes newtons of it, the limit is hundreds.
STIFFNESS = 2e4

_SPEED_LIMIT = 1.0
_MISMATCH = 5e-3
_OUTSIDE = 10e-3


@dataclass(frozen=True)
class Case:
    """A task and its length.

    Attributes:
        name: of the case.
        scenario: what to do.
        steps: longest run that is watched; a target beyond the path's end is the end.
        noise: of the readings that close the loop [rad]; None: it goes on from the command.
        options: coopqp's.
    """

    name: str
    scenario: Scenario
    steps: int
    noise: float | None = None
    options: QPOptions = field(default_factory=QPOptions)


def options_of(name: str, dt: float) -> QPOptions:
    """coopqp's options in a case of cost: the defaults except for the case's own setting; ``dt`` in s."""
    if name == "watched":  # readings are one sample late
        return QPOptions(supervision=SupervisionOptions(stiffness=STIFFNESS, servo_delay=dt))
    return QPOptions(shortcut=name != "qp")


def build(name: str, arms: int = 3, joints: int = 6) -> Case:
    """Build a case by name. ``arms`` and ``joints`` (per arm) only apply to the cases of cost."""
    if name in COST:
        scenario = common.ring(arms=arms, joints=joints, path="zigzag" if name == "zigzag" else "nominal")
        noise = NOISE if name in READ else None
        return Case(name, scenario, 200, noise, options_of(name, scenario.dt))
    if name == "fast":  # the object at 0.6 m/s: too fast for joints of 1 rad/s
        return Case(name, fast_lift(joint_speed=_SPEED_LIMIT), 900)
    if name == "mismatch":  # the second arm starts 5 mm from its grasp
        lift = _slow_joints(paper_lift(duration=3.0))
        tools = list(lift.grasp.T_object_tool)
        tools[1] = pin.SE3(np.eye(3), _MISMATCH * np.array([0.6, 0.0, 0.8])) * tools[1]
        q = inverse_kinematics(lift.cell, Grasp(tuple(tools)), lift.path.pose(0.0), lift.q_start)
        return Case(name, replace(lift, q_start=q), 300)
    if name == "outside":  # the joint that moves most starts 10 mrad outside its limit; the path leads it inwards
        lift = _slow_joints(paper_lift(duration=3.0))
        chain = Chain(lift.cell, lift.grasp)
        start = lift.path.pose(0.0)
        chain.linearise(lift.q_start, about=start.translation)
        twist = np.kron(np.eye(2), start.rotation) @ lift.path.twist(0.0)
        v = chain.joint_velocities(np.tile(twist, (len(lift.cell), 1)))
        j = int(np.abs(v).argmax())
        limits = {"lower": lift.cell.limits.lower.copy(), "upper": lift.cell.limits.upper.copy()}
        limits["lower" if v[j] > 0 else "upper"][j] = lift.q_start[j] + np.sign(v[j]) * _OUTSIDE
        return Case(name, replace(lift, cell=lift.cell.with_limits(**limits)), 300)
    raise ValueError(f"there is no case '{name}'")


def _slow_joints(scenario: Scenario) -> Scenario:
    return replace(scenario, cell=scenario.cell.with_limits(velocity=_SPEED_LIMIT), dt=2e-3)
