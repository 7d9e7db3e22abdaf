"""The loop of a cell: measure, step, send.  python docs/examples/05_real_loop.py"""

import gc
import sys
import time
from pathlib import Path

import numpy as np

from coopqp import QPController, Status
from coopqp.scenarios import paper_lift
from coopqp.simulation import Disturbances, DisturbedPlant

lift, dt = paper_lift(time_law="quintic"), 0.001
cell = lift.cell.with_limits(acceleration=10.0)
controller = QPController(cell, lift.grasp, lift.path, dt=dt)

# In place of the robots: joints that lag by 5 ms and encoders off by up to 2e-5 rad; an arm
# stops after 1 s.
arms = cell.arm_names
faults = Disturbances(encoder_noise=2e-5, lag=dict.fromkeys(arms, 0.005), stall={arms[1]: 1.0})
robots = DisturbedPlant(cell, lift.grasp, faults)

q = robots.reset(lift.q_start)
controller.reset(lift.q_start)  # the last command; runs the look-ahead, so before the loop
for _ in range(50):  # warm up caches and branch predictors, then start again
    controller.step(q)
controller.reset(lift.q_start)
gc.collect()
gc.freeze()  # what lives now is not looked at again
gc.disable()  # no pause while the robots move

times, steps, last = [], [], Status.TRACKING
for tick in range(1500):
    began = time.perf_counter()
    step = controller.step(q)
    times.append(time.perf_counter() - began)
    steps.append(step)
    if step.status is not last:
        print(f"{tick * dt:.3f} s {step.status.value}: {step.explain()}")
        last = step.status
    if step.status is Status.FAULT:
        break  # at rest until reset(q) with the measured configuration
    q = robots.apply(step)  # send step.q_next, wait for the period, read the encoders
    if step.finished:
        break
gc.enable()

print(f"object at {step.clock:.3f} s of {lift.path.duration:g} s, {step.status.value}")
middle, late, worst = 1e6 * np.percentile(times, [50, 99, 100])
print(f"one step: {middle:.0f} µs, 99 % below {late:.0f} µs, longest {worst:.0f} µs")

if "--out" in sys.argv:
    import matplotlib.pyplot as plt

    shown = slice(950, 1150)
    ms = 1e3 * dt * np.arange(len(steps))[shown]
    speeds = np.array([step.velocity for step in steps])[shown]
    figure, (top, bottom) = plt.subplots(
        2, 1, sharex=True, figsize=(8, 5.5), layout="constrained"
    )
    top.plot(ms, [step.rate for step in steps[shown]], "k")
    top.set_ylabel("rate σ of the object")
    for name, joints in zip(arms, cell.v_slices, strict=True):
        bottom.plot(ms, np.abs(speeds[:, joints]).max(axis=1), label=name)
    bottom.set(xlabel="time [ms]", ylabel="fastest joint, commanded [rad/s]")
    for panel in (top, bottom):
        panel.axvline(1000, color="#b00020", ls="--", lw=1)
    top.annotate(f"{arms[1]} stops", (1002, 0.15), color="#b00020")
    bottom.legend()
    figure.savefig(Path(sys.argv[sys.argv.index("--out") + 1]) / "real_loop.png", dpi=80)
