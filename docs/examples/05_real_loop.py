"""The loop of a real cell: measure, step, send, branch on the status.  python docs/examples/05_real_loop.py"""

import gc
import time

import numpy as np

from coopqp import Disturbances, DisturbedPlant, QPController, Status
from coopqp.scenarios import paper_lift

lift, dt = paper_lift(time_law="quintic"), 0.001
cell = lift.cell.with_limits(acceleration=10.0)
controller = QPController(cell, lift.grasp, lift.path, dt=dt)

# In place of the robots: joints that lag by 5 ms and encoders off by up to 2e-5 rad; an arm stops after 1 s.
arms = cell.arm_names
robots = DisturbedPlant(
    cell, lift.grasp, Disturbances(encoder_noise=2e-5, lag=dict.fromkeys(arms, 0.005), stall={arms[1]: 1.0})
)

q = robots.reset(lift.q_start)
controller.reset(q)  # allocates, runs the preview ahead: takes milliseconds, so before the loop
for _ in range(50):  # warm up caches and branch predictors, then start again
    controller.step(q)
controller.reset(q)
gc.collect()
gc.freeze()  # what lives now is not looked at again
gc.disable()  # no pause while the robots move

times, last = [], Status.TRACKING
for tick in range(1500):
    began = time.perf_counter()
    step = controller.step(q)
    times.append(time.perf_counter() - began)
    if step.status is not last:
        print(f"{tick * dt:.3f} s {step.status.value}: {step.explain()}")
        last = step.status
    if step.status is Status.FAULT:
        break  # at rest until reset(q) with the measured configuration
    q = robots.apply(step)  # send step.q_next (or step.velocity), wait for the period, read the encoders
    if step.finished:
        break
gc.enable()

print(f"object at {step.clock:.3f} s of {lift.path.duration:g} s, {step.status.value}")
middle, late, worst = 1e6 * np.percentile(times, [50, 99, 100])
print(f"one step: {middle:.0f} µs, 99 % below {late:.0f} µs, longest {worst:.0f} µs")
