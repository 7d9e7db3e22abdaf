"""Examples of the classes of this page: each section is shown at the classes that it names; all are run by a test."""

# %% before
import numpy as np

from coopqp import QPController, simulate
from coopqp.scenarios import dual_arm7

task = dual_arm7()

# %% coopqp.VelocityConstraint, coopqp.Rank
from coopqp import Rank


class SlowElbow:
    """Rows J, low, high on the joint velocities, at each step: here on one joint of the left arm [rad/s]."""

    name, rank = "slow elbow", Rank.LIMITS

    def rows(self, state, dt):
        J = np.zeros((1, state.cell.nv))
        J[0, 3] = 1.0
        return J, np.array([-0.1]), np.array([0.1])


controller = QPController(task.cell, task.grasp, task.path, dt=0.01, constraints=[SlowElbow()])
run = simulate(controller, q_start=task.q_start, duration=1.0)
assert np.abs(run.velocity[:, 3]).max() <= 0.1 + 1e-9


# %% coopqp.RateBound, coopqp.Knot
class Gentle:
    """At most 0.3 rad/s for each joint along the path, from its slope dq/ds at a grid point ahead."""

    name = "gentle"

    def lines(self, knot):
        slope = np.abs(knot.slope).max()
        return np.array([slope**2]), np.zeros(1), np.array([0.3**2])  # a z + b σ̇ ≤ c, z = σ²


controller = QPController(task.cell, task.grasp, task.path, dt=0.01, constraints=[Gentle()])

# %% coopqp.control.StallBound
from coopqp.control import StallBound

stall = StallBound(0.002, dt=0.01)  # an arm that does not move draws the others by no more than 2 mm
controller = QPController(task.cell, task.grasp, task.path, dt=0.01, constraints=[stall])
