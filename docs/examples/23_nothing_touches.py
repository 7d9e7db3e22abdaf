"""Keep clear of a post; elbows evade a knob.

python docs/examples/23_nothing_touches.py [--out FOLDER]
"""

import sys
from pathlib import Path

import numpy as np
import pinocchio as pin

from coopqp import Clearance, CollisionScene, QPController, simulate
from coopqp.collision import Body, Box
from coopqp.scenarios import elbow_and_knob, plate_and_post
from coopqp.simulation import Closeness, check_run

curves = []
for task in (plate_and_post(), elbow_and_knob()):
    cell = task.cell.with_limits(acceleration=5.0)
    scene = CollisionScene.of(task, cell=cell, margin=0.02)  # 20 mm
    judge = Closeness(scene)  # distances by another way than the controller's
    near = scene.distances(task.q_start)[0]
    print(f"{task.name}: {len(scene.names)} bodies, {len(scene.pairs)} pairs; {near}")
    for said, constraints in (("without", []), ("avoiding", [Clearance(scene)])):
        controller = QPController(
            cell, task.grasp, task.path, dt=task.dt, constraints=constraints
        )
        run = simulate(controller, q_start=task.q_start, patience=1.0)
        closest = judge.closest(run.q_command, run.time)
        end = "Finished." if run.finished else run.notes[-1].partition(": ")[2]
        print(f"  {said}: {end} Closest: {closest.pair}")
        if constraints:
            verdict = check_run(run, cell, scene=scene)
            kept = "kept" if verdict.ok else "broken"
            print(f"  judged: {kept}, chain {1e3 * verdict.worst.chain_m:.0e} mm")
        body = task.obstacles[0].name
        pairs = [k for k, names in enumerate(scene.built.labels) if body in names]
        distances = judge.over_time(run.q_command[::8], pairs)
        curves.append((body, said, run.time[::8], 1e3 * distances))

# A body closer than its margin at the start is refused by name.
task = plate_and_post()
middle = (task.path.pose(0.0) * task.T_object_body).translation
T_world_lid = pin.SE3(np.eye(3), middle + np.array([0, 0, 0.053]))
lid = Body("lid", Box((0.3, 0.3, 0.05)), T_world_lid)
clearance = Clearance(CollisionScene.of(task, margin=0.02, obstacles=[lid]))
controller = QPController(task.cell, task.grasp, task.path, dt=task.dt, constraints=[clearance])
try:
    controller.reset(task.q_start)
except ValueError as error:
    print(str(error).partition(". ")[0])

if "--out" in sys.argv:
    import matplotlib.pyplot as plt

    figure, panels = plt.subplots(1, 2, figsize=(9, 3.2), sharey=True, layout="constrained")
    for panel, name in zip(panels, ("post", "knob"), strict=True):
        for body, said, times, distances in curves:
            if body == name:
                panel.plot(times, distances, label=said)
        panel.axhline(20, color="grey", ls="--", label="margin")
        panel.set(title=f"distance to the {name}", xlabel="time [s]", ylim=(-5, 60))
    panels[0].set_ylabel("distance [mm]")
    panels[0].legend()
    figure.savefig(Path(sys.argv[sys.argv.index("--out") + 1]) / "nothing_touches.png", dpi=80)
