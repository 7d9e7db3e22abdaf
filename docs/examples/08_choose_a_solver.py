"""The same steps by every kept solver, every step as a QP.  python docs/examples/08_choose_a_solver.py"""

import numpy as np

from coopqp import QPController, QPOptions, read_run, simulate
from coopqp.scenarios import fast_lift

task = fast_lift()  # 0.6 m/s asked for, joints limited to 1 rad/s: nearly every step is at a limit
for solver in ("daqp", "proxqp", "osqp"):
    options = QPOptions(solver=solver, shortcut=False)  # by default most steps need no QP at all
    controller = QPController(task.cell, task.grasp, task.path, dt=0.004, options=options)
    steps = []
    recording = simulate(controller, q_start=task.q_start, observe=steps.append)
    errors = read_run(task.cell, recording)
    middle = 1e6 * np.median([step.solver.time_s for step in steps])
    print(
        f"{solver:7} solves in {middle:4.0f} µs (median); the arms part by {errors.chain_mm.max():.0e} "
        f"mm, {errors.object_mm.max():.0e} mm off the path; finished in {recording.time[-1]:.3f} s"
    )
