"""Up and down five times: which errors accumulate?  python docs/examples/12_cumulative_errors.py"""

import numpy as np

from coopqp import (
    PseudoInverseController,
    PseudoInverseOptions,
    QPController,
    QPOptions,
    WaypointPath,
    relative_positioning_error,
    simulate,
    tool_placements,
)
from coopqp.scenarios import paper_lift

lift = paper_lift()
down, up = lift.path.pose(0.0), lift.path.pose(lift.path.duration)
cycles = 5
path = WaypointPath([down, up] * cycles, durations=[3.0] * (2 * cycles - 1), time_law="linear")

methods = {
    "paper": (PseudoInverseController, PseudoInverseOptions(increment="exact")),
    "midpoint, open loop": (PseudoInverseController, PseudoInverseOptions(increment="exact", integration="midpoint")),
    "QP": (QPController, QPOptions()),
    "QP, iterations=2": (QPController, QPOptions(iterations=2)),
}
N = 40  # steps per lift
for name, (kind, options) in methods.items():
    controller = kind(lift.cell, lift.grasp, path, dt=3.0 / N, options=options)
    recording = simulate(controller, q_start=lift.q_start)
    tools = tool_placements(lift.cell, recording.q)
    mm = 1e3 * np.array([relative_positioning_error(T, lift.grasp) for T in tools])
    print(f"{name:20} ε_p after 1 lift {mm[N]:.2g} mm, after {2 * cycles - 1} {mm[-1]:.2g} mm")
