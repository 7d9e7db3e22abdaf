"""An arm grasps again; a gate waits for its gripper.  python docs/examples/39_grasp_again.py"""

import sys
from pathlib import Path

import numpy as np
import pinocchio as pin

from coopqp import LinePath, Phase, Program, QPController, Status
from coopqp.programs import Travels
from coopqp.scenarios import paper_lift

task = paper_lift(time_law="linear")
cell = task.cell.with_limits(acceleration=5.0)
X = task.grasp.T_object_tool[2]
there = pin.SE3(
    X.rotation, X.translation + np.array([-0.1, 0, 0])
)  # 10 cm along the plate's edge
middle = task.path.pose(1.5)
phases = [
    Phase(
        "carry",  # the object moves on while the arm is on its way
        path=LinePath(task.path.start, middle, duration=1.5, time_law="linear"),
        arms={"slave_2": Travels(to=there, retreat_m=0.04)},
        until="closed",
    ),
    Phase("lift", path=LinePath(middle, task.path.goal, duration=1.5, time_law="linear")),
]
program = Program(cell, task.grasp, phases)
for phase in program.spans:
    print(f"{phase.name}: held by {', '.join(phase.holding)}")

rates = {}
for when in (1.0, 1.5, 2.5):  # when the gripper says that it is closed [s]
    controller = QPController(cell, task.grasp, program, dt=0.002)
    controller.reset(task.q_start)
    steps = []
    while not (steps and steps[-1].finished):
        if len(steps) == round(when / 0.002):
            controller.signal("closed")
        steps.append(controller.step())
    waits = 0.002 * sum(step.status is Status.WAITING for step in steps)
    rates[when] = [step.rate for step in steps]
    least = min(step.rate for step in steps if 0.4 < step.clock < 2.6)  # but for both ends
    print(f"signal at {when} s: least path speed {least:.2f}, {waits:.1f} s at the gate")

if "--out" in sys.argv:
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(8, 3.5), layout="constrained")
    for i, (when, rate) in enumerate(rates.items()):
        axes.plot(0.002 * np.arange(len(rate)), rate, f"C{i}", label=f"signal at {when} s")
        axes.axvline(when, color=f"C{i}", lw=0.8, ls=":")
    axes.set(xlabel="time [s]", ylabel="path speed σ")
    axes.legend(loc="lower right")
    figure.savefig(Path(sys.argv[sys.argv.index("--out") + 1]) / "grasp_again.png", dpi=80)
