"""Follow a target that moves while the arms run.  python docs/examples/06_servo_path.py"""

import sys
from pathlib import Path

import numpy as np
import pinocchio as pin

from coopqp import QPController, ServoPath
from coopqp.scenarios import paper_lift
from coopqp.simulation import chain_error, object_error, tool_placements

lift = paper_lift()
start = lift.path.pose(0.0)
path = ServoPath(start, speed=0.1, spin=0.3)
controller = QPController(lift.cell, lift.grasp, path, dt=0.002)
controller.reset(lift.q_start)

targets = {
    0: (0, 0, 0.10),
    500: (0, 0.05, 0.15),
}  # at which tick, how far from the start [m]
worst, moved = 0.0, []
for tick in range(1500):
    if tick in targets:
        target = pin.SE3(start.rotation, start.translation + np.array(targets[tick]))
        controller.retarget(target)  # from where the object is now
    step = controller.step()
    tools = tool_placements(lift.cell, [step.q_next])[0]
    worst = max(worst, chain_error(tools, lift.grasp)[0])
    T_world_object = tools[0] * lift.grasp.T_object_tool[0].inverse()
    moved.append(T_world_object.translation - start.translation)
away = object_error(tools, lift.grasp, target)[0]
print(f"the arms agree to {1e3 * worst:.1e} mm; {1e3 * away:.1e} mm remain to the target")

if "--out" in sys.argv:
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(8, 4), layout="constrained")
    time = 0.002 * np.arange(1, len(moved) + 1)
    for axis, colour in ((1, "C0"), (2, "C1")):
        axes.plot(time, 1e3 * np.array(moved)[:, axis], colour, label=f"object, {'xyz'[axis]}")
        steps = [1e3 * targets[0 if t <= 1.0 else 500][axis] for t in time]
        axes.plot(time, steps, colour, ls="--", lw=1, label=f"target, {'xyz'[axis]}")
    axes.set(xlabel="time [s]", ylabel="from the start [mm]")
    axes.legend()
    figure.savefig(Path(sys.argv[sys.argv.index("--out") + 1]) / "servo_path.png", dpi=80)
