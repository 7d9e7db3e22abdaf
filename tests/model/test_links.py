"""Joints of an arm as a product of frames whose z axes are the joints' axes."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from coopqp import Arm
from coopqp.errors import ModelError
from coopqp.model.batch import ArmKinematics
from coopqp.model.links import joint_axes, joint_links

#: Kinds of joints, with the twist of each in its own frame.
KINDS = {
    "JointModelRX": (0, 0, 0, 1, 0, 0),
    "JointModelRY": (0, 0, 0, 0, 1, 0),
    "JointModelRZ": (0, 0, 0, 0, 0, 1),
    "JointModelPX": (1, 0, 0, 0, 0, 0),
    "JointModelPY": (0, 1, 0, 0, 0, 0),
    "JointModelPZ": (0, 0, 1, 0, 0, 0),
    "JointModelRUBZ": (0, 0, 0, 0, 0, 1),
}
SKEW = np.array([0.6, -0.48, 0.64])


def serial(rng: np.random.Generator) -> pin.Model:
    """A joint of each kind and two about and along an axis askew, at random places one behind the other."""
    model, at = pin.Model(), 0
    joints = [getattr(pin, name)() for name in KINDS]
    for joint in [*joints, pin.JointModelRevoluteUnaligned(SKEW), pin.JointModelPrismaticUnaligned(SKEW)]:
        place = pin.SE3(pin.exp3(rng.normal(size=3)), rng.normal(size=3))
        at = model.addJoint(at, joint, place, f"joint {model.njoints}")
    return model


def test_axes_are_unit_twists(rng: np.random.Generator) -> None:
    expected = [*KINDS.values(), (*SKEW, 0, 0, 0)]
    expected.insert(-1, (0, 0, 0, *SKEW))
    np.testing.assert_allclose(joint_axes(serial(rng)), expected, rtol=0, atol=1e-15)


@pytest.mark.parametrize("count", [1, 2, 4, 9])
def test_the_links_are_the_model(count: int, rng: np.random.Generator) -> None:
    """Where the last joint is, as a product of places and of turns about z or slides along z."""
    model = serial(rng)
    R, p, pitch, aligned = joint_links(model, range(1, count + 1))
    assert R.shape == (count, 3, 3)
    names = [joint.shortname() for joint in list(model.joints)[1 : count + 1]]
    np.testing.assert_array_equal(pitch, [np.inf if name.startswith("JointModelP") else 0.0 for name in names])
    x = rng.uniform(-2.0, 2.0, model.nv)
    T = pin.SE3.Identity()
    for i, value in enumerate(x[:count]):
        turn = (
            pin.SE3(np.eye(3), np.array([0.0, 0.0, value]))
            if pitch[i]
            else pin.SE3(pin.utils.rotate("z", value), np.zeros(3))
        )
        T = T * pin.SE3(R[i], p[i]) * turn
    data = model.createData()
    pin.forwardKinematics(model, data, pin.integrate(model, pin.neutral(model), x))
    own = T * pin.SE3(aligned.T, np.zeros(3))
    np.testing.assert_allclose(own.homogeneous, data.oMi[count].homogeneous, rtol=0, atol=1e-13)
    for M in (*R, aligned):
        np.testing.assert_allclose(M @ M.T, np.eye(3), rtol=0, atol=1e-14)
        assert np.linalg.det(M) == pytest.approx(1.0)


def test_a_screw_has_a_pitch_which_only_the_step_knows() -> None:
    screw = pin.Model()
    screw.addJoint(0, pin.JointModelHelicalUnaligned(SKEW, 0.1), pin.SE3.Identity(), "screw")
    screw.addFrame(pin.Frame("tool", 1, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    assert joint_links(screw, [1])[2] == pytest.approx([0.1], abs=1e-15)
    arm = Arm.from_model("a", screw, tool_frame="tool", velocity_limits=1.0, lower_limits=-1.0, upper_limits=1.0)
    with pytest.raises(ModelError, match="arm 'a': joint screw neither turns about an axis nor slides along one"):
        ArmKinematics(arm)


def test_what_is_no_row_of_joints_is_named(rng: np.random.Generator) -> None:
    model = serial(rng)
    for joints in ([2], [1, 3], [1, 2, 2], [2, 1]):
        with pytest.raises(ModelError, match=r"joint joint [123] does not follow the one before"):
            joint_links(model, joints)
    ball = pin.Model()
    ball.addJoint(0, pin.JointModelSpherical(), pin.SE3.Identity(), "ball")
    with pytest.raises(ModelError, match="joint ball does not follow"):
        joint_links(ball, [1])
