"""A driver for a robot that counts in degrees.  python docs/examples/35_a_driver.py"""

import numpy as np

from coopqp import QPController
from coopqp.drivers import (
    Command,
    ControlLoop,
    DriverError,
    ManualTime,
    RobotState,
    SimulatedRobot,
)
from coopqp.scenarios import dual_arm7


class DegreesRobot:
    """In place of a maker's library: positions in degrees, seconds since it was switched on."""

    def __init__(self, degrees, clock):
        names = [f"j{i + 1}" for i in range(7)]
        self._robot = SimulatedRobot(names, np.deg2rad(degrees), time=clock, clock_offset=500.0)
        self.online = True

    def newest(self):
        s = self._robot.read()
        return s and (s.stamp, *np.rad2deg((s.q, s.velocity, s.target)))

    def move(self, degrees, at):
        self._robot.send(Command(np.deg2rad(degrees), np.zeros(7), at))

    def halt(self):
        self._robot.stop()


class DegreesDriver:
    """What the loop needs to know."""

    period, lag, delay, commands = 0.002, 0.0, 0.0, "position"

    def __init__(self, robot, joint_names):
        self.robot, self.joint_names = robot, tuple(joint_names)

    def connect(self):
        if not self.robot.online:
            raise DriverError("the robot is off. Switch it on.")

    def read(self):
        newest = self.robot.newest()
        if newest is None:
            return None
        stamp, q, velocity, target = newest
        return RobotState(np.deg2rad(q), np.deg2rad(velocity), stamp, target=np.deg2rad(target))

    def send(self, command):
        self.robot.move(np.rad2deg(command.q), command.at)

    def stop(self):
        self.robot.halt()


bar = dual_arm7()
cell, time = bar.cell.with_limits(acceleration=15.0), ManualTime()
start = np.rad2deg(cell.positions(bar.q_start))
drivers = {
    arm: DegreesDriver(
        DegreesRobot(start[own], time),
        [joint.partition("/")[2] for joint in cell.joint_names[own]],
    )
    for arm, own in zip(cell.arm_names, cell.v_slices, strict=True)
}
loop = ControlLoop(QPController(cell, bar.grasp, bar.path, dt=0.002), drivers, time=time)
print("would be refused:", loop.refused() or "nothing")
print(loop.run().lines()[0])
