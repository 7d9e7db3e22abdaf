"""Stop, back, aside, go on.  python docs/examples/32_operator.py"""

import sys
from pathlib import Path

import numpy as np
import pinocchio as pin

from coopqp import QPController, Status
from coopqp.scenarios import dual_arm7
from coopqp.simulation import Monitor

task = dual_arm7()  # two arms of seven joints
cell = task.cell.with_limits(acceleration=5.0)
controller = QPController(cell, task.grasp, task.path, dt=0.002)
controller.reset(task.q_start)
monitor, steps = Monitor(cell, task.grasp), []


def run(most=5000, until=None):
    for _ in range(most):
        steps.append(controller.step())
        monitor.observe(steps[-1])
        if steps[-1].status is until or steps[-1].finished:
            break


def say():
    now = f"{0.002 * len(steps):.3f} s, clock {steps[-1].clock_next:.3f} s"
    print(f"{now}: {steps[-1].explain()}")


run(900)
say()
controller.reverse(to=0.0)
run(400)
say()
run(until=Status.PAUSED)
say()
back = np.abs(steps[-1].q_next - task.q_start).max()
print(f"back at the start: joints to {back:.0e} rad")

controller.run_to(1.0)
run(until=Status.PAUSED)
say()

for _ in range(10):  # by hand, a command every 50 ms: 0.1 m/s along the world's x
    controller.jog([0.1, 0, 0, 0, 0, 0], frame="world")
    run(25)
run(250)  # no command holds any more: the object brakes, and rests
say()

controller.return_to_path()
run(until=Status.PAUSED)  # as it was before
say()

aside = pin.SE3(np.eye(3), np.array([0.02, 0.0, 0.0]))
controller.shift_path(aside, over=0.05)
controller.forward()
run()
say()
there = task.grasp.carried(steps[-1].state)[0].translation
moved = 1e3 * (there - task.path.pose(task.path.duration).translation)
print(f"at the end aside by {moved[0]:.2f} mm")
print(f"kept all the way: {not monitor.verdict().counts}")

if "--out" in sys.argv:
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(8, 3.5), layout="constrained")
    times = 0.002 * np.arange(len(steps))
    axes.plot(times, [step.clock for step in steps], "k")
    by_hand = [step.status is Status.JOGGING for step in steps]
    axes.fill_between(times, 0, task.path.duration, by_hand, color="C0", alpha=0.2, lw=0)
    axes.set(xlabel="time [s]", ylabel="clock of the program [s]", title="blue: led by hand")
    figure.savefig(Path(sys.argv[sys.argv.index("--out") + 1]) / "operator.png", dpi=80)
