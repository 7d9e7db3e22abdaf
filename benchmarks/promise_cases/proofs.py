"""What the check and the plan of a path say, against what runs show.

The oracle follows each tool by Newton's method with Pinocchio alone, in small steps along the geometry, from the start
that is judged. It shares no code with the proof but the poses of the path.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from coopqp import (
    Arm,
    Clearance,
    CollisionScene,
    CoopqpError,
    Grasp,
    InvalidInputError,
    LinePath,
    QPController,
    RobotCell,
    Status,
    WaypointPath,
    check_path,
    plan,
    simulate,
)
from coopqp.collision import Body, Box, Sphere
from coopqp.errors import MissingExtraError, UndecidedError, UnreachableError
from coopqp.paths import PathGeometry
from coopqp.planning import PathCheck, PathVerdict
from coopqp.scenarios import ROBOTS, SCENARIOS, dual_arm7, robot_path
from promise_cases import Promise

Array = NDArray[np.float64]

#: Margin of the scenes [m].
_MARGIN = 0.02
#: Six-joint arms of the random cells, and samples of each path.
_ROBOTS, _SAMPLES = ("rx90l", "arm6c", "kr16_2", "irb1600"), 600


def promises(quick: bool) -> Iterator[Promise]:
    """The promises of this module; ``quick`` for a part of the cases."""
    yield from _one_torso()
    yield from _blends(2 if quick else 60)
    yield from _self_motions(4 if quick else 44)
    yield from _planned_beside_bodies(1 if quick else 30)


def _one_torso() -> Iterator[Promise]:
    """Ten random robots with two arms on a torso of 1–3 joints, given as two arms; and the cells that are shipped."""
    accepted, unnamed = 0, 0
    for seed in range(10):
        rng = np.random.default_rng([2026, seed])
        torso = int(rng.integers(1, 4))
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "robot.urdf"
            file.write_text(_two_armed(rng, torso), encoding="utf-8")
            arms = [
                Arm.from_urdf(
                    side, file, tool_frame=f"{side}_6", geometry=False, T_world_base=pin.exp6(rng.normal(size=6))
                )
                for side in ("left", "right")
            ]
        try:
            RobotCell([arms[0], arms[1].placed(arms[0].T_world_base)])
            accepted += 1
        except InvalidInputError as error:
            unnamed += not all(f"'torso_{i}'" in str(error) for i in range(torso))
    refused = 0
    for name, make in SCENARIOS.items():
        try:
            make(**({"geometry": False} if name in ("panda_bar", "ur5_table") else {}))
        except InvalidInputError:
            refused += 1
        except MissingExtraError:
            pass
    yield Promise("robots with two arms given as two arms: accepted, of 10", accepted, 0, "cells")
    yield Promise("the same: a shared joint is not named", unnamed, 0, "cells")
    yield Promise(f"shipped scenarios that are refused, of {len(SCENARIOS)}", refused, 0, "cells")


def _two_armed(rng: np.random.Generator, torso: int) -> str:
    """A URDF of a base, a torso of some random joints, and two arms of six random joints."""

    def joint(name: str, parent: str, child: str, kind: str) -> str:
        xyz, rpy, axis = (" ".join(f"{x:.6f}" for x in v) for v in rng.uniform(-0.4, 0.4, (3, 3)))
        limit = "" if kind == "continuous" else 'lower="-2" upper="2" '
        return (
            f'<link name="{child}"/><joint name="{name}" type="{kind}"><parent link="{parent}"/>'
            f'<child link="{child}"/><origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>'
            f'<limit {limit}velocity="2" effort="9"/></joint>'
        )

    kinds = ("revolute", "prismatic", "continuous")
    text, last = '<robot name="both"><link name="base"/>', "base"
    for i in range(torso):
        text += joint(f"torso_{i}", last, f"chest_{i}", str(rng.choice(kinds)))
        last = f"chest_{i}"
    for side in ("left", "right"):
        for i in range(6):
            text += joint(f"{side}_joint_{i + 1}", f"{side}_{i}" if i else last, f"{side}_{i + 1}", "revolute")
    return text + "</robot>"


def _blends(count: int) -> Iterator[Promise]:
    """Random cells with waypoints: the blends of paths whose corners are certified, and dense samples of them."""
    corners, lost, violated, loosest = 0, 0, 0, 0.0
    seed = 0
    while corners < count:
        seed += 1
        task = _waypoints(np.random.default_rng([2027, seed]))
        cell, grasp, poses, q = task
        corner = WaypointPath(poses, durations=[1.0] * (len(poses) - 1))
        if check_path(cell, grasp, corner, q_start=q).verdict is not _CERTIFIED:
            continue
        corners += 1
        size = float(np.random.default_rng(seed).uniform(0.005, 0.06))
        made = plan(cell, grasp, poses, q_start=q, blend=size, knots=60)
        check = check_path(cell, grasp, made.path, q_start=q)
        if check.verdict is not _CERTIFIED:
            lost += 1
            continue
        violation, loose = _violations(check, made.path.geometry())
        violated += violation
        loosest = max(loosest, loose)
    yield Promise(f"blends that are not certified, of {count} whose corners are", lost / count, 0.0, "share")
    yield Promise(f"certified blends that dense samples disprove, of {count - lost}", violated, 0, "paths")
    yield Promise("certified blends: largest distance of a margin's bound from samples", loosest, 0.2, "°")


_CERTIFIED = PathVerdict.CERTIFIED


def _waypoints(rng: np.random.Generator) -> tuple[RobotCell, Grasp, list[pin.SE3], Array]:
    """Two or three arms that hold an object, 3–5 poses from there on, and the configuration."""
    arms, tools, q = [], [], []
    origin = pin.SE3(pin.exp3(rng.normal(size=3)), rng.uniform(-0.5, 0.5, 3))
    for k in range(int(rng.integers(2, 4))):
        robot = str(rng.choice(_ROBOTS))
        arm = Arm.from_urdf(f"a{k}", robot_path(robot), tool_frame=ROBOTS[robot].tool_frame, geometry=False)
        model, data = arm.model, arm.model.createData()
        x = np.clip(rng.uniform(-1.2, 1.2, model.nv), 0.8 * arm.limits.lower, 0.8 * arm.limits.upper)
        own = pin.neutral(model)
        for i, value in enumerate(x):
            at = model.joints[i + 1]
            own[at.idx_q : at.idx_q + at.nq] = [value] if at.nq == 1 else [np.cos(value), np.sin(value)]
        pin.framesForwardKinematics(model, data, own)
        X = pin.SE3(pin.exp3(rng.normal(size=3)), rng.uniform(-0.3, 0.3, 3))
        tool = data.oMf[model.getFrameId(arm.tool_frame)]
        arms.append(arm.placed(origin * X * tool.inverse()))
        tools.append(X)
        q.append(own)
    poses, T = [origin], origin
    for _ in range(int(rng.integers(2, 5))):
        way, turn = 0.12 * rng.normal(size=3), 0.2 * rng.normal(size=3) * rng.integers(0, 2)
        T = pin.SE3(T.rotation @ pin.exp3(turn), T.translation + way)
        poses.append(T)
    return RobotCell(arms).with_limits(acceleration=10.0), Grasp(tuple(tools)), poses, np.concatenate(q)


def _violations(check: PathCheck, geometry: PathGeometry) -> tuple[bool, float]:
    """Whether dense samples disprove a certificate, and how loose its margins are at most [°]."""
    s = np.linspace(0.0, geometry.length, _SAMPLES)
    R, p = geometry.poses(s)
    wrong, loosest = False, 0.0
    if check.q_start is None:
        raise UnreachableError("a certified path has a start")
    for k, (arm, own) in enumerate(zip(check.cell.arms, check.cell.q_slices, strict=True)):
        judged = check.arms[k].chosen
        if judged is None:
            raise UnreachableError("a certified arm has a branch")
        model, data, q = arm.model, arm.model.createData(), check.q_start[own].copy()
        frame, base = model.getFrameId(arm.tool_frame), arm.T_world_base.inverse()
        margins, sigma = np.full(model.nv, np.inf), np.inf
        for rotation, origin in zip(R, p, strict=True):
            goal = base * pin.SE3(rotation, origin) * check.grasp.T_object_tool[k]
            for _ in range(6):
                J = pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL)
                pin.framesForwardKinematics(model, data, q)
                away = pin.log6(data.oMf[frame].actInv(goal)).vector
                q = pin.integrate(model, q, np.linalg.solve(J, away))
                if np.abs(away).max() < 1e-12:
                    break
            for i in range(model.nv):
                at = model.joints[i + 1]
                if at.nq == 1:
                    x = q[at.idx_q]
                    margins[i] = min(margins[i], x - arm.limits.lower[i], arm.limits.upper[i] - x)
            sigma = min(sigma, float(np.linalg.svd(J)[1][-1]))
        known = np.isfinite(margins) & np.isfinite(judged.margins)
        apart = margins[known] - judged.margins[known]
        wrong |= bool((apart < -1e-9).any() or sigma < judged.sigma_bound - 1e-9 or margins.min() < -1e-9)
        loosest = max(loosest, float(np.rad2deg(apart[margins[known].argmin()])) if known.any() else 0.0)
    return wrong, loosest


def _self_motions(count: int) -> Iterator[Promise]:
    """Random starts of arms with seven joints that are certified, and their runs on the elbows that the check found."""
    stuck, outside, tried, ran = 0, 0.0, 0, 0
    while ran < count:
        tried += 1
        cell, grasp, path, q = redundant_task(np.random.default_rng([44, tried]))
        check = check_path(cell, grasp, path, q_start=q)
        if check.verdict is not _CERTIFIED:
            continue
        ran += 1
        run = simulate(QPController(cell, grasp, check.led_path(), dt=0.008), q_start=q)
        stuck += not run.finished or bool((run.status == Status.BLOCKED.code).any())
        x = np.array([cell.positions(row) for row in run.q])
        outside = max(outside, float((cell.limits.lower - x).max()), float((x - cell.limits.upper).max()))
    yield Promise(f"certified starts of redundant arms that are BLOCKED when run, of {ran}", stuck, 0, "runs")
    yield Promise("the same: how far a joint is outside its limits", outside, 1e-6, "rad")


def redundant_task(rng: np.random.Generator) -> tuple[RobotCell, Grasp, LinePath, Array]:
    """One or two arms with seven joints anywhere inside their limits, a line of 0.1 to 0.6 m, and the configuration."""
    arms, tools, q = [], [], []
    origin = pin.SE3(pin.exp3(rng.normal(size=3)), rng.uniform(-0.5, 0.5, 3))
    for k in range(int(rng.integers(1, 3))):
        robot = str(rng.choice(("arm7", "gantry7")))
        arm = Arm.from_urdf(f"a{k}", robot_path(robot), tool_frame=ROBOTS[robot].tool_frame, geometry=False)
        low, high = np.maximum(arm.limits.lower, -2.5), np.minimum(arm.limits.upper, 2.5)
        q.append(rng.uniform(low + 0.05 * (high - low), high - 0.05 * (high - low)))
        data = arm.model.createData()
        pin.framesForwardKinematics(arm.model, data, q[-1])
        X = pin.SE3(pin.exp3(rng.normal(size=3)), rng.uniform(-0.3, 0.3, 3))
        tool = data.oMf[arm.model.getFrameId(arm.tool_frame)]
        arms.append(arm.placed(origin * X * tool.inverse()))
        tools.append(X)
    way = rng.normal(size=3)
    way *= rng.uniform(0.1, 0.6) / np.linalg.norm(way)
    turn = pin.exp3(0.5 * rng.normal(size=3) * rng.integers(0, 2))
    goal = pin.SE3(origin.rotation @ turn, origin.translation + way)
    cell = RobotCell(arms).with_limits(acceleration=10.0)
    return cell, Grasp(tuple(tools)), LinePath(origin, goal, duration=2.0), np.concatenate(q)


def _planned_beside_bodies(count: int) -> Iterator[Promise]:
    """Two seven-joint arms and posts in their way: what the plan says, and its run with the bodies kept off."""
    base = dual_arm7()
    cell = base.cell.with_limits(acceleration=5.0)
    slowed, differs, nearest, ran, tried = 0, 0, np.inf, 0, 0
    while ran < count and tried < 4 * count:
        tried += 1
        rng = np.random.default_rng([2028, tried])
        T = base.path.pose(0.0)
        path = LinePath.displaced(T, translation=rng.uniform(-0.15, 0.15, 3), duration=3.0)
        posts = [
            Body(f"post_{i}", Sphere(0.05), pin.SE3(np.eye(3), T.translation + rng.uniform(-0.6, 0.6, 3)))
            for i in range(8)
        ]
        try:
            carried = [Body("object", Box(base.object_size))]
            scene = CollisionScene(cell=cell, grasp=base.grasp, margin=_MARGIN, obstacles=posts, carried=carried)
            check = check_path(cell, base.grasp, path, q_start=base.q_start, scene=scene)
        except CoopqpError:
            continue
        try:
            made = plan(cell, base.grasp, path, q_start=base.q_start, scene=scene)
        except (UnreachableError, UndecidedError) as error:
            differs += check.feasible or check.verdict.value.lower() not in str(error)
            continue
        if made.check is None or made.check.verdict is not check.verdict:
            differs += 1
        ran += 1
        controller = QPController(cell, made.grasp, made.path, dt=0.004, constraints=[Clearance(scene)])
        run = simulate(controller, q_start=made.q_start)
        late = int((np.asarray(run.rate) < 1.0 - 1e-9).sum())
        slowed += late > 0
        nearest = min(nearest, _least_distance(cell, posts, run.q[::10]))
    yield Promise(f"plans beside bodies whose verdict is not that of the check, of {tried}", differs, 0, "plans")
    yield Promise(f"plans beside bodies that are slowed when run, of {ran}", slowed / max(ran, 1), 0.0, "share")
    yield Promise("the same: how far inside the margin an arm comes to a post", 1e3 * (_MARGIN - nearest), 0, "mm")


def _least_distance(cell: RobotCell, posts: list[Body], rows: Array) -> float:
    """The least distance of the arms from the posts (spheres), by a geometry model of Pinocchio's of its own [m]."""
    geometry = cell.collision_model()
    arms = range(geometry.ngeoms)
    for post in posts:
        ball = pin.GeometryObject(post.name, 0, post.placement, coal.Sphere(0.05))
        index = geometry.addGeometryObject(ball)
        for arm in arms:
            if geometry.geometryObjects[arm].parentJoint > 0:
                geometry.addCollisionPair(pin.CollisionPair(arm, index))
    data, placed, least = cell.model.createData(), geometry.createData(), np.inf
    for q in rows:
        pin.updateGeometryPlacements(cell.model, data, geometry, placed, q)
        pin.computeDistances(geometry, placed)
        least = min([least, *(result.min_distance for result in placed.distanceResults)])
    return least
