"""A step of the controller at its shortest: three arms lift a plate, faster than they can.

It has the closed chain, velocity bounds, the priority levels, and corrects what linearisations
miss. It has no look-ahead: it slows down at limits, not ahead of them. See docs/derivations.md.
"""

import numpy as np
import pinocchio as pin
import qpsolvers

from coopqp import LinePath, QPController, QPOptions
from coopqp.scenarios import paper_lift

lift, dt, gain = paper_lift(), 0.01, 20.0
cell = lift.cell.with_limits(acceleration=3.0)
path = LinePath(lift.path.start, lift.path.goal, duration=1.5)
model, data, limits, arms = cell.model, cell.model.createData(), cell.limits, range(len(cell))


def carried(q):
    """O_k: the object in the world, as each arm carries it."""
    pin.framesForwardKinematics(model, data, q)
    return [data.oMf[cell.tool_frames[k]] * lift.grasp.T_object_tool[k].inverse() for k in arms]


def inverses(q, R):
    """A_k⁻¹: from the object's twist, about R's origin in its axes, to arm k's joints."""
    found, axes = [], np.kron(np.eye(2), R.rotation.T)
    pin.computeJointJacobians(model, data, q)
    pin.updateFramePlacements(model, data)
    for frame, own in zip(cell.tool_frames, cell.v_slices, strict=True):
        J = pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED)[:, own]
        J[:3] -= pin.skew(R.translation - data.oMf[frame].translation) @ J[3:]
        found.append(np.linalg.inv(axes @ J))
    return found


def bounds(q, v):
    """l ≤ v ≤ u: speed limits, braking distances, and what accelerations make of the last v."""
    change = limits.acceleration * dt

    def stopping(way):
        braking = np.sqrt(change**2 + 2.0 * limits.acceleration * np.maximum(way, 0.0)) - change
        return np.minimum(limits.velocity, braking)

    lower, upper = -stopping(q - limits.lower), stopping(limits.upper - q)
    return np.clip(lower, v - change, v + change), np.clip(upper, v - change, v + change)


def least_given_up(fixed, columns, lower, upper):
    """x = [s, 1 − σ, 1 − ρ_g, 1 − ρ_p] of least cost with lower ≤ fixed + columns x ≤ upper."""
    costs = np.array([1e4] * 3 + [900.0] * 3 + [1e-4, 1.0, 1e-2])  # the levels, far apart
    units = 1.0 / np.sqrt(costs)  # in which the QP asks for the admissible point next to 0
    G, h = np.vstack([columns, -columns]) * units, np.append(upper - fixed, fixed - lower)
    lb, ub = (
        np.append(np.full(6, -np.inf), np.zeros(3)),
        np.append(np.full(6, np.inf), 1.0 / units[6:]),
    )
    x = qpsolvers.solve_qp(
        np.eye(9), np.zeros(9), G, h, lb=lb, ub=ub, solver="daqp", primal_tol=1e-9
    )
    assert x is not None, "only apart could the arms go on: the controller has further attempts"
    return units * x


def step(q, v, v_before, clock, expected):
    """The command, σ, and the errors expected next; from q, the last two commands and τ."""
    R = path.pose(clock)
    e = np.array([pin.log6(R.actInv(O)).vector for O in carried(q)])  # e[0]: of the object
    h = min(dt, path.duration - clock)
    nu = np.tile(pin.log6(R.actInv(path.pose(clock + h))).vector / h, (len(cell), 1))
    c_g, c_p = gain * (e[0] - e), np.tile(-gain * e[0], (len(cell), 1))
    b = (
        0.0 * e if expected is None else (expected - e) / dt
    )  # linearisations miss it, and it changes slowly
    A_inverse = inverses(
        pin.integrate(model, q, 0.5 * dt * (2.0 * v - v_before)), R
    )  # midpoint

    def joints(twists):
        return np.concatenate([A @ twist for A, twist in zip(A_inverse, twists, strict=True)])

    off_path = [joints(np.tile(axis, (len(cell), 1))) for axis in np.eye(6)]
    columns = np.column_stack([*off_path, -joints(nu), -joints(c_g), -joints(c_p)])
    x = least_given_up(joints(nu + c_g + c_p + b), columns, *bounds(q, v))
    s, (rate, rho_g, rho_p) = x[:6], 1.0 - x[6:]
    made = s + rho_g * c_g + rho_p * c_p + b
    return joints(made + rate * nu), rate, e + dt * made


controller = QPController(cell, lift.grasp, path, dt=dt, options=QPOptions(preview=None))
controller.reset(lift.q_start)
q, v, v_before, clock, expected = lift.q_start, np.zeros(cell.nv), np.zeros(cell.nv), 0.0, None
apart = beside = 0.0
while clock < path.duration - 1e-9:
    command, rate, expected = step(q, v, v_before, clock, expected)
    q, v, v_before, clock = pin.integrate(model, q, dt * command), command, v, clock + dt * rate
    places = np.array([O.translation for O in carried(q)])
    apart = max(apart, np.linalg.norm(places - places[0], axis=1).max())
    beside = max(beside, np.abs(q - controller.step().q_next).max())
print(f"arms apart by {1e6 * apart:.1f} µm at most")
print(f"joints {1e6 * beside:.2f} µrad beside those of the controller")
