"""One robot with two arms: its lift moves, too.  python docs/examples/36_one_robot.py"""

import sys
from pathlib import Path

import numpy as np
import pinocchio as pin

from coopqp import Grasp, LinePath, QPController, Robot, RobotCell, check_path, simulate
from coopqp.scenarios import robot_path

robot = Robot(
    robot_path("lift2"),  # for your own: the path of its URDF
    {"left": "left_tool", "right": "right_tool"},
    name="lift",
    acceleration_limits={"lift": 0.5}
    | {f"{s}_joint_{i}": 5.0 for s in ("left", "right") for i in range(1, 7)},
)
cell = RobotCell([robot])
print(cell.joint_names[:2], cell.nv)

ends = ((0.3, 90.0), (-0.3, -90.0))  # the tools point at the ends of a bar along y
grasp = Grasp(
    tuple(
        pin.SE3(pin.rpy.rpyToMatrix(np.deg2rad(roll), 0.0, 0.0), np.array([0.0, y, 0.0]))
        for y, roll in ends
    )
)
low, high = (pin.SE3(np.eye(3), np.array([0.55, 0.0, z])) for z in (0.2, 1.7))
path = LinePath(low, high, duration=8.0)

check = check_path(cell, grasp, path)
print(check.verdict.value)
print(check.shared[0].s[[0, -1], 0].round(3))  # the lift at the start and at the end [m]

run = simulate(
    QPController(cell, grasp, check.led_path(), dt=0.005), q_start=check.q_start, settle=0.2
)
lift = run.q_command[:, 0]
print(run.finished, f"{lift[0]:.3f} m to {lift[-1]:.3f} m in {run.time[-1]:.2f} s")

if "--out" in sys.argv:
    from coopqp.visualization import motion_figure

    bar = {"object_size": (0.05, 0.60, 0.05), "T_object_body": pin.SE3.Identity()}
    figure = motion_figure(cell, run, **bar, frames=3, columns=3, azimuth=-60.0, pixels=340)
    figure.savefig(Path(sys.argv[sys.argv.index("--out") + 1]) / "one_robot.png", dpi=100)
