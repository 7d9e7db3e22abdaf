"""Examples of the classes of this page: each section is shown at the classes that it names; all are run by a test."""

# %% before
import numpy as np
import pinocchio as pin

from coopqp import Grasp, QPController, QPOptions, RobotCell
from coopqp.scenarios import dual_arm7, robot_path

task = dual_arm7()

# %% coopqp.Arm
from coopqp import Arm

left = Arm.from_urdf(
    "left", robot_path("arm7"), tool_frame="tool", T_world_base=pin.SE3.Identity(), acceleration_limits=10.0
)
opposite = pin.SE3(np.diag([-1.0, -1.0, 1.0]), np.array([1.6, 0.0, 0.0]))
right = Arm.from_urdf("right", robot_path("arm7"), tool_frame="tool", T_world_base=opposite)

# %% coopqp.RobotCell
cell = RobotCell([left, right])
assert cell.arm_names == ("left", "right")
assert cell.nv == 14

# %% coopqp.JointLimits
limits = left.limits.replace(velocity=np.full(7, 0.5))
slow = left.with_limits(velocity=0.5)  # the same as an arm
assert np.allclose(slow.limits.velocity, limits.velocity)

# %% coopqp.Robot
from coopqp import Robot

tools = {"left": "left_tool", "right": "right_tool"}
torso = RobotCell([Robot(robot_path("lift2"), tools, name="lift")])
assert torso.nv == 13  # the lift, and six joints of each arm

# %% coopqp.Grasp
down = pin.SE3(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.4, 0.0]))
other = pin.SE3(np.diag([1.0, -1.0, -1.0]), np.array([0.0, -0.4, 0.0]))
grasp = Grasp((down, other))  # T_object_tool of each arm

# %% coopqp.model.CellState
from coopqp.model import CellState

state = CellState(task.cell, task.q_start)
pose = task.grasp.carried(state)[0]  # T_world_object in the hand of the first arm
assert np.allclose(pose.translation, task.path.pose(0.0).translation, atol=1e-6)

# %% coopqp.CommonError
from coopqp import CommonError

together = QPOptions(common_error=CommonError.leaderless())  # no arm leads: the mean of all arms is the object
controller = QPController(task.cell, task.grasp, task.path, dt=task.dt, options=together)

# %% coopqp.PostureOptions
from coopqp import PostureOptions

centred = QPOptions(posture=PostureOptions(centring=1.0))  # spare joints stay near the middle of their range
controller = QPController(task.cell, task.grasp, task.path, dt=task.dt, options=centred)

# %% coopqp.model.Free
pinned = task.grasp.freed("left", "rx", range=(-0.5, 0.5))  # a hinge in place of a rigid grip
assert pinned.free[0].axis == "rx"

# %% coopqp.model.FreedCell
from coopqp.model import freed_cell

made = freed_cell(task.cell, pinned)
assert made.cell.nv == task.cell.nv + 1  # a passive joint more
