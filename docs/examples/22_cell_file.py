"""Run a cell from a file, and draw its motion.  python docs/examples/22_cell_file.py"""

import sys
from pathlib import Path

from coopqp import load_cell_file
from coopqp.files import example_path

task = load_cell_file(example_path("bar"))
recording = task.run()
print(f"finished: {recording.finished} after {recording.time[-1]:.2f} s; {recording.notes[0]}")

if "--out" in sys.argv:
    from coopqp.visualization import motion_figure

    bar = {
        "object_size": task.scenario.object_size,
        "T_object_body": task.scenario.T_object_body,
    }
    figure = motion_figure(
        task.scenario.cell, recording, **bar, frames=3, columns=3, azimuth=-60.0, pixels=340
    )
    figure.savefig(Path(sys.argv[sys.argv.index("--out") + 1]) / "cell_file.png", dpi=100)
