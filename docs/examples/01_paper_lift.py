"""Three arms lift and tilt a plate: the paper's algorithm beside the QP.  python docs/examples/01_paper_lift.py"""

import sys

from coopqp import PseudoInverseController, QPController, relative_positioning_error, simulate, tool_placements
from coopqp.scenarios import paper_lift

lift = paper_lift()  # three RX-90L, the plate they hold, its path of 3 s, and where they start


def largest_error_mm(recording):
    """ε_p of the paper, the largest over the run [mm]."""
    samples = tool_placements(lift.cell, recording.q)
    return 1e3 * max(relative_positioning_error(tools, lift.grasp) for tools in samples)


for N in (40, 400, 1000):
    dt = lift.path.duration / N
    runs = {}
    for name, kind in (("paper", PseudoInverseController), ("QP", QPController)):
        controller = kind(lift.cell, lift.grasp, lift.path, dt=dt)
        runs[name] = simulate(controller, q_start=lift.q_start)
    errors = ", ".join(f"{name} {largest_error_mm(run):.2g} mm" for name, run in runs.items())
    print(f"N = {N}: {errors}")

if "--view" in sys.argv:
    from coopqp import LiveViewer

    with LiveViewer(runs["QP"]) as viewer:
        print("Open", viewer.url)
        viewer.run()
