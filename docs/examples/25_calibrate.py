"""Where do bases really stand?  python docs/examples/25_calibrate.py [--out FOLDER]"""

import sys
import warnings
from pathlib import Path

import numpy as np
import pinocchio as pin

import coopqp
from coopqp.forces import determining_motion
from coopqp.scenarios import paper_lift

warnings.simplefilter(
    "ignore", coopqp.errors.StartWarning
)  # the arms start where the closed grips put them
lift = paper_lift(time_law="quintic")
off = pin.SE3(
    pin.exp3(np.deg2rad([0.06, 0.06, 0.06])), np.array([0.0006, 0.0006, 0.0006])
)  # 1 mm, 0.1°


def lifted(cell, grasp, disturbances):
    """A lift in the engine; the recording, and the wrenches at its end."""
    plant = coopqp.simulation.PhysicsPlant.of(lift, disturbances=disturbances)
    # This run squeezes on purpose: no supervision may stop it.
    loose = coopqp.SupervisionOptions(slow_from=0.005, hold_from=0.01, stall_samples=10_000)
    options = coopqp.QPOptions(supervision=loose)
    controller = coopqp.QPController(cell, grasp, lift.path, dt=lift.dt, options=options)
    q_start = coopqp.inverse_kinematics(cell, grasp, lift.path.pose(0.0), lift.q_start)
    return coopqp.simulate(controller, plant, q_start=q_start, settle=0.3), plant.wrenches()


def squeeze(wrenches):
    return np.linalg.norm((wrenches - load)[:, :3], axis=1).max()


# 1. The base of one arm stands 1 mm and 0.1° off. The object is squeezed.
load = lifted(lift.cell, lift.grasp, None)[1]
wrong = coopqp.simulation.Disturbances(base_offset={"slave_2": off}, encoder_noise=1e-4)
run, wrenches = lifted(lift.cell, lift.grasp, wrong)
print(f"before: {squeeze(wrenches):.0f} N at the end of the lift")

# 2. Its measured configurations say where the base is. No force sensor, no tool but the arms.
found = coopqp.simulation.calibrate_runs([run], cell=lift.cell)
print(found.explain())

# 3. The same lift with the corrected model.
_, wrenches = lifted(found.cell, found.grasp, wrong)
print(f"after: less than 15 N: {squeeze(wrenches) < 15.0}")

# 4. The lift turns about one axis only. This motion would determine the rest.
motion = determining_motion(lift.cell, lift.grasp, lift.q_start)
tilts = np.rad2deg(motion.tilts).round(1)
left, verdict = len(motion.undetermined), motion.check.verdict.value
print(f"tilts {tilts}°: {left} directions left, path {verdict}")

if "--out" in sys.argv:
    coopqp.visualization.write_calibration(
        found, Path(sys.argv[sys.argv.index("--out") + 1]) / "calibration.png", dpi=90
    )
