"""Torque-controlled arms.  python docs/examples/30_torque_drives.py [--out FOLDER]"""

import sys
import warnings
from pathlib import Path

import coopqp
from coopqp.scenarios import torque_lift
from coopqp.simulation import read_loads, run_in_engine

# A plate that sank starts off its path.
warnings.simplefilter("ignore", coopqp.errors.StartWarning)

# What the drives know of arms and plate is half of every mass.
laws = {
    "position servos": {"servo": "position", "wrist_sensors": False},
    "computed torque": {"servo": "computed torque", "wrist_sensors": False},
    "observer": {"servo": "disturbance observer", "wrist_sensors": False},
    "observer, wrist sensors": {"servo": "disturbance observer"},
}
drawn = {}
for name, drives in laws.items():
    lift = torque_lift(duration=1.5, assumed_mass=0.5, assumed_payload=0.5, **drives)
    run = run_in_engine(lift)
    loads, read = read_loads(lift.cell, run), coopqp.simulation.read_run(lift.cell, run)
    drawn[name] = loads.time, read.object_mm[1:], loads.internal.max(axis=1)
    print(
        f"{name}: off by {read.object_mm.max():.2f} mm at most,",
        f"and {read.object_mm[-1]:.2f} mm at the end;",
        f"squeezed by {loads.internal[-1].max():.0f} N;",
        f"{100 * loads.torque_use.max():.0f} % of a torque",
    )

if "--out" in sys.argv:
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    styles = ("-", "-", "--", "-")
    for (name, (time, off, force)), style in zip(drawn.items(), styles, strict=True):
        axes[0].semilogy(time, off, style, label=name)
        axes[1].plot(time, force, style, label=name)
    axes[0].set(xlabel="time [s]", ylabel="plate off its path [mm]", ylim=(1e-3, None))
    axes[1].set(xlabel="time [s]", ylabel="largest internal force of an arm [N]")
    axes[1].set_ylim(bottom=0.0)
    axes[0].legend()
    figure.savefig(Path(sys.argv[sys.argv.index("--out") + 1]) / "torque_drives.png", dpi=80)
