"""A start from which the arms can follow.  python docs/examples/15_find_a_start.py"""

import sys
from pathlib import Path

import numpy as np
import pinocchio as pin

from coopqp import Arm, Grasp, LinePath, QPController, RobotCell, find_start, simulate
from coopqp.errors import NoStartError
from coopqp.scenarios import robot_path

# Two arms face each other and hold a bar. A cable lets joints 4 and 6 of the left one turn
# by ±100° only.
DOWN = np.diag([1.0, -1.0, -1.0])
grasp = Grasp(tuple(pin.SE3(DOWN, np.array([x, 0, 0])) for x in (-0.4, 0.4)))
arms = []
for name, x, yaw in (("left", -1.1, 0.0), ("right", 1.1, np.pi)):
    base = pin.SE3(pin.utils.rotate("z", yaw), np.array([x, 0, 0]))
    rx90 = robot_path("rx90l")
    arms.append(Arm.from_urdf(name, rx90, tool_frame="flange", T_world_base=base))
lower, upper = arms[0].limits.lower.copy(), arms[0].limits.upper.copy()
lower[[3, 5]], upper[[3, 5]] = np.deg2rad([[-100], [100]])
arms[0] = arms[0].with_limits(lower=lower, upper=upper)
cell = RobotCell(arms)
start = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.5]))
path = LinePath.displaced(
    start, translation=(0.0, 0.2, 0.2), rotation=(0.0, 0.0, 0.3), duration=3.0
)

try:
    find_start(cell, grasp, path)
except NoStartError as error:
    print(error)

found = find_start(cell, grasp, path, free_roll={"left": [np.pi]})
print(found.explain())
controller = QPController(cell, found.grasp, path, dt=0.01)
print("finished:", simulate(controller, q_start=found.q).finished)

if "--out" in sys.argv:
    import matplotlib.pyplot as plt

    from coopqp.visualization import View, box_solid, cell_solids, render

    branches = found.arms[0].branches
    scenes = cell_solids(cell, [np.r_[branch.q, found.q[6:]] for branch in branches])
    for scene in scenes:
        scene.append(box_solid((0.9, 0.05, 0.05), start, (0.30, 0.52, 0.75)))
    view = View.around(scenes, azimuth=-65.0, elevation=20.0)
    figure, panels = plt.subplots(2, 4, figsize=(12, 4.4), layout="constrained")
    pictures = render(scenes, view, width=300)
    for panel, branch, picture in zip(panels.flat, branches, pictures, strict=True):
        panel.imshow(picture)
        panel.axis("off")
        margin = np.rad2deg(branch.margins.min())
        verdict = f"{margin:.0f}° inside" if margin > 0 else f"{-margin:.0f}° outside"
        taken = branch is found.arms[0].chosen
        panel.set_title(f"{verdict}: taken" if taken else verdict, color="C2" if taken else "k")
    figure.savefig(Path(sys.argv[sys.argv.index("--out") + 1]) / "branches.png", dpi=80)
