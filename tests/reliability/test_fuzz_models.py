"""Odd robot models give an arm that agrees with its description or a named error; then cells and controllers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from fuzzing import Tried, answer

from coopqp import Arm, Grasp, LinePath, QPController, RobotCell
from coopqp.model import CellState
from coopqp.simulation import Monitor, Tolerances

pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")
LIMITS_ONLY = Tolerances(chain_mm=1e9, chain_deg=1e9, object_mm=1e9, object_deg=1e9)

NUMBERS = ["0", "1.5", "-1.5", "3", "nan", "inf", "-inf", "1e300", "-1e300", "1e-310", "", "abc", "1,5"]
KINDS = ["revolute"] * 6 + ["continuous", "prismatic", "fixed", "floating", "planar", "mimic", "screw"]
AXES = ["1 0 0", "0 1 0", "0 0 1", "0.6 0 0.8", "0 0 -1"]
ODD_AXES = ["0 0 0", "2 0 0", "nan 0 0", "1 1", "0 0 1e-300"]


@dataclass(frozen=True)
class Joint:
    kind: str
    name: str
    axis: str
    limit: str
    xyz: tuple[float, float, float]
    rpy: tuple[float, float, float]


@dataclass(frozen=True)
class Description:
    """A URDF, and True if it is valid."""

    text: str
    joints: tuple[Joint, ...]
    tool: str
    plain: bool


def description(rng: Random) -> Description:
    """A chain of joints. In half of the cases one joint or a name is odd."""
    n = rng.randint(1, 8)
    odd = rng.randint(0, 2 * n)  # index of the odd joint
    joints = []
    for i in range(n):
        kind, axis = rng.choice(["revolute"] * 5 + ["continuous", "prismatic"]), rng.choice(AXES)
        limit = '<limit lower="-2.5" upper="2.5" velocity="1.5" effort="10"/>'
        name = f"joint_{i}"
        if i == odd:
            kind = rng.choice(KINDS)
            axis = rng.choice(AXES + ODD_AXES)
            low, high, speed = (rng.choice(NUMBERS) for _ in range(3))
            limit = rng.choice(["", limit, f'<limit lower="{low}" upper="{high}" velocity="{speed}" effort="1"/>'])
            name = rng.choice([name, name, "joint_0", "", "a/b", "link_0", "universe", "é"])
        if kind == "continuous" and i != odd:
            limit = '<limit velocity="1.5" effort="10"/>'
        xyz, rpy = (tuple(round(rng.uniform(-0.5, 0.5), 3) for _ in range(3)) for _ in range(2))
        joints.append(Joint(kind, name, axis, limit, xyz, rpy))
    tool = rng.choice([f"link_{n}"] * 6 + ["link_0", "nowhere", ""])
    lines = ['<robot name="r"><link name="link_0"/>']
    for i, j in enumerate(joints):
        kind = "revolute" if j.kind == "mimic" else j.kind
        mimic = f'<mimic joint="{joints[0].name}" multiplier="2"/>' if j.kind == "mimic" else ""
        lines.append(
            f'<link name="link_{i + 1}"/><joint name="{j.name}" type="{kind}"><parent link="link_{i}"/>'
            f'<child link="link_{i + 1}"/><origin xyz="{" ".join(map(str, j.xyz))}" rpy="{" ".join(map(str, j.rpy))}"/>'
            f'<axis xyz="{j.axis}"/>{j.limit}{mimic}</joint>'
        )
    text = "\n".join([*lines, "</robot>"])
    return Description(text, tuple(joints), tool, odd >= n and tool == f"link_{n}")


def tool_by_hand(joints: tuple[Joint, ...], x: Any) -> pin.SE3:
    """Placement of the last link from the description's numbers; ``x`` has one position per moving joint."""
    T, positions = pin.SE3.Identity(), iter(x)
    for j in joints:
        T = T * pin.SE3(pin.rpy.rpyToMatrix(np.array(j.rpy)), np.array(j.xyz))
        if j.kind == "fixed":
            continue
        axis = np.array([float(a) for a in j.axis.split()])
        axis, q = axis / np.linalg.norm(axis), next(positions)
        T = T * (pin.SE3(np.eye(3), q * axis) if j.kind == "prismatic" else pin.SE3(pin.exp3(q * axis), np.zeros(3)))
    return T


def drawn(cell: RobotCell, rng: np.random.Generator, inside: float = 0.9) -> Any:
    """Positions (nv,) well inside the limits; between −2 and 2 without limits."""
    lower, upper = cell.limits.lower, cell.limits.upper
    low = np.maximum(lower, np.minimum(-2.0, upper - 4.0))  # limits may lie beyond ±2
    high = np.minimum(upper, np.maximum(2.0, lower + 4.0))
    low, high = np.where(cell.continuous, -2.0, low), np.where(cell.continuous, 2.0, high)  # these have none
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    return middle + inside * rng.uniform(-half, half)


@pytest.mark.parametrize(
    "limits", [(2.5, 3.0), (-9.0, -3.0), (-1.0, 1.0), (-np.inf, np.inf), (-np.inf, -5.0), (4.0, np.inf)]
)
def test_positions_are_drawn_inside_any_limits(
    limits: tuple[float, float], make_cell: Callable[..., RobotCell], rng: np.random.Generator
) -> None:
    cell = make_cell(["rx90l"]).with_limits(lower=limits[0], upper=limits[1])
    x = np.array([drawn(cell, rng) for _ in range(20)])
    assert (x > limits[0]).all()
    assert (x < limits[1]).all()
    assert np.ptp(x) > 0.1


def check_cell(arm: Arm, arms: int, rng: np.random.Generator) -> None:
    """A cell of ``arms`` copies: its placements agree with the arm, and a controller keeps its limits."""
    placed = [
        arm.placed(pin.SE3(pin.exp3(rng.normal(size=3)), rng.normal(size=3)), name=f"arm {k}") for k in range(arms)
    ]
    cell = RobotCell(placed)
    n = arm.model.nv
    assert [s.stop - s.start for s in cell.v_slices] == [n] * arms
    x = drawn(cell, rng)
    q = cell.configuration(x)
    assert np.allclose(cell.positions(q), x, atol=1e-12)
    state, data = CellState(cell, q), arm.model.createData()
    for k in range(arms):
        pin.framesForwardKinematics(arm.model, data, q[cell.q_slices[k]])
        alone = placed[k].T_world_base * data.oMf[arm.model.getFrameId(arm.tool_frame)]
        assert np.abs(state.T_world_tool[k].homogeneous - alone.homogeneous).max() < 1e-10
    start = state.T_world_tool[0]
    grasp = Grasp.from_configuration(cell, q, start)
    cell = cell.with_limits(acceleration=10.0) if rng.random() < 0.5 else cell
    path = LinePath.displaced(
        start, translation=0.05 * rng.normal(size=3), rotation=0.1 * rng.normal(size=3), duration=0.2
    )
    controller = QPController(cell, grasp, path, dt=0.01)
    controller.reset(q)
    monitor = Monitor(cell, grasp, tolerances=LIMITS_ONLY)
    for _ in range(3):
        monitor.observe(controller.step())
    assert monitor.verdict().ok, monitor.verdict()


@pytest.mark.slow
def test_descriptions_of_arms(catalogue: Any, tmp_path: Path) -> None:
    tried, file = Tried(), tmp_path / "arm.urdf"

    def holds(random: Random) -> None:
        made, seed = description(random), random.randrange(2**32)
        rng = np.random.default_rng(seed)
        file.write_text(made.text, encoding="utf-8")
        arm = answer(lambda: Arm.from_urdf("arm", file, tool_frame=made.tool, geometry=False))
        assert arm is not None or not made.plain
        if arm is None:
            return
        tried.accepted += 1
        limits, n = arm.limits, arm.model.nv
        assert n == sum(j.kind != "fixed" for j in made.joints)
        assert (limits.lower < limits.upper).all()
        assert (limits.velocity > 0.0).all()
        assert np.isfinite(arm.model.jointPlacements[1].homogeneous).all()
        cell = RobotCell([arm])
        x = drawn(cell, rng)
        tool = CellState(cell, cell.configuration(x)).T_world_tool[0]
        by_hand = tool_by_hand(made.joints, x) if made.tool == f"link_{len(made.joints)}" else tool
        assert np.abs(tool.homogeneous - by_hand.homogeneous).max() < 1e-9
        if seed % 4 == 0:
            check_cell(arm, int(rng.integers(1, 9)), rng)

    tried.each(holds)
    tried.row(catalogue, "models, URDFs of 1–8 joints, then cells of 1–8 arms")


# -- models built in code ----------------------------------------------------------------------------------------------

SINGLE = {
    "turns about x": pin.JointModelRX,
    "turns about z": pin.JointModelRZ,
    "slides": pin.JointModelPY,
    "turns without end": pin.JointModelRUBZ,
    "unaligned": lambda: pin.JointModelRevoluteUnaligned(np.array([0.6, 0.0, 0.8])),
    "slides, unaligned": lambda: pin.JointModelPrismaticUnaligned(np.array([0.0, 0.6, 0.8])),
}
OTHERS = {
    "floats": pin.JointModelFreeFlyer,
    "ball": pin.JointModelSpherical,
    "ball of angles": pin.JointModelSphericalZYX,
    "planar": pin.JointModelPlanar,
    "translates": pin.JointModelTranslation,
}


def model_like(random: Random) -> tuple[pin.Model, dict[str, Any], bool]:
    """A model, limits for it, and True if both are valid."""
    n = random.randint(0, 7)
    rng = np.random.default_rng(random.randrange(2**32))
    model, plain, at = pin.Model(), n > 0, 0
    strange = random.randint(0, 2 * n + 1)
    for i in range(n):
        kind = random.choice(sorted(SINGLE))
        joint = SINGLE[kind]()
        name = f"j{i}"
        if i == strange:
            what = random.choice(["kind", "name", "placement"])
            if what == "kind":
                joint, plain = OTHERS[random.choice(sorted(OTHERS))](), False
            elif what == "name" and i:
                name, plain = "j0", False
        T = pin.SE3(pin.exp3(rng.normal(size=3)), 0.3 * rng.normal(size=3))
        ones = np.ones(joint.nv)
        low, high = (
            (-2.0 * np.ones(joint.nq), 2.0 * np.ones(joint.nq))
            if joint.nq == joint.nv
            else (-1.01 * np.ones(joint.nq), 1.01 * np.ones(joint.nq))
        )
        try:
            at = model.addJoint(at, joint, T, name, ones, ones, low, high)
        except (ValueError, RuntimeError):  # Pinocchio's check of names
            plain = False
            break
    if at:
        model.addFrame(pin.Frame("tool", at, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    given: dict[str, Any] = {}
    if random.random() < 0.5:
        key = random.choice(["velocity_limits", "acceleration_limits", "lower_limits", "upper_limits"])
        value = random.choice([1.9, 0.0, -1.0, np.nan, np.inf, -np.inf, 1e300, "fast", [1.0] * 3, None, 5e-324, 1j])
        given[key] = value
        plain = plain and ((value == 1.9 and key != "lower_limits") or value is None)
    return model, given, plain and n > 0


@pytest.mark.slow
def test_models_built_in_code(catalogue: Any) -> None:
    tried = Tried()

    def holds(random: Random) -> None:
        (model, limits, plain), seed = model_like(random), random.randrange(2**32)
        before = (list(model.names), model.nq, model.lowerPositionLimit.copy())
        arm = answer(lambda: Arm.from_model("arm", model, tool_frame="tool", **limits))
        assert arm is not None or not plain
        assert (list(model.names), model.nq) == before[:2]
        assert np.array_equal(model.lowerPositionLimit, before[2])
        if arm is None:
            return
        tried.accepted += 1
        assert (arm.limits.lower < arm.limits.upper).all()
        assert (arm.limits.velocity > 0.0).all()
        assert (arm.limits.acceleration > 0.0).all()
        if seed % 4 == 0:
            rng = np.random.default_rng(seed)
            check_cell(arm, int(rng.integers(1, 9)), rng)

    tried.each(holds)
    tried.row(catalogue, "models, built in code, then cells of 1–8 arms")
