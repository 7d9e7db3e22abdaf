"""Examples of the classes of this page: each section is shown at the classes that it names; all are run by a test."""

# %% before
from coopqp import QPController, simulate
from coopqp.scenarios import dual_arm7, hot_plate

task = dual_arm7()
run = simulate(QPController(task.cell, task.grasp, task.path, dt=0.01), q_start=task.q_start)

# %% coopqp.simulation.RunLoads
from coopqp.simulation import read_loads, run_in_engine

hot = hot_plate(duration=0.5)
loads = read_loads(hot.cell, run_in_engine(hot))
print(f"internal forces up to {loads.internal.max():.0f} N")

# %% coopqp.simulation.Replay
from coopqp.simulation import Replay, recorded_motion

replay = Replay(
    task.cell, task.grasp, task.path, recorded_motion(task.cell, run), dt=0.01
)  # a controller without feedback
replay.reset(task.q_start)

# %% coopqp.control.VelocityBox
from coopqp.control import VelocityBox

box = VelocityBox(task.cell)  # the bounds of the joint velocities of one step
