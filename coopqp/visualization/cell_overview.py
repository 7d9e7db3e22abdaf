"""A task before it runs, at a glance: the arms as near to their grasps as they come, their reach, and who is short."""

from __future__ import annotations

import itertools
import textwrap
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin

from coopqp.collision.scene import CollisionScene
from coopqp.model.batch import ArmKinematics
from coopqp.model.links import joint_links
from coopqp.model.shapes import Body, Box
from coopqp.planning.arm_check import ArmCheck
from coopqp.planning.check import PathCheck
from coopqp.simulation.recording.bodies import describe_bodies, describe_carried
from coopqp.simulation.recording.recording import Recording
from coopqp.simulation.recording.scene import describe_cell, describe_object, describe_path
from coopqp.spatial import Array
from coopqp.visualization.renderer import (
    Solid,
    View,
    body_solids,
    cell_solids,
    name_places,
    object_solids,
    render,
    revolved,
)
from coopqp.visualization.style import INK, RED, WIDTH, label, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Seeds of the search for the nearest configuration; samples of the reach, and how many are made longer.
_SEEDS, _SAMPLES, _LONGEST = 64, 2000, 5
#: Points of a ring.
_RING = 120
#: Lines of the check that a picture shows; radius of a stick [m].
_LINES, _STICK_RADIUS = 12, 0.03
_BLUE = "#0072b2"
_PLATE, _STICK = (0.30, 0.52, 0.75), (0.55, 0.58, 0.62)
#: A tool this near to its grasp is there [m].
_THERE = 1e-6


@dataclass(frozen=True, eq=False)
class Reach:
    """How far a tool comes.

    Attributes:
        centre: point on the first joint's axis beside the second joint (3,) [m].
        radius: largest distance of the tool from it, which was found [m].
    """

    centre: Array
    radius: float

    def ring(self, height: float) -> Array:
        """The circle (K, 3) [m] that the reach has at a height [m]; empty above and below it."""
        square = self.radius**2 - (height - self.centre[2]) ** 2
        if square <= 0.0:
            return np.empty((0, 3))
        angle = np.linspace(0.0, 2.0 * np.pi, _RING)
        circle = np.sqrt(square) * np.column_stack([np.cos(angle), np.sin(angle)])
        return np.column_stack([self.centre[:2] + circle, np.full(_RING, height)])


@dataclass(frozen=True, eq=False)
class Glance:
    """A task before it runs.

    Attributes:
        name: its name.
        check: what was found about it.
        metadata: object and bodies, as in a recording.
        clock: of the pose that is shown [s]: the start, or the end of the way of the first arm that stops.
        pose: of the object there.
        q: the arms as near to their grasps as they come (nq,).
        short: by how much the arms that stop there miss their grasps [m], by name.
        reaches: by name of the arm; arms with sliding joints have none.
    """

    name: str
    check: PathCheck
    metadata: Mapping[str, Any]
    clock: float
    pose: pin.SE3
    q: Array
    short: Mapping[str, float]
    reaches: Mapping[str, Reach]

    def lines(self) -> list[str]:
        """The verdict, and what the check says, in lines."""
        return [self.check.verdict.value, *self.check.explain().splitlines()]

    def grasps(self) -> dict[str, Array]:
        """Where each tool should be (3,) [m], by name of its arm."""
        check = self.check
        placed = zip(check.cell.arm_names, check.grasp.T_object_tool, strict=True)
        return {name: (self.pose * X).translation for name, X in placed}

    def targets(self) -> dict[str, tuple[Array, Array]]:
        """Where the tools of :attr:`short` are, and where they should be (3,) [m]."""
        cell, found = self.check.cell, {}
        data = cell.model.createData()
        pin.framesForwardKinematics(cell.model, data, self.q)
        for name in self.short:
            k = cell.index(name)
            wanted = self.pose * self.check.grasp.T_object_tool[k]
            found[name] = data.oMf[cell.tool_frames[k]].translation.copy(), wanted.translation
        return found

    def recording(self) -> Recording:
        """The arms at rest, as a run of one step."""
        cell, path = self.check.cell, self.check.path
        X = np.array([T.homogeneous for T in self.check.grasp.T_object_tool])
        scene = {"scene": describe_cell(cell), "path": describe_path(path), "scenario": self.name}
        rest, poses = np.array([self.q, self.q]), np.tile(self.pose.homogeneous, (2, 1, 1))
        return Recording(
            time=np.array([0.0, 1e-3]), q=rest, q_command=rest, velocity=np.zeros((1, cell.nv)),
            clock=np.full(2, self.clock), rate=np.ones(1), status=np.zeros(1), reference=poses, T_object_tool=X,
            notes=(), metadata={**scene, "arms": list(cell.arm_names), **self.metadata},
        )  # fmt: skip


def glance(name: str, check: PathCheck, box: Body, scene: CollisionScene | None) -> Glance:
    """Look at a task.

    Args:
        name: of the task.
        check: result of its check.
        box: the object.
        scene: bodies that keep distances; may be None.
    """
    ends = {arm.arm: 0.0 if arm.chosen is None else arm.chosen.until for arm in check.arms if not arm.follows}
    clock = min(ends.values(), default=0.0)
    stuck = [name for name, end in ends.items() if end <= clock]
    pose = check.path.pose(clock)
    kinematics = [ArmKinematics(arm) for arm in check.cell.arms]
    x = check.cell.positions(pin.neutral(check.cell.model))
    short = {}
    for k, (arm, kin) in enumerate(zip(check.arms, kinematics, strict=True)):
        own = check.cell.columns[k][kin.columns]
        target = pose * check.grasp.T_object_tool[k]
        x[own] = _nearest(kin, target, _seeds(kin, arm, clock))
        if arm.arm in stuck:
            reached = kin.tool_poses(x[None, own])[0, :3, 3]
            short[arm.arm] = float(np.linalg.norm(reached - target.translation))
    size = box.shape.size if isinstance(box.shape, Box) else (0.1, 0.1, 0.1)
    drawn: dict[str, Any] = {"object": describe_object(size, box.placement)}
    if scene is not None:
        drawn |= {"bodies": describe_bodies(scene), "carried": describe_carried(scene, drawn["object"])}
    reaches = {kin.arm.name: reach for kin in kinematics if (reach := _reach(kin)) is not None}
    q = check.cell.configuration(x)
    return Glance(name, check, drawn, clock, pose, q, short, reaches)


def _seeds(kinematics: ArmKinematics, arm: ArmCheck, clock: float) -> Array:
    """Starts of the search: the checked way of the arm if it has one, else anywhere inside its limits."""
    if arm.chosen is not None:
        i = int(np.abs(arm.chosen.clocks - clock).argmin())
        return arm.chosen.q[i : i + 1]
    return _anywhere(kinematics, _SEEDS)


def _anywhere(kinematics: ArmKinematics, number: int) -> Array:
    rng = np.random.default_rng(0)
    low, high = np.maximum(kinematics.lower, -np.pi), np.minimum(kinematics.upper, np.pi)
    return rng.uniform(low, np.maximum(high, low), (number, kinematics.n))


def _nearest(kinematics: ArmKinematics, target: pin.SE3, seeds: Array) -> Array:
    """The configuration (n,) nearest to a tool pose, of those that Newton's method finds; inside the limits."""
    q = kinematics.newton(target.homogeneous, seeds, steps=200)[0]
    q = np.clip(q, kinematics.lower, kinematics.upper)
    off = np.linalg.norm(kinematics.tool_poses(q)[:, :3, 3] - target.translation, axis=1)
    return np.asarray(q[int(np.nan_to_num(off, nan=np.inf).argmin())])


def _reach(kinematics: ArmKinematics) -> Reach | None:
    """The reach of an arm whose joints all turn, by samples and steps uphill from the longest."""
    if kinematics.slides.any() or kinematics.n < 2:
        return None
    model = kinematics.arm.model
    frame = model.frames[model.getFrameId(kinematics.arm.tool_frame)]
    R, p, _, _ = joint_links(model, [int(j) for j in model.supports[frame.parentJoint] if j])
    centre = kinematics.arm.T_world_base.act(p[0] + R[0][:, 2] * p[1][2])
    q = _anywhere(kinematics, _SAMPLES)
    away = np.linalg.norm(kinematics.tool_poses(q)[:, :3, 3] - centre, axis=1)
    best = q[np.argsort(away)[-_LONGEST:]]
    for _ in range(200):
        offset = kinematics.tool_poses(best)[:, :3, 3] - centre
        slope = np.einsum("mi,mij->mj", offset, kinematics.jacobians(best)[:, :3])
        step = 0.2 * slope / np.maximum((offset**2).sum(axis=1), 1e-9)[:, None]
        best = np.clip(best + step, kinematics.lower, kinematics.upper)
    return Reach(centre, float(np.linalg.norm(kinematics.tool_poses(best)[:, :3, 3] - centre, axis=1).max()))


# -- the picture -------------------------------------------------------------------------------------------------------


def glance_figure(found: Glance, *, pixels: int = 900) -> Figure:
    """The cell as it would stand, the path, the reach at the height of each grasp that is missed, and what is said.

    Raises:
        MissingExtraError: Matplotlib is not installed.
    """
    cell = found.check.cell
    size, T = np.array(found.metadata["object"]["size_m"]), pin.SE3(np.array(found.metadata["object"]["T_object_body"]))
    solids, _ = object_solids(found.metadata, size, T, _PLATE)
    scene = [*_arm_solids(found), *(solid.placed(found.pose) for solid in solids), *body_solids(found.metadata)]
    targets = found.targets()
    rings = {
        name: found.reaches[name].ring(wanted[2]) for name, (_, wanted) in targets.items() if name in found.reaches
    }
    before, after = _path_points(found)
    points = np.vstack([before, after, *rings.values(), *(np.array(pair) for pair in targets.values())])
    view = View.around(
        [[*scene, Solid(points, np.empty((0, 3), dtype=np.intp), _PLATE)]], azimuth=125.0, elevation=32.0
    )
    view = replace(view, top=view.top + 0.08 * (view.top - view.bottom))
    picture = render([scene], view, width=pixels)[0]
    height, width = picture.shape[:2]
    lines = [line for text in found.lines()[:_LINES] for line in textwrap.wrap(text, 118)]
    lines += ["Dashed: how far the arm comes at the height of its grasp."] if any(map(len, rings.values())) else []
    shown, below = WIDTH * height / width, 0.25 + 0.19 * len(lines)
    figure = new_figure(WIDTH, shown + below)
    axes = figure.add_axes((0.0, below / (shown + below), 1.0, shown / (shown + below)))
    axes.imshow(picture, aspect="auto", extent=(0.0, width, height, 0.0))
    axes.set_axis_off()

    def line(points: Array, **style: Any) -> None:
        axes.plot(*view.pixels(points, width, height)[:, :2].T, **style)

    line(before, color=_BLUE, lw=2.0)
    line(after, color=RED if found.short else _BLUE, lw=2.0)
    for ring in rings.values():
        if len(ring):
            line(ring, color=RED, lw=1.2, ls=(0, (6, 4)))
    for name, (tool, wanted) in targets.items():
        line(np.array([tool, wanted]), color=RED, lw=2.2, marker="o", ms=4)
        x, y = view.pixels(wanted[None], width, height)[0, :2]
        axes.annotate(shortfall(found, name), (x, y), (10, -14), textcoords="offset points", color=RED, fontsize=11,
                      bbox={"fc": "white", "ec": "none", "alpha": 0.75, "pad": 1.5})  # fmt: skip
    for name, place in zip(cell.arm_names, name_places(cell, found.q), strict=True):
        x, y = view.pixels(place[None], width, height)[0, :2]
        axes.text(x, y, label(name), ha="center", va="bottom", fontsize=11, color=RED if name in found.short else INK)
    for i, text in enumerate(lines):
        y = (below - 0.22 - 0.19 * i) / (shown + below)
        figure.text(
            0.02, y, text.replace("$", "\\$"), fontsize=9.5, color=INK, fontweight="bold" if i < 1 else "normal"
        )
    return figure


def shortfall(found: Glance, name: str) -> str:
    """What is written beside a grasp that is missed, or where an arm comes no further."""
    gap, reach = found.short[name], found.reaches.get(name)
    if gap < _THERE:
        return f"{label(name)} comes no further, {found.clock:.2f} s"
    if gap < 1e-3:
        return f"{label(name)} cannot turn its tool so"
    wanted = (found.pose * found.check.grasp.T_object_tool[found.check.cell.index(name)]).translation
    if reach is not None and np.linalg.norm(wanted - reach.centre) > reach.radius:
        return f"{label(name)}: {1e3 * gap:.0f} mm beyond its reach of {reach.radius:.2f} m"
    return f"{label(name)} misses its grasp by {1e3 * gap:.0f} mm"


def _path_points(found: Glance) -> tuple[Array, Array]:
    """Points (K, 3) [m] of the path until the pose that is shown, and from there to its end."""
    path = found.check.path
    end = path.duration if np.isfinite(path.duration) else found.clock
    parts = (np.linspace(0.0, found.clock, 40), np.linspace(found.clock, end, 40))
    before, after = (np.array([path.pose(float(clock)).translation for clock in part]) for part in parts)
    return before, after


def _arm_solids(found: Glance) -> list[Solid]:
    """The arms' shapes, and sticks for arms without."""
    cell = found.check.cell
    visual = cell.visual_model()
    solids = cell_solids(cell, [found.q])[0] if visual.ngeoms else []
    drawn = {item.name.split("/", 1)[0] for item in visual.geometryObjects}
    data = cell.model.createData()
    pin.framesForwardKinematics(cell.model, data, found.q)
    for k, (arm, own) in enumerate(zip(cell.arms, cell.v_slices, strict=True)):
        if arm.name in drawn:
            continue
        joints = [data.oMi[j + 1].translation for j in range(own.start, own.stop)]
        places = [arm.T_world_base.translation, *joints, data.oMf[cell.tool_frames[k]].translation]
        solids += [_stick(a, b) for a, b in itertools.pairwise(places) if np.linalg.norm(b - a) > 1e-3]
    return solids


def _stick(start: Array, end: Array) -> Solid:
    along = (end - start) / np.linalg.norm(end - start)
    R = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), along).matrix()
    rod = revolved(np.full(2, _STICK_RADIUS), np.array([0.0, float(np.linalg.norm(end - start))]))
    return Solid(*rod, _STICK).placed(pin.SE3(R, start))
