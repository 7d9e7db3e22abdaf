"""A fault is latched; go on from where the arms really are.  python docs/examples/07_fault_and_reset.py"""

import numpy as np

from coopqp import QPController, Status
from coopqp.scenarios import paper_lift

lift = paper_lift(time_law="quintic")
controller = QPController(lift.cell, lift.grasp, lift.path, dt=0.002)
controller.reset(lift.q_start)
q, faults = lift.q_start, 0

for tick in range(5000):
    step = controller.step(q)
    q = step.q_next  # an ideal robot, but for
    if 500 <= tick < 520:  # a blow to the second arm: its shoulder reads 0.03 rad off for 40 ms
        q = q + np.where(np.arange(lift.cell.nv) == 7, 0.03, 0.0)
    if step.status is Status.FAULT and tick > 600:  # it stays latched until reset
        faults += 1
        print(f"{tick * 0.002:.2f} s: {step.status.value}, the object is on its path up to {step.clock:.2f} s")
        controller.reset(q, clock=step.clock)  # from the measured configuration: refused if an arm is 20 mm off
    if step.finished:
        break
print(f"{faults} fault, then finished: {step.finished} after {tick * 0.002:.2f} s; {step.explain()}")
