"""A way round in the browser: the cell goes along it in one offline page; both trees, the straight way, the bodies."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from coopqp.collision.scene import CollisionScene
from coopqp.control.qp import QPController
from coopqp.errors import InvalidInputError
from coopqp.planning.route.route import Route
from coopqp.simulation.simulate import simulate
from coopqp.visualization.route_plots import GHOSTS, drawn_body
from coopqp.visualization.viewer import export_html

#: Period of the run that is shown [s].
_DT = 0.01
#: Colours of both trees, the straight way and the way.
_TREES, _STRAIGHT, _WAY = ((46, 139, 87), (176, 106, 0)), (176, 0, 32), (31, 95, 168)
_BODY, _GHOST = (204, 184, 148), (199, 217, 237)


def export_route(route: Route, file: str | Path, *, progress: Callable[[int, int], None] | None = None) -> Path:
    """Write a way round as one offline page: a controller leads the object along it, with play, pause and scrub.

    Both trees are thin, the straight way is red, the object is pale at places of the way.

    Args:
        route: an answer with a way, among the bodies of a :class:`coopqp.CollisionScene`.
        file: path of the page.
        progress: called as ``progress(pictures done, pictures)``.

    Raises:
        InvalidInputError: there is no way, or its bodies are no :class:`coopqp.CollisionScene`.
        OutputError: the file cannot be written.
        MissingExtraError: viser is not installed.
    """
    check, path = route.check, route.path
    scene = None if check is None else check.scene
    if check is None or path is None or route.poses is None or not isinstance(scene, CollisionScene):
        raise InvalidInputError(
            "no way among bodies", "export_route", "Give a route that is found, of a CollisionScene."
        )
    controller = QPController(check.cell, check.grasp, path, dt=_DT)
    recording = simulate(controller, q_start=check.q_start, metadata={"name": f"A way round of {route.length:.2f} m"})
    return export_html(recording, file, progress=progress, mark=lambda viewer: _mark(viewer, route, scene))


def _mark(viewer: Any, route: Route, scene: CollisionScene) -> None:
    """Add trees, ways, bodies and the object at places of the way to a scene of viser."""
    assert route.poses is not None
    for k, edges in enumerate(route.trees[:2]):
        if len(edges):
            lines = edges.astype(np.float32)
            viewer.add_line_segments(
                f"/route/tree_{k}", lines, colors=_TREES[k], thickness=1.0, thickness_units="screen"
            )
    way = route.poses[:, 9:]
    for name, points, colour in (("straight", way[[0, -1]], _STRAIGHT), ("way", way, _WAY)):
        lines = np.stack([points[:-1], points[1:]], axis=1).astype(np.float32)
        viewer.add_line_segments(f"/route/{name}", lines, colors=colour, thickness=3.0, thickness_units="screen")
    for body in scene.obstacles:
        for solid in drawn_body(body, (0.0, 0.0, 0.0)):
            viewer.add_mesh_simple(f"/route/{body.name}", solid.vertices, solid.triangles, color=_BODY)
    places = np.unique(np.linspace(0, len(way) - 1, GHOSTS).astype(int))
    for k, row in enumerate(route.poses[places]):
        T = pin.SE3(row[:9].reshape(3, 3), row[9:])
        for body in scene.carried:
            for solid in drawn_body(body, (0.0, 0.0, 0.0)):
                placed = solid.placed(T)
                name = f"/route/place_{k}/{body.name}"
                viewer.add_mesh_simple(name, placed.vertices, placed.triangles, color=_GHOST, opacity=0.35)
