"""Your own cell in a physics engine: its forces, read in two ways, and a watch.  python docs/examples/13_physics.py"""

import numpy as np
import pinocchio as pin

import coopqp
from coopqp.scenarios import paper_lift


def pose(x, y, z, *, yaw=0.0, pitch=0.0):
    """A placement from a position [m] and angles [deg]: turn about y by pitch, then about z by yaw."""
    R = pin.utils.rotate("z", np.deg2rad(yaw)) @ pin.utils.rotate("y", np.deg2rad(pitch))
    return pin.SE3(R, np.array([x, y, z]))


# 1. The cell of tutorial 2: two arms, a bar between them, a path.
arm = coopqp.Arm.from_urdf("left", coopqp.robot_path("arm7"), tool_frame="tool", acceleration_limits=10)
cell = coopqp.RobotCell([arm.placed(pose(-0.8, 0, 0)), arm.placed(pose(0.8, 0, 0, yaw=180), name="right")])
grasp = coopqp.Grasp((pose(-0.3, 0, 0, pitch=150), pose(0.3, 0, 0, yaw=180, pitch=150)))
path = coopqp.LinePath.displaced(pose(0, 0, 0.25), translation=(0, 0.1, 0.2), rotation=(0, 0, 0.2), duration=3.0)
guess = cell.configuration(np.deg2rad([0, 14, 0, 105, 0, 31, 0] * 2))
q_start = coopqp.inverse_kinematics(cell, grasp, path.pose(0.0), guess)

# 2. The same loop on the engine, the bar a body with mass; once as modelled, once with a base that is 1 mm off.
for what, base in (("as modelled", {}), ("right base 1 mm off", {"right": pose(0.001, 0, 0)})):
    plant = coopqp.PhysicsPlant(
        cell,
        grasp,
        object_size=(0.6, 0.05, 0.05),  # [m]
        object_mass=1.2,  # [kg]
        disturbances=coopqp.Disturbances(base_offset=base),
    )
    held = coopqp.Grasp.from_configuration(cell, plant.reset(q_start), nominal=grasp)  # where the grips really closed
    controller = coopqp.QPController(cell, held, path, dt=0.002)
    run = coopqp.simulate(controller, plant, q_start=q_start, settle=0.5)
    # 3. What each arm does to the bar: by the engine, weight included, and by the servos, without what is fed forward.
    servos = coopqp.StressModel(cell, held, stiffness=plant.stiffness).from_servos(run.q_command[-1], run.q[-1])
    by_engine, by_servos = (np.linalg.norm(coopqp.at_tools(w, held)[:, :3], axis=1) for w in (plant.wrenches(), servos))
    print(f"{what}: finished {run.finished}; engine {by_engine.round(1)} N, servos {by_servos.round(1)} N")

# 4. The paper's lift: an arm's servos stop at 1.2 s, and the others drag it along. Without and with a watch on forces.
lift = paper_lift(time_law="quintic")
plant = coopqp.PhysicsPlant.of(lift, disturbances=coopqp.Disturbances(stall={"slave_1": 1.2}))
for stiffness in (None, plant.stiffness):
    supervision = coopqp.SupervisionOptions(stiffness=stiffness, force_limit=300.0)  # [N]
    options = coopqp.QPOptions(supervision=supervision)
    cell = lift.cell.with_limits(acceleration=10.0)
    controller = coopqp.QPController(cell, lift.grasp, lift.path, dt=0.002, options=options)
    steps = []
    coopqp.simulate(controller, plant, q_start=lift.q_start, duration=2.0, observe=steps.append)
    force = np.linalg.norm(plant.wrenches()[:, :3], axis=1).max()
    print(f"{force:.0f} N at 2 s; {steps[-1].explain()}")
