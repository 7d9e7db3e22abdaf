"""Examples of the classes of this page: each section is shown at the classes that it names; all are run by a test."""

# %% before
import numpy as np
import pinocchio as pin

from coopqp import QPController
from coopqp.scenarios import dual_arm7

task = dual_arm7()

# %% coopqp.collision.Body, coopqp.collision.Capsule
from coopqp.collision import Body, Capsule

post = Body("post", Capsule(0.03, 0.3), pin.SE3(np.eye(3), np.array([0.0, 0.4, 0.15])))

# %% coopqp.collision.Box, coopqp.collision.Sphere, coopqp.collision.Cylinder
from coopqp.collision import Box, Cylinder, Sphere

table = Body("table", Box((1.0, 0.6, 0.05)), pin.SE3(np.eye(3), np.array([0.0, 1.0, 0.0])))
ball = Body("ball", Sphere(0.05), pin.SE3(np.eye(3), np.array([0.0, 1.0, 0.2])))
can = Body("can", Cylinder(0.04, 0.12), pin.SE3(np.eye(3), np.array([0.2, 1.0, 0.2])))

# %% coopqp.collision.Hull
from coopqp.collision import Hull

wedge = Body("wedge", Hull(np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]])), table.placement)

# %% coopqp.collision.Mesh
from coopqp.collision import Mesh

with open("part.obj", "w") as file:
    file.write("v 0 0 0\nv 100 0 0\nv 0 100 0\nv 0 0 100\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
part = Mesh("part.obj", scale=(1e-3, 1e-3, 1e-3))  # its hull; the file is in millimetres

# %% coopqp.CollisionScene
from coopqp import CollisionScene

scene = CollisionScene.of(task, obstacles=[post, table], margin=0.02)
assert "post" in scene.names

# %% coopqp.collision.PairRules
from coopqp.collision import PairRules

nearer = CollisionScene.of(task, obstacles=[post], rules=PairRules(apart=4))  # links of one arm

# %% coopqp.collision.NearPair
nearest = min(scene.distances(task.q_start), key=lambda pair: pair.distance)
print(nearest.first, nearest.second, f"{1e3 * nearest.distance:.0f} mm")

# %% coopqp.Clearance
from coopqp import Clearance

controller = QPController(task.cell, task.grasp, task.path, dt=task.dt, constraints=[Clearance(scene)])
controller.reset(task.q_start)
step = controller.step()
