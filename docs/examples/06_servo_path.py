"""Follow a target that moves while the arms run.  python docs/examples/06_servo_path.py"""

import numpy as np
import pinocchio as pin

from coopqp import QPController, ServoPath, chain_error, object_error, tool_placements
from coopqp.scenarios import paper_lift

lift = paper_lift()
start = lift.path.pose(0.0)
controller = QPController(lift.cell, lift.grasp, ServoPath(start, speed=0.1, spin=0.3), dt=0.002)
controller.reset(lift.q_start)

targets = {0: (0.0, 0.0, 0.10), 500: (0.0, 0.05, 0.15)}  # at which tick, how far from the start [m]
worst = 0.0
for tick in range(1500):
    if tick in targets:
        target = pin.SE3(start.rotation, start.translation + np.array(targets[tick]))
        controller.retarget(target)  # on a straight line from where the object is now
    step = controller.step()
    tools = tool_placements(lift.cell, [step.q_next])[0]
    worst = max(worst, chain_error(tools, lift.grasp)[0])
away = object_error(tools, lift.grasp, target)[0]
print(f"the arms agree to {1e3 * worst:.1e} mm; {1e3 * away:.1e} mm remain to the target")
