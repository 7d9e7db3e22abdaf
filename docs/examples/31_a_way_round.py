"""Over a post: a way round, for all arms at once, with its proof.

python docs/examples/31_a_way_round.py [--out FOLDER]
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin

from coopqp import (
    Clearance,
    CollisionScene,
    LinePath,
    QPController,
    Replanner,
    check_path,
    find_path,
    inverse_kinematics,
    simulate,
)
from coopqp.collision import Body, Capsule
from coopqp.planning import ArmGoal, FreeTurn, TurnedGoal
from coopqp.scenarios import dual_arm7

# Two seven-joint arms carry a bar to the other side of a post.
task = dual_arm7()
cell, grasp = task.cell.with_limits(acceleration=10.0), task.grasp
start, goal = (pin.SE3(np.eye(3), np.array([0.0, y, 0.3])) for y in (-0.15, 0.15))
post = Body("post", Capsule(0.03, 0.3), pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.15])))
scene = CollisionScene.of(replace(task, cell=cell), obstacles=[post])  # keeps 10 mm
q_start = inverse_kinematics(cell, grasp, start, task.q_start)

line = LinePath(start, goal, duration=3.0)
straight = check_path(cell, grasp, line, q_start=q_start, scene=scene)
print("straight:", straight.clearance.explain())

# nodes ends the search: the same seed then finds the same way again.
route = find_path(cell, grasp, start, goal, scene, q_start=q_start, nodes=1000)
print(route.verdict.value, route.check.verdict.value)
print(route.check.clearance.explain())

# The fastest motion along it, and a run.
planned = route.timed()
print(f"{planned.path.duration:.2f} s from rest to rest")
controller = QPController(cell, grasp, planned.path, dt=0.002)
run = simulate(controller, q_start=planned.q_start)
print("finished:", run.finished)

# Other goals: a pose with a free turn, and the joint positions of one arm.
turned = TurnedGoal(goal, [FreeTurn("rx", -0.3, 0.3)])
at_goal = route.joints[-1][cell.v_slices[1]]
for other in (turned, ArmGoal("right", at_goal)):
    found = find_path(cell, grasp, start, other, scene, q_start=q_start, nodes=1000)
    print(type(other).__name__, found.verdict.value)

# What is impossible is named; what is not found is not denied.
high = pin.SE3(goal.rotation, goal.translation + np.array([0, 0, 2.0]))
print(find_path(cell, grasp, start, high, scene, q_start=q_start).reason)

# A body that comes into the way in motion: the object goes round it, without a stop.
below, inside = (pin.SE3(np.eye(3), np.array([0.0, 0.0, z])) for z in (-2.0, 0.15))
cart = Body("cart", Capsule(0.03, 0.3), below)
scene = CollisionScene.of(replace(task, cell=cell), moving=[cart])
line = LinePath(start, goal, duration=2.0)
controller = QPController(cell, grasp, line, dt=0.002, constraints=[Clearance(scene)])
replanner = Replanner(controller, scene, simulated=True)


def move(_, step):
    replanner.move("cart", inside if step >= 200 else below)


run = simulate(controller, q_start=q_start, operate=move, observe=replanner.watch)
print("went round:", replanner.found == 1, "finished:", run.finished)

if "--out" in sys.argv:
    from coopqp.visualization import route_figure

    figure = route_figure(route, azimuth=65.0, elevation=25.0)
    figure.savefig(Path(sys.argv[sys.argv.index("--out") + 1]) / "way_round.png", dpi=90)
