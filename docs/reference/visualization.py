"""Examples of the classes of this page: each section is shown at the classes that it names; all are run by a test."""

# %% before
from coopqp import QPController, simulate
from coopqp.scenarios import dual_arm7

task = dual_arm7()

# %% coopqp.visualization.LiveViewer
from coopqp.visualization import LiveViewer

run = simulate(QPController(task.cell, task.grasp, task.path, dt=0.01), q_start=task.q_start)
with LiveViewer(run, port=0) as viewer:
    print("Open", viewer.url)  # viewer.run() serves until Ctrl-C

# %% coopqp.visualization.PageLink
from coopqp.drivers import RealTimeRun
from coopqp.visualization import PageLink

if __name__ == "__main__":  # the page has a process of its own
    controller = QPController(task.cell, task.grasp, task.path, dt=0.01)
    live = RealTimeRun(controller, task.q_start)
    link = PageLink(live, run, port=0)  # the operator's page; live.run(link.observe) then moves and shows the cell
    print("Open", link.url)
    link.close()
