"""A joint reaches its limit: all arms brake together.  python docs/examples/04_at_a_limit.py"""

import sys
from pathlib import Path

import numpy as np

from coopqp import QPController, simulate
from coopqp.baselines import IndependentQPController
from coopqp.scenarios import at_limit
from coopqp.simulation import read_run

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
    from coopqp.visualization import LiveViewer

    with LiveViewer(recording) as viewer:
        print("Open", viewer.url)
        viewer.run()

if "--out" in sys.argv:
    import matplotlib.pyplot as plt

    names, limits = task.cell.arm_names, task.cell.limits
    figure = plt.figure(figsize=(8, 7), layout="constrained")
    panels = figure.subplot_mosaic(
        [["rate"] * 3, list(names), ["parted"] * 3], height_ratios=[2, 3, 3]
    )
    panels["rate"].plot(recording.time[1:], recording.rate)
    panels["rate"].set_ylabel("rate σ")
    position = (2 * recording.q - limits.upper - limits.lower) / (limits.upper - limits.lower)
    for name, joints in zip(names, task.cell.v_slices, strict=True):
        panel, labels = panels[name], [f"joint {j + 1}" for j in range(6)]
        panel.plot(recording.time, position[:, joints], lw=1.2, label=labels)
        panel.hlines([-1, 1], 0, recording.time[-1], "k", "dashed", lw=0.8)
        panel.set_title(name.replace("_", " "), fontsize=10)
        panel.set_ylim(-1.1, 1.1)
    panels[names[0]].set_ylabel("joints (±1: their limits)")
    figure.legend(
        *panel.get_legend_handles_labels(), loc="outside upper center", ncols=6, fontsize=9
    )
    bottom = panels["parted"]
    for name, run in runs.items():
        bottom.semilogy(run.time, np.maximum(errors[name].chain_mm, 1e-10), label=name)
    bottom.set_ylabel("the arms part by [mm]")
    bottom.set_xlabel("time [s]")
    bottom.legend()
    figure.savefig(Path(sys.argv[sys.argv.index("--out") + 1]) / "at_a_limit.png", dpi=80)
