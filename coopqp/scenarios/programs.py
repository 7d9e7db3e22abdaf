"""Programs: arms that open a part, draw on it, grasp it again, hand it over; a positioner and a belt as members."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin

from coopqp.model.cell import Arm, RobotCell
from coopqp.model.grasp import Grasp
from coopqp.model.inverse_kinematics import inverse_kinematics
from coopqp.paths.path import LinePath, ObjectPath, WaypointPath
from coopqp.paths.scenario import Scenario
from coopqp.programs.program import Phase, Program
from coopqp.programs.roles import Travels, Turns, Waits, Works
from coopqp.scenarios.arms import robot_arm
from coopqp.scenarios.paper import paper_lift
from coopqp.scenarios.stations import FORWARD
from coopqp.scenarios.units import Metres, MetresPerSecond, Radians, Seconds
from coopqp.spatial import Array

#: Acceleration limit of all joints of the paper's arms [rad/s²].
_ACCELERATION = 5.0
#: The pin of the part that opens, in the object frame [m].
_PIN = (0.0, 0.8, 0.0)


def _lift(duration: float) -> Scenario:
    """The paper's lift from rest to rest, with limits of acceleration."""
    task = paper_lift(duration=duration, time_law="quintic")
    return replace(task, cell=task.cell.with_limits(acceleration=_ACCELERATION), dt=0.002)


def _beside(X: pin.SE3, *way: float) -> pin.SE3:
    """A place of a tool on the object, moved in the object frame [m]."""
    return pin.SE3(X.rotation, X.translation + np.array(way))


def pliers(*, angle: Radians = 0.175, duration: Seconds = 3.0) -> Scenario:
    """Three arms lift a part of two halves with a pin; two of them open it on the way, and close it again.

    The object frame is the bisector of the halves: each half turns by half the angle.

    Args:
        angle: angle between the halves.
        duration: duration of the lift; the part closes in two thirds of it.
    """
    task, half = _lift(duration), 0.5 * angle
    opens = {"slave_1": Turns(about=_PIN, angle=half), "slave_2": Turns(about=_PIN, angle=-half)}
    shuts = {"slave_1": Turns(about=_PIN, angle=-half), "slave_2": Turns(about=_PIN, angle=half)}
    phases = [Phase("open", path=task.path, arms=opens), Phase("close", duration=duration / 1.5, arms=shuts)]
    return replace(task, name="pliers", path=Program(task.cell, task.grasp, phases))


def draw_on_plate(*, side: Metres = 0.10, duration: Seconds = 4.0) -> Scenario:
    """Two arms carry a plate; the tool of a third draws a square on it meanwhile.

    Args:
        side: side of the square.
        duration: duration of the lift.
    """
    task = _lift(duration)
    X = task.grasp.T_object_tool[2]
    corners = [(0.0, 0.0), (-side, 0.0), (-side, side), (0.0, side), (0.0, 0.0)]
    square = WaypointPath([_beside(X, x, y, 0.0) for x, y in corners], durations=[duration / 4.0] * 4)
    phases = [Phase("draw", path=task.path, arms={"slave_2": Works(on=square)})]
    return replace(task, name="draw_on_plate", path=Program(task.cell, task.grasp, phases))


def regrasp_plate(*, way: Metres = 0.10, duration: Seconds = 3.0, closed_s: Seconds = 2.4) -> Scenario:
    """An arm lets go of a plate that two others hold, grasps it at another place, and all three lift it.

    The lift begins when a signal says that the gripper is closed.

    Args:
        way: distance of the new place along the plate's edge.
        duration: duration of the lift.
        closed_s: when the signal comes, after the start of the run.
    """
    task = _lift(duration)
    there = _beside(task.grasp.T_object_tool[2], -way, 0.0, 0.0)
    travel = {"slave_2": Travels(to=there, retreat_m=0.05)}
    phases = [
        Phase("regrasp", arms=travel, duration=2.0, until="slave_2 closed"),
        Phase("lift", path=task.path),
    ]
    program = Program(task.cell, task.grasp, phases, signals={"slave_2 closed": closed_s})
    return replace(task, name="regrasp_plate", path=program)


def hand_over(*, speed: MetresPerSecond = 0.1, way: Metres = 0.10) -> Scenario:
    """The leader lets go of a plate that moves at an even speed, and grasps it again under way.

    Args:
        speed: speed of the plate.
        way: distance of the leader's new place along the plate.
    """
    task = _lift(3.0)
    start, up = task.path.pose(0.0), np.array([0.0, 0.0, 1.0])
    marks = [pin.SE3(start.rotation, start.translation + 0.06 * i * up) for i in range(6)]
    carry, over, on = (
        LinePath(marks[a], marks[b], duration=0.06 * (b - a) / speed, time_law="linear")
        for a, b in ((0, 1), (1, 4), (4, 5))
    )
    there = _beside(task.grasp.T_object_tool[0], 0.0, way, 0.0)
    phases = [
        Phase("carry", path=carry),
        Phase("over", path=over, arms={"master": Travels(to=there, retreat_m=0.03)}),
        Phase("on", path=on),
    ]
    return replace(task, name="hand_over", path=Program(task.cell, task.grasp, phases))


def _member(name: str, joint: pin.JointModel, base: pin.SE3, tool: pin.SE3, low: float, high: float) -> Arm:
    """A member of one joint: a table that turns about its z axis, or a belt along its x axis."""
    model = pin.Model()
    limits = (np.array([80.0]), np.array([1.5]), np.array([low]), np.array([high]))
    moving = model.addJoint(0, joint, pin.SE3.Identity(), "drive", *limits)
    model.addFrame(pin.Frame("plate", moving, 0, tool, pin.FrameType.OP_FRAME))
    return Arm.from_model(name, model, tool_frame="plate", T_world_base=base, acceleration_limits=[5.0])


def _beside_an_arm(name: str, member: Arm, program: list[Phase], path: ObjectPath, torch: pin.SE3) -> Scenario:
    """A part on a member, and an RX-90L whose tool works on it."""
    arm = robot_arm("rx90l", name="torch").with_limits(acceleration=_ACCELERATION)
    cell = RobotCell([member, arm])
    start = path.pose(0.0)
    grasp = Grasp((pin.SE3.Identity(), start.actInv(torch)))
    guess: Array = np.concatenate([np.zeros(1), np.deg2rad([0.0, 38.0, 102.0, 0.0, -50.0, 0.0])])
    return Scenario(
        name=name,
        cell=cell,
        grasp=grasp,
        path=Program(cell, grasp, program),
        q_start=inverse_kinematics(cell, grasp, start, guess),
        dt=0.005,
        object_size=(0.30, 0.30, 0.02),
        object_mass=5.0,
    )


def positioner(*, angle: Radians = 2.0, duration: Seconds = 4.0) -> Scenario:
    """A turntable turns a part under a torch that goes along by a quarter of its angle, round a seam on the rim.

    Args:
        angle: angle of the table.
        duration: duration of the turn.
    """
    axis, rim = pin.SE3(np.eye(3), np.array([1.0, 0.0, 0.30])), 0.15
    table = _member("table", pin.JointModelRZ(), axis, pin.SE3.Identity(), -3.0, 3.0)
    path = LinePath.displaced(axis, rotation=(0.0, 0.0, angle), duration=duration)
    round_it = Turns(about=(0.0, 0.0, 0.0), angle=-0.75 * angle, holds=False)
    torch = pin.SE3(FORWARD, np.array([1.0 - rim, 0.0, 0.30]))
    return _beside_an_arm("positioner", table, [Phase("weld", path=path, arms={"torch": round_it})], path, torch)


def conveyor(*, way: Metres = 0.40, duration: Seconds = 4.0) -> Scenario:
    """A belt that the controller drives carries a part past an arm that goes along, draws a line on it, and waits.

    Args:
        way: how far the belt goes.
        duration: duration of its way.
    """
    belt_base = pin.SE3(pin.utils.rotate("z", 0.5 * np.pi), np.array([1.0, 0.0, 0.30]))
    start = belt_base * pin.SE3(np.eye(3), np.array([-0.5 * way, 0.0, 0.0]))
    belt = _member("belt", pin.JointModelPX(), start, pin.SE3.Identity(), -0.6, 1.0)
    goal = start * pin.SE3(np.eye(3), np.array([way, 0.0, 0.0]))
    middle = start * pin.SE3(np.eye(3), np.array([0.5 * way, 0.0, 0.0]))
    torch = pin.SE3(FORWARD, start.translation + np.array([-0.15, 0.0, 0.0]))
    X = start.actInv(torch)
    line = WaypointPath([X, _beside(X, 0.06, 0.0, 0.0), X], durations=[duration / 4.0] * 2)
    first, second = (LinePath(a, b, duration=duration / 2.0) for a, b in ((start, middle), (middle, goal)))
    phases = [
        Phase("draw", path=first, arms={"torch": Works(on=line)}),
        Phase("carry", path=second, arms={"torch": Waits()}),
    ]
    return _beside_an_arm("conveyor", belt, phases, first, torch)


#: The functions of the scenarios whose path is a program, by name.
PROGRAMS = {make.__name__: make for make in (pliers, draw_on_plate, regrasp_plate, hand_over, positioner, conveyor)}
