"""Four cells from files: proved, run, judged.  python docs/examples/21_four_cells.py"""

import sys
from pathlib import Path

from coopqp import check_path, load_cell_file
from coopqp.files import example_path
from coopqp.simulation import evaluate, read_run

runs = {}
for name in ("two_ur10", "panda_and_ur5", "pandas_and_ur5s", "gantry_and_ur5"):
    run = load_cell_file(example_path(name))  # there is no start in the file: this finds one
    task = run.scenario
    check = check_path(task.cell, task.grasp, task.path, q_start=task.q_start)
    recording = run.run()
    findings = evaluate(task.cell, recording, read_run(task.cell, recording))
    finished = f"{check.verdict.value}, finished {recording.finished}"
    print(f"{name}: {finished}, all checks hold: {all(finding.holds for finding in findings)}")
    runs[name] = task, recording

if "--out" in sys.argv:
    import matplotlib.pyplot as plt

    from coopqp.visualization import View, box_solid, cell_solids, render

    figure, panels = plt.subplots(2, 2, figsize=(9, 6.4), layout="constrained")
    for panel, (name, (task, recording)) in zip(panels.flat, runs.items(), strict=True):
        (scene,) = cell_solids(task.cell, recording.q[-1:])
        bar = task.path.pose(task.path.duration) * task.T_object_body
        scene.append(box_solid(task.object_size, bar, (0.30, 0.52, 0.75)))
        side = 35.0 if name == "gantry_and_ur5" else -60.0
        view = View.around([scene], azimuth=side, elevation=25.0)
        panel.imshow(render([scene], view, width=450)[0])
        panel.set_title(name)
        panel.axis("off")
    figure.savefig(Path(sys.argv[sys.argv.index("--out") + 1]) / "four_cells.png", dpi=80)
