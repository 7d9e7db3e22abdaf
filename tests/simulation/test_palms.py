"""Palms in the physics engine: pads that press along their normals, the stand below the object, and slip; grips that
move with an object that grows."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from coopqp import HoldPath, InvalidInputError
from coopqp.forces import Grip
from coopqp.scenarios import Scenario, palm_box
from coopqp.simulation import Disturbances, PhysicsOptions, PhysicsPlant
from coopqp.simulation.plants.mujoco_model import OBJECT, STAND, grip_site, tool_site
from coopqp.simulation.plants.replay import Replay
from coopqp.spatial import Array

mujoco = pytest.importorskip("mujoco")

AT_ONCE: dict[str, Any] = {"settle": 0.0, "hand_over": 0.0}


@pytest.fixture(scope="module")
def task() -> Scenario:
    return palm_box()


def palm_plant(task: Scenario, *normals: Any, **options: Any) -> PhysicsPlant:
    """A plant whose two palms press along normals in their tools' axes, without time to settle."""
    palms = [Grip(kind="palm", friction=0.6 + 0.1 * k, radius=0.06 * k, normal=n) for k, n in enumerate(normals)]
    return PhysicsPlant.of(task, palms=palms, options=PhysicsOptions(**AT_ONCE, **options))


def rest(task: Scenario, plant: PhysicsPlant, *, rate: float, dt: float) -> None:
    """One step in which the arms stay, at a rate of the path."""
    replay = Replay(task.cell, task.grasp, HoldPath(task.path.pose(0.0)), lambda _: task.q_start, dt=dt)
    plant.apply(replay.step().replaced(rate=rate))


def rotation(quaternion: Array) -> Array:
    out = np.zeros(9)
    mujoco.mju_quat2Mat(out, quaternion)
    return out.reshape(3, 3)


@pytest.mark.parametrize(
    "normal", [[0, 0, 1], [0, 0, -1], [1, 0, 0], [0, -1, 0], [0.6, 0.8, 0], [0, 0.6, -0.8], [0.36, 0.48, 0.8]]
)
def test_the_face_of_a_pad_is_at_the_tool_and_looks_along_the_normal(task: Scenario, normal: list[float]) -> None:
    model = palm_plant(task, normal, normal).mj_model
    for arm, half, friction in zip(task.cell.arm_names, (0.01, 0.06), (0.6, 0.7), strict=True):
        pad = model.geom(int(model.body(tool_site(arm)).geomadr[0]))
        assert pad.type[0] == mujoco.mjtGeom.mjGEOM_BOX
        np.testing.assert_allclose(rotation(pad.quat)[:, 2], normal, atol=1e-12)
        np.testing.assert_allclose(pad.pos + pad.size[2] * np.array(normal), 0.0, atol=1e-12)
        np.testing.assert_allclose(pad.size[:2], half)
        assert pad.friction[0] == pytest.approx(friction)


def test_the_stand_holds_the_object_until_it_moves(task: Scenario) -> None:
    plant = palm_plant(task, [0, 0, 1], [0, 0, 1])
    plant.reset(task.q_start)
    model, data = plant.mj_model, plant.mj_data
    mujoco.mj_forward(model, data)
    stand = data.body(STAND)
    below = plant.T_world_object * task.T_object_body
    top = stand.xpos + stand.xmat.reshape(3, 3) @ [0.0, 0.0, model.geom(STAND).size[2]]
    np.testing.assert_allclose(top, below.act(np.array([0.0, 0.0, -0.5 * task.object_size[2]])), atol=1e-9)
    np.testing.assert_allclose(stand.xmat.reshape(3, 3), below.rotation, atol=1e-9)
    np.testing.assert_allclose(model.geom(STAND).size[:2], 0.5 * np.array(task.object_size[:2]))

    def meets() -> bool:
        """Whether the stand and the object can touch, by the engine's rule."""
        a, b = model.geom(STAND), model.geom(int(model.body(OBJECT).geomadr[0]))
        return bool(a.contype[0] & b.conaffinity[0] or b.contype[0] & a.conaffinity[0])

    assert meets()
    rest(task, plant, rate=0.0, dt=0.002)
    assert meets()
    rest(task, plant, rate=0.5, dt=0.002)
    assert not meets()
    plant.reset(task.q_start)
    assert meets()
    assert plant.slip() == 0.0


def test_slip_is_the_largest_way_across_a_normal_since_the_stand_let_go(task: Scenario) -> None:
    plant = palm_plant(task, [0, 0, 1], [0, 0, 1], gravity=(0.0, 0.0, 0.0))
    plant.reset(task.q_start)
    normal = plant.T_world_tool[0].rotation[:, 2]
    across = np.cross(normal, [0.3, -0.5, 0.8])
    across /= np.linalg.norm(across)
    for along, sideways, counts in ((0.0, 0.0, False), (0.02, 0.0, True), (-0.01, 0.004, True), (0.0, -0.003, True)):
        plant.reset(task.q_start)
        rest(task, plant, rate=1.0 if counts else 0.0, dt=1e-6)
        at = plant.mj_model.joint(OBJECT).qposadr[0]
        plant.mj_data.qpos[at : at + 3] += along * normal + sideways * across
        assert plant.slip() == pytest.approx(abs(sideways), abs=1e-7)
        if not counts:
            plant.mj_data.qpos[at : at + 3] += 0.05 * across
            assert plant.slip() == 0.0


@pytest.mark.parametrize("palms", [(), [Grip(kind="palm", friction=0.6)], [Grip(), Grip()], ["palm", "palm"]])
def test_palms_are_one_for_each_arm(task: Scenario, palms: Any) -> None:
    with pytest.raises(InvalidInputError, match=r"no palm for each arm.*Give Grip\(kind=\"palm\", …\)"):
        PhysicsPlant.of(task, palms=palms)


def test_grips_move_with_an_object_that_grows(paper: Scenario) -> None:
    """By a share that is a sine of the time since the start; without growth they stay."""
    for growth in (0.0, 0.02, -0.01):
        plant = PhysicsPlant.of(
            paper,
            options=PhysicsOptions(**AT_ONCE, timestep=0.002),
            disturbances=Disturbances(object_growth=growth, growth_period=0.02),
        )
        plant.reset(paper.q_start)
        for i in range(8):
            rest(paper, plant, rate=1.0, dt=0.002)
            size = 1.0 + growth * math.sin(2.0 * math.pi * i * 0.002 / 0.02)
            for arm, X in zip(paper.cell.arm_names, paper.grasp.T_object_tool, strict=True):
                np.testing.assert_allclose(plant.mj_model.site(grip_site(arm)).pos, size * X.translation, atol=1e-12)
        plant.reset(paper.q_start)
        for arm, X in zip(paper.cell.arm_names, paper.grasp.T_object_tool, strict=True):
            np.testing.assert_allclose(plant.mj_model.site(grip_site(arm)).pos, X.translation, atol=1e-12)


@pytest.mark.parametrize(("options", "seconds"), [({}, 1.5), ({"settle": 0.1}, 0.6), (AT_ONCE, 0.0)])
def test_a_reset_takes_the_time_to_settle_and_twice_that_of_the_hand_over(
    paper: Scenario, options: dict[str, Any], seconds: float
) -> None:
    plant = PhysicsPlant.of(paper, options=PhysicsOptions(**options))
    plant.reset(paper.q_start)
    assert plant.mj_data.time == pytest.approx(seconds)
    assert plant.time == 0.0
