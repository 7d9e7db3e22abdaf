"""Why did it slow down? Ask the steps.  python docs/examples/10_why_slow.py"""

import sys
from collections import Counter
from pathlib import Path

from coopqp import QPController, simulate
from coopqp.scenarios import fast_lift

task = fast_lift()
controller = QPController(task.cell, task.grasp, task.path, dt=task.dt)
steps = []
recording = simulate(controller, q_start=task.q_start, observe=steps.append)

print("\n".join(recording.notes[:4]))  # one line per change: "step: explanation"
print("how many steps each limit held back:")
held_back = Counter(limit for step in steps for limit in step.binding)
for limit, count in held_back.most_common():
    print(f"  {count:4} {limit}")

slowest = min(steps, key=lambda step: step.rate)
at = f"{slowest.clock:.3f} s of the path, σ = {slowest.rate:.2f}"
print(f"slowest at {at}: {slowest.explain()}")
print(f"given up there: {slowest.given_up}")
print(f"smallest singular value of each arm: {slowest.sigma_min.round(3)}")

if "--out" in sys.argv:
    import matplotlib.pyplot as plt
    import numpy as np

    figure, axes = plt.subplots(figsize=(8, 4), layout="constrained")
    time = recording.time[1:]
    axes.plot(time, recording.rate, "k", lw=1.5)
    for limit, colour in zip(held_back, ("C1", "C0", "C2"), strict=False):
        held = np.array([limit in step.binding for step in steps])
        below = np.where(held, recording.rate, np.nan)
        axes.fill_between(
            time, 0, below, color=colour, alpha=0.4, label=f"held back by {limit}"
        )
    axes.set(xlabel="time [s]", ylabel="rate σ of the object", ylim=(0, 1.3))
    axes.legend(loc="upper left")
    figure.savefig(Path(sys.argv[sys.argv.index("--out") + 1]) / "why_slow.png", dpi=80)
