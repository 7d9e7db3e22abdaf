"""A physics engine, and force monitoring.  python docs/examples/13_physics.py"""

import sys
from pathlib import Path

import numpy as np
import pinocchio as pin

import coopqp
from coopqp.scenarios import paper_lift


def pose(x, y, z, *, yaw=0.0, pitch=0.0):
    """A placement: position [m], turn about y by pitch, then about z by yaw [deg]."""
    R = pin.utils.rotate("z", np.deg2rad(yaw)) @ pin.utils.rotate("y", np.deg2rad(pitch))
    return pin.SE3(R, np.array([x, y, z]))


# 1. The cell of tutorial 2: two arms, a bar between them, a path.
urdf = coopqp.scenarios.robot_path("arm7")
arm = coopqp.Arm.from_urdf("left", urdf, tool_frame="tool", acceleration_limits=10)
right = arm.placed(pose(0.8, 0, 0, yaw=180), name="right")
cell = coopqp.RobotCell([arm.placed(pose(-0.8, 0, 0)), right])
grasp = coopqp.Grasp((pose(-0.3, 0, 0, pitch=150), pose(0.3, 0, 0, yaw=180, pitch=150)))
path = coopqp.LinePath.displaced(
    pose(0, 0, 0.25), translation=(0, 0.1, 0.2), rotation=(0, 0, 0.2), duration=3.0
)
guess = cell.configuration(np.deg2rad([0, 14, 0, 105, 0, 31, 0] * 2))
q_start = coopqp.inverse_kinematics(cell, grasp, path.pose(0.0), guess)

# 2. The same loop on the engine, the bar a body with mass [m, kg]; once as modelled, once
#    with a base that is 1 mm off. The grasp is where the grips really closed.
for what, base in (
    ("as modelled", {}),
    ("right base 1 mm off", {"right": pose(0.001, 0, 0)}),
):
    wrong = coopqp.simulation.Disturbances(base_offset=base)
    bar = {"object_size": (0.6, 0.05, 0.05), "object_mass": 1.2}
    plant = coopqp.simulation.PhysicsPlant(cell, grasp, **bar, disturbances=wrong)
    held = coopqp.Grasp.from_configuration(cell, plant.reset(q_start), nominal=grasp)
    controller = coopqp.QPController(cell, held, path, dt=0.002)
    run = coopqp.simulate(controller, plant, q_start=q_start, settle=0.5)
    # 3. What each arm does to the bar: by the engine, weight included, and by the servos,
    #    without what is fed forward.
    model = coopqp.forces.StressModel(cell, held, stiffness=plant.stiffness)
    read = {
        "engine": plant.wrenches(),
        "servos": model.from_servos(run.q_command[-1], run.q[-1]),
    }
    forces = [
        f"{name} {np.linalg.norm(coopqp.forces.at_tools(w, held)[:, :3], axis=1).round(1)} N"
        for name, w in read.items()
    ]
    print(f"{what}: finished {run.finished}; {', '.join(forces)}")

# 4. The paper's lift: an arm's servos stop at 1.2 s, and the others drag it along.
lift = paper_lift(time_law="quintic")
plant = coopqp.simulation.PhysicsPlant.of(
    lift, disturbances=coopqp.simulation.Disturbances(stall={"slave_1": 1.2})
)


def drag_along(stiffness):
    """The largest force of an arm after each step [N], by servos if there is a stiffness."""
    supervision = coopqp.SupervisionOptions(stiffness=stiffness, force_limit=300.0)
    options = coopqp.QPOptions(supervision=supervision)
    cell = lift.cell.with_limits(acceleration=10.0)
    controller = coopqp.QPController(cell, lift.grasp, lift.path, dt=0.002, options=options)
    q, forces = plant.reset(lift.q_start), []
    controller.reset(q)
    while len(forces) < 1000:
        step = controller.step(q)
        q = plant.apply(step)
        forces.append(np.linalg.norm(plant.wrenches()[:, :3], axis=1).max())
    print(f"{forces[-1]:.0f} N at 2 s; {step.explain()}")
    return forces


without, watched = drag_along(None), drag_along(plant.stiffness)

if "--out" in sys.argv:
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(8, 4), layout="constrained")
    for forces, label in ((without, "stiffness not given"), (watched, "stiffness given")):
        axes.semilogy(0.002 * np.arange(len(forces)), forces, label=label)
    axes.axvline(1.2, color="#b00020", ls="--", lw=1)
    axes.annotate("servos of slave_1 stop", (1.19, 2000), color="#b00020", ha="right")
    axes.set(xlabel="time [s]", ylabel="largest force of an arm on the plate [N]")
    axes.legend()
    figure.savefig(Path(sys.argv[sys.argv.index("--out") + 1]) / "physics.png", dpi=80)
