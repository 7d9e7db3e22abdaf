"""Two arms open a part while a third lifts it.  python docs/examples/37_pliers.py"""

import sys
from pathlib import Path

import numpy as np

from coopqp import Phase, Program, QPController, check_path, simulate
from coopqp.programs import Turns
from coopqp.scenarios import paper_lift
from coopqp.simulation import check_run

task = paper_lift(time_law="quintic")
cell = task.cell.with_limits(acceleration=5.0)
pin = (0.0, 0.8, 0.0)  # the pin of the part, in the object frame [m]


def program(angle):
    """Open by an angle [rad] while the part is lifted, and close it again at rest."""
    half = angle / 2
    return Program(
        cell,
        task.grasp,
        [
            Phase(
                "open",
                path=task.path,
                arms={
                    "slave_1": Turns(about=pin, angle=half),
                    "slave_2": Turns(about=pin, angle=-half),
                },
            ),
            Phase(
                "close",
                duration=2.0,
                arms={
                    "slave_1": Turns(about=pin, angle=-half),
                    "slave_2": Turns(about=pin, angle=half),
                },
            ),
        ],
    )


for degrees in (20, 40):
    path = program(np.deg2rad(degrees))
    check = check_path(cell, task.grasp, path, q_start=task.q_start)
    print(f"{degrees}°: {check.verdict.value}")
    for phase in check.phases:
        print(f"  {phase.name}: {phase.verdict.value if phase.verdict else 'not reached'}")
        if phase.why and phase.arm:
            print(f"    {phase.why}")

path = program(np.deg2rad(20))
run = simulate(QPController(cell, task.grasp, path, dt=0.002), q_start=task.q_start)
held = check_run(run, cell).ok
print(f"arrived: {run.finished} in {run.time[-1]:.2f} s; all checks hold: {held}")

if "--out" in sys.argv:
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(8, 3.5), layout="constrained")
    turns = np.rad2deg(run.shift[:, 1, 5] - run.shift[:, 2, 5])
    height = run.reference[:, 2, 3] - run.reference[0, 2, 3]
    axes.plot(run.time[1:], turns, "C0", label="angle between the halves [°]")
    axes.plot(run.time, 100 * height, "k", label="height [cm]")
    for phase, color in zip(path.spans, ("C0", "C1"), strict=True):
        axes.axvspan(phase.start, phase.end, color=color, alpha=0.08, lw=0)
        axes.text(phase.start + 0.05, 31, phase.name)
    axes.set(xlabel="time [s]", ylim=(-2, 34))
    axes.legend(loc="center left")
    figure.savefig(Path(sys.argv[sys.argv.index("--out") + 1]) / "pliers.png", dpi=80)
