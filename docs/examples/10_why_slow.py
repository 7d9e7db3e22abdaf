"""Why did it slow down? Ask the steps.  python docs/examples/10_why_slow.py"""

from collections import Counter

from coopqp import QPController, simulate
from coopqp.scenarios import fast_lift

task = fast_lift()
controller = QPController(task.cell, task.grasp, task.path, dt=task.dt)
steps = []
recording = simulate(controller, q_start=task.q_start, observe=steps.append)

print("\n".join(recording.notes[:4]))  # one line per change of status or binding limit, "step: explanation"
print("how many steps each limit held back:")
for limit, count in Counter(limit for step in steps for limit in step.binding).most_common():
    print(f"  {count:4} {limit}")

slowest = min(steps, key=lambda step: step.rate)
print(f"slowest at {slowest.clock:.3f} s of the path, σ = {slowest.rate:.2f}: {slowest.explain()}")
print(f"given up there: {slowest.given_up}")
print(f"smallest singular value of each arm: {slowest.sigma_min.round(3)}")
