"""Save a run, read it back, write it as CSV and as a ROS 2 bag.  python docs/examples/11_export.py"""

import tempfile
from importlib.util import find_spec
from pathlib import Path

from coopqp import QPController, Recording, simulate, write_bag, write_csv
from coopqp.scenarios import paper_lift

lift = paper_lift()
controller = QPController(lift.cell, lift.grasp, lift.path, dt=lift.dt)
recording = simulate(controller, q_start=lift.q_start, metadata={"scenario": lift.name})

with tempfile.TemporaryDirectory() as folder:
    file = recording.save(Path(folder) / "lift.npz")  # arrays and notes; no code in it is run when it is read
    again = Recording.load(file)

    table = write_csv(again, Path(folder) / "lift.csv", cell=lift.cell).read_text().splitlines()
    print(f"{len(table) - 1} rows of {len(table[0].split(','))} columns: {table[0][:50]} …")
    if find_spec("rosbags"):  # the extra "bags"
        write_bag(again, Path(folder) / "lift_bag", cell=lift.cell)  # JointState and JointTrajectory, in MCAP
