"""Slow down, pause, resume, start again in mid-path.  python docs/examples/17_reins.py"""

import sys
from pathlib import Path

from coopqp import QPController, Status
from coopqp.scenarios import paper_lift
from coopqp.simulation import chain_error, path_error, tool_placements

lift = paper_lift(time_law="quintic")
cell = lift.cell.with_limits(acceleration=5.0)
controller = QPController(cell, lift.grasp, lift.path, dt=0.002)
controller.reset(lift.q_start)

OPERATOR = {  # at which tick
    400: lambda: controller.set_override(0.4),
    600: controller.pause,
    900: controller.resume,
    1100: lambda: controller.set_override(1.0),
}
step, last, arms, path, rates = None, Status.TRACKING, 0.0, 0.0, []
for tick in range(5000):
    OPERATOR.get(tick, lambda: None)()
    if tick == 800:  # at rest: reset where it is, and still paused
        controller.reset(step.q_next, clock=step.clock_next)
    step = controller.step()
    rates.append(step.rate)
    if step.status is not last:
        print(f"{tick * 0.002:.3f} s: {step.explain()}")
        last = step.status
    tools = tool_placements(cell, [step.q_next])[0]
    arms = max(arms, chain_error(tools, lift.grasp)[0])
    path = max(path, path_error(tools, lift.grasp, lift.path, step.clock_next)[0])
    if step.finished:
        break
errors = f"arms agree to {1e6 * arms:.2g} µm, off the path by {1e6 * path:.2g} µm"
print(f"finished after {tick * 0.002:.2f} s; {errors}")

if "--out" in sys.argv:
    import matplotlib.pyplot as plt

    words = {
        400: "set_override(0.4)",
        600: "pause()",
        900: "resume()",
        1100: "set_override(1)",
    }
    figure, axes = plt.subplots(figsize=(8, 3.5), layout="constrained")
    axes.plot([0.002 * k for k in range(len(rates))], rates, "k")
    for at, word in words.items():
        axes.axvline(0.002 * at, color="C1", ls="--", lw=1)
        axes.annotate(word, (0.002 * at - 0.02, 0.47), color="C1", ha="right", rotation=90)
    axes.set(xlabel="time [s]", ylabel="rate σ of the object")
    figure.savefig(Path(sys.argv[sys.argv.index("--out") + 1]) / "reins.png", dpi=80)
