"""Constraints of your own: walls, a slow elbow, little energy.  python docs/examples/16_constraints.py"""

import numpy as np
import pinocchio as pin

from coopqp import QPController, Rank, adjoint, simulate
from coopqp.scenarios import paper_lift

AXES = np.array([[0, 1, 1.618], [0, 1, -1.618], [1, 1.618, 0], [1, -1.618, 0], [1.618, 0, 1], [-1.618, 0, 1]]) / 1.902


def object_jacobian(grasp, state):
    """Twist of the object in its own frame per joint velocity, as the first arm carries it (6, nv)."""
    J = np.zeros((6, state.cell.nv))
    J[:, state.cell.v_slices[0]] = adjoint(grasp.T_object_tool[0]) @ state.jacobian(0)
    return J


class Box:  # a VelocityConstraint
    name, rank = "box", Rank.LIMITS

    def __init__(self, grasp, low, high, deceleration=1.0):  # two corners [m], braking [m/s²]
        self.grasp, self.low, self.high, self.a = grasp, np.array(low), np.array(high), deceleration

    def rows(self, state, dt):
        T = self.grasp.carried(state)[0]
        J, p = T.rotation @ object_jacobian(self.grasp, state)[:3], T.translation
        return J, -self.speed(p - self.low, dt), self.speed(self.high - p, dt)

    def speed(self, room, dt):  # from which the object can stop: v dt + v²/(2 a) = room
        return np.sqrt((self.a * dt) ** 2 + 2 * self.a * np.maximum(room, 0)) - self.a * dt


class SlowPoint:  # a VelocityConstraint
    rank = Rank.LIMITS

    def __init__(self, cell, frame, speed):  # a frame of the cell's model [m/s]
        self.name, self.speed = f"speed of {frame}", speed
        self.model, self.data, self.frame = cell.model, cell.model.createData(), cell.model.getFrameId(frame)

    def rows(self, state, dt):
        J = pin.computeFrameJacobian(self.model, self.data, state.q, self.frame, pin.LOCAL_WORLD_ALIGNED)
        bound = np.full(6, 0.7947 * self.speed)  # the corners of this polyhedron are at the speed
        return AXES @ J[:3], -bound, bound


class LittleEnergy:  # a RateBound
    name = "energy"

    def __init__(self, grasp, mass, energy):  # [kg], [J]
        self.grasp, self.mass, self.energy = grasp, mass, energy

    def lines(self, knot):
        v = object_jacobian(self.grasp, knot.state)[:3] @ knot.slope
        return 0.5 * self.mass * v @ v, 0.0, self.energy  # ½ m v² σ² ≤ energy


if __name__ == "__main__":
    lift = paper_lift(time_law="quintic")
    cell, top = lift.cell.with_limits(acceleration=5.0), lift.path.pose(0.0).translation[2] + 0.2
    box = Box(lift.grasp, (-np.inf, -np.inf, -np.inf), (np.inf, np.inf, top))
    for constraint in (box, SlowPoint(cell, "slave_1/joint_3", 0.03), LittleEnergy(lift.grasp, 9.0, 0.05)):
        controller = QPController(cell, lift.grasp, lift.path, dt=0.005, constraints=[constraint])
        run = simulate(controller, q_start=lift.q_start, duration=6.0)
        print(f"{constraint.name}: after {run.time[-1]:.3g} s", *run.notes[-2:], sep="\n  ")
