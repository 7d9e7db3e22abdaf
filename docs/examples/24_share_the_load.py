"""Who carries how much?  python docs/examples/24_share_the_load.py [--out FOLDER]"""

import sys
from pathlib import Path

import numpy as np

from coopqp import QPController, simulate
from coopqp.forces import Grip, LoadBound, LoadShare, load_use
from coopqp.planning import Payload, time_path
from coopqp.scenarios import paper_lift
from coopqp.visualization import write_load_use

# The paper's plate, three arms with the motors' torques of their model, and an object of 53 kg.
lift = paper_lift(time_law="quintic", duration=6.0)
cell, grasp, centre = lift.cell, lift.grasp, lift.T_object_body.translation
heavy = LoadShare(cell, grasp, Payload(mass=53.0, centre=centre), internal_force=50.0)
at_rest = heavy.share(lift.q_start)
print(at_rest.explain())
print(
    "up [N]:",
    at_rest.wrenches[:, 2].round(1),
    " internal [N]:",
    np.linalg.norm(at_rest.internal[:, :3], axis=1).round(1),
)

# The whole lift: the share of each limit that it uses.
run = simulate(QPController(cell, grasp, lift.path, dt=0.03), q_start=lift.q_start)
use = load_use(heavy, run.time, run.q_command)
print(*(f"{name}: {value}" for name, value in use.figures().items()), sep="\n")

# What is too heavy is said, with the largest share that the limits leave.
print(
    LoadShare(cell, grasp, Payload(mass=90.0, centre=centre), internal_force=50.0)
    .share(lift.q_start)
    .explain()
)

# Open palms with μ = 0.6 hold 20 kg by squeezing: as much as Coulomb asks, and no more.
palms = [Grip(kind="palm", friction=0.6)] * 3
for cap in (200.0, 120.0):
    shared = LoadShare(
        cell, grasp, Payload(mass=20.0, centre=centre), internal_force=cap, grips=palms
    ).share(lift.q_start)
    squeeze = shared.wrenches[0, 1]
    print(f"cap {cap:.0f} N: the master presses with {squeeze:.1f} N. {shared.explain()}")

# What the arms can carry bounds the speed: the fastest lift within 20 rad/s².
agile = cell.with_limits(acceleration=20.0)
for mass in (20.0, 53.0):
    load = LoadShare(agile, grasp, Payload(mass=mass, centre=centre), internal_force=50.0)
    fastest = time_path(
        agile, grasp, lift.path, q_start=lift.q_start, bounds=[LoadBound(load)], knots=100
    )
    print(f"{mass:.0f} kg: lifted in {fastest.duration:.2f} s")

if "--out" in sys.argv:
    write_load_use(use, Path(sys.argv[sys.argv.index("--out") + 1]) / "load_use.png", dpi=90)
