"""A start from which the arms can follow the whole path.  python docs/examples/15_find_a_start.py"""

import numpy as np
import pinocchio as pin

from coopqp import Arm, Grasp, LinePath, NoStartError, QPController, RobotCell, robot_path, simulate
from coopqp.planning import find_start

# Two arms face each other and hold a bar. A cable lets joints 4 and 6 of the left one turn by ±100° only.
DOWN = np.diag([1.0, -1.0, -1.0])
grip = {"left": pin.SE3(DOWN, np.array([-0.4, 0, 0])), "right": pin.SE3(DOWN, np.array([0.4, 0, 0]))}
arms = []
for name, x, yaw in (("left", -1.1, 0.0), ("right", 1.1, np.pi)):
    base = pin.SE3(pin.utils.rotate("z", yaw), np.array([x, 0, 0]))
    arms.append(Arm.from_urdf(name, robot_path("rx90l"), tool_frame="flange", T_world_base=base))
lower, upper = arms[0].limits.lower.copy(), arms[0].limits.upper.copy()
lower[[3, 5]], upper[[3, 5]] = np.deg2rad([[-100], [100]])
arms[0] = arms[0].with_limits(lower=lower, upper=upper)
cell, grasp = RobotCell(arms), Grasp(tuple(grip.values()))
start = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.5]))
path = LinePath.displaced(start, translation=(0.0, 0.2, 0.2), rotation=(0.0, 0.0, 0.3), duration=3.0)

try:
    find_start(cell, grasp, path)
except NoStartError as error:
    print(error)

found = find_start(cell, grasp, path, free_roll={"left": [np.pi]})
print(found.explain())
controller = QPController(cell, found.grasp, path, dt=0.01)
print("finished:", simulate(controller, q_start=found.q).finished)
