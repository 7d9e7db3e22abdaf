"""A tool draws on a plate that two arms carry.  python docs/examples/38_draw_on_a_plate.py"""

import sys
from pathlib import Path

import numpy as np
import pinocchio as pin

from coopqp import Phase, Program, QPController, WaypointPath
from coopqp.programs import Works
from coopqp.scenarios import paper_lift

task = paper_lift(time_law="quintic", duration=4.0)
cell = task.cell.with_limits(acceleration=5.0)
X = task.grasp.T_object_tool[2]  # where the tool is on the plate at the start
corners = [(0, 0), (-0.1, 0), (-0.1, 0.1), (0, 0.1), (0, 0)]
square = WaypointPath(
    [pin.SE3(X.rotation, X.translation + np.array([x, y, 0])) for x, y in corners],
    durations=[1.0] * 4,
)
program = Program(
    cell, task.grasp, [Phase("draw", path=task.path, arms={"slave_2": Works(on=square)})]
)
print(f"holding: {', '.join(program.spans[0].holding)}")

controller = QPController(cell, task.grasp, program, dt=0.002)
controller.reset(task.q_start)
data, drawn, world, off = cell.model.createData(), [], [], 0.0
while True:
    step = controller.step()
    pin.framesForwardKinematics(cell.model, data, step.q_next)
    tool = data.oMf[cell.tool_frames[2]]
    on_plate = program.pose(step.clock_next).actInv(tool)
    away = on_plate.translation - square.pose(step.clock_next).translation
    off = max(off, np.linalg.norm(away))
    drawn.append(on_plate.translation[:2])
    world.append(tool.translation.copy())
    if step.finished:
        break
print(f"{len(drawn)} steps; the tool stays within 0.001 mm of its line: {off < 1e-6}")

if "--out" in sys.argv:
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(8, 3.5), layout="constrained")
    left.plot(*(100 * np.array(drawn).T), "C0")
    left.set(title="on the plate", xlabel="x [cm]", ylabel="y [cm]", aspect="equal")
    right.plot(*(100 * np.array(world).T[[1, 2]]), "C3")
    right.set(title="in the world", xlabel="y [cm]", ylabel="z [cm]", aspect="equal")
    figure.savefig(Path(sys.argv[sys.argv.index("--out") + 1]) / "draw_on_a_plate.png", dpi=80)
