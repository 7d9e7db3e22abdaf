"""Two arms from URDF files, a bar between them, a path.  python docs/examples/02_your_own_arms.py"""

import sys

import numpy as np
import pinocchio as pin

from coopqp import (
    Arm,
    Grasp,
    LinePath,
    QPController,
    RobotCell,
    inverse_kinematics,
    judge,
    read_run,
    robot_path,
    simulate,
)

my_arm = robot_path("arm7")  # a URDF that comes with coopqp; put the path of yours here: "my_arm.urdf"


def pose(x, y, z, *, yaw=0.0, pitch=0.0):
    """A placement from a position [m] and angles [deg]: turn about y by pitch, then about z by yaw."""
    R = pin.utils.rotate("z", np.deg2rad(yaw)) @ pin.utils.rotate("y", np.deg2rad(pitch))
    return pin.SE3(R, np.array([x, y, z]))


# 1. The arms: a name, a URDF, the link that grasps, where the base stands. URDF has no acceleration limits.
left = Arm.from_urdf("left", my_arm, tool_frame="tool", T_world_base=pose(-0.80, 0, 0), acceleration_limits=10)
right = Arm.from_urdf(
    "right", my_arm, tool_frame="tool", T_world_base=pose(0.80, 0, 0, yaw=180), acceleration_limits=10
)
cell = RobotCell([left, right])

# 2. The grasp: where each tool sits on the bar, in the bar's frame (its centre, x along it).
grasp = Grasp((pose(-0.30, 0, 0, pitch=150), pose(0.30, 0, 0, yaw=180, pitch=150)))

# 3. The path: from here, 20 cm up and 10 cm sideways while the bar turns by 0.2 rad about z, in 3 s.
start = pose(0, 0, 0.25)
path = LinePath.displaced(start, translation=(0, 0.10, 0.20), rotation=(0, 0, 0.2), duration=3.0)

# 4. Where it starts: the configuration at which both arms hold the bar, near a guess that picks the elbow [deg].
guess = cell.configuration(np.deg2rad([0, 14, 0, 105, 0, 31, 0] * 2))
q_start = inverse_kinematics(cell, grasp, start, guess)

# 5. Control it, and judge the run from its configurations alone.
controller = QPController(cell, grasp, path, dt=0.002)
recording = simulate(controller, q_start=q_start)
for finding in judge(cell, recording, read_run(cell, recording)):
    print("yes" if finding.holds else "NO ", finding.question, finding.answer)

if "--view" in sys.argv:
    from coopqp import LiveViewer

    with LiveViewer(recording) as viewer:
        print("Open", viewer.url)
        viewer.run()
