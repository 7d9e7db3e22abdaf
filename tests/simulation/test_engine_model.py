"""The cell as the engine's model: what its bodies, joints, servos and shapes are made of, number by number."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import coal
import mujoco
import numpy as np
import pinocchio as pin
import pytest
from cells import cart

from coopqp import Arm, Grasp, InvalidInputError, RobotCell
from coopqp.errors import ModelError, UnknownNameError
from coopqp.simulation import Disturbances, PhysicsOptions, PhysicsPlant
from coopqp.simulation.engine import box_payload
from coopqp.spatial import Array

SIZE, MASS = (0.2, 0.4, 0.6), 3.0


def at(*p: float) -> pin.SE3:
    return pin.SE3(np.eye(3), np.array(p))


CELL = RobotCell([cart("left"), cart("right", T_world_base=at(0.0, 1.0, 0.0))])
GRASP = Grasp((at(0.0, -0.5, 0.0), at(0.0, 0.5, 0.0)))


def plant_of(cell: RobotCell = CELL, grasp: Grasp = GRASP, **more: Any) -> PhysicsPlant:
    return PhysicsPlant(cell, grasp, object_size=SIZE, object_mass=MASS, **more)


def matrix(quat: Any) -> Array:
    return np.asarray(pin.Quaternion(*np.asarray(quat).tolist()).toRotationMatrix())


def test_the_object_has_the_mass_and_inertia_of_a_box_where_it_is() -> None:
    T = pin.SE3(pin.exp3(np.array([0.2, -0.5, 0.9])), np.array([0.03, 0.02, -0.01]))
    body = plant_of(T_object_body=T).mj_model.body("object")
    assert body.mass[0] == pytest.approx(MASS)
    np.testing.assert_allclose(body.ipos, T.translation)
    R = matrix(body.iquat)
    x, y, z = SIZE
    box = MASS / 12.0 * np.diag([y * y + z * z, x * x + z * z, x * x + y * y])
    np.testing.assert_allclose(R @ np.diag(body.inertia) @ R.T, T.rotation @ box @ T.rotation.T, atol=1e-12)


def test_joints_have_their_own_kinds_axes_drives_and_servos() -> None:
    options: dict[str, Any] = {
        "stiffness": [1e4, 2e3, 3e4, 4e3],
        "damping": [100.0, 20.0, 300.0, 40.0],
        "armature": [1.0, 2.0, 3.0, 4.0],
    }
    model = plant_of(options=options).mj_model
    for j, name in enumerate(CELL.joint_names):
        joint, actuator = model.joint(name), model.actuator(name)
        slides = name.endswith("rail")
        assert joint.type[0] == (mujoco.mjtJoint.mjJNT_SLIDE if slides else mujoco.mjtJoint.mjJNT_HINGE)
        np.testing.assert_allclose(joint.axis, [1, 0, 0] if slides else [0, 0, 1])
        assert model.dof_armature[joint.dofadr[0]] == options["armature"][j]
        kp, kd = options["stiffness"][j], options["damping"][j]
        assert actuator.gainprm[0] == kp
        np.testing.assert_allclose(actuator.biasprm[:3], [0.0, -kp, -kd])
    assert (model.body_mass[1:] >= 1e-6).all(), "the engine needs masses"
    assert (model.body_inertia[1:] >= 1e-9).all()
    motors = plant_of(options={"servo": "computed torque"}).mj_model
    for name in CELL.joint_names:
        assert motors.actuator(name).gainprm[0] == 1.0
        np.testing.assert_allclose(motors.actuator(name).biasprm[:3], 0.0)


def test_the_stiffness_that_is_told_is_that_of_the_drives(paper: Any) -> None:
    """Of servos kp; of torques ω² times the inertia at each joint, the drives' own included, all joints at zero."""
    given = {"object_size": paper.object_size, "object_mass": 1.0}
    servo = PhysicsPlant(paper.cell, paper.grasp, options={"stiffness": 3e4}, **given)
    np.testing.assert_array_equal(servo.stiffness, np.full(paper.cell.nv, 3e4))
    options = {"servo": "computed torque", "loop_bandwidth": 20.0, "armature": 0.7}
    torque = PhysicsPlant(paper.cell, paper.grasp, options=options, **given)
    model = paper.cell.model
    inertia = np.diag(pin.crba(model, model.createData(), pin.neutral(model))) + 0.7
    np.testing.assert_allclose(torque.stiffness, 400.0 * inertia)
    assert (servo.servoed, torque.servoed) == (True, False)


@pytest.mark.parametrize("size", [(0.0, 1.0, 1.0), (1.0, 1.0, -0.1)])
def test_a_box_has_three_lengths(size: Any) -> None:
    with pytest.raises(InvalidInputError, match="PhysicsPlant: object_size"):
        PhysicsPlant(CELL, GRASP, object_size=size, object_mass=1.0)


def test_the_engine_s_own_settings_are_those_of_the_options() -> None:
    options: dict[str, Any] = {
        "timestep": 0.003, "gravity": (0.1, 0.2, -5.0), "tolerance": 1e-9, "iterations": 17, "weld_solref": (0.01, 0.9),
        "weld_solimp": (0.9, 0.95, 0.002, 0.4, 3.0),
    }  # fmt: skip
    model = plant_of(options=options).mj_model
    assert (model.opt.timestep, model.opt.tolerance, model.opt.iterations) == (0.003, 1e-9, 17)
    np.testing.assert_allclose(model.opt.gravity, options["gravity"])
    np.testing.assert_allclose(model.eq_solref, np.tile(options["weld_solref"], (2, 1)))
    np.testing.assert_allclose(model.eq_solimp, np.tile(options["weld_solimp"], (2, 1)))


@pytest.mark.parametrize(("compensated", "mass"), [(True, 1.0), (True, 0.5), (False, 1.0)])
def test_what_the_drives_carry_of_the_arms_is_what_they_are_told_to(
    make_cell: Callable[..., RobotCell], compensated: bool, mass: float
) -> None:
    """Gravity's torque of the arm by itself, times the mass that they assume; nothing without compensation."""
    cell = make_cell(["rx90l"])
    options = {"gravity_compensation": compensated, "assumed_mass": mass, "load_feed_forward": False, "settle": 0.0}
    plant = plant_of(cell, Grasp((pin.SE3.Identity(),)), options={**options, "hand_over": 0.0})
    q = cell.configuration([0.1, 0.5, 0.7, 0.2, 0.4, 0.3])
    plant.reset(q)
    wanted = mass * compensated * pin.computeGeneralizedGravity(cell.model, cell.model.createData(), q)
    np.testing.assert_allclose(plant.joint_torques - plant.servo_torques, wanted, atol=1e-4)  # the tool's 1 mg


@pytest.mark.parametrize("axis", np.eye(3).tolist())
def test_a_joint_that_turns_and_slides_at_once_is_refused_about_any_axis(axis: list[float]) -> None:
    """One that only turns, or only slides, is not."""
    for kind, refused in (
        (pin.JointModelHelicalUnaligned(np.array(axis), 0.1), True),
        (pin.JointModelRevoluteUnaligned(np.array(axis)), False),
        (pin.JointModelPrismaticUnaligned(np.array(axis)), False),
    ):
        model = pin.Model()
        joint = model.addJoint(0, kind, at(0.0, 0.0, 0.0), "odd")
        model.addFrame(pin.Frame("tool", joint, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
        cell = RobotCell([Arm.from_model("arm", model, tool_frame="tool", velocity_limits=1.0)])
        if refused:
            with pytest.raises(ModelError, match="arm 'arm': joint 'odd' turns and slides at once"):
                plant_of(cell, Grasp((pin.SE3.Identity(),)))
        else:
            found = plant_of(cell, Grasp((pin.SE3.Identity(),))).mj_model.joint("arm/odd")
            np.testing.assert_allclose(found.axis, axis, atol=1e-12)
            assert (found.type[0] == mujoco.mjtJoint.mjJNT_SLIDE) is (
                kind.shortname() == "JointModelPrismaticUnaligned"
            )


def test_arms_that_do_not_hold_at_first_are_open_after_each_reset() -> None:
    """Their grips transmit nothing, and the plant takes the object for held by the others."""
    plant = plant_of(holds=(False, True), options={"settle": 0.02, "hand_over": 0.0})
    for _ in range(2):
        plant.reset(CELL.configuration(np.zeros(4)))
        assert plant.gripped
        wrenches = plant.wrenches()
        assert not wrenches[0].any()
        assert np.abs(wrenches[1]).max() > 1.0
        plant.release()
        assert not plant.gripped
    for holds in ((False, False), (True,), (True,) * 3):
        with pytest.raises(InvalidInputError, match="PhysicsPlant: holds"):
            plant_of(holds=holds)


def test_the_payload_of_a_scenario_is_its_box_with_a_share_of_the_torques(paper: Any) -> None:
    for share in (1.0, 0.5, 2.0):
        payload = box_payload(paper, share)
        np.testing.assert_allclose(payload.limits(paper.cell), share * box_payload(paper).limits(paper.cell))
        box = paper.T_object_body.act(pin.Inertia.FromBox(paper.object_mass, *paper.object_size))
        assert payload.mass == paper.object_mass
        np.testing.assert_allclose(payload.centre, paper.T_object_body.translation, atol=1e-12)
        np.testing.assert_allclose(payload.inertia, box.inertia, atol=1e-12)


def test_primitive_shapes_are_drawn_and_others_left_out() -> None:
    """With their sizes as the engine takes them, their places and their colours; nothing of them touches."""
    model, shapes = CELL.arms[0].model, pin.GeometryModel()
    rng = np.random.default_rng(2)
    made = [
        (coal.Box(0.2, 0.4, 0.6), mujoco.mjtGeom.mjGEOM_BOX, (0.1, 0.2, 0.3)),
        (coal.Sphere(0.3), mujoco.mjtGeom.mjGEOM_SPHERE, (0.3, 0.0, 0.0)),
        (coal.Cylinder(0.1, 0.8), mujoco.mjtGeom.mjGEOM_CYLINDER, (0.1, 0.4, 0.0)),
        (coal.Capsule(0.2, 0.6), mujoco.mjtGeom.mjGEOM_CAPSULE, (0.2, 0.3, 0.0)),
        (coal.Ellipsoid(0.1, 0.2, 0.3), mujoco.mjtGeom.mjGEOM_ELLIPSOID, (0.1, 0.2, 0.3)),
        (coal.Cone(0.1, 0.2), None, ()),
    ]
    for k, (geometry, _, _) in enumerate(made):
        shape = pin.GeometryObject(f"s{k}", 2, 0, pin.exp6(rng.normal(size=6)), geometry)
        shape.parentFrame = model.getFrameId("table")
        shape.meshColor = np.array([0.1 * k, 0.5, 0.25, 1.0])
        shapes.addGeometryObject(shape)
    cell = RobotCell([Arm.from_model("one", model, tool_frame="tool", visual=shapes)])
    found = plant_of(cell, Grasp((pin.SE3.Identity(),))).mj_model
    table = found.body("one/table")
    geoms = [found.geom(g) for g in range(int(table.geomadr[0]), int(table.geomadr[0]) + int(table.geomnum[0]))]
    expected = [(kind, size, item) for (_, kind, size), item in zip(made, shapes.geometryObjects, strict=True) if size]
    assert len(geoms) == len(expected)
    for geom, (kind, size, item) in zip(geoms, expected, strict=True):
        assert geom.type[0] == kind
        np.testing.assert_allclose(geom.size[: len(np.trim_zeros(size))], np.trim_zeros(size))
        np.testing.assert_allclose(geom.pos, item.placement.translation)
        np.testing.assert_allclose(matrix(geom.quat), item.placement.rotation, atol=1e-12)
        np.testing.assert_allclose(geom.rgba, item.meshColor, atol=1e-6)
        assert (geom.contype[0], geom.conaffinity[0]) == (0, 0)


# -- settings ----------------------------------------------------------------------------------------------------------


def options_of(**given: Any) -> PhysicsOptions:
    return PhysicsOptions(**given)


@pytest.mark.parametrize(("settle", "hand_over"), [(0.05, 0.0), (0.0, 0.03), (0.02, 0.05)])
def test_a_reset_settles_and_hands_over_for_as_long_as_told(settle: float, hand_over: float) -> None:
    """Once to move the targets, and once more to come to rest."""
    plant = plant_of(options={"settle": settle, "hand_over": hand_over})
    for _ in range(2):
        plant.reset(CELL.configuration(np.zeros(4)))
        assert plant.mj_data.time == pytest.approx(settle + 2.0 * hand_over)
        assert plant.time == 0.0


def test_after_a_reset_the_servos_aim_at_what_was_measured() -> None:
    """Grips that do not fit pull the carts; a controller then starts where they are, and nothing jumps."""
    off = Grasp((GRASP.T_object_tool[0], at(0.01, 0.5, 0.0)))
    for hand_over in (0.05, 0.0):
        plant = plant_of(real_grasp=off, options={"settle": 0.1, "hand_over": hand_over, "stiffness": 1e5})
        start = CELL.configuration(np.zeros(4))
        measured = plant.reset(start)
        pulled = CELL.positions(measured)
        assert np.abs(pulled).max() > 1e-3
        aim = [plant.mj_data.ctrl[plant.mj_model.actuator(name).id] for name in CELL.joint_names]
        np.testing.assert_allclose(aim, pulled if hand_over else np.zeros(4), atol=1e-12)


def test_an_arm_that_does_not_hold_at_first_feeds_nothing_forward(lift: Any) -> None:
    """Beside its own weight; the others bear all of the object."""
    holds = (True, False, True)
    plant = PhysicsPlant.of(lift, holds=holds, options={"settle": 0.02, "hand_over": 0.0, "load_shares": None})
    plant.reset(lift.q_start)
    model = lift.cell.model
    own = pin.computeGeneralizedGravity(model, model.createData(), lift.cell.configuration(plant.positions))
    more = plant.joint_torques - plant.servo_torques - own
    for s, held in zip(lift.cell.v_slices, holds, strict=True):
        assert bool(np.abs(more[s]).max() > 1.0) is held
        if not held:
            np.testing.assert_allclose(more[s], 0.0, atol=1e-3)


def test_by_default_a_reset_takes_a_second_and_a_half() -> None:
    plant = plant_of()
    plant.reset(CELL.configuration(np.zeros(4)))
    assert plant.mj_data.time == pytest.approx(1.5)


#: Options of torque-controlled drives at the edge of what is steady; what to change, and the rule that it breaks.
EDGES: list[tuple[dict[str, float], str, str]] = [
    ({"loop_bandwidth": 250.0}, "loop_bandwidth", r"max\(1, assumed_mass\) 2 loop_bandwidth timestep is 0\.505"),
    ({"loop_bandwidth": 62.5, "timestep": 0.004}, "timestep", r"2 loop_bandwidth timestep is 0\.505"),
    ({"loop_bandwidth": 125.0, "assumed_mass": 2.0}, "assumed_mass", r"timestep is 0\.505"),
]


@pytest.mark.parametrize(("edge", "name", "said"), EDGES)
def test_torques_that_would_swing_are_refused_and_the_edge_is_not(edge: dict[str, float], name: str, said: str) -> None:
    made = options_of(servo="computed torque", **edge)
    assert made.servo == "computed torque"
    with pytest.raises(InvalidInputError, match=said):
        options_of(servo="computed torque", **{**edge, name: 1.01 * edge[name]})
    options_of(**{**edge, name: 1.01 * edge[name]})


def test_lighter_masses_than_the_real_ones_do_not_make_room_for_a_faster_loop() -> None:
    with pytest.raises(InvalidInputError, match=r"2 loop_bandwidth timestep is 0\.6"):
        options_of(servo="computed torque", loop_bandwidth=300.0, assumed_mass=0.2)


def test_an_observer_has_three_rules() -> None:
    """The loop's rate, too light masses, and the age of the wrenches."""
    observer: dict[str, Any] = {"servo": "disturbance observer"}
    options_of(**observer, loop_bandwidth=200.0, observer_bandwidth=100.0)
    with pytest.raises(InvalidInputError, match=r"\(2 loop_bandwidth \+ observer_bandwidth\) timestep is 0\.51"):
        options_of(**observer, loop_bandwidth=205.0, observer_bandwidth=100.0)
    w, K = 30.0, 40.0
    lightest = K * w / ((2.0 * w + K) * (w + 2.0 * K) * 0.5)
    options_of(**observer, assumed_mass=lightest)
    with pytest.raises(InvalidInputError, match=r"K ω / \(assumed_mass .* is 0\.505, and may be 0\.5"):
        options_of(**observer, assumed_mass=lightest / 1.01)
    options_of(servo="computed torque", assumed_mass=lightest / 1.01)
    sensing = options_of(**observer, wrist_sensors=True)
    sensing.check_rate(0.0115)
    with pytest.raises(InvalidInputError, match=r"observer_bandwidth \(wrench_latency \+ timestep\) is 0\.52"):
        sensing.check_rate(0.012)
    options_of(**observer).check_rate(1.0)
    with pytest.raises(InvalidInputError, match="torques would swing"):
        plant_of(options=sensing, disturbances=Disturbances(wrench_latency=0.02))


def test_options_that_are_no_choice_are_named_with_the_choices() -> None:
    for name, choice in (("interpolation", "cubic"), ("grips", "where they are"), ("servo", "disturbance observer")):
        with pytest.raises(UnknownNameError, match=choice):
            options_of(**{name: "other"})
        assert getattr(options_of(**{name: choice}), name) == choice
    for bad, said in (
        ({"timestep": 0.11}, "timestep"), ({"settle": -0.1}, "settle"), ({"hand_over": -0.1}, "hand_over"),
        ({"tolerance": 0.0}, "tolerance"), ({"gravity": (0.0, 1.0)}, "gravity"), ({"iterations": 0}, "iterations"),
        ({"loop_bandwidth": 0.0}, "loop_bandwidth"), ({"observer_bandwidth": 1.1e4}, "observer_bandwidth"),
        ({"assumed_mass": 0.0}, "assumed_mass"), ({"assumed_payload": -1.0}, "assumed_payload"),
        ({"weld_solimp": (1.0,)}, "weld_solimp"),
    ):  # fmt: skip
        with pytest.raises(InvalidInputError, match=said):
            options_of(**bad)
    assert options_of(assumed_payload=0.0).assumed_payload == 0.0


def test_torque_limits_are_one_for_all_or_one_each(paper: Any) -> None:
    cell = paper.cell
    np.testing.assert_array_equal(options_of(torque_limits=7.0).limits(cell), np.full(cell.nv, 7.0))
    own = np.arange(1.0, cell.nv + 1.0)
    np.testing.assert_array_equal(options_of(torque_limits=own).limits(cell), own)
    model = np.array(cell.model.effortLimit)
    np.testing.assert_array_equal(options_of().limits(cell), np.where(model > 0.0, model, np.inf))
    for bad in (0.0, [1.0, 2.0], -own):
        with pytest.raises(InvalidInputError, match="torque_limits"):
            options_of(torque_limits=bad).limits(cell)


def test_default_servos_run_along_an_arm_of_any_number_of_joints(make_cell: Callable[..., RobotCell]) -> None:
    """Geometrically between the joints of the six-joint table; of prismatic joints those of a slide; of one joint the
    base's.
    """
    kp = np.array([1e5, 1e5, 5e4, 1e4, 1e4, 5e3])
    for robot in ("arm7", "arm5", "rx90l"):
        servos = options_of().servos(make_cell([robot]))
        place = np.linspace(0.0, 5.0, len(servos.stiffness))
        np.testing.assert_allclose(servos.stiffness, np.exp(np.interp(place, np.arange(6.0), np.log(kp))))
        assert (servos.damping[0], servos.damping[-1], servos.armature[0], servos.armature[-1]) == pytest.approx(
            (3160.0, 71.0, 5.0, 0.2)
        )
    carts = options_of().servos(CELL)
    np.testing.assert_allclose(carts.stiffness, [1e6, 5e3] * 2)
    np.testing.assert_allclose(carts.damping, [2e4, 71.0] * 2)
    np.testing.assert_allclose(carts.armature, [20.0, 0.2] * 2)
    one = pin.Model()
    one.addFrame(
        pin.Frame("tool", one.addJoint(0, pin.JointModelRZ(), at(0, 0, 0), "j"), 0, at(1, 0, 0), pin.FrameType.OP_FRAME)
    )
    assert options_of().servos(RobotCell([Arm.from_model("one", one, tool_frame="tool")])).stiffness == 1e5
