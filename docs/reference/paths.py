"""Examples of the classes of this page: each section is shown at the classes that it names; all are run by a test."""

# %% before
import numpy as np
import pinocchio as pin

from coopqp import QPController, plan
from coopqp.scenarios import dual_arm7

task = dual_arm7()
start = task.path.pose(0.0)

# %% coopqp.LinePath
from coopqp import LinePath

line = LinePath.displaced(start, translation=(0.0, 0.0, 0.2), rotation=(0.0, 0.0, 0.3), duration=2.0)
assert np.isclose(line.pose(2.0).translation[2], start.translation[2] + 0.2)

# %% coopqp.WaypointPath
from coopqp import WaypointPath

up = pin.SE3(start.rotation, start.translation + np.array([0.0, 0.0, 0.1]))
path = WaypointPath([start, up, start], durations=[1.0, 1.0])
assert path.duration == 2.0

# %% coopqp.HoldPath
from coopqp import HoldPath

still = HoldPath(start, duration=5.0)

# %% coopqp.ObjectPath
from coopqp import ObjectPath


class Circle(ObjectPath):
    """A path of one's own: a pose and a twist [linear; angular] at each clock."""

    duration = 3.0

    def pose(self, clock):
        angle = 2.0 * np.pi * clock / self.duration
        return pin.SE3(start.rotation, start.translation + 0.1 * np.array([0.0, np.cos(angle) - 1.0, np.sin(angle)]))

    def twist(self, clock):
        w = 2.0 * np.pi / self.duration
        angle = w * clock
        return np.array([0.0, -0.1 * w * np.sin(angle), 0.1 * w * np.cos(angle), 0.0, 0.0, 0.0])


controller = QPController(task.cell, task.grasp, Circle(), dt=task.dt)

# %% coopqp.ServoPath
from coopqp import ServoPath

servo = ServoPath(start, speed=0.1)
servo.set_target(up, clock=0.0)  # at any time, also while a controller follows the path

# %% coopqp.TimedPath, coopqp.paths.SpeedProfile
fastest = plan(task.cell.with_limits(acceleration=10.0), task.grasp, line, q_start=task.q_start).path
assert fastest.duration == fastest.profile.duration
speeds = np.sqrt(fastest.profile.squares)  # of the path parameter, at the grid points
assert speeds[0] == 0.0

# %% coopqp.paths.PathGeometry, coopqp.paths.Piece, coopqp.paths.MotionBounds
geometry = fastest.geometry()
assert len(geometry.pieces) == 1  # one straight line
bounds = geometry.pieces[0].bounds(np.array([0.0, 0.5 * geometry.length]), np.array([0.0, geometry.length]))
assert np.all(bounds.way >= 0.0)

# %% coopqp.paths.Section
from coopqp.paths import Section

half = Section(line, 0.0, 1.0)
assert np.allclose(half.pose(1.0).translation, line.pose(1.0).translation)

# %% coopqp.paths.ShiftedPath
from coopqp.paths import ShiftedPath

aside = ShiftedPath(line, pin.SE3(np.eye(3), np.array([0.0, 0.05, 0.0])), begin=0.5, end=1.5)
assert np.isclose(aside.pose(2.0).translation[1], line.pose(2.0).translation[1] + 0.05)

# %% coopqp.paths.TimeLaw
from coopqp.paths import TimeLaw

even = LinePath(start, up, duration=1.0, time_law=TimeLaw.LINEAR)
assert np.isclose(even.twist(0.5)[2], 0.1)  # m/s, from the first moment to the last

# %% coopqp.paths.JointPath
from coopqp.paths import JointPath

folded = JointPath([[0.0, 0.5], [0.3, 0.2], [0.0, 0.5]], durations=[1.0, 2.0])  # of an arm with two joints
assert folded.duration == 3.0
