"""The paper's lift: its own algorithm beside the QP.  python docs/examples/01_paper_lift.py"""

import sys
from pathlib import Path

from coopqp import QPController, simulate
from coopqp.baselines import PseudoInverseController
from coopqp.scenarios import paper_lift
from coopqp.simulation import relative_positioning_error, tool_placements

lift = paper_lift()  # three RX-90L, the plate they hold, its path of 3 s, and where they start


def largest_error_mm(recording):
    """ε_p of the paper, the largest over the run [mm]."""
    samples = tool_placements(lift.cell, recording.q)
    return 1e3 * max(relative_positioning_error(tools, lift.grasp) for tools in samples)


runs = {"paper": [], "QP": []}
for N in (40, 400, 1000):
    dt = lift.path.duration / N
    for name, kind in (("paper", PseudoInverseController), ("QP", QPController)):
        controller = kind(lift.cell, lift.grasp, lift.path, dt=dt)
        runs[name].append(simulate(controller, q_start=lift.q_start))
    errors = [f"{name} {largest_error_mm(done[-1]):.2g} mm" for name, done in runs.items()]
    print(f"N = {N}: {', '.join(errors)}")

if "--view" in sys.argv:
    from coopqp.visualization import LiveViewer

    with LiveViewer(runs["QP"][-1]) as viewer:
        print("Open", viewer.url)
        viewer.run()

if "--out" in sys.argv:
    from coopqp.visualization import error_figure

    figure = error_figure(lift.cell, runs)
    figure.savefig(Path(sys.argv[sys.argv.index("--out") + 1]) / "paper_drift.png", dpi=80)
