"""Two arms from URDF files carry a bar.  python docs/examples/02_your_own_arms.py"""

import sys
from pathlib import Path

import numpy as np
import pinocchio as pin

from coopqp import Arm, Grasp, LinePath, QPController, RobotCell, inverse_kinematics, simulate
from coopqp.scenarios import robot_path
from coopqp.simulation import evaluate, read_run

my_arm = robot_path("arm7")  # comes with coopqp; put the path of your URDF here: "my_arm.urdf"


def pose(x, y, z, *, yaw=0.0, pitch=0.0):
    """A placement: position [m], turn about y by pitch, then about z by yaw [deg]."""
    R = pin.utils.rotate("z", np.deg2rad(yaw)) @ pin.utils.rotate("y", np.deg2rad(pitch))
    return pin.SE3(R, np.array([x, y, z]))


# 1. The arms: a name, a URDF, the link that grasps, where the base stands.
#    URDF has no acceleration limits.
arms = [
    Arm.from_urdf(name, my_arm, tool_frame="tool", T_world_base=base, acceleration_limits=10)
    for name, base in (("left", pose(-0.80, 0, 0)), ("right", pose(0.80, 0, 0, yaw=180)))
]
cell = RobotCell(arms)

# 2. The grasp: where each tool sits on the bar, in the bar's frame (its centre, x along it).
grasp = Grasp((pose(-0.30, 0, 0, pitch=150), pose(0.30, 0, 0, yaw=180, pitch=150)))

# 3. The path: 20 cm up and 10 cm sideways while the bar turns by 0.2 rad about z, in 3 s.
start = pose(0, 0, 0.25)
path = LinePath.displaced(
    start, translation=(0, 0.10, 0.20), rotation=(0, 0, 0.2), duration=3.0
)

# 4. Where it starts: the configuration at which both arms hold the bar, near a guess that
#    picks the elbow [deg].
guess = cell.configuration(np.deg2rad([0, 14, 0, 105, 0, 31, 0] * 2))
q_start = inverse_kinematics(cell, grasp, start, guess)

# 5. Control it, and judge the run from its configurations alone.
controller = QPController(cell, grasp, path, dt=0.002)
recording = simulate(controller, q_start=q_start)
for finding in evaluate(cell, recording, read_run(cell, recording)):
    print("yes" if finding.holds else "NO ", finding.question, finding.answer)

if "--view" in sys.argv:
    from coopqp.visualization import LiveViewer

    with LiveViewer(recording) as viewer:
        print("Open", viewer.url)
        viewer.run()

if "--out" in sys.argv:
    from coopqp.visualization import motion_figure

    bar = {"object_size": (0.7, 0.05, 0.05), "T_object_body": pin.SE3.Identity()}
    figure = motion_figure(cell, recording, **bar, frames=2, azimuth=-60.0, pixels=500)
    figure.savefig(Path(sys.argv[sys.argv.index("--out") + 1]) / "your_own_arms.png", dpi=90)
