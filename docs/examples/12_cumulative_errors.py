"""Up and down five times: what accumulates?  python docs/examples/12_cumulative_errors.py"""

import sys
from pathlib import Path

import numpy as np

from coopqp import QPController, QPOptions, WaypointPath, simulate
from coopqp.baselines import PseudoInverseController, PseudoInverseOptions
from coopqp.scenarios import paper_lift
from coopqp.simulation import relative_positioning_error, tool_placements

lift = paper_lift()
down, up = lift.path.pose(0.0), lift.path.pose(lift.path.duration)
cycles = 5
durations = [3.0] * (2 * cycles - 1)
path = WaypointPath([down, up] * cycles, durations=durations, time_law="linear")

middle = PseudoInverseOptions(increment="exact", integration="midpoint")
methods = {
    "paper": (PseudoInverseController, PseudoInverseOptions(increment="exact")),
    "midpoint, open loop": (PseudoInverseController, middle),
    "QP": (QPController, QPOptions()),
}
N = 40  # steps per lift
errors = {}
for name, (kind, options) in methods.items():
    controller = kind(lift.cell, lift.grasp, path, dt=3.0 / N, options=options)
    recording = simulate(controller, q_start=lift.q_start)
    tools = tool_placements(lift.cell, recording.q)
    mm = 1e3 * np.array([relative_positioning_error(T, lift.grasp) for T in tools])
    ends = f"after 1 lift {mm[N]:.2g} mm, after {2 * cycles - 1} {mm[-1]:.2g} mm"
    print(f"{name:20} ε_p {ends}, at most {mm.max():.2g} mm")
    errors[name] = mm

if "--out" in sys.argv:
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(8, 4), layout="constrained")
    for name, mm in errors.items():
        axes.semilogy(3.0 / N * np.arange(1, len(mm)), mm[1:], label=name)
    axes.set(xlabel="time [s]", ylabel="ε_p [mm]", ylim=(1e-7, 200))
    figure.legend(loc="outside upper center", ncols=3)
    out = Path(sys.argv[sys.argv.index("--out") + 1])
    figure.savefig(out / "cumulative_errors.png", dpi=80)
