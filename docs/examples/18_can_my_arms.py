"""Can my arms do it? A proof before the motion.  python docs/examples/18_can_my_arms.py"""

import sys
from pathlib import Path

import numpy as np
import pinocchio as pin

from coopqp import Arm, Grasp, LinePath, QPController, RobotCell, check_path, simulate
from coopqp.planning import find_remedies
from coopqp.scenarios import robot_path

# Two arms face each other and carry a bar of 1 m to the side and up.
DOWN = np.diag([1.0, -1.0, -1.0])
arms = []
for name, x, yaw in (("left", -1.25, 0.0), ("right", 1.25, np.pi)):
    base = pin.SE3(pin.utils.rotate("z", yaw), np.array([x, 0, 0]))
    rx90 = robot_path("rx90l")
    arms.append(Arm.from_urdf(name, rx90, tool_frame="flange", T_world_base=base))
grasp = Grasp(tuple(pin.SE3(DOWN, np.array([x, 0, 0])) for x in (-0.5, 0.5)))
start = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.4]))
path = LinePath.displaced(
    start, translation=(-0.1, 0.45, 0.3), rotation=(0.0, 0.0, 0.4), duration=3.0
)

check = check_path(RobotCell(arms), grasp, path)
print(check.explain())
remedies = find_remedies(check)
for remedy in remedies:
    print("remedy:", remedy)

better = remedies[0].check  # the same task with the remedy
print(better.explain())
controller = QPController(better.cell, better.grasp, better.path, dt=0.01)
print("finished:", simulate(controller, q_start=better.q_start).finished)

if "--out" in sys.argv:
    import matplotlib.pyplot as plt

    figure, panels = plt.subplots(
        2, 2, sharex=True, sharey="row", figsize=(9, 6), layout="constrained"
    )
    answers = ((check, "as asked"), (better, "path moved"))
    for (top, bottom), (answer, title) in zip(panels.T, answers, strict=True):
        arm, limits = answer.arms[1], answer.cell.arms[1].limits
        branch = arm.chosen
        margins = np.rad2deg(np.minimum(branch.q - limits.lower, limits.upper - branch.q))
        for joint, line in zip(arm.joints, margins.T, strict=True):
            top.plot(branch.clocks, line, label=joint.replace("_", " "))
        bottom.plot(branch.clocks, branch.sigma_min, "k", label="σ_min")
        for panel in (top, bottom):
            for a, b in branch.certified:
                panel.axvspan(a, b, color="#dcefe1", zorder=0, label="proved")
            panel.axhline(0, color="k", lw=0.8, ls="--")
        top.set_title(f"right arm, {title}: {arm.verdict.value}")
        bottom.set_xlabel("clock of the path [s]")
    panels[0, 0].set_ylabel("margins to the limits [deg]")
    panels[1, 0].set_ylabel("σ_min")
    figure.legend(
        *panels[0, 1].get_legend_handles_labels(), loc="outside lower center", ncols=7
    )
    figure.savefig(Path(sys.argv[sys.argv.index("--out") + 1]) / "can_my_arms.png", dpi=80)
