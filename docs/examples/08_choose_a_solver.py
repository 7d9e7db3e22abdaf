"""The same steps by every kept solver.  python docs/examples/08_choose_a_solver.py"""

import sys
from pathlib import Path

import numpy as np

from coopqp import QPController, QPOptions, simulate
from coopqp.scenarios import fast_lift
from coopqp.simulation import read_run

task = fast_lift()  # 0.6 m/s asked for, joints limited to 1 rad/s: mostly at a limit
runs = {}
for solver in ("daqp", "proxqp", "osqp"):
    options = QPOptions(solver=solver, shortcut=False)  # by default most steps need no QP
    controller = QPController(task.cell, task.grasp, task.path, dt=0.004, options=options)
    steps = []
    runs[solver] = recording = simulate(controller, q_start=task.q_start, observe=steps.append)
    errors = read_run(task.cell, recording)
    middle = 1e6 * np.median([step.solver.time_s for step in steps])
    print(
        f"{solver:7} solves in {middle:4.0f} µs (median); "
        f"the arms part by {errors.chain_mm.max():.0e} mm, "
        f"{errors.object_mm.max():.0e} mm off the path; finished in {recording.time[-1]:.3f} s"
    )

if "--out" in sys.argv:
    import matplotlib.pyplot as plt

    figure, (top, bottom) = plt.subplots(
        2, 1, sharex=True, figsize=(8, 5), layout="constrained"
    )
    for (solver, run), width, style in zip(runs.items(), (6, 3, 1), "--:", strict=True):
        share = 100 * np.abs(run.velocity / task.cell.limits.velocity).max(axis=1)
        top.plot(run.time[1:], run.rate, lw=width, ls=style, label=solver)
        bottom.plot(run.time[1:], share, lw=width, ls=style)
    top.set_ylabel("rate σ of the object")
    bottom.set(xlabel="time [s]", ylabel="fastest joint [% of its limit]")
    top.legend()
    figure.savefig(Path(sys.argv[sys.argv.index("--out") + 1]) / "solvers.png", dpi=80)
