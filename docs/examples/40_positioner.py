"""A turntable turns a part under a torch.  python docs/examples/40_positioner.py"""

import sys
from pathlib import Path

import numpy as np
import pinocchio as pin

from coopqp import (
    Arm,
    Grasp,
    LinePath,
    Phase,
    Program,
    QPController,
    RobotCell,
    inverse_kinematics,
)
from coopqp.programs import Turns
from coopqp.scenarios import robot_arm

# A member of one joint, which turns about its z axis, is an arm like any other.
model, one = pin.Model(), np.ones(1)
drive = model.addJoint(
    0, pin.JointModelRZ(), pin.SE3.Identity(), "drive", 80 * one, 1.5 * one, -3 * one, 3 * one
)
model.addFrame(pin.Frame("plate", drive, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
centre = pin.SE3(np.eye(3), np.array([1.0, 0.0, 0.3]))
table = Arm.from_model(
    "table", model, tool_frame="plate", T_world_base=centre, acceleration_limits=[5.0]
)
robot = robot_arm("rx90l", name="torch").with_limits(acceleration=5.0)
cell = RobotCell([table, robot])

forward = pin.utils.rotate("y", np.pi / 2)  # the torch points along x, at the rim of the part
torch = pin.SE3(forward, np.array([0.85, 0.0, 0.3]))
grasp = Grasp((pin.SE3.Identity(), centre.actInv(torch)))
guess = np.deg2rad([0, 0, 38, 102, 0, -50, 0])
q_start = inverse_kinematics(cell, grasp, centre, guess)

# The table turns by 115°; on it the torch goes the other way by three quarters of that.
turn = LinePath.displaced(centre, rotation=(0, 0, 2.0), duration=4.0)
seam = Turns(about=(0, 0, 0), angle=-1.5, holds=False)
program = Program(cell, grasp, [Phase("weld", path=turn, arms={"torch": seam})])
controller = QPController(cell, grasp, program, dt=0.005)
controller.reset(q_start)
data, angles, off = cell.model.createData(), [], 0.0
while True:
    step = controller.step()
    pin.framesForwardKinematics(cell.model, data, step.q_next)
    plate, tip = (data.oMf[frame] for frame in cell.tool_frames)
    on_part = plate.actInv(tip).translation
    off = max(off, abs(np.hypot(*on_part[:2]) - 0.15))
    round_part = np.degrees(np.arctan2(-on_part[1], -on_part[0]))
    angles.append([np.degrees(np.arctan2(*plate.rotation[1::-1, 0])), round_part])
    if step.finished:
        break
print(f"held by {', '.join(program.spans[0].holding)}")
gone = abs(angles[-1][1])
print(f"the torch has gone {gone:.0f}° round the part; on the seam within 1 µm: {off < 1e-6}")

if "--out" in sys.argv:
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(8, 3.5), layout="constrained")
    times = 0.005 * np.arange(1, len(angles) + 1)
    axes.plot(times, [a for a, _ in angles], "k", label="table")
    axes.plot(times, [b for _, b in angles], "C3", label="torch round the part")
    axes.set(xlabel="time [s]", ylabel="angle [°]")
    axes.legend()
    figure.savefig(Path(sys.argv[sys.argv.index("--out") + 1]) / "positioner.png", dpi=80)
