"""The loop follows the slowest of three robots.  python docs/examples/34_slowest_arm.py"""

import sys
from pathlib import Path

from coopqp import QPController, QPOptions, SupervisionOptions
from coopqp.drivers import ControlLoop, ManualTime, SimulatedRobot
from coopqp.scenarios import paper_lift

lift = paper_lift(time_law="quintic")
cell = lift.cell.with_limits(acceleration=10.0)
x = cell.positions(lift.q_start)
stiff = QPOptions(supervision=SupervisionOptions(stiffness=1e5))


class Watch:
    """Notes the object's clock, and lets the second robot move at half its speed for 1.5 s."""

    def __init__(self, robots, slow):
        self.robots, self.slow, self.times, self.clocks = robots, slow, [], []

    def take(self, moment, measured, sent, step, clock):
        self.times.append(moment)
        self.clocks.append(clock)
        slow = self.slow and 0.75 <= moment - self.times[0] < 2.25
        self.robots["slave_1"].servo.limit(0.2 if slow else None)


runs = {}
for name, slow in (("free", False), ("slave_1 at half its speed", True)):
    time = ManualTime()  # goes on when it is waited for; with robots it is the machine's
    robots = {}
    for arm, own, lag in zip(cell.arm_names, cell.v_slices, (0.007, 0.032, 0.047), strict=True):
        joints = [joint.partition("/")[2] for joint in cell.joint_names[own]]
        robots[arm] = SimulatedRobot(joints, x[own], time=time, lag=lag)
    controller = QPController(cell, lift.grasp, lift.path, dt=0.002, options=stiff)
    watch = runs[name] = Watch(robots, slow)
    report = ControlLoop(controller, robots, recorder=watch, time=time).run()
    print(f"{name}: {report.reason} after {report.time:.2f} s")
    print(f"  lost to slave_1 {report.lost_time['slave_1']:.2f} s", end=", ")
    share = report.acceleration
    print(f"apart {1e3 * report.apart:.2f} mm, acceleration {share:.2f} of the limit")

if "--out" in sys.argv:
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(8, 3.5), layout="constrained")
    for name, watch in runs.items():
        axes.plot([t - watch.times[0] for t in watch.times], watch.clocks, label=name)
    axes.axvspan(0.75, 2.25, color="0.92")
    axes.set(xlabel="time [s]", ylabel="object's clock [s]")
    axes.legend()
    figure.savefig(Path(sys.argv[sys.argv.index("--out") + 1]) / "drive.png", dpi=130)
