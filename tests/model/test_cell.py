"""Arms and cells keep kinematics, limits and names, leave the user's models unchanged, and refuse bad models."""

from __future__ import annotations

import contextlib
import gc
import hashlib
import weakref
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from cells import rx90l
from hypothesis import given, strategies as st
from numpy.typing import NDArray

import coopqp.model.arm
from coopqp import (
    Arm,
    CoopqpError,
    Grasp,
    HoldPath,
    InvalidInputError,
    JointLimits,
    QPController,
    RobotCell,
)
from coopqp.errors import ModelError, UnknownNameError
from coopqp.model import CellState
from coopqp.model.cell import of_cell, slides, standing
from coopqp.model.tool_guess import guess_tool
from coopqp.scenarios import ROBOT_NAMES, ROBOTS, robot_path

Array = NDArray[np.float64]

#: A base where no other arm stands.
BESIDE = pin.SE3(np.eye(3), np.array([0.0, 3.0, 0.0])).homogeneous
LIMIT = '<limit lower="-1" upper="1" velocity="2" effort="1"/>'
TWO_JOINTS = """<robot name="two">
  <link name="base"/><link name="upper"/><link name="lower"/><link name="tip"/>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 0 1"/>{shoulder}</joint>
  <joint name="elbow" type="{kind}"><parent link="upper"/><child link="lower"/>
    <origin xyz="0.5 0 0"/><axis xyz="0 1 0"/>{elbow}</joint>
  <joint name="wrist" type="fixed"><parent link="lower"/><child link="tip"/><origin xyz="0.3 0 0"/></joint>
</robot>"""

ARM_MJCF = """<mujoco model="small">
  <compiler angle="radian"/>
  <worldbody><body name="pedestal">
    <geom type="box" size=".1 .1 .1"/>
    <body name="link1" pos="0 0 .3">
      <joint name="link1" type="hinge" axis="0 0 1" range="-2 2" limited="true" pos=".1 0 0"/>
      <geom type="capsule" size=".05 .1"/>
      <body name="link2" pos=".4 0 0">
        <joint name="joint2" type="hinge" axis="0 1 0"/>
        <geom type="sphere" size=".05"/>
        <body name="link3" pos=".2 0 0">
          <joint name="joint3" type="slide" axis="1 0 0" range="0 .2" limited="true"/>
          <geom type="sphere" size=".05"/>
          <site name="tool" pos=".1 0 0"/>
        </body>
      </body>
    </body>
  </body></worldbody>
</mujoco>"""


@pytest.fixture
def two_joints(tmp_path: Path) -> Callable[..., Path]:
    def write(shoulder: str = LIMIT, elbow: str = LIMIT, kind: str = "revolute") -> Path:
        file = tmp_path / "two.urdf"
        file.write_text(TWO_JOINTS.format(shoulder=shoulder, elbow=elbow, kind=kind))
        return file

    return write


@pytest.fixture
def mjcf(tmp_path: Path) -> Path:
    pytest.importorskip("mujoco")
    file = tmp_path / "small.xml"
    file.write_text(ARM_MJCF)
    return file


def tool_alone(arm: Arm, q: Array) -> pin.SE3:
    """The tool in the arm's base frame, from the arm's own model."""
    data = arm.model.createData()
    pin.framesForwardKinematics(arm.model, data, q)
    return data.oMf[arm.model.getFrameId(arm.tool_frame)].copy()


# -- assembly --------------------------------------------------------------------------------------------------------


def test_slices_names_and_sizes(mixed_cell: RobotCell) -> None:
    cell = mixed_cell
    assert [s.stop - s.start for s in cell.v_slices] == [7, 6, 4, 7, 5, 6]
    assert [s.stop - s.start for s in cell.q_slices] == [7, 6, 4, 7, 5, 7]  # the continuous joint takes two numbers
    assert cell.nv == cell.model.nv == 35
    assert cell.nq == cell.model.nq == 36
    assert len(cell) == 6
    assert cell.arm_names == tuple(arm.name for arm in cell.arms)
    assert [s.start for s in cell.v_slices[1:]] == [s.stop for s in cell.v_slices[:-1]]
    assert len(cell.joint_names) == len(set(cell.joint_names)) == cell.nv
    for k, (name, s) in enumerate(zip(cell.arm_names, cell.v_slices, strict=True)):
        assert cell.joint_names[s] == tuple(f"{name}/{joint}" for joint in list(cell.arms[k].model.names)[1:])
        assert cell.index(name) == cell.index(k) == k
        assert {cell.arm_of_joint(j) for j in range(s.start, s.stop)} == {k}
    for joint in cell.joint_names:  # joints, velocities and the model have the same order
        assert cell.model.joints[cell.model.getJointId(joint)].idx_v == cell.joint_names.index(joint)
    assert list(np.flatnonzero(cell.continuous)) == [34]
    names = [frame.name for frame in cell.model.frames][1:]
    assert all(name.split("/")[0] in cell.arm_names for name in names)
    assert len(names) == len(set(names))
    assert repr(cell).count("joints") == 6


def test_speeds_of_a_model_may_be_set_after_its_joints_were_made() -> None:
    """Pinocchio 4 keeps the lower limit of before, above the new one, and refuses to join such models."""
    model = pin.buildModelFromUrdf(str(robot_path("rx90l")))
    model.addFrame(pin.Frame("tool", model.addJoint(6, pin.JointModelRX(), pin.SE3.Identity(), "added"), 0,
                             pin.SE3.Identity(), pin.FrameType.OP_FRAME))  # fmt: skip
    model.velocityLimit = np.arange(1.0, 8.0) / 10.0
    arm = Arm.from_model("a", model, tool_frame="tool", lower_limits=-2.0, upper_limits=2.0)
    cell = RobotCell([arm, arm.placed(BESIDE, name="b")])
    np.testing.assert_array_equal(cell.limits.velocity, np.tile(np.arange(1.0, 8.0) / 10.0, 2))
    np.testing.assert_array_equal(cell.model.velocityLimit, cell.limits.velocity)


def test_kinematics_is_base_times_arm_alone(
    mixed_cell: RobotCell, random_q: Callable[..., Array], rng: np.random.Generator
) -> None:
    for _ in range(50):
        q = random_q(mixed_cell, rng)
        tools = CellState(mixed_cell, q).T_world_tool
        for arm, s, T in zip(mixed_cell.arms, mixed_cell.q_slices, tools, strict=True):
            expected = arm.T_world_base * tool_alone(arm, q[s])
            np.testing.assert_allclose(T.homogeneous, expected.homogeneous, rtol=0, atol=1e-14)


def test_order_of_arms_only_permutes(make_cell: Callable[..., RobotCell], rng: np.random.Generator) -> None:
    pin.seed(3)
    robots, bases = ["rx90l", "arm7", "arm6c"], [pin.SE3.Random() for _ in range(3)]
    cell = make_cell(robots, bases)
    other = make_cell(robots[::-1], bases[::-1])
    x = rng.uniform(-1.0, 1.0, cell.nv)
    x_other = np.concatenate([x[s] for s in cell.v_slices[::-1]])
    tools = CellState(cell, cell.configuration(x)).T_world_tool
    mirrored = CellState(other, other.configuration(x_other)).T_world_tool
    for T, U in zip(tools, mirrored[::-1], strict=True):
        np.testing.assert_allclose(T.homogeneous, U.homogeneous, rtol=0, atol=1e-14)
    for field in ("lower", "upper", "velocity", "acceleration"):
        a, b = getattr(cell.limits, field), getattr(other.limits, field)
        assert np.array_equal(np.concatenate([a[s] for s in cell.v_slices[::-1]]), b)


@pytest.mark.parametrize("robot", ROBOT_NAMES)
def test_every_robot_makes_a_cell(robot: str) -> None:
    frame = ROBOTS[robot].tool_frame
    arm = Arm.from_urdf("one", robot_path(robot), tool_frame=frame)
    cell = RobotCell([arm, arm.placed(BESIDE, name="two")])
    assert cell.nv == 2 * arm.model.nv
    assert cell.visual_model().ngeoms == 2 * arm.visual.ngeoms
    assert cell.collision_model().ngeoms == 2 * arm.collision.ngeoms
    assert str(robot_path(robot)) == arm.source


def test_nothing_given_is_modified() -> None:
    path = str(robot_path("arm7"))
    model = pin.buildModelFromUrdf(path)
    visual = pin.buildGeomFromUrdf(model, path, pin.GeometryType.VISUAL)
    collision = pin.buildGeomFromUrdf(model, path, pin.GeometryType.COLLISION)
    base = np.array(pin.SE3.Random().homogeneous)
    given_up_front = (model, visual, collision)
    attributes = set(dir(model))

    def prints() -> list[str]:
        texts = [x.saveToString() for x in given_up_front] + [base.tobytes().hex()]
        return [hashlib.sha256(text.encode()).hexdigest() for text in texts]

    before = prints()
    arm = Arm.from_model("a", model, tool_frame="tool", T_world_base=base, visual=visual, collision=collision)
    locked = Arm.from_model(
        "b", model, tool_frame="tool", visual=visual, collision=collision, locked_joints={"joint_3": 0.3}
    )
    own = [x.saveToString() for x in (arm.model, arm.visual, arm.collision)]
    cell = RobotCell([arm, arm.placed(BESIDE, name="c").with_limits(velocity=1.0), locked])
    cell.visual_model().geometryObjects[0].name = "mine"
    cell.collision_model()
    cell.with_limits(acceleration=3.0)
    CellState(cell, cell.configuration(np.full(cell.nv, 0.1)))
    assert prints() == before
    assert set(dir(model)) == attributes
    assert [x.saveToString() for x in (arm.model, arm.visual, arm.collision)] == own  # the arms are unchanged, too
    model.names[1] = "changed later"
    assert arm.model.names[1] == "joint_1"


def test_visual_shapes_follow_the_joints(random_q: Callable[..., Array], rng: np.random.Generator) -> None:
    pin.seed(5)
    arms = [
        rx90l("left", T_world_base=pin.SE3.Random()),
        Arm.from_urdf("right", robot_path("arm6c"), tool_frame="tool", T_world_base=pin.SE3.Random()),
    ]
    cell = RobotCell(arms)
    for kind, shapes in (("visual", cell.visual_model()), ("collision", cell.collision_model())):
        names = [shape.name for shape in shapes.geometryObjects]
        assert len(names) == len(set(names)) > 10
        q = random_q(cell, rng)
        data, placed = cell.model.createData(), shapes.createData()
        pin.updateGeometryPlacements(cell.model, data, shapes, placed, q)
        where = dict(zip(names, placed.oMg, strict=True))
        for arm, s in zip(arms, cell.q_slices, strict=True):
            own = getattr(arm, kind)
            own_data, own_placed = arm.model.createData(), own.createData()
            pin.updateGeometryPlacements(arm.model, own_data, own, own_placed, q[s])
            for shape, M in zip(own.geometryObjects, own_placed.oMg, strict=True):
                expected = (arm.T_world_base * M).homogeneous
                got = where[f"{arm.name}/{shape.name}"].homogeneous
                np.testing.assert_allclose(got, expected, rtol=0, atol=1e-14)


def test_arms_without_shapes_have_none(mixed_cell: RobotCell) -> None:
    assert mixed_cell.arms[0].visual is None
    assert mixed_cell.visual_model().ngeoms == 0
    both = RobotCell([rx90l("a"), rx90l("b", geometry=False, T_world_base=BESIDE)])
    assert {shape.name.split("/")[0] for shape in both.visual_model().geometryObjects} == {"a"}


# -- configurations --------------------------------------------------------------------------------------------------


@given(st.tuples(*[st.floats(-3.1, 3.1)] * 35))
def test_configuration_and_positions_are_inverse(mixed_cell: RobotCell, x: list[float]) -> None:
    q = mixed_cell.configuration(x)
    assert q.shape == (mixed_cell.nq,)
    np.testing.assert_allclose(mixed_cell.positions(q), x, rtol=0, atol=1e-15)
    assert np.array_equal(mixed_cell.check_configuration(q, "here"), q)  # the same bits: nothing to correct


def test_configuration_agrees_with_integration(mixed_cell: RobotCell, rng: np.random.Generator) -> None:
    x, v = rng.uniform(-1, 1, (2, mixed_cell.nv))
    moved = pin.integrate(mixed_cell.model, mixed_cell.configuration(x), v)
    np.testing.assert_allclose(mixed_cell.positions(moved), x + v, rtol=0, atol=1e-14)


@given(st.floats(-50.0, 50.0))
def test_a_continuous_joint_has_no_end(mixed_cell: RobotCell, angle: float) -> None:
    x = np.zeros(mixed_cell.nv)
    x[-1] = angle
    got = mixed_cell.positions(mixed_cell.configuration(x))[-1]
    assert -np.pi <= got <= np.pi
    assert np.cos(got - angle) == pytest.approx(1.0, abs=1e-14)
    assert mixed_cell.limits.lower[-1] == -np.inf
    assert mixed_cell.limits.upper[-1] == np.inf
    assert np.isfinite(mixed_cell.limits.velocity[-1])


def test_a_configuration_off_the_circle_names_the_joint(mixed_cell: RobotCell) -> None:
    q = mixed_cell.configuration(np.zeros(mixed_cell.nv))
    q[-2:] *= 1.0 + 1e-8  # rounding is corrected
    assert np.hypot(*mixed_cell.check_configuration(q, "here")[-2:]) == pytest.approx(1.0, abs=1e-15)
    for bad in ([0.0, 0.0], [1.1, 0.0], [1.0, 1.0]):
        q[-2:] = bad
        with pytest.raises(InvalidInputError, match=r"here.*5_arm6c/joint_6.*configuration"):
            mixed_cell.check_configuration(q, "here")


@pytest.mark.parametrize(
    "bad", [None, 1.0, "q", [], [[0.0] * 36], [0.0] * 35, [np.nan] * 36, [np.inf] * 36, [None] * 36]
)
def test_what_is_no_configuration(mixed_cell: RobotCell, bad: Any) -> None:
    with pytest.raises(InvalidInputError, match="there"):
        mixed_cell.check_configuration(bad, "there")
    with pytest.raises(InvalidInputError, match="CellState"):
        CellState(mixed_cell, bad)
    if not (isinstance(bad, list) and len(bad) == 35):
        with pytest.raises(InvalidInputError, match="configuration"):
            mixed_cell.configuration(bad)


def test_unknown_arms(mixed_cell: RobotCell) -> None:
    with pytest.raises(UnknownNameError, match="Did you mean '1_rx90l'"):
        mixed_cell.index("rx90l")
    for bad in (-1, 6):
        with pytest.raises(UnknownNameError, match="Available: 0, 1"):
            mixed_cell.index(bad)


# -- limits ----------------------------------------------------------------------------------------------------------


def test_limits_of_the_model(two_joints: Callable[..., Path]) -> None:
    arm = Arm.from_urdf("a", two_joints(elbow='<limit velocity="3" effort="1"/>', kind="continuous"), tool_frame="tip")
    assert arm.limits.lower.tolist() == [-1.0, -np.inf]
    assert arm.limits.upper.tolist() == [1.0, np.inf]
    assert arm.limits.velocity.tolist() == [2.0, 3.0]
    assert arm.limits.acceleration.tolist() == [np.inf, np.inf]  # URDF has none
    nothing = Arm.from_urdf("a", two_joints(elbow="", kind="continuous"), tool_frame="tip")
    assert nothing.limits.velocity.tolist() == [2.0, np.inf]


@pytest.mark.parametrize("text", ["1e300", "1e7", "1e6"])
def test_huge_limits_are_none(two_joints: Callable[..., Path], text: str) -> None:
    limit = f'<limit lower="-{text}" upper="{text}" velocity="{text}" effort="1"/>'
    limits = Arm.from_urdf("a", two_joints(elbow=limit, kind="prismatic"), tool_frame="tip").limits
    assert limits.lower[1] == -np.inf
    assert limits.upper[1] == limits.velocity[1] == np.inf


def test_limits_can_be_overridden(two_joints: Callable[..., Path]) -> None:
    file = two_joints(elbow='<limit lower="1" upper="-1" velocity="0" effort="1"/>')
    arm = Arm.from_urdf(
        "a",
        file,
        tool_frame="tip",
        lower_limits=-2,
        upper_limits=[2, 3],
        velocity_limits=4.0,
        acceleration_limits=[5, 6],
    )
    assert arm.limits.lower.tolist() == [-2.0, -2.0]
    assert arm.limits.upper.tolist() == [2.0, 3.0]
    assert arm.limits.velocity.tolist() == [4.0, 4.0]
    assert arm.limits.acceleration.tolist() == [5.0, 6.0]


@pytest.mark.parametrize(
    ("elbow", "says"),
    [
        ('<limit lower="1" upper="-1" velocity="2" effort="1"/>', "reversed"),
        ('<limit lower="0.5" upper="0.5" velocity="2" effort="1"/>', "empty"),
        ('<limit lower="-1" upper="1" velocity="0" effort="1"/>', "velocity limit 0"),
        ('<limit velocity="2" effort="1"/>', "empty"),  # URDF: both are 0 then
    ],
)
def test_impossible_limits_name_the_joint(two_joints: Callable[..., Path], elbow: str, says: str) -> None:
    with pytest.raises(InvalidInputError, match="arm 'a', joint 'elbow'") as caught:
        Arm.from_urdf("a", two_joints(elbow=elbow), tool_frame="tip")
    assert says in str(caught.value)
    assert "_limits" in caught.value.remedy


def test_a_negative_velocity_limit_is_refused(two_joints: Callable[..., Path]) -> None:
    with pytest.raises((ModelError, InvalidInputError)) as caught:  # by Pinocchio 4, and by coopqp with an earlier one
        Arm.from_urdf("a", two_joints(elbow='<limit lower="-1" upper="1" velocity="-2" effort="1"/>'), tool_frame="tip")
    assert "arm 'a'" in str(caught.value)
    assert "velocity" in str(caught.value)


@pytest.mark.parametrize("bad", ["fast", [1.0, 2.0, 3.0], np.nan, -1.0, 0.0, [1.0, np.nan], {}, 1j, [10**400, 1]])
@pytest.mark.parametrize("which", ["velocity_limits", "acceleration_limits"])
def test_bad_overrides(two_joints: Callable[..., Path], which: str, bad: Any) -> None:
    with pytest.raises(InvalidInputError, match="arm 'a'"):
        Arm.from_urdf("a", two_joints(), tool_frame="tip", **{which: bad})


def test_with_limits(mixed_cell: RobotCell) -> None:
    before = mixed_cell.limits.velocity.copy()
    acceleration = np.linspace(1.0, 2.0, mixed_cell.nv)
    changed = mixed_cell.with_limits(acceleration=acceleration, velocity=7.0)
    assert np.array_equal(changed.limits.acceleration, acceleration)
    assert (changed.limits.velocity == 7.0).all()
    assert np.array_equal(changed.limits.lower, mixed_cell.limits.lower)
    assert np.array_equal(mixed_cell.limits.velocity, before)
    assert (mixed_cell.limits.acceleration == np.inf).all()
    assert changed.arm_names == mixed_cell.arm_names
    for arm, s in zip(changed.arms, changed.v_slices, strict=True):
        assert np.array_equal(arm.limits.acceleration, acceleration[s])
    with pytest.raises(ValueError, match="read-only"):
        changed.limits.velocity[0] = 0.0


@pytest.mark.parametrize(
    "changes",
    [{"velocity": 0.0}, {"velocity": np.nan}, {"lower": 100.0}, {"upper": -np.inf}, {"velocity": [1.0, 2.0]},
     {"acceleration": "high"}, {"acceleration": None}, {"jerk": 1.0}, {"lower": [[0.0] * 35]}],
)  # fmt: skip
def test_with_bad_limits(mixed_cell: RobotCell, changes: dict[str, Any]) -> None:
    with pytest.raises((InvalidInputError, UnknownNameError), match=r"JointLimits|\[lower|joint"):
        mixed_cell.with_limits(**changes)
    with pytest.raises((InvalidInputError, UnknownNameError), match="JointLimits"):
        mixed_cell.arms[0].with_limits(**changes)


@pytest.mark.parametrize(
    ("lower", "upper", "velocity", "acceleration"),
    [
        (0.0, [1.0], [1.0], [1.0]),
        ([[0.0]], [1.0], [1.0], [1.0]),
        ([0.0, [1.0]], [1.0], [1.0], [1.0]),
        ("low", [1.0], [1.0], [1.0]),
        ([0.0], [1.0, 2.0], [1.0], [1.0]),
        ([0.0], [1.0], [np.nan], [1.0]),
        ([0.0], [1.0], [1.0], None),
        ([0.0], [0.0], [1.0], [1.0]),
        ([np.inf], [np.inf], [1.0], [1.0]),
        ([0.0], [1.0], [1.0], [0.0]),
        ([-(10**400)], [1.0], [1.0], [1.0]),
    ],
)
def test_what_are_no_limits(lower: Any, upper: Any, velocity: Any, acceleration: Any) -> None:
    with pytest.raises(InvalidInputError, match="JointLimits"):
        JointLimits(lower, upper, velocity, acceleration)


# -- locking, mimic joints, floating bases -----------------------------------------------------------------------------


@given(st.floats(-1.0, 1.0), st.integers(0, 2**32 - 1))
def test_locked_joints_are_frozen_where_told(position: float, seed: int) -> None:
    whole = rx90l(geometry=False)
    locked = rx90l(geometry=False, locked_joints={"joint_2": position, "joint_5": 0.25})
    assert list(locked.model.names)[1:] == ["joint_1", "joint_3", "joint_4", "joint_6"]
    assert np.array_equal(locked.limits.velocity, whole.limits.velocity[[0, 2, 3, 5]])
    q = np.random.default_rng(seed).uniform(-2, 2, 6)
    q[[1, 4]] = position, 0.25
    T, U = tool_alone(whole, q), tool_alone(locked, q[[0, 2, 3, 5]])
    np.testing.assert_allclose(T.homogeneous, U.homogeneous, rtol=0, atol=1e-14)


def test_locked_shapes_stay_on_their_links() -> None:
    whole, locked = rx90l(), rx90l(locked_joints={"joint_3": 1.0})
    q = np.array([0.1, 0.2, 1.0, 0.3, 0.4, 0.5])
    for kind in ("visual", "collision"):
        placements = []
        for arm, x in ((whole, q), (locked, np.delete(q, 2))):
            shapes = getattr(arm, kind)
            placed = shapes.createData()
            pin.updateGeometryPlacements(arm.model, arm.model.createData(), shapes, placed, x)
            names = [shape.name for shape in shapes.geometryObjects]
            placements.append(dict(zip(names, [M.homogeneous for M in placed.oMg], strict=True)))
        assert placements[0].keys() == placements[1].keys()
        for name, M in placements[0].items():
            np.testing.assert_allclose(placements[1][name], M, rtol=0, atol=1e-14)


@pytest.mark.parametrize("position", [np.nan, np.inf, "zero", None, [1.0, 2.0]])
def test_a_lock_needs_a_position(position: Any) -> None:
    with pytest.raises(InvalidInputError, match=r"arm 'arm'.*joint_1"):
        rx90l(locked_joints={"joint_1": position})


def test_locks_that_cannot_be() -> None:
    with pytest.raises(UnknownNameError, match=r"joint named 'joint1'.*locked_joints.*Did you mean 'joint_1'"):
        rx90l(locked_joints={"joint1": 0.0})
    with pytest.raises(ModelError, match="no moving joint"):
        rx90l(locked_joints={f"joint_{i}": 0.0 for i in range(1, 7)})


def fingers(*names: str) -> str:
    """A URDF of one joint, and sliding fingers."""
    joints = "".join(
        f'<link name="{n}_link"/><joint name="{n}" type="prismatic"><parent link="hand"/><child link="{n}_link"/>'
        f'<axis xyz="0 0 1"/>{LIMIT}</joint>'
        for n in names
    )
    return (
        '<robot name="hand"><link name="base"/><link name="hand"/><joint name="turn" type="revolute">'
        f'<parent link="base"/><child link="hand"/><axis xyz="0 0 1"/>{LIMIT}</joint>{joints}</robot>'
    )


def test_joints_to_lock_are_a_dictionary(tmp_path: Path) -> None:
    file = tmp_path / "hand.urdf"
    file.write_text(fingers(*"abc"))
    for bad in (3, ["a", "b", "c"], "abc"):
        with pytest.raises(InvalidInputError, match="arm 'h': locked_joints"):
            Arm.from_urdf("h", file, tool_frame="hand", locked_joints=bad)  # type: ignore[arg-type]
    arm = Arm.from_urdf("h", file, tool_frame="hand", locked_joints={"a": 0.1, "b": 0.0, "c": -0.1})
    assert list(arm.model.names)[1:] == ["turn"]


def test_joints_without_a_speed_limit_are_told(tmp_path: Path) -> None:
    file = tmp_path / "hand.urdf"
    file.write_text(fingers("a", "b", "c"))
    arm = Arm.from_urdf("h", file, tool_frame="hand")
    assert RobotCell([arm]).speed_note() == ""
    some = arm.with_limits(velocity=[1.0, np.inf, 1.0, 1.0])
    assert RobotCell([some]).speed_note() == "h/a has no speed limit: nothing slows the motion down for it."
    free = RobotCell([arm.with_limits(velocity=np.inf)])
    assert free.speed_note() == (
        "h/turn, h/a, h/b and 1 more have no speed limit: nothing slows the motion down for them."
    )
    assert free.notes() == [free.standing_note(), free.speed_note()]


@pytest.mark.parametrize(
    ("names", "says"),
    [
        ("", ""),
        ("a", "h/a moves no tool of its arm: it is locked where it stands."),
        ("ab", "h/a, h/b move no tool of their arm: they are locked where they stand."),
        ("abc", "h/a, h/b, h/c move no tool of their arm: they are locked where they stand."),
        ("abcd", "h/a, h/b, h/c and 1 more move no tool of their arm: they are locked where they stand."),
        ("abcde", "h/a, h/b, h/c and 2 more move no tool of their arm: they are locked where they stand."),
    ],
)
def test_joints_that_move_no_tool_are_told(names: str, says: str, tmp_path: Path) -> None:
    file = tmp_path / "hand.urdf"
    file.write_text(fingers(*names))
    arm = Arm.from_urdf("h", file, tool_frame="hand")
    cell = RobotCell([arm])
    assert cell.standing_note() == says
    assert slides(cell) == [False] + [True] * len(names)
    (still,) = standing(cell)
    np.testing.assert_array_equal(still, range(1, cell.nv))
    J = CellState(cell, np.full(cell.nv, 0.2)).jacobian("h")
    assert not J[:, 1:].any()
    assert J[5, 0] == 1.0


def test_a_continuous_joint_can_be_locked_at_any_angle() -> None:
    """Beside others: the tool is where it is with the joint there."""
    whole = Arm.from_urdf("c", robot_path("arm6c"), tool_frame="tool", geometry=False)
    cell = RobotCell([whole])
    name = whole.model.names[6]
    for angle in (-2.5, 0.7, 4.0):
        held = Arm.from_urdf("c", robot_path("arm6c"), tool_frame="tool", geometry=False, locked_joints={name: angle})
        x = np.array([0.1, -0.2, 0.3, 0.4, 0.5, angle])
        T = CellState(cell, cell.configuration(x)).T_world_tool[0]
        np.testing.assert_allclose(tool_alone(held, x[:5]).homogeneous, T.homogeneous, rtol=0, atol=1e-14)


def test_a_joint_of_several_freedoms_cannot_be_locked() -> None:
    model = pin.buildModelFromUrdf(str(robot_path("rx90l")), pin.JointModelPlanar())
    with pytest.raises(ModelError, match=r"joint 'root_joint' has 3 degrees of freedom; joints with one can be locked"):
        Arm.from_model("a", model, tool_frame="flange", locked_joints={"root_joint": 0.0})
    plain = pin.buildModelFromUrdf(str(robot_path("rx90l")))
    for bad in ([("joint_1", 0.0)], "joint_1", 3):
        with pytest.raises(InvalidInputError, match="arm 'arm': locked_joints"):
            rx90l(locked_joints=bad)
        with pytest.raises(InvalidInputError, match="arm 'a': locked_joints"):
            Arm.from_model("a", plain, tool_frame="flange", locked_joints=bad)  # type: ignore[arg-type]


def test_models_with_names_or_axes_that_cannot_be_are_refused() -> None:
    def of(names: tuple[str, ...], axis: tuple[float, ...] = (0.0, 0.0, 1.0)) -> pin.Model:
        model, at = pin.Model(), 0
        for name in names:
            at = model.addJoint(at, pin.JointModelRevoluteUnaligned(np.array(axis)), pin.SE3.Identity(), f"_{name}")
        model.addFrame(pin.Frame("tool", at, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
        for i, name in enumerate(names, start=1):
            model.names[i] = name
        return model

    with pytest.raises(ModelError, match=r"arm 'a': joint names are not unique: \['universe', 'x', 'x'\]"):
        Arm.from_model("a", of(("x", "x")), tool_frame="tool")
    with pytest.raises(ModelError, match=r"arm 'a': the joint name 'y\\x07' has control characters"):
        Arm.from_model("a", of(("x", "y\a", "z\a")), tool_frame="tool")
    bent = of(("x", "y"))
    bent.jointPlacements[2] = pin.SE3(np.full((3, 3), np.nan), np.zeros(3))
    with pytest.raises(ModelError, match=r"arm 'a': joint '[xy]' has no valid axis or origin"):
        Arm.from_model("a", bent, tool_frame="tool")


def test_an_unknown_frame_lists_the_twelve_nearest(tmp_path: Path) -> None:
    file = tmp_path / "hand.urdf"
    file.write_text(fingers(*(f"finger_{i:02}" for i in range(10))))
    with pytest.raises(UnknownNameError, match=r"in arm 'h' \(.*hand\.urdf\)") as caught:
        Arm.from_urdf("h", file, tool_frame="finger_03_lin")
    assert len(caught.value.available) == 12
    assert caught.value.available[0] == "finger_03_link"
    assert "universe" not in caught.value.available


def test_an_arm_keeps_its_model_with_another_tool_place_or_name() -> None:
    arm = rx90l(geometry=False)
    other = arm.with_tool(arm.model.frames[arm.model.njoints].name, name="other")
    assert (other.name, other.model) == ("other", arm.model)
    for bad in ("", "a/b", None, "two\nlines"):
        with pytest.raises(InvalidInputError, match=r"Arm\.name"):
            arm.with_tool("flange", name=bad)  # type: ignore[arg-type]
        if bad is not None:
            with pytest.raises(InvalidInputError, match=r"Arm\.name"):
                arm.placed(BESIDE, name=bad)
    with pytest.raises(UnknownNameError, match="no frame named 'hand' in arm 'other'"):
        arm.with_tool("hand", name="other")
    with pytest.raises(ModelError, match="arm 'other': no joint moves the tool frame 'base_link'"):
        arm.with_tool("base_link", name="other")
    moved = arm.placed(BESIDE)
    assert moved.name == "arm"
    np.testing.assert_array_equal(moved.T_world_base.homogeneous, BESIDE)
    with pytest.raises(InvalidInputError, match="arm 'there': T_world_base"):
        arm.placed(2.0 * np.eye(4), name="there")
    assert repr(arm).startswith("Arm(arm: 6 joints, tool flange, ")


@pytest.mark.parametrize("locked", [None, {"elbow": 0.0}, {"shoulder": 0.0}])
def test_a_mimic_joint_in_a_model_is_refused(two_joints: Callable[..., Path], locked: Any) -> None:
    file = two_joints(elbow=LIMIT + '<mimic joint="shoulder"/>')
    model = pin.buildModelFromUrdf(str(file), True)
    with pytest.raises(ModelError, match="'elbow' mimics another"):
        Arm.from_model("a", model, tool_frame="tip", locked_joints=locked)


@pytest.mark.parametrize("root", [pin.JointModelFreeFlyer(), pin.JointModelPlanar(), pin.JointModelSpherical()])
def test_a_floating_base_is_refused(root: pin.JointModel) -> None:
    model = pin.buildModelFromUrdf(str(robot_path("rx90l")), root)
    with pytest.raises(ModelError, match=r"'root_joint'.*fixed base.*T_world_base"):
        Arm.from_model("a", model, tool_frame="flange")


# -- names, files, placements ----------------------------------------------------------------------------------------


def test_names_of_arms() -> None:
    with pytest.raises(InvalidInputError, match="two arms are named 'arm'"):
        RobotCell([rx90l(geometry=False), rx90l(geometry=False)])
    with pytest.raises(InvalidInputError, match="at least one arm"):
        RobotCell([])
    with pytest.raises(InvalidInputError, match=r"RobotCell: a Model.*from_urdf"):
        RobotCell([pin.Model()])
    for bad in ("", "left/arm", None, 3):
        with pytest.raises(InvalidInputError, match=r"Arm\.name"):
            rx90l(bad)


@pytest.mark.parametrize("frame", ["flang", "", "tool0", 7, None])
def test_an_unknown_frame_lists_what_there_is(frame: Any) -> None:
    with pytest.raises(UnknownNameError) as caught:
        Arm.from_urdf("left", robot_path("rx90l"), tool_frame=frame)
    assert "left" in str(caught.value)
    assert "Available: " in str(caught.value)
    if frame == "flang":
        assert "Did you mean 'flange'?" in str(caught.value)
    assert isinstance(caught.value, KeyError)


def test_the_base_does_not_move() -> None:
    with pytest.raises(ModelError, match="no joint moves the tool frame 'base_link'"):
        Arm.from_urdf("a", robot_path("rx90l"), tool_frame="base_link")


@pytest.mark.parametrize("read", [Arm.from_urdf, Arm.from_mjcf])
@pytest.mark.parametrize(
    "text",
    ["", "hello", "<a/>", "<mujoco/>", '<robot name="x"/>', '<robot name="x"><link name="a"/></robot>', "\x00\x01",
     "<robot", '<robot name="x"><link name="a"/><link name="b"/></robot>', "solid\n" * 100],
)  # fmt: skip
def test_a_file_that_is_no_robot(read: Callable[..., Arm], text: str, tmp_path: Path) -> None:
    if read is Arm.from_mjcf:
        pytest.importorskip("mujoco")
    file = tmp_path / "robot.xml"
    file.write_text(text)
    with pytest.raises(ModelError, match="arm 'left'") as caught:
        read("left", file, tool_frame="tool")
    assert "\n" not in str(caught.value)
    assert "/src/" not in str(caught.value), "where a parser's own source lies helps nobody"


@pytest.mark.parametrize(
    ("read", "reader", "raised", "says"),
    [
        (Arm.from_urdf, "buildModelFromUrdf", ValueError, "is not a readable URDF"),
        (Arm.from_urdf, "buildModelFromUrdf", RuntimeError, "is not a readable URDF"),
        (Arm.from_urdf, "buildGeomFromUrdf", ValueError, "geometry .* cannot be read"),
        (Arm.from_urdf, "buildGeomFromUrdf", RuntimeError, "geometry .* cannot be read"),
        (lambda _, file, tool_frame: guess_tool(file), "buildModelFromUrdf", ValueError, "is not a readable URDF"),
        (lambda _, file, tool_frame: guess_tool(file), "buildModelFromUrdf", RuntimeError, "is not a readable URDF"),
    ],
)  # fmt: skip
def test_what_a_parser_raises_is_said_of_the_file(
    read: Callable[..., Any], reader: str, raised: type[Exception], says: str,
    two_joints: Callable[..., Path], monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """Pinocchio's versions differ in what they raise. What it says of its own source is left out."""

    def fails(*_: object, **__: object) -> None:
        raise raised("file: /src/parser.hxx\nline: 3\nmessage: the second\n link is  odd.")

    monkeypatch.setattr(pin, reader, fails)
    file = two_joints()
    with pytest.raises(ModelError, match=says) as caught:
        read("left", file, tool_frame="tip")
    assert file.name in str(caught.value)
    if read == Arm.from_urdf:
        assert "arm 'left': " in str(caught.value)
        assert "(the second link is odd)" in str(caught.value)


@pytest.mark.parametrize("read", [Arm.from_urdf, Arm.from_mjcf])
def test_a_path_that_is_no_file(read: Callable[..., Arm], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for bad in (tmp_path / "nothing.urdf", tmp_path, "", "\0", None, 5):
        with pytest.raises(ModelError, match="arm 'left'"):
            read("left", bad, tool_frame="tool")
    with pytest.raises(ModelError, match=r"no file .*nothing\.urdf.*relative to"):
        read("left", "nothing.urdf", tool_frame="tool")
    monkeypatch.setattr(coopqp.model.description, "MAX_DESCRIPTION_BYTES", 100)
    with pytest.raises(ModelError, match="larger than 100 bytes"):
        read("left", robot_path("rx90l"), tool_frame="flange")


def test_a_missing_mesh_says_what_to_do(tmp_path: Path) -> None:
    shape = '<visual><geometry><mesh filename="package://nowhere/x.stl"/></geometry></visual>'
    text = TWO_JOINTS.format(shoulder=LIMIT, elbow=LIMIT, kind="revolute")
    file = tmp_path / "meshes.urdf"
    file.write_text(text.replace('<link name="upper"/>', f'<link name="upper">{shape}</link>'))
    with pytest.raises(ModelError, match=r"visual geometry.*package_dirs, or geometry=False"):
        Arm.from_urdf("a", file, tool_frame="tip")
    assert Arm.from_urdf("a", file, tool_frame="tip", geometry=False).visual is None


@pytest.mark.parametrize(
    "bad", [2.0 * np.eye(4), np.diag([1.0, 1.0, -1.0, 1.0]), np.eye(3), np.full((4, 4), np.nan), "origin"]
)
def test_a_base_that_is_no_placement(bad: Any) -> None:
    with pytest.raises(InvalidInputError, match="arm 'arm': T_world_base"):
        rx90l(T_world_base=bad)
    with pytest.raises(InvalidInputError, match="arm 'arm': T_world_base"):
        rx90l(geometry=False).placed(bad)


def test_a_model_must_be_one() -> None:
    for bad in (robot_path("rx90l"), "robot.urdf", None):
        with pytest.raises(InvalidInputError, match="from_urdf"):
            Arm.from_model("a", bad, tool_frame="flange")


# -- MJCF ------------------------------------------------------------------------------------------------------------


def test_mjcf_arm(mjcf: Path) -> None:
    arm = Arm.from_mjcf("m", mjcf, tool_frame="tool", velocity_limits=[1.0, 2.0, 3.0])
    assert arm.limits.lower.tolist() == [-2.0, -np.inf, 0.0]
    assert arm.limits.upper.tolist() == [2.0, np.inf, 0.2]
    assert arm.limits.velocity.tolist() == [1.0, 2.0, 3.0]
    cell = RobotCell([rx90l("u", geometry=False), arm.placed(pin.SE3(np.eye(3), np.array([0.0, 0.0, 1.0])))])
    q1, q2, q3 = q = np.array([0.3, 0.4, 0.15])
    T = CellState(cell, np.concatenate([np.zeros(6), q])).T_world_tool[1]
    # link1 is at height 0.3; Rz(q1) about (0.1, 0) in link1; then 0.3 along x, Ry(q2), 0.3 + q3 along x.
    reach = 0.3 + (0.3 + q3) * np.cos(q2)
    expected = [0.1 + reach * np.cos(q1), reach * np.sin(q1), 1.3 - (0.3 + q3) * np.sin(q2)]
    np.testing.assert_allclose(T.translation, expected, rtol=0, atol=1e-14)
    assert cell.visual_model().ngeoms + cell.collision_model().ngeoms > 0


def test_mjcf_has_no_velocity_limits(mjcf: Path) -> None:
    assert (Arm.from_mjcf("m", mjcf, tool_frame="tool").limits.velocity == np.inf).all()


def test_a_link_may_have_the_name_of_its_joint(mjcf: Path) -> None:
    """In MJCF a link and a joint may share a name: as a tool frame, 'link1' means the link."""
    arm = Arm.from_mjcf("m", mjcf, tool_frame="link1", geometry=False)
    cell = RobotCell([arm, arm.placed(BESIDE, name="n")])
    origin = CellState(cell, np.zeros(6)).T_world_tool[0].translation
    np.testing.assert_allclose(origin, [0.0, 0.0, 0.3], rtol=0, atol=1e-15)  # the joint's frame is at x = 0.1
    assert len({frame.name for frame in cell.model.frames}) == cell.model.nframes


def test_the_frame_of_a_locked_joint_stays_between_its_links(mjcf: Path) -> None:
    """Also where it has its link's name. From every frame the parents lead to the world."""
    mine = pin.buildModelFromMJCF(str(mjcf))
    theirs = pin.buildModelFromUrdf(str(robot_path("rx90l")))
    for model, tool, locked in (
        (mine, "tool", ("link1",)), (mine, "tool", ("link1", "joint2")), (theirs, "flange", ("joint_1", "joint_3")),
        (theirs, "flange", ("joint_2",)), (theirs, "flange", ("joint_4", "joint_5")),
    ):  # fmt: skip
        whole = Arm.from_model("a", model, tool_frame=tool, velocity_limits=1.0).model
        own = Arm.from_model(
            "a", model, tool_frame=tool, velocity_limits=1.0, locked_joints=dict.fromkeys(locked, 0.1)
        ).model
        assert len({frame.name for frame in own.frames}) == own.nframes == whole.nframes

        def parents(model: pin.Model, frame: str) -> list[str]:
            names: list[str] = []
            i = model.getFrameId(frame)
            while i > 0 and len(names) < 100:
                i = model.frames[i].parentFrame
                names.append(model.frames[i].name.removesuffix(" (joint)").removesuffix(" (fixed_joint)"))
            return names

        assert parents(own, tool) == [name.removesuffix(" (joint)") for name in parents(whole, tool)]
        assert own.njoints == whole.njoints - len(locked)


def test_mjcf_with_a_free_body_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    file = tmp_path / "free.xml"
    file.write_text(
        '<mujoco><worldbody><body name="b"><freejoint/><geom type="sphere" size=".1"/></body></worldbody></mujoco>'
    )
    with pytest.raises(ModelError, match="fixed base"):
        Arm.from_mjcf("a", file, tool_frame="b")


@given(st.binary(max_size=40), st.integers(0, 8000))
def test_a_damaged_description_is_refused_or_read(tmp_path: Path, noise: bytes, at: int) -> None:
    raw = robot_path("scara4").read_bytes()
    file = tmp_path / "damaged.urdf"
    file.write_bytes(raw[:at] + noise + raw[at + len(noise) :])
    with contextlib.suppress(CoopqpError):
        assert Arm.from_urdf("a", file, tool_frame="tool", geometry=False).model.nv >= 1


def test_readings_at_rest_are_averaged_joint_by_joint(mixed_cell: RobotCell) -> None:
    """Continuous joints are averaged on the circle, also across ±π. Noise falls with the root of the number."""
    rng = np.random.default_rng(3)
    x = rng.uniform(-0.5, 0.5, mixed_cell.nv)
    x[mixed_cell.continuous] = np.pi - 1e-4
    readings = [mixed_cell.configuration(x + rng.uniform(-1e-3, 1e-3, mixed_cell.nv)) for _ in range(400)]
    mean = mixed_cell.average(readings)
    away = pin.difference(mixed_cell.model, mixed_cell.configuration(x), mean)
    assert np.abs(away).max() < 5.0 * 1e-3 / np.sqrt(3.0 * 400)
    np.testing.assert_allclose(mixed_cell.average([readings[0]]), readings[0], atol=1e-15)
    with pytest.raises(InvalidInputError, match="average"):
        mixed_cell.average([])
    with pytest.raises(InvalidInputError, match="average"):
        mixed_cell.average([readings[0], readings[0] * np.nan])


def test_rows_measured_at_rest_are_averaged_and_one_configuration_is_checked(mixed_cell: RobotCell) -> None:
    x = np.full(mixed_cell.nv, 0.2)
    rows = np.array([mixed_cell.configuration(x + d) for d in (-0.01, 0.0, 0.04)])
    mean = mixed_cell.at_rest(rows, "here")
    np.testing.assert_allclose(mean, mixed_cell.configuration(x + 0.01), rtol=0, atol=1e-9)
    np.testing.assert_array_equal(mixed_cell.at_rest(rows[1], "here"), rows[1])
    np.testing.assert_allclose(mixed_cell.at_rest(rows[:2], "here"), mixed_cell.average(rows[:2]), rtol=0, atol=0)
    for bad in (rows[:1], rows[:0], [[0.0], [0.0, 1.0]], "rest", None):
        with pytest.raises(InvalidInputError, match=r"^here: "):
            mixed_cell.at_rest(bad, "here")  # type: ignore[arg-type]
    with pytest.raises(InvalidInputError, match=r"RobotCell\.average"):
        mixed_cell.at_rest(np.vstack([rows, rows * np.nan]), "here")


@given(st.floats(-4.0, 4.0), st.floats(-0.9e-6, 0.9e-6))
def test_what_was_normalised_once_keeps_its_bits(mixed_cell: RobotCell, angle: float, off: float) -> None:
    """A command goes back in unchanged. Off the circle by less than a millionth is rounding, and is cured."""
    x = np.zeros(mixed_cell.nv)
    x[-1] = angle
    q = mixed_cell.configuration(x)
    q[-2:] *= 1.0 + off
    once = mixed_cell.check_configuration(q, "here")
    assert abs(np.hypot(*once[-2:]) - 1.0) < 1e-15
    np.testing.assert_array_equal(mixed_cell.check_configuration(once, "here"), once)
    np.testing.assert_allclose(mixed_cell.positions(once)[-1], mixed_cell.positions(q)[-1], rtol=0, atol=1e-15)
    for wrong in (1.0 + 1.1e-6, 1.0 - 1.1e-6):
        with pytest.raises(InvalidInputError, match=r"given by .* at entries 34, 35; their norm is"):
            mixed_cell.check_configuration(np.concatenate([q[:-2], wrong * once[-2:]]), "here")


def test_many_configurations_have_their_positions_at_once(mixed_cell: RobotCell, rng: np.random.Generator) -> None:
    x = rng.uniform(-3.0, 3.0, (4, 3, mixed_cell.nv))
    q = np.array([[mixed_cell.configuration(y) for y in rows] for rows in x])
    np.testing.assert_allclose(mixed_cell.positions(q), x, rtol=0, atol=1e-15)
    plain = RobotCell([rx90l(geometry=False)])
    own = rng.normal(size=(5, 6))
    got = plain.positions(own)
    got[0] = 0.0
    assert own[0].any(), "what comes back is a copy"


def test_moved_is_the_integral_of_a_displacement(
    make_cell: Any, mixed_cell: RobotCell, random_q: Any, rng: np.random.Generator
) -> None:
    for cell in (make_cell(["rx90l", "arm7"]), mixed_cell):
        q, step = random_q(cell, rng), 0.1 * rng.standard_normal(cell.nv)
        np.testing.assert_allclose(cell.moved(q, step), pin.integrate(cell.model, q, step), rtol=0.0, atol=1e-15)
        assert cell.euclidean == (cell.nq == cell.nv)


def test_what_is_found_of_a_cell_is_kept_while_the_cell_lives(make_cell: Callable[..., RobotCell]) -> None:
    asked = []

    @of_cell
    def names(cell: RobotCell) -> list[str]:
        asked.append(cell.arm_names)
        return list(cell.arm_names)

    cell, other = RobotCell(make_cell(("rx90l",)).arms), make_cell(("arm7", "arm7"))
    assert names(cell) is names(cell)
    assert names(other) == list(other.arm_names)
    assert len(asked) == 2
    QPController(cell, Grasp((np.eye(4),)), HoldPath(pin.SE3.Identity()), dt=0.01)
    alive = weakref.ref(cell)
    del cell
    gc.collect()
    assert alive() is None
