"""As fast as the joints allow.  python docs/examples/20_as_fast_as_possible.py"""

import sys
from pathlib import Path

import numpy as np
import pinocchio as pin

from coopqp import QPController, WaypointPath, plan, simulate
from coopqp.scenarios import dual_arm7
from coopqp.simulation import read_run
from coopqp.visualization import write_speed_profile

# Two arms move a bar up, then across. Every joint accelerates by at most 5 rad/s².
task = dual_arm7()
cell, grasp = task.cell.with_limits(acceleration=5.0), task.grasp
start = task.path.pose(0.0)
up = pin.SE3(start.rotation, start.translation + np.array([0.0, 0.05, 0.20]))
aside = up.translation + np.array([0.05, 0.15, 0.0])
across = pin.SE3(pin.rpy.rpyToMatrix(0.2, 0.0, 0.3), aside)
way = [start, up, across]


def run(name, path, q_start):
    controller = QPController(cell, grasp, path, dt=0.002)
    recording = simulate(controller, q_start=q_start)
    slowed = f"{np.count_nonzero(recording.rate < 1.0 - 1e-6)} steps slowed"
    chain = f"{read_run(cell, recording).chain_mm.max():.0e} mm"
    print(f"{name}: {recording.time[-1]:.2f} s, {slowed}, arms within {chain} of each other")


# A controller that knows only what is ahead brakes and speeds up by itself on a path that
# asks for too much.
reactive = WaypointPath(way, durations=[0.6, 0.6])
run("reactive", reactive, task.q_start)

# A plan knows the whole path: the fastest profile under all limits, from rest to rest, and
# to rest at the corner.
planned = plan(cell, grasp, way, q_start=task.q_start)
run("planned", planned.path, planned.q_start)

# With the corner rounded off within 2 cm, the object goes on.
rounded = plan(cell, grasp, way, q_start=task.q_start, blend=0.02)
run("rounded", rounded.path, rounded.q_start)
print("\n".join(rounded.explain().splitlines()[:2]))  # how long, and what binds longest

if "--out" in sys.argv:
    out = Path(sys.argv[sys.argv.index("--out") + 1])
    write_speed_profile(rounded.path, out / "speed_profile.png", dpi=90)
