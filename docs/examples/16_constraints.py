"""Constraints of your own: a ceiling, and a speed limit of an elbow.  python docs/examples/16_constraints.py"""

import numpy as np
import pinocchio as pin

from coopqp import CellState, Grasp, QPController, Rank
from coopqp.scenarios import paper_lift


class Box:
    """Keeps the object's origin inside a box of the world [m]."""

    name, rank = "ceiling", Rank.LIMITS

    def __init__(self, grasp: Grasp, low, high) -> None:
        self.X, self.low, self.high = grasp.T_object_tool[0].inverse(), np.array(low), np.array(high)

    def rows(self, state: CellState, dt: float):
        T = state.T_world_tool[0] * self.X  # the object as the first arm holds it
        J = state.jacobian(0, pin.WORLD)
        G = np.zeros((3, state.cell.nv))
        G[:, state.cell.v_slices[0]] = J[:3] - pin.skew(T.translation) @ J[3:]  # velocity of the origin
        return G, (self.low - T.translation) / dt, (self.high - T.translation) / dt


class ElbowSpeed:
    """Keeps a frame of one arm slower than a speed [m/s]: each component below its share of it."""

    name, rank = "elbow", Rank.LIMITS

    def __init__(self, frame: str, speed: float) -> None:
        self.frame, self.most = frame, speed / np.sqrt(3.0)

    def rows(self, state: CellState, dt: float):
        model = state.cell.model
        frame = model.getFrameId(self.frame)
        G = pin.computeFrameJacobian(model, model.createData(), state.q, frame, pin.LOCAL_WORLD_ALIGNED)[:3]
        return G, np.full(3, -self.most), np.full(3, self.most)


lift = paper_lift(duration=1.0)
top = lift.path.pose(0.0).translation[2] + 0.2
constraints = [Box(lift.grasp, [-9, -9, -9], [9, 9, top]), ElbowSpeed("slave_1/joint_4", 0.15)]
cell = lift.cell.with_limits(acceleration=10.0)
controller = QPController(cell, lift.grasp, lift.path, dt=0.002, constraints=constraints)
controller.reset(lift.q_start)
said = ""
for i in range(1500):
    step = controller.step()
    if step.explain().partition(" at ")[0] != said:
        said = step.explain().partition(" at ")[0]
        print(f"{0.002 * i:.3f} s {step.explain()}")
height = lift.grasp.carried(CellState(cell, step.q_next))[0].translation[2]
print(f"The plate rests {1e6 * (top - height):.3f} µm below its ceiling.")
