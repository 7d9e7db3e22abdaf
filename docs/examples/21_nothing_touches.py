"""Keep clear of a post; elbows evade a knob.  python docs/examples/21_nothing_touches.py [--out FOLDER]"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pinocchio as pin

from coopqp import Closeness, QPController, check_run, simulate
from coopqp.collision import Body, Box, Clearance, CollisionScene, Sphere
from coopqp.scenarios import elbow_and_knob, plate_and_post

figure, axes = plt.subplots(1, 2, figsize=(9.0, 3.2), sharey=True, layout="constrained")
for task, axis in ((plate_and_post(), axes[0]), (elbow_and_knob(), axes[1])):
    cell = task.cell.with_limits(acceleration=5.0)
    scene = CollisionScene.of(task, cell=cell, margin=0.02)  # 20 mm
    judge = Closeness(scene)  # distances by another way than the controller's
    body = task.obstacles[0].name
    pairs = [k for k, names in enumerate(scene.built.labels) if body in names]
    print(f"{task.name}: {len(scene.names)} bodies, {len(scene.pairs)} pairs; {scene.distances(task.q_start)[0]}")
    for said, constraints in (("without", []), ("avoiding", [Clearance(scene)])):
        controller = QPController(cell, task.grasp, task.path, dt=task.dt, constraints=constraints)
        run = simulate(controller, q_start=task.q_start, patience=1.0)
        closest = judge.closest(run.q_command, run.time)
        end = "finished" if run.finished else run.notes[-1].partition(": ")[2]
        print(f"  {said}: {end}{'' if end.endswith('.') else '.'} Closest: {closest.pair}")
        axis.plot(run.time[::8], 1e3 * judge.over_time(run.q_command[::8], pairs), label=said)
        if constraints:
            verdict = check_run(run, cell, scene=scene)
            print(f"  judged: {str(verdict).partition(':')[0]}, chain {1e3 * verdict.worst.chain_m:.0e} mm")
    axis.axhline(20.0, color="grey", linestyle="--", label="margin")
    axis.set(title=f"distance to the {body}", xlabel="time [s]", ylim=(-5, 60))
axes[0].set_ylabel("distance [mm]")
axes[0].legend()
if "--out" in sys.argv:
    figure.savefig(Path(sys.argv[-1]) / "nothing_touches.png", dpi=120)

task = plate_and_post()  # a body of one's own, closer than its margin at the start
middle = (task.path.pose(0.0) * task.T_object_body).translation
lid = Body("lid", Box((0.3, 0.3, 0.05)), pin.SE3(np.eye(3), middle + np.array([0, 0, 0.053])))
ball = Body("ball", Sphere(0.1), pin.SE3(np.eye(3), np.array([9.0, 0.0, 0.0])))
scene = CollisionScene.of(task, margin=0.02, obstacles=[lid, ball])
try:
    QPController(task.cell, task.grasp, task.path, dt=task.dt, constraints=[Clearance(scene)]).reset(task.q_start)
except ValueError as error:
    print(str(error).partition(". ")[0])
