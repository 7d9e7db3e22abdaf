"""The common tasks of coopqp and its peers."""

from __future__ import annotations

from dataclasses import dataclass, replace

import common  # first: it limits BLAS to one thread
import numpy as np
import pinocchio as pin

from coopqp.model.chain import Chain
from coopqp.model.grasp import Grasp
from coopqp.model.inverse_kinematics import inverse_kinematics
from coopqp.scenarios import Scenario, fast_lift, paper_lift

#: Cases of behaviour (the paper's three arms, 1 rad/s) and of cost (arms around a ring).
BEHAVIOUR = ("fast", "mismatch", "outside")
COST = ("nominal", "zigzag")

_SPEED_LIMIT = 1.0
_MISMATCH = 5e-3
_OUTSIDE = 10e-3


@dataclass(frozen=True)
class Case:
    """A task and its length.

    Attributes:
        name: name of the case.
        scenario: the task.
        steps: largest number of steps; after the end of the path the target is its end.
    """

    name: str
    scenario: Scenario
    steps: int


def build(name: str, arms: int = 3, joints: int = 6) -> Case:
    """Build a case by name. ``arms`` and ``joints`` (per arm) only apply to the cases of cost."""
    if name in COST:
        return Case(name, common.ring(arms=arms, joints=joints, path=name), 200)
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
        chain.linearise(lift.q_start)
        twist = lift.path.pose(0.0).action @ lift.path.twist(0.0)
        v = chain.joint_velocities(np.tile(twist, (len(lift.cell), 1)), np.empty(lift.cell.nv))
        j = int(np.abs(v).argmax())
        limits = {"lower": lift.cell.limits.lower.copy(), "upper": lift.cell.limits.upper.copy()}
        limits["lower" if v[j] > 0 else "upper"][j] = lift.q_start[j] + np.sign(v[j]) * _OUTSIDE
        return Case(name, replace(lift, cell=lift.cell.with_limits(**limits)), 300)
    raise ValueError(f"there is no case '{name}'")


def _slow_joints(scenario: Scenario) -> Scenario:
    return replace(scenario, cell=scenario.cell.with_limits(velocity=_SPEED_LIMIT), dt=2e-3)
