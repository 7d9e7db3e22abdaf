"""Save a run, read it back, write CSV and a ROS 2 bag.  python docs/examples/11_export.py"""

import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from coopqp import QPController, Recording, simulate
from coopqp.files import write_bag, write_csv
from coopqp.scenarios import paper_lift

lift = paper_lift()
controller = QPController(lift.cell, lift.grasp, lift.path, dt=lift.dt)
metadata = {"scenario": lift.name}
recording = simulate(controller, q_start=lift.q_start, metadata=metadata)

with tempfile.TemporaryDirectory() as folder:
    file = recording.save(Path(folder) / "lift.npz")  # no code in it is run when it is read
    again = Recording.load(file)

    table = write_csv(again, Path(folder) / "lift.csv", cell=lift.cell)
    columns = np.genfromtxt(table, delimiter=",", names=True, deletechars="", encoding="utf-8")
    names = columns.dtype.names
    print(f"{len(columns)} rows of {len(names)} columns: {','.join(names)[:50]} …")
    if find_spec("rosbags"):  # the extra "bags": JointState and JointTrajectory, in MCAP
        write_bag(again, Path(folder) / "lift_bag", cell=lift.cell)

if "--out" in sys.argv:
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(8, 4), layout="constrained")
    for name in names:
        if name.startswith("slave_2/") and name.endswith("command_rad"):
            axes.plot(columns["time_s"], columns[name], label=name)
    axes.set(xlabel="time_s", ylabel="columns of lift.csv")
    figure.legend(loc="outside lower center", ncols=3, fontsize="small")
    figure.savefig(Path(sys.argv[sys.argv.index("--out") + 1]) / "export.png", dpi=80)
