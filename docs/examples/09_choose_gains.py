"""How fast errors die away, and how much noise gets through.  python docs/examples/09_choose_gains.py"""

import numpy as np
import pinocchio as pin

from coopqp import Disturbances, DisturbedPlant, HoldPath, QPController, QPOptions, misplaced
from coopqp.scenarios import paper_lift

lift = paper_lift()
hold = HoldPath(lift.path.pose(0.0), duration=0.5)

print("a grasp that is 5 mm off at the start:")
wrong = misplaced(lift.cell, lift.grasp, {"slave_1": pin.SE3(np.eye(3), np.array([0.005, 0.0, 0.0]))})
for gain in (5.0, 20.0, 50.0):
    controller = QPController(lift.cell, wrong, hold, dt=0.001, options=QPOptions(grasp_gain=gain))
    controller.reset(lift.q_start)
    mm = [controller.step().relative_errors[0, 0] for _ in range(500)]
    print(f"  grasp_gain {gain:4g} 1/s: {mm[0]:.2f} mm, after 0.1 s {mm[100]:.3f} mm, after 0.3 s {mm[300]:.1e} mm")

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
    print(f"  path_gain {gain:4g} 1/s, measurement_time {let_in:4g} s: joints move at {rms:.2f} mrad/s (rms)")
