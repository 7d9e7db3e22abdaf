"""Examples of the classes of this page: each section is shown at the classes that it names; all are run by a test."""

# %% before
from dataclasses import replace

import numpy as np
import pinocchio as pin

from coopqp import Clearance, CollisionScene, LinePath, QPController, check_path, find_path, find_start, plan
from coopqp.collision import Body, Capsule
from coopqp.scenarios import at_limit, dual_arm7

task = dual_arm7()
cell, grasp = task.cell.with_limits(acceleration=10.0), task.grasp

# %% coopqp.planning.Start, coopqp.planning.ArmStart, coopqp.planning.BranchAlongPath
start = find_start(cell, grasp, task.path)
print(start.explain())
left = start.arms[0]
assert left.chosen.complete  # this branch reaches the end of the path
assert left.chosen in left.branches

# %% coopqp.planning.PathCheck, coopqp.planning.PathVerdict
from coopqp.planning import PathVerdict

check = check_path(cell, grasp, task.path, q_start=task.q_start)
assert check.feasible
assert check.verdict is PathVerdict.CERTIFIED

# %% coopqp.planning.ArmCheck, coopqp.planning.BranchCheck
arm = check.arms[0]
print(arm.arm, f"margin {np.rad2deg(arm.chosen.margins.min()):.0f}°, σ_min {arm.chosen.sigma_min.min():.3f}")

# %% coopqp.planning.UndecidedInterval
for interval in check.intervals:  # empty where all is decided
    print(interval.arm, interval.start, interval.end)

# %% coopqp.planning.ClearanceCheck
post = Body("post", Capsule(0.03, 0.3), pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.15])))
scene = CollisionScene.of(replace(task, cell=cell), obstacles=[post])
near, far = (pin.SE3(np.eye(3), np.array([0.0, y, 0.3])) for y in (-0.15, 0.15))
blocked = check_path(cell, grasp, LinePath(near, far, duration=3.0), scene=scene)
print(blocked.clearance.explain())

# %% coopqp.planning.Remedy
from coopqp.planning import find_remedies

trouble = at_limit()
answer = find_remedies(check_path(trouble.cell, trouble.grasp, trouble.path, q_start=trouble.q_start))
for remedy in answer:
    print(remedy.kind, remedy.text)

# %% coopqp.planning.Plan
fastest = plan(cell, grasp, task.path, q_start=task.q_start)
print(fastest.explain())
controller = QPController(cell, grasp, fastest.path, dt=0.002)
controller.reset(fastest.q_start)

# %% coopqp.planning.Route, coopqp.planning.RouteVerdict
from coopqp.planning import RouteVerdict

route = find_path(cell, grasp, near, far, scene, nodes=1000)
assert route.verdict is RouteVerdict.FOUND
print(f"{route.length:.2f} m, {route.timed().path.duration:.2f} s")

# %% coopqp.planning.TurnedGoal, coopqp.planning.FreeTurn
from coopqp.planning import FreeTurn, TurnedGoal

turned = TurnedGoal(far, [FreeTurn("rx", -0.3, 0.3)])  # any turn about the bar's x axis will do

# %% coopqp.planning.ArmGoal
from coopqp.planning import ArmGoal

goal = ArmGoal("right", route.joints[-1][cell.v_slices[1]])

# %% coopqp.Replanner
from coopqp import Replanner

timed = route.timed()
controller = QPController(cell, grasp, timed.path, dt=0.002, constraints=[Clearance(scene)])
controller.reset(timed.q_start)
replanner = Replanner(controller, scene)  # searches beside the loop when the way is closed
replanner.close()

# %% coopqp.planning.Payload
from coopqp.planning import Payload

loaded = plan(cell, grasp, task.path, q_start=task.q_start, payload=Payload(mass=1.2))

# %% coopqp.planning.Search
from coopqp import Phase
from coopqp.planning import Search

around = Phase("around", path=Search(far, scene, speed=0.2, start=near))  # the way is found when the program is built
