"""A fault is latched; go on from there.  python docs/examples/07_fault_and_reset.py"""

import sys
from pathlib import Path

import numpy as np

from coopqp import QPController, Status
from coopqp.scenarios import paper_lift

lift = paper_lift(time_law="quintic")
controller = QPController(lift.cell, lift.grasp, lift.path, dt=0.002)
controller.reset(lift.q_start)
q, faults, steps = lift.q_start, 0, []

for tick in range(5000):
    step = controller.step(q)
    steps.append(step)
    q = step.q_next  # an ideal robot, but for
    if 500 <= tick < 520:  # a blow to the second arm: its shoulder is 0.03 rad off for 40 ms
        q = q + np.where(np.arange(lift.cell.nv) == 7, 0.03, 0.0)
    if step.status is Status.FAULT and tick > 600:  # it stays latched until reset
        faults += 1
        at = f"the object is on its path up to {step.clock:.2f} s"
        print(f"{tick * 0.002:.2f} s: {step.status.value}, {at}")
        controller.reset(q, clock=step.clock)  # measured; refused if an arm is 20 mm off
    if step.finished:
        break
after = f"{step.finished} after {tick * 0.002:.2f} s"
print(f"{faults} fault, then finished: {after}; {step.explain()}")

if "--out" in sys.argv:
    import matplotlib.pyplot as plt

    time = 0.002 * np.arange(len(steps))
    clocks = np.array([step.clock for step in steps])
    latched = np.array([step.status is Status.FAULT for step in steps])
    figure, axes = plt.subplots(figsize=(8, 3.5), layout="constrained")
    axes.plot(time, clocks, "k", label="the object's clock")
    axes.fill_between(time, 0, 3, where=latched, color="#f3c6c6", label="fault, at rest")
    axes.set(xlabel="time [s]", ylabel="clock on the path [s]")
    axes.legend(loc="upper left")
    figure.savefig(Path(sys.argv[sys.argv.index("--out") + 1]) / "fault_and_reset.png", dpi=80)
