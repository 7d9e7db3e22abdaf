"""Two seven-joint arms use their freedom.  python docs/examples/03_redundant_arms.py"""

import sys
from pathlib import Path

import numpy as np

from coopqp import HoldPath, PostureOptions, QPController, QPOptions, simulate
from coopqp.scenarios import dual_arm7
from coopqp.simulation import read_run

bar = dual_arm7()  # two arms of seven joints, a bar of 0.6 m
out = bar.q_start + np.tile([0, 0, 0.5, 0, 0, 0, 0], 2)  # to be near [rad]; the bar decides
hold = HoldPath(bar.path.pose(0.0), duration=3.0)
tasks = {
    "carry, stay near the start": (bar.path, PostureOptions()),
    "carry, elbows out": (bar.path, PostureOptions(target=out)),
    "carry, away from the limits": (bar.path, PostureOptions(gain=0.0, centring=0.5)),
    "hold still, elbows out": (hold, PostureOptions(target=out)),
}
runs = {}
for name, (path, posture) in tasks.items():
    options = QPOptions(posture=posture)
    controller = QPController(bar.cell, bar.grasp, path, dt=0.004, options=options)
    runs[name] = recording = simulate(controller, q_start=bar.q_start)
    errors = read_run(bar.cell, recording)
    elbow = recording.q[-1, 2] - bar.q_start[2]  # joint 3 of the left arm
    print(
        f"{name}: the arms part by {errors.chain_mm.max():.0e} mm, "
        f"{errors.object_mm.max():.0e} mm off the path, "
        f"the left arm's joint 3 turns by {elbow:.2f} rad"
    )

if "--view" in sys.argv:
    from coopqp.visualization import LiveViewer

    with LiveViewer(recording) as viewer:
        print("Open", viewer.url)
        viewer.run()

if "--out" in sys.argv:
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(8, 4), layout="constrained")
    for name, run in runs.items():
        axes.plot(run.time, run.q[:, 2] - run.q[0, 2], label=name)
    axes.set(xlabel="time [s]", ylabel="left arm's joint 3 turns by [rad]")
    axes.set_title("The elbow moves; the bar does what it does anyway")
    axes.legend()
    figure.savefig(Path(sys.argv[sys.argv.index("--out") + 1]) / "elbows.png", dpi=80)
