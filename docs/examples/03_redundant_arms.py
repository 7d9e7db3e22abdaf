"""Two seven-joint arms use their freedom without moving the object.  python docs/examples/03_redundant_arms.py"""

import sys

import numpy as np

from coopqp import HoldPath, PostureOptions, QPController, QPOptions, read_run, simulate
from coopqp.scenarios import dual_arm7

bar = dual_arm7()  # two arms of seven joints, a bar of 0.6 m
elbows_out = bar.q_start + np.tile([0, 0, 0.5, 0, 0, 0, 0], 2)  # a posture to be near [rad]; the bar decides the rest
tasks = {
    "carry, stay near the start": (bar.path, PostureOptions()),
    "carry, elbows out": (bar.path, PostureOptions(target=elbows_out)),
    "carry, away from the limits": (bar.path, PostureOptions(gain=0.0, centring=0.5)),
    "hold still, elbows out": (HoldPath(bar.path.pose(0.0), duration=3.0), PostureOptions(target=elbows_out)),
}
for name, (path, posture) in tasks.items():
    controller = QPController(bar.cell, bar.grasp, path, dt=0.004, options=QPOptions(posture=posture))
    recording = simulate(controller, q_start=bar.q_start)
    errors = read_run(bar.cell, recording)
    elbow = recording.q[-1, 2] - bar.q_start[2]  # joint 3 of the left arm
    print(
        f"{name}: the arms part by {errors.chain_mm.max():.0e} mm, {errors.object_mm.max():.0e} mm off the path, "
        f"the left arm's joint 3 turns by {elbow:.2f} rad"
    )

if "--view" in sys.argv:
    from coopqp import LiveViewer

    with LiveViewer(recording) as viewer:
        print("Open", viewer.url)
        viewer.run()
