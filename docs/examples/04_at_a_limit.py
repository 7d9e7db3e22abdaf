"""A joint reaches its limit: all arms brake together.  python docs/examples/04_at_a_limit.py"""

import sys
from pathlib import Path

import numpy as np

from coopqp import IndependentQPController, QPController, read_run, simulate
from coopqp.scenarios import at_limit

# The paper's cell, every joint fenced in to ±0.25 rad, at most 5 rad/s²; the path of 1 m
# leads out of the fence.
task = at_limit()
runs, errors = {}, {}
for name, kind in (
    ("cooperative", QPController),
    ("independent arms", IndependentQPController),
):
    controller = kind(task.cell, task.grasp, task.path, dt=task.dt)
    runs[name] = simulate(controller, q_start=task.q_start, duration=1.5)
    errors[name] = read_run(task.cell, runs[name])
    parted, off = errors[name].chain_mm.max(), errors[name].object_mm.max()
    print(f"{name}: the arms part by {parted:.1e} mm, {off:.1e} mm off the path")
recording = runs["cooperative"]
print(recording.notes[-1])  # which arm, which joint, which limit

if "--view" in sys.argv:
    from coopqp import LiveViewer

    with LiveViewer(recording) as viewer:
        print("Open", viewer.url)
        viewer.run()

if "--out" in sys.argv:
    import matplotlib.pyplot as plt

    limits = task.cell.limits
    figure, panels = plt.subplots(3, 1, sharex=True, figsize=(7, 7), layout="constrained")
    top, middle, bottom = panels
    top.plot(recording.time[1:], recording.rate)
    top.set_ylabel("rate σ")
    position = (2 * recording.q - limits.upper - limits.lower) / (limits.upper - limits.lower)
    middle.plot(recording.time, position, lw=0.8)
    middle.axhline(1, color="k", lw=0.8, ls="--")
    middle.axhline(-1, color="k", lw=0.8, ls="--")
    middle.set_ylabel("joints (±1: their limits)")
    for name, run in runs.items():
        bottom.semilogy(run.time, np.maximum(errors[name].chain_mm, 1e-10), label=name)
    bottom.set_ylabel("the arms part by [mm]")
    bottom.set_xlabel("time [s]")
    bottom.legend()
    figure.savefig(Path(sys.argv[sys.argv.index("--out") + 1]) / "at_a_limit.png", dpi=80)
