"""The bodies that keep clear of each other: the arms' links, the object, and bodies that stand or move around."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, final

import numpy as np
import pinocchio as pin

from coopqp.checks import as_scalar, require
from coopqp.collision.branch_choice import clear_choice
from coopqp.collision.built_scene import BuiltScene, Levers, Part, joints_to
from coopqp.collision.clearance_check import NO_SHAPES, ClearanceCheck
from coopqp.collision.coal_geometry import reach_of
from coopqp.collision.convex_shapes import ConvexShapes
from coopqp.collision.distances import Distances, core_shapes
from coopqp.collision.edges import EdgeLimits, Edges
from coopqp.collision.evasion import evading_trajectory
from coopqp.collision.gaps import ObjectGaps
from coopqp.collision.one_robot import OneRobot
from coopqp.collision.pairs import Names, PairRules, as_pair, srdf_pairs
from coopqp.collision.path_check import check_clearance
from coopqp.errors import InvalidInputError, UnknownNameError, shown
from coopqp.model.batch import ArmKinematics
from coopqp.model.cell import RobotCell
from coopqp.model.grasp import Grasp
from coopqp.model.shapes import Body, Box, NearPair
from coopqp.paths.joint_trajectories import CellTrajectory
from coopqp.paths.scenario import Scenario
from coopqp.spatial import Array, as_placement

#: Distance that is kept by default [m].
DEFAULT_MARGIN = 0.01
#: Share that is added to bounds of motion for the rounding of distances.
_MORE = 1e-5


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class CollisionScene:
    """The bodies of a cell and the distances that they keep. All shapes are convex.

    A mesh counts as its convex hull, and :attr:`notes` names it where the hull is much larger; ``decompose`` takes its
    convex parts instead.

    Names: a link is ``arm/link``; other bodies are called as their ``Body`` says. Where two names are asked for, an
    arm's name stands for all its links, and ``"*"`` for all bodies.

    Attributes:
        cell, grasp: the arms with their collision shapes, and how they hold.
        carried: bodies of the object, placed in the object frame.
        obstacles: bodies that stand in the world.
        moving: bodies in the world whose place is told in motion (:meth:`Clearance.move`).
        on_links: further bodies on links ``arm/link``, placed in the link's frame, e.g. a gripper's capsule.
        without: links whose own shapes are left out, e.g. because ``on_links`` replaces them.
        srdf: for arms by name an SRDF, a file or its text: pairs that it disables are left out, across arms
            of one description, too.
        rules: which pairs are left out because they touch by design.
        margin: distance that is kept [m].
        margins: other margins for pairs of names [m].
        ignored: pairs of names that may touch.
        inside: pairs of names that may start inside their margin; they come no closer then.
        decompose: names of bodies whose meshes count as their convex parts, and not as one hull. Needs the extra
            ``decompose``; the parts are kept in the user's cache folder.

    Raises:
        InvalidInputError, UnknownNameError: a bad mesh, size, name or margin.
        MissingExtraError: ``decompose`` without its extra.
    """

    cell: RobotCell
    grasp: Grasp
    carried: Sequence[Body] = ()
    obstacles: Sequence[Body] = ()
    moving: Sequence[Body] = ()
    on_links: Mapping[str, Sequence[Body]] = field(default_factory=dict)
    without: Sequence[str] = ()
    srdf: Mapping[str, str | Path] = field(default_factory=dict)
    rules: PairRules = field(default_factory=PairRules)
    margin: float = DEFAULT_MARGIN
    margins: Mapping[tuple[str, str], float] = field(default_factory=dict)
    ignored: Sequence[tuple[str, str]] = ()
    inside: Sequence[tuple[str, str]] = ()
    decompose: Sequence[str] = ()

    def __post_init__(self) -> None:
        require(self.cell, RobotCell, "CollisionScene: cell", "Give a RobotCell.")
        require(self.grasp, Grasp, "CollisionScene: grasp", "Give a Grasp.")
        require(self.rules, PairRules, "CollisionScene: rules", "Give PairRules.")
        self.grasp.check_arms(self.cell)
        for name in ("carried", "obstacles", "moving"):
            object.__setattr__(self, name, _bodies(getattr(self, name), f"CollisionScene: {name}"))
        on_links = {str(link): _bodies(bodies, f"on_links '{link}'") for link, bodies in dict(self.on_links).items()}
        object.__setattr__(self, "on_links", on_links)
        object.__setattr__(self, "margin", as_scalar(self.margin, "CollisionScene: margin", open_low=False, high=10.0))
        for name in ("without", "ignored", "inside", "decompose"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        margins = {
            as_pair(pair, "CollisionScene: margins"): as_scalar(
                value, f"CollisionScene: margins {shown(pair)}", open_low=False, high=10.0
            )
            for pair, value in dict(self.margins).items()
        }
        object.__setattr__(self, "margins", margins)
        _ = self.built  # everything that can be wrong is found now

    @staticmethod
    def of(scenario: Scenario, **changes: Any) -> CollisionScene:
        """The scene of a scenario: its arms, its object's box named ``"object"``, its obstacles.

        Args:
            scenario: whose bodies they are.
            changes: further arguments, or others in place of the scenario's.
        """
        given = {
            "cell": scenario.cell,
            "grasp": scenario.grasp,
            "carried": [Body("object", Box(scenario.object_size), scenario.T_object_body)],
            "obstacles": scenario.obstacles,
        }
        return CollisionScene(**{**given, **changes})

    @cached_property
    def built(self) -> BuiltScene:
        """The bodies in Pinocchio's terms."""
        return _build(self)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all bodies."""
        return tuple(dict.fromkeys(self.built.names))

    @property
    def pairs(self) -> tuple[tuple[str, str], ...]:
        """Pairs of names that keep a distance, in a fixed order."""
        return tuple(dict.fromkeys(self.built.labels))

    @property
    def notes(self) -> tuple[str, ...]:
        """Remarks for the user: meshes whose hulls are much larger than themselves, and what convex parts leave out."""
        return tuple(self.built.notes.values())

    def distances(self, q: Any) -> tuple[NearPair, ...]:
        """Distances of all pairs of names at a configuration (nq,), the nearest first [m]."""
        x = self.cell.check_configuration(q, "CollisionScene: q")
        found: dict[tuple[str, str], float] = {}
        for label, d in zip(self.built.labels, Distances(self.built).all(x).tolist(), strict=True):
            found[label] = min(d, found.get(label, np.inf))
        return tuple(NearPair(*label, d) for label, d in sorted(found.items(), key=lambda item: item[1]))

    def along(self, way: CellTrajectory, *, any_start: bool = False) -> ClearanceCheck:
        """Distances along a way that is checked before the motion; see :func:`coopqp.check_path`."""
        return check_clearance(self.built, way, any_start=any_start)

    def evading(self, way: CellTrajectory) -> tuple[Array, Array] | None:
        """The way with the self-motion of redundant arms that keeps bodies apart; None if no self-motion does.

        Returns:
            places on the way (K,) and joint positions (K, nv).
        """
        return evading_trajectory(self.built, way)

    def clear_choice(self, ways: Sequence[Array]) -> tuple[int, ...] | None:
        """One way for each arm, the best first; together they keep all margins at the samples. None if no ways do.

        Args:
            ways: joint positions of each arm along its ways (B, K, its joints) [rad or m].
        """
        return clear_choice(self.built, ways)

    @property
    def labels(self) -> tuple[tuple[str, str], ...]:
        """Names of the bodies of each pair of shapes, P of them."""
        return self.built.labels

    @property
    def starts_inside(self) -> Array:
        """Pairs that may start inside their margin (P,), and come no closer then."""
        return np.asarray(self.built.inside)

    def required_at(self, starts: Array) -> tuple[Array, Array]:
        """Required distances (P,) [m], where pairs may start inside their margin as at ``starts`` (M, nv), and levers.

        Levers (P,) are finite for pairs of the object and a body that stands: no motion of an arm changes these.
        """
        built = self.built
        required = np.where(built.moves, -np.inf, built.margins)  # where bodies move to nobody knows
        if built.inside.any():
            distances = Distances(built)
            for x in starts:
                found = distances.all(self.cell.configuration(x))
                required = np.where(built.inside, np.minimum(required, found), required)
        return required, built.levers

    @cached_property
    def _core_shapes(self) -> dict[str, Any]:
        return core_shapes(self.cell.model, self.built.geometry)

    def edges(self, arms: Sequence[ArmKinematics], grasp: Grasp, limits: EdgeLimits) -> Edges:
        """Edges of a search for a way of these arms among the bodies."""
        return Edges(self.built, self._core_shapes, arms, grasp, limits)

    @cached_property
    def _gaps(self) -> ObjectGaps:
        return ObjectGaps(self.built, self.grasp)

    def pushed(self, T_world_object: pin.SE3, along: Array, required: Array) -> pin.SE3 | None:
        """A pose pushed across a line until the object keeps its distances from what stands; None if it does not.

        Args:
            T_world_object: the pose.
            along: unit vector of the line (3,), along which it is not pushed.
            required: distance of each pair (P,) [m].
        """
        return self._gaps.pushed(T_world_object, along, required)

    def widened(self, clearance: float) -> CollisionScene:
        """The same bodies, which keep so much more than their margins [m]."""
        margins = {pair: margin + clearance for pair, margin in self.margins.items()}
        return replace(self, margin=self.margin + clearance, margins=margins)

    def standing(self, places: Mapping[str, pin.SE3]) -> CollisionScene:
        """The same bodies, of which those that move stand at places in the world, or where they are by default."""
        stand = [replace(body, placement=places.get(body.name, body.placement)) for body in self.moving]
        return replace(self, obstacles=(*self.obstacles, *stand), moving=())

    def of_cell(self, cell: RobotCell, grasp: Grasp) -> CollisionScene:
        """The same bodies about other arms or another grasp."""
        return replace(self, cell=cell, grasp=grasp)

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name not in ("built", "_gaps", "_core_shapes")}


def _bodies(bodies: Any, where: str) -> tuple[Body, ...]:
    if isinstance(bodies, Body):
        raise InvalidInputError("one Body", where, "Give a list of them.")
    found = tuple(bodies)
    for body in found:
        require(body, Body, where, "Give a list of Body.")
    return found


def _build(scene: CollisionScene) -> BuiltScene:
    on_links = [body for bodies in scene.on_links.values() for body in bodies]
    others = (*scene.carried, *scene.obstacles, *on_links)
    shapes = ConvexShapes(scene.cell, others, scene.moving, scene.decompose)
    parts = [*_links(scene, shapes), *_others(scene, shapes)]
    if len(parts) < 2:
        raise InvalidInputError(
            "fewer than two shapes",
            "CollisionScene",
            "Take arms with collision shapes, or give bodies: on_links, obstacles, carried.",
        )
    _check_names(scene, parts)
    model, geometry = scene.cell.model, pin.GeometryModel()
    for i, part in enumerate(parts):
        shape = pin.GeometryObject(f"{i}: {part.name}", part.joint, part.T_joint_shape, part.geometry)
        shape.parentFrame = part.frame
        geometry.addGeometryObject(shape)
    one_robot = OneRobot(scene.cell)
    known = Names([part.name for part in parts], scene.cell.arm_names, one_robot.copies(parts))
    pairs = _pairs(scene, parts, one_robot, known)
    levers_of = Levers(scene.cell, parts)
    kinds, reach = np.zeros((len(pairs), scene.cell.nv)), np.zeros((len(pairs), scene.cell.nv))
    for row, (i, j) in enumerate(pairs):
        geometry.addCollisionPair(pin.CollisionPair(i, j))
        for joint, way in levers_of.between(i, j).items():
            v = int(model.joints[joint].idx_v)
            kinds[row, v] = 1.0 if joint in levers_of.chains[j] else -1.0
            reach[row, v] = way * (1.0 + _MORE)
    levers = [
        min(parts[i].lever, parts[j].lever) if 0 in (parts[i].joint, parts[j].joint) else np.inf for i, j in pairs
    ]
    names = tuple(part.name for part in parts)
    labels = tuple((names[i], names[j]) for i, j in pairs)
    margins, inside = np.full(len(pairs), scene.margin), known.pairs(scene.inside, "CollisionScene: inside")
    for pair, margin in scene.margins.items():
        meant = known.pairs([pair], "CollisionScene: margins")
        margins[[frozenset(label) in meant for label in labels]] = margin
    return BuiltScene(
        scene.cell,
        geometry,
        names,
        labels,
        kinds,
        reach,
        margins,
        np.array([frozenset(label) in inside for label in labels], dtype=bool),
        np.array(levers) * (1.0 + _MORE),
        tuple(scene.moving),
        tuple(i for i, part in enumerate(parts) if part.moving),
        {**_without_shapes(scene.cell, parts), **shapes.notes},
    )


def _without_shapes(cell: RobotCell, parts: Sequence[Part]) -> dict[str, str]:
    """Remarks on arms of which nothing is there to keep a distance from."""
    moved = {cell.arm_of_joint(cell.model.joints[p.joint].idx_v) for p in parts if p.joint and not p.object}
    there = {p.name.partition("/")[0] for p in parts} | {cell.arm_names[k] for k in moved}
    return {name: f"arm {name} {NO_SHAPES}" for name in cell.arm_names if name not in there}


def _check_names(scene: CollisionScene, parts: Sequence[Part]) -> None:
    """Shapes of one name are one body and keep no distance: they have to stand on one link, or be one object."""
    known: dict[str, tuple[int, bool, bool]] = {}
    for part in parts:
        if part.name == "*" or part.name in scene.cell.arm_names:
            raise InvalidInputError(
                f"a body is named '{part.name}'",
                "CollisionScene",
                "Give it another name: this one stands for several bodies where pairs are named.",
            )
        own, before = (0 if part.object else part.joint, part.object, part.moving), known.get(part.name)
        known[part.name] = own
        if before is not None and (before != own or part.moving):  # what moves has one place
            raise InvalidInputError(
                f"two bodies are named '{part.name}'",
                "CollisionScene",
                "Give each a name of its own: shapes of one name are one body and keep no distance from each other.",
            )


def _links(scene: CollisionScene, convex: ConvexShapes) -> list[Part]:
    """The arms' own shapes, and those that the user put on links."""
    model, parts = scene.cell.model, []
    shapes = list(scene.cell.collision_model().geometryObjects)
    links = [model.frames[shape.parentFrame].name for shape in shapes]
    known, without = Names(links, scene.cell.arm_names), set[str]()
    for pattern in scene.without:
        without |= known.matching(pattern, "CollisionScene: without")
    for shape, link in zip(shapes, links, strict=True):
        if link in without:
            continue
        at = shape.parentJoint, shape.parentFrame, shape.placement
        parts += [Part(link, *at, geometry) for geometry in convex.of(link, shape.geometry, link)]
    for link, bodies in scene.on_links.items():
        if not model.existFrame(link):
            raise UnknownNameError("link", link, sorted(set(links)), "CollisionScene: on_links")
        frame = model.getFrameId(link)
        for body in bodies:
            at = model.frames[frame].parentJoint, frame, model.frames[frame].placement * body.placement
            parts += [Part(body.name, *at, geometry) for geometry in convex.of_body(body)]
    return parts


def _others(scene: CollisionScene, convex: ConvexShapes) -> list[Part]:
    """The object, as each arm carries it, and the surroundings.

    All arms carry the object to one place, up to the chain's error. With the links of an arm goes the object as that
    arm carries it, with all else as the first one does: so a distance depends on as few joints as it can.
    """
    cell = scene.cell
    parts = []
    for body, geometry in [(b, g) for b in scene.carried for g in convex.of_body(b)]:
        T = as_placement(body.placement, body.name)
        lever = reach_of(geometry, T.rotation, T.translation)
        for joint, frame, T_joint_tool, X in zip(
            cell.tool_joints, cell.tool_frames, cell.T_joint_tool, scene.grasp.T_object_tool, strict=True
        ):
            placement = T_joint_tool * X.inverse() * body.placement
            parts.append(Part(body.name, joint, frame, placement, geometry, object=True, lever=lever))
    for bodies, moving in ((scene.obstacles, False), (scene.moving, True)):
        parts += [Part(b.name, 0, 0, b.placement, g, moving=moving) for b in bodies for g in convex.of_body(b)]
    return parts


def _one_chain(a: str, b: str, robot_of: dict[str, str]) -> bool:
    """Whether links of two arms are of one: of the same one, or one link is of what an arm shares with others."""
    return bool(a) and (a == b or robot_of.get(a) == b or robot_of.get(b) == a)


def _pairs(scene: CollisionScene, parts: Sequence[Part], one_robot: OneRobot, known: Names) -> list[tuple[int, int]]:
    """Numbers of the parts that keep a distance. What is on the world is one body, but for bodies that move.

    Parts that no driven joint moves to each other keep none: nothing that the arms do changes it.
    """
    cell, model = scene.cell, scene.cell.model
    left_out = known.pairs(scene.ignored, "CollisionScene: ignored")
    for arm, source in scene.srdf.items():
        cell.index(arm)
        names = srdf_pairs(source, f"CollisionScene: srdf of arm '{arm}'")
        before = list(itertools.product(one_robot.names_of(arm), repeat=2))
        left_out |= {known.pair(f"{x}/{a}", f"{y}/{b}") for a, b in names for x, y in before}
    owners = [one_robot.owners(part) for part in parts]
    driven = frozenset(int(j) for tool in cell.tool_joints for j in model.supports[tool])
    carriers = [frozenset(joints_to(model, part.joint)) & driven for part in parts]
    depth = [len(joints_to(model, part.joint)) for part in parts]
    arm_of = [model.frames[part.frame].name.partition("/")[0] if part.frame else "" for part in parts]
    robot_of = {name: arm.robot for name, arm in zip(cell.arm_names, cell.arms, strict=True) if arm.shared}
    holds = {name: len(joints_to(model, joint)) for name, joint in zip(cell.arm_names, cell.tool_joints, strict=True)}
    found = []
    for i, a in enumerate(parts):
        for j in range(i + 1, len(parts)):
            b = parts[j]
            if (a.joint == b.joint and not (a.object ^ b.object)) or a.name == b.name:
                continue
            if carriers[i] == carriers[j] and not (a.object ^ b.object or a.moving or b.moving):
                continue
            if a.name in known.copies or b.name in known.copies or known.pair(a.name, b.name) in left_out:
                continue
            if a.object or b.object:
                link = j if a.object else i
                if a.object and b.object:
                    continue
                carrier = arm_of[i] if a.object else arm_of[j]
                own = arm_of[link] in cell.arm_names  # else of the world, or of links that arms share
                if carrier != (arm_of[link] if own else cell.arm_names[0]):
                    continue
                if own and holds[arm_of[link]] - depth[link] < scene.rules.object_apart:
                    continue
            elif abs(depth[i] - depth[j]) < scene.rules.apart and (
                _one_chain(arm_of[i], arm_of[j], robot_of) or arm_of[i] in owners[j] or arm_of[j] in owners[i]
            ):
                continue
            found.append((i, j))
    return found
