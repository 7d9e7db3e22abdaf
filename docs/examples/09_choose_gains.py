"""How fast errors die away, and noise.  python docs/examples/09_choose_gains.py"""

import sys
from pathlib import Path

import numpy as np
import pinocchio as pin

from coopqp import HoldPath, QPController, QPOptions
from coopqp.scenarios import paper_lift
from coopqp.simulation import Disturbances, DisturbedPlant, misplaced

lift = paper_lift()
hold = HoldPath(lift.path.pose(0.0), duration=0.5)

print("a grasp that is 5 mm off at the start:")
off = pin.SE3(np.eye(3), np.array([0.005, 0.0, 0.0]))
wrong = misplaced(lift.cell, lift.grasp, {"slave_1": off})
decays = {}
for gain in (5.0, 20.0, 50.0):
    options = QPOptions(grasp_gain=gain)
    controller = QPController(lift.cell, wrong, hold, dt=0.001, options=options)
    controller.reset(lift.q_start)
    decays[gain] = mm = [controller.step().relative_errors[0, 0] for _ in range(500)]
    after = f"after 0.1 s {mm[100]:.3f} mm, after 0.3 s {mm[300]:.1e} mm"
    print(f"  grasp_gain {gain:4g} 1/s: {mm[0]:.2f} mm, {after}")

print("encoders that are off by up to 1e-4 rad, the command fed back through path_gain:")
for gain, let_in in ((5.0, 0.02), (20.0, 0.02), (50.0, 0.02), (20.0, 0.2)):
    options = QPOptions(path_gain=gain, measurement_time=let_in)
    controller = QPController(lift.cell, lift.grasp, hold, dt=0.001, options=options)
    robots = DisturbedPlant(lift.cell, lift.grasp, Disturbances(encoder_noise=1e-4))
    q, speeds = robots.reset(lift.q_start), []
    controller.reset(lift.q_start)
    for _ in range(500):
        step = controller.step(q)
        q = robots.apply(step)
        speeds.append(step.velocity)
    rms = 1e3 * np.sqrt(np.mean(np.square(speeds)))
    settings = f"path_gain {gain:4g} 1/s, measurement_time {let_in:4g} s"
    print(f"  {settings}: joints move at {rms:.2f} mrad/s (rms)")

if "--out" in sys.argv:
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(8, 4), layout="constrained")
    for gain, mm in decays.items():
        axes.semilogy(0.001 * np.arange(500), mm, label=f"grasp_gain {gain:g} 1/s")
    axes.set(xlabel="time [s]", ylabel="arms apart [mm]", ylim=(1e-6, 10))
    axes.legend()
    figure.savefig(Path(sys.argv[sys.argv.index("--out") + 1]) / "gains.png", dpi=80)
