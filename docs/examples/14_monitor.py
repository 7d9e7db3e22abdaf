"""Evaluate a run by its commands alone, then or later.  python docs/examples/14_monitor.py"""

from coopqp import QPController, simulate
from coopqp.baselines import PseudoInverseController
from coopqp.scenarios import fast_lift
from coopqp.simulation import Monitor, Monitored, check_run

task = fast_lift()  # faster than the joints can move

# Afterwards: a recording.
controller = PseudoInverseController(task.cell, task.grasp, task.path, dt=task.dt)
recording = simulate(controller, q_start=task.q_start)
print("pseudo-inverse,", str(check_run(recording, task.cell)).splitlines()[0])

# While it goes on: a monitor beside the controller, with tolerances of your own.
monitor = Monitor(task.cell, task.grasp, tolerances={"chain_mm": 0.01, "object_mm": 0.01})
watched = Monitored(QPController(task.cell, task.grasp, task.path, dt=task.dt), monitor)
watched.reset(task.q_start)
while not watched.step().finished:
    if not watched.verdict().ok:
        print(watched.verdict().violations[0])
        break
print("cooperative QP,", watched.verdict())
