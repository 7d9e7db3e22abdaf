"""Relax internal forces.  python docs/examples/26_hold_without_squeezing.py [--out FOLDER]"""

import sys
import warnings
from pathlib import Path

import numpy as np
import pinocchio as pin

import coopqp
from coopqp.planning import Payload
from coopqp.scenarios import paper_lift

warnings.simplefilter(
    "ignore", coopqp.errors.StartWarning
)  # an arm starts off its grasp: that is the point
lift = paper_lift(time_law="quintic")
off = pin.SE3(
    pin.exp3(np.deg2rad([0.06, 0.06, 0.06])), np.array([0.0006, 0.0006, 0.0006])
)  # 1 mm, 0.1°
# Without sensors the run squeezes on purpose: no supervision may stop it.
tolerant = coopqp.SupervisionOptions(slow_from=0.005, hold_from=0.01, stall_samples=10_000)


def lifted(relax, **sensors):
    """The controller, the run and the largest force of an arm at each step, one base off."""
    wrong = coopqp.simulation.Disturbances(
        base_offset={"slave_2": off}, wrench_latency=0.01, **sensors
    )
    plant = coopqp.simulation.PhysicsPlant.of(lift, disturbances=wrong)
    options = coopqp.QPOptions() if relax else coopqp.QPOptions(supervision=tolerant)
    controller = coopqp.QPController(
        lift.cell, lift.grasp, lift.path, dt=lift.dt, options=options
    )
    if relax:
        payload = Payload(mass=plant.object_mass, centre=lift.T_object_body.translation)
        forces = coopqp.ForceOptions(stiffness=plant.stiffness, payload=payload, delay=0.01)
        controller = coopqp.ForceController(controller, forces)
    felt = []

    def feel(step):
        felt.append(np.linalg.norm(plant.wrenches()[:, :3], axis=1).max())

    run = coopqp.simulate(controller, plant, q_start=lift.q_start, settle=0.5, observe=feel)
    return controller, run, felt


_, stiff, squeezed = lifted(relax=False)
print(f"without sensors: {squeezed[-1]:.0f} N on an arm at the end of the lift")
controller, run, relaxed = lifted(relax=True)
print(f"with sensors: {relaxed[-1]:.0f} N, of which the plate's weight takes 98 N")
moved = 1e3 * np.linalg.norm(controller.shift[:, :3], axis=1)
print("the grips gave way by", ", ".join(f"{m:.1f} mm" for m in moved))

# A sensor the wrong way round is found before anything moves.
_, stopped, _ = lifted(relax=True, wrench_gain={"slave_1": -1.0})
why = stopped.notes[-1].split(";")[1].strip()
print(f"{stopped.statuses[-1].value} at clock {stopped.clock[-1]:g} s: {why}")

if "--out" in sys.argv:
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(8, 4), layout="constrained")
    for made, felt, label in (
        (stiff, squeezed, "without sensors"),
        (run, relaxed, "ForceController"),
    ):
        axes.plot(made.time[1:], felt, label=label)
    axes.axhline(98.0, color="#666666", ls="--", lw=1)
    axes.annotate(
        "what the plate's weight takes", (3.5, 104.0), color="#666666", ha="right", va="bottom"
    )
    begins = run.time[1:][np.argmax(run.rate > 0.0)]
    axes.axvline(begins, color="#666666", ls=":", lw=1)
    axes.annotate(" it begins to move", (begins, 300.0), color="#666666")
    axes.set(
        xlabel="time [s]", ylabel="largest force of an arm on the plate [N]", ylim=(0.0, None)
    )
    axes.legend()
    figure.savefig(Path(sys.argv[sys.argv.index("--out") + 1]) / "forces.png", dpi=80)
