"""Constraints of your own: walls, a slow elbow.  python docs/examples/16_constraints.py"""

import sys
from pathlib import Path

import numpy as np
import pinocchio as pin

from coopqp import QPController, Rank, simulate
from coopqp.scenarios import paper_lift
from coopqp.spatial import adjoint

g = 1.618  # AXES: through the corners of an icosahedron
AXES = np.array([[0, 1, g], [0, 1, -g], [1, g, 0], [1, -g, 0], [g, 0, 1], [-g, 0, 1]]) / 1.902


def object_jacobian(grasp, state):
    """Twist of the object in its own frame, as the first arm carries it (6, nv)."""
    J = np.zeros((6, state.cell.nv))
    J[:, state.cell.v_slices[0]] = adjoint(grasp.T_object_tool[0]) @ state.jacobian(0)
    return J


class Box:  # a VelocityConstraint
    name, rank = "box", Rank.LIMITS

    def __init__(self, grasp, low, high, braking=1.0):  # two corners [m], braking [m/s²]
        self.grasp, self.a = grasp, braking
        self.low, self.high = np.array(low), np.array(high)

    def rows(self, state, dt):
        T = self.grasp.carried(state)[0]
        J, p = T.rotation @ object_jacobian(self.grasp, state)[:3], T.translation
        return J, -self.speed(p - self.low, dt), self.speed(self.high - p, dt)

    def speed(self, distance, dt):  # from which the object can stop: v dt + v²/(2 a) = distance
        return np.sqrt((self.a * dt) ** 2 + 2 * self.a * np.maximum(distance, 0)) - self.a * dt


class SlowPoint:  # a VelocityConstraint
    rank = Rank.LIMITS

    def __init__(self, cell, frame, speed):  # a frame of the cell's model [m/s]
        self.name, self.speed = f"speed of {frame}", speed
        self.model, self.data = cell.model, cell.model.createData()
        self.frame = cell.model.getFrameId(frame)

    def rows(self, state, dt):
        axes = pin.LOCAL_WORLD_ALIGNED
        J = pin.computeFrameJacobian(self.model, self.data, state.q, self.frame, axes)
        bound = np.full(6, 0.7947 * self.speed)  # this polyhedron's corners are at the speed
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
    cell = lift.cell.with_limits(acceleration=5.0)
    top = lift.path.pose(0.0).translation[2] + 0.2
    box = Box(lift.grasp, (-np.inf, -np.inf, -np.inf), (np.inf, np.inf, top))
    slow = SlowPoint(cell, "slave_1/joint_3", 0.03)
    little = LittleEnergy(lift.grasp, 9.0, 0.05)
    runs = {}
    for constraint in (box, slow, little):
        own = {"constraints": [constraint]}
        controller = QPController(cell, lift.grasp, lift.path, dt=0.005, **own)
        run = simulate(controller, q_start=lift.q_start, duration=6.0)
        notes = "\n  ".join(run.notes[-2:])
        print(f"{constraint.name}: after {run.time[-1]:.3g} s\n  {notes}")
        runs[constraint.name] = run

    if "--out" in sys.argv:
        import matplotlib.pyplot as plt

        figure, axes = plt.subplots(figsize=(8, 4), layout="constrained")
        for name, run in runs.items():
            axes.plot(run.clock[:-1], run.rate, label=name)
        axes.set(xlabel="clock of the path [s]", ylabel="rate σ of the object")
        axes.legend()
        out = Path(sys.argv[sys.argv.index("--out") + 1])
        figure.savefig(out / "constraints.png", dpi=80)
