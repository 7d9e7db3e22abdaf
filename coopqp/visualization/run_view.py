"""A run as a 3D scene of viser: the objects, their poses at each sample, and marks for binding limits.

The scene has no windows, buttons or files. :mod:`coopqp.visualization.viewer` shows it, live or as a page.
"""

from __future__ import annotations

from collections import defaultdict
from typing import Any

import numpy as np
import pinocchio as pin

from coopqp.checks import require
from coopqp.model.cell import RobotCell
from coopqp.model.limits import BindingLimit, LimitKind
from coopqp.simulation.evaluation import metrics
from coopqp.simulation.evaluation.metrics import Readings, read_run
from coopqp.simulation.recording.recording import Recording
from coopqp.simulation.recording.scene import read_object, read_path
from coopqp.spatial import Array
from coopqp.visualization.binding_words import Why
from coopqp.visualization.renderer import Camera, Solid, body_solids, mesh_of, name_places, object_solids
from coopqp.visualization.run_marks import ForceArrows, NearestLine, has_forces

Colour = tuple[int, int, int]

#: Colour of joints and arms with binding limits.
ALERT: Colour = (214, 30, 30)
_OBJECT: Colour = (76, 132, 191)
_PATH: Colour = (0, 114, 178)
_GOAL: Colour = (120, 126, 134)
_STICK: Colour = (90, 98, 108)
#: Opacity of an object that forces are drawn in.
_CLEAR = 0.5
#: The grid of the floor, on a white and on a black page.
_GRID_FINE: Colour = (176, 181, 187)
_GRID: Colour = (140, 146, 154)
#: Largest number of points of the drawn path.
_PATH_POINTS = 200
#: Elevation, azimuth and field of view of the camera [deg].
_ELEVATION, _AZIMUTH, FIELD_OF_VIEW = 24.0, 125.0, 38.0
#: Share of the picture that the scene fills, and the smallest ratio of width to height.
_FILL, _ASPECT = 0.84, 1.2


class Stage:
    """The arms, the object, its path and its goal in a viser scene.

    Attributes:
        recording: the run.
        cell: cell of the run, read from the recording.
        readings: errors of the run over time.

    Raises:
        SceneError: the recording does not describe its cell, or a mesh file is missing.
    """

    def __init__(self, scene: Any, recording: Recording, *, sticks: bool = False) -> None:
        require(recording, Recording, "viewer: recording", "Give a Recording, as simulate() returns it.")
        self.recording = recording
        self.cell: RobotCell = recording.cell(shapes=not sticks)
        self.readings: Readings = read_run(self.cell, recording)
        self._scene = scene
        self._data = self.cell.model.createData()
        self._why = Why(recording)
        self._links: dict[int, Any] = {}  # frame of each joint with shapes
        self._meshes: dict[int, list[tuple[Any, Colour]]] = defaultdict(list)  # by joint
        self._sticks: list[tuple[Any, list[int]]] = []
        self._names: list[Any] = []
        self._shown: tuple[Any, ...] = ()  # marked limits
        size, T_object_body = read_object(recording.metadata, recording.T_object_tool)
        blue = (_OBJECT[0] / 255, _OBJECT[1] / 255, _OBJECT[2] / 255)
        self._carried, self._corners_of_object = object_solids(recording.metadata, size, T_object_body, blue)
        self._path = read_path(recording.metadata) or self._followed()
        self._bodies = body_solids(recording.metadata)
        self._standing: list[tuple[str, Any, Colour]] = []  # all bodies by name, to mark them
        self._cloud = self._points()
        self.low, self.high = self._cloud.min(axis=0), self._cloud.max(axis=0)
        self._add_floor()
        self._add_arms()
        self._add_object()
        self._add_path()
        self._add_bodies()
        self._nearest = NearestLine(scene, recording.metadata, ALERT)
        diagonal = float(np.linalg.norm(self.high - self.low))
        self._forces = ForceArrows(scene, self.cell, recording, diagonal)
        self.show(0)

    def _followed(self) -> list[pin.SE3]:
        """The followed part of the path, for recordings without the whole path."""
        samples = np.unique(np.linspace(0, self.recording.n_steps, _PATH_POINTS).astype(int))
        return [pin.SE3(self.recording.reference[i]) for i in samples]

    # -- the scene -----------------------------------------------------------------------------------------------

    def _points(self) -> Array:
        """Points (n, 3) [m]: bases; joints and names at the start, middle and end; corners of the object."""
        corners = self._corners_of_object
        points = []
        for i in {0, self.recording.n_steps // 2, self.recording.n_steps}:
            pin.forwardKinematics(self.cell.model, self._data, self.recording.q[i])
            points += [T.translation for T in list(self._data.oMi)[1:]]
            points += list(name_places(self.cell, self.recording.q[i]))
        for pose in [*self._path[:: max(1, len(self._path) // 8)], self._path[-1]]:
            points += list(corners @ pose.rotation.T + pose.translation)
        points += [arm.T_world_base.translation for arm in self.cell.arms]
        points += [corner for solid in self._bodies for corner in solid.vertices]
        return np.array([*points, *self._corners()])

    def _corners(self) -> list[Array]:
        """Corners (3,) [m] of the boxes around all shapes at the start."""
        pin.forwardKinematics(self.cell.model, self._data, self.recording.q[0])
        found: list[Array] = []
        for item in self.cell.visual_model().geometryObjects:
            item.geometry.computeLocalAABB()
            around = item.geometry.aabb_local
            T = self._data.oMi[int(item.parentJoint)] * item.placement
            cube = np.stack(np.meshgrid(*zip(around.min_, around.max_, strict=True)), axis=-1).reshape(-1, 3)
            found += [corner for corner in cube @ T.rotation.T + T.translation if np.isfinite(corner).all()]
        return found

    def camera(self) -> tuple[Array, Array]:
        """Camera position and target (3,) [m] that show the whole scene."""
        points = self._cloud
        target = 0.5 * (points.min(axis=0) + points.max(axis=0))
        right, up, away = Camera(target, _AZIMUTH, _ELEVATION, distance=0.0).axes
        # Needed distance of the camera for a point: its depth towards the camera plus its offset / slope.
        slope = _FILL * np.tan(np.deg2rad(0.5 * FIELD_OF_VIEW))
        offsets = points - target
        needed = np.maximum(np.abs(offsets @ up), np.abs(offsets @ right) / _ASPECT) / slope
        return target + float(np.max(offsets @ away + needed)) * away, target

    def _add_floor(self) -> None:
        middle, span = 0.5 * (self.low + self.high), float(np.max(self.high - self.low)) + 1.5
        bases = [arm.T_world_base.translation[2] for arm in self.cell.arms]
        self._scene.add_grid(
            "/floor",
            width=span,
            height=span,
            cell_size=0.1,
            section_size=0.5,
            cell_color=_GRID_FINE,
            section_color=_GRID,
            cell_thickness=0.4,
            section_thickness=0.7,
            position=(middle[0], middle[1], min([0.0, *bases]) - 1e-3),
        )

    def _add_arms(self) -> None:
        visual = self.cell.visual_model()
        drawn: set[str] = set()
        for item in visual.geometryObjects:
            mesh = mesh_of(item.geometry)
            if mesh is None:
                continue
            vertices, triangles = mesh
            joint, T = int(item.parentJoint), item.placement
            red, green, blue = (round(255 * float(c)) for c in np.asarray(item.meshColor)[:3])
            self._add_mesh(joint, item.name, vertices @ T.rotation.T + T.translation, triangles, (red, green, blue))
            drawn.add(item.name.split("/", 1)[0])
        for name, joints in zip(self.cell.arm_names, self.cell.v_slices, strict=True):
            own = list(range(joints.start + 1, joints.stop + 1))
            if name not in drawn:
                handle = self._scene.add_line_segments(
                    f"/sticks/{name}",
                    np.zeros((len(own) + 1, 2, 3)),
                    colors=_STICK,
                    thickness=7.0,
                    thickness_units="screen",
                )
                self._sticks.append((handle, own))
        for name, place in zip(self.cell.arm_names, name_places(self.cell, self.recording.q[0]), strict=True):
            label = self._scene.add_label(f"/names/{name}", _title(name), position=place, anchor="bottom-center")
            self._names.append(label)

    def _add_mesh(self, joint: int, name: str, vertices: Array, triangles: Any, colour: Colour) -> None:
        """Add a mesh in the frame of a joint."""
        if joint not in self._links:
            self._links[joint] = self._scene.add_frame(f"/links/{joint}", show_axes=False)
        place = f"/links/{joint}/{name.replace('/', '_')}"
        mesh = self._scene.add_mesh_simple(place, *_compact(vertices, triangles), color=colour, flat_shading=True)
        self._meshes[joint].append((mesh, colour))

    def _add_object(self) -> None:
        self._object = self._scene.add_frame("/object", axes_length=0.16, axes_radius=0.006, origin_radius=0.012)
        for i, solid in enumerate(self._carried):
            self._add_solid(f"/object/body {i}" if i else "/object/body", solid)
        self._grasps = [
            self._scene.add_frame(
                f"/object/grasp {name}", axes_length=0.11, axes_radius=0.004, origin_radius=0.009,
                wxyz=_wxyz(X), position=X.translation,
            )
            for name, X in zip(self.cell.arm_names, self.recording.grasp.T_object_tool, strict=True)
        ]  # fmt: skip

    def _add_solid(self, place: str, solid: Solid) -> None:
        """Add a body that can be marked."""
        red, green, blue = (round(255 * c) for c in solid.colour)
        inside = place.startswith("/object") and has_forces(self.recording)  # forces point into the object
        mesh = _compact(solid.vertices, solid.triangles)
        look = {"color": (red, green, blue), "opacity": _CLEAR if inside else None, "flat_shading": True}
        handle = self._scene.add_mesh_simple(place, *mesh, **look)
        self._standing.append((solid.name, handle, (red, green, blue)))

    def _add_path(self) -> None:
        """Add the lines of the object frame's origin and of the grasps, and outlines of the object at both ends."""
        poses = self._path
        points = [np.zeros(3), *(X.translation for X in self.recording.grasp.T_object_tool)]
        for k, point in enumerate(points):
            line = np.array([T.act(point) for T in poses], dtype=np.float32)
            if float(np.linalg.norm(np.ptp(line, axis=0))) > 1e-6:
                segments = np.stack([line[:-1], line[1:]], axis=1)
                width = 2.0 if k else 4.5
                self._scene.add_line_segments(
                    f"/path/line {k}", segments, colors=_PATH, thickness=width, thickness_units="screen"
                )
        corners = self._corners_of_object
        edges = [(i, i ^ bit) for i in range(8) for bit in (1, 2, 4) if not i & bit]
        for name, T in (("start", poses[0]), ("end", poses[-1])):
            world = (corners @ T.rotation.T + T.translation).astype(np.float32)
            self._scene.add_line_segments(
                f"/path/{name}",
                np.array([[world[a], world[b]] for a, b in edges]),
                colors=_GOAL,
                thickness=1.5,
                thickness_units="screen",
            )

    def _add_bodies(self) -> None:
        """Add what stands in the world."""
        for i, solid in enumerate(self._bodies):
            self._add_solid(f"/bodies/{i}", solid)

    # -- a sample ------------------------------------------------------------------------------------------------

    def show(self, sample: int) -> None:
        """Move the scene to a sample (0 to T) of the run, and mark the joints and arms with binding limits."""
        self._nearest.show(float(self.recording.time[sample]))
        self._forces.show(sample)
        grasps = None if self.recording.shift is None else self.recording.grasps_at(sample)
        self.place(self.recording.q[sample], self._why.limits(sample), grasps)

    def place(self, q: Array, limits: tuple[BindingLimit, ...], grasps: tuple[pin.SE3, ...] | None = None) -> pin.SE3:
        """Move the arms to ``q`` (nq,) and the object with them, and mark joints and arms with binding limits.

        ``grasps`` are T_object_tool of all arms where tools have moved on the object; None: as at the start.

        Returns:
            T_world_object.
        """
        pin.forwardKinematics(self.cell.model, self._data, q)
        for joint, frame in self._links.items():
            _place(frame, self._data.oMi[joint])
        for handle, joints in self._sticks:
            handle.points = self._stick_points(joints)
        held = self.recording.grasp.T_object_tool if grasps is None else grasps
        pose: pin.SE3 = metrics.tool_placements(self.cell, [q])[0][0] * held[0].inverse()
        _place(self._object, pose)
        if grasps is not None:
            for handle, X in zip(self._grasps, grasps, strict=True):
                _place(handle, X)
        for label, place in zip(self._names, name_places(self.cell, q), strict=True):
            label.position = place
        if limits != self._shown:
            self._mark(limits)
            self._shown = limits
        return pose

    def put_object(self, pose: pin.SE3) -> None:
        """Show the object at another pose than in the first arm's hand: before a run the arms may not reach it."""
        _place(self._object, pose)

    def _stick_points(self, joints: list[int]) -> Array:
        """Ends of the sticks of an arm, from its base along the joints to the tool (n, 2, 3)."""
        arm = self.cell.arm_of_joint(joints[0] - 1)
        places = [self._data.oMi[j].translation for j in joints]
        parents = [int(self.cell.model.parents[j]) for j in joints]
        base = self.cell.arms[arm].T_world_base.translation
        before = [self._data.oMi[p].translation if p else base for p in parents]
        last = self._data.oMi[self.cell.tool_joints[arm]]
        tool = (last * self.cell.T_joint_tool[arm]).translation
        return np.array([*zip(before, places, strict=True), (last.translation, tool)], dtype=np.float32)

    def _mark(self, limits: tuple[BindingLimit, ...]) -> None:
        """Colour the arms with binding limits (their joints strongest) and write the limits under their names.

        Of two bodies that come too close the links' arms and the bodies that stand in the world are coloured.
        """
        close = {name for limit in limits for name in limit.between}
        for name, mesh, colour in self._standing:
            mesh.color = _blend(colour, 0.6 if name in close else 0.0)
        for arm, own in enumerate(self.cell.v_slices):
            name = self.cell.arm_names[arm]
            bound = [limit for limit in limits if _concerns(limit, name)]
            if not bound and not any(_concerns(limit, name) for limit in self._shown):
                continue
            self._names[arm].text = "\n".join([_title(name), *(_short(limit, name) for limit in bound)])
            joints = range(own.start + 1, own.stop + 1)
            strong = {j for j in joints if self.cell.joint_names[j - 1] in {f"{b.arm}/{b.joint}" for b in bound}}
            share = {j: 0.0 if not bound else 1.0 if j in strong else 0.45 for j in joints}
            for j in joints:
                for mesh, colour in self._meshes[j]:
                    mesh.color = _blend(colour, share[j])
            for handle, sticks in self._sticks:
                if sticks[0] == joints[0]:
                    colours = [_blend(_STICK, share[j]) for j in [*sticks, sticks[-1]]]
                    handle.colors = np.repeat(np.array(colours, dtype=np.uint8)[:, None, :], 2, axis=1)


def _concerns(limit: BindingLimit, arm: str) -> bool:
    """Whether a limit is the arm's, or a distance of one of its links."""
    return limit.arm == arm or any(name.startswith(f"{arm}/") for name in limit.between)


def _compact(vertices: Array, triangles: Any) -> tuple[Any, Any]:
    """A mesh in 32 bits; vertices that are equal in them are one."""
    points, index = np.unique(np.asarray(vertices, dtype=np.float32), axis=0, return_inverse=True)
    return points, index.reshape(-1)[np.asarray(triangles)].astype(np.uint32)


def _title(arm: str) -> str:
    return arm.replace("_", " ")


def _short(limit: BindingLimit, arm: str) -> str:
    """A limit under the name of an arm."""
    if limit.between:
        own = next(name for name in limit.between if name.startswith(f"{arm}/"))
        other = next((name for name in limit.between if name != own), own)
        return f"! {own.partition('/')[2]} near {other}".replace("_", " ")
    what = limit.name if limit.kind is LimitKind.CONSTRAINT else limit.kind.value
    return f"! {limit.joint.replace('_', ' ')} {what}".replace("!  ", "! ")


def _blend(colour: Colour, share: float) -> Colour:
    """``colour`` mixed with a share of the alert colour."""
    red, green, blue = (round((1.0 - share) * a + share * b) for a, b in zip(colour, ALERT, strict=True))
    return red, green, blue


def _place(frame: Any, T: pin.SE3) -> None:
    frame.wxyz = _wxyz(T)
    frame.position = T.translation


def _wxyz(T: pin.SE3) -> Array:
    x, y, z, w = pin.Quaternion(T.rotation).coeffs()
    return np.array([w, x, y, z])
