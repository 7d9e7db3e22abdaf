"""A conveyor sets the pace.  python docs/examples/33_conveyor.py"""

import sys
from pathlib import Path

import numpy as np

from coopqp import LinePath, QPController, Status
from coopqp.scenarios import mixed_cell

task, dt = mixed_cell(), 0.002
cell = task.cell.with_limits(acceleration=5.0)
# The program: 0.36 m in 8 s at the belt's full speed.
path = LinePath.displaced(
    task.path.pose(0.0), translation=(0, 0.1, 0.35), duration=8.0, time_law="linear"
)
controller = QPController(cell, task.grasp, path, dt=dt)
controller.reset(task.q_start)

rng, belt, lags, speeds, rates = np.random.default_rng(0), 0.0, [], [], []
status = Status.TRACKING
for tick in range(6000):
    t = tick * dt
    speed = 0.7 * (1 + 0.2 * np.sin(np.pi * t))  # 70 % of the program's speed, ± 20 %
    stops = 4.0 < t < 5.0
    speed = 0.0 if stops else speed
    if not 7.0 < t < 7.5:  # the encoder is silent for half a second
        controller.gear(belt + 2e-4 * rng.normal(), speed=0.7)
    step = controller.step()
    belt += speed * dt
    lags.append(belt - step.clock_next)
    speeds.append(speed)
    rates.append(step.rate)
    if step.status is Status.PAUSED is not status:
        print(f"{t:.3f} s: {step.explain()}")
    status = step.status
    if step.finished:
        break
for first, last in ((2.0, 4.0), (5.5, 7.0), (9.0, 10.5)):
    part = 1e3 * np.array(lags[round(first / dt) : round(last / dt)])
    rms = np.sqrt(np.mean(part**2))
    print(f"{first:g} to {last:g} s: lag {rms:.1f} ms rms, {np.abs(part).max():.1f} ms at most")

if "--out" in sys.argv:
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(8, 3.5), layout="constrained")
    times = dt * np.arange(len(rates))
    axes.plot(times, speeds, "C1--", label="belt")
    axes.plot(times, rates, "k", label="object")
    axes.axvspan(7.0, 7.5, color="C3", alpha=0.15, lw=0, label="encoder silent")
    axes.set(xlabel="time [s]", ylabel="path speed σ")
    axes.legend(loc="lower left")
    figure.savefig(Path(sys.argv[sys.argv.index("--out") + 1]) / "conveyor.png", dpi=80)
