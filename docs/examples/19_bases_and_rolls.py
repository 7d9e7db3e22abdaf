"""Where can bases stand, how may tools turn?  python docs/examples/19_bases_and_rolls.py"""

import sys
from pathlib import Path

import numpy as np
import pinocchio as pin

from coopqp import Arm, Grasp, LinePath, RobotCell, check_path
from coopqp.planning import find_remedies
from coopqp.scenarios import robot_path

DOWN = np.diag([1.0, -1.0, -1.0])
arms = []
for name, x, yaw in (("left", -1.1, 0.0), ("right", 1.1, np.pi)):
    base = pin.SE3(pin.utils.rotate("z", yaw), np.array([x, 0, 0]))
    rx90 = robot_path("rx90l")
    arms.append(Arm.from_urdf(name, rx90, tool_frame="flange", T_world_base=base))
# A cable lets joints 4 and 6 of the left arm turn by ±100° only.
lower, upper = arms[0].limits.lower.copy(), arms[0].limits.upper.copy()
lower[[3, 5]], upper[[3, 5]] = np.deg2rad([[-100], [100]])
cell = RobotCell([arms[0].with_limits(lower=lower, upper=upper), arms[1]])
grasp = Grasp(tuple(pin.SE3(DOWN, np.array([x, 0, 0])) for x in (-0.4, 0.4)))
start = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.5]))
path = LinePath.displaced(
    start, translation=(0.0, 0.2, 0.2), rotation=(0.0, 0.0, 0.3), duration=3.0
)

# 1. What is wrong with the left arm: the table of its branches.
check = check_path(cell, grasp, path)
for branch, verdict, *_, why in check.arms[0].table()[1:]:
    print(branch, verdict, why)

# 2. What helps. A remedy has the whole task with the change: cell, grasp, path, q_start.
for remedy in find_remedies(check):
    least = min(arm.chosen.margins.min() for arm in remedy.check.arms)
    print(f"{remedy.kind}: {remedy}; least margin {np.rad2deg(least):.0f}°")

# 3. A map of your own: the largest margin of the right arm for places of its base, in cm.
right, held = cell.arms[1], Grasp(grasp.T_object_tool[1:])
margins = []
for y in (-0.4, -0.2, 0.0, 0.2, 0.4):
    row = []
    for x in (-0.3, -0.2, -0.1, 0.0, 0.1, 0.2, 0.3):
        T = right.T_world_base * pin.SE3(np.eye(3), np.array([x, y, 0.0]))
        answer = check_path(RobotCell([right.placed(T)]), held, path)
        margin = answer.arms[0].chosen.margins.min() if answer.feasible else np.nan
        row.append(np.rad2deg(margin))
    print(f"y = {100 * y:3.0f}:", *("  –" if np.isnan(m) else f"{m:3.0f}" for m in row))
    margins.append(row)

if "--out" in sys.argv:
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(7, 3.8), layout="constrained")
    axes.set_facecolor("#dddddd")  # no branch follows the path
    area = (-35, 35, -50, 50)
    picture = axes.imshow(margins, origin="lower", extent=area, aspect="auto", vmin=0)
    figure.colorbar(picture, label="least margin [deg]; grey: none")
    axes.plot(0, 0, "r+", ms=12, label="as built")
    axes.set(xlabel="base moved by x [cm]", ylabel="base moved by y [cm]")
    axes.legend()
    figure.savefig(Path(sys.argv[sys.argv.index("--out") + 1]) / "bases.png", dpi=80)
