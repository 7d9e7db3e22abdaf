"""Picture of a way round: the object along it, both trees, the straight way, clearance and joint margins."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin

from coopqp.collision.coal_geometry import geometry_of
from coopqp.collision.scene import CollisionScene
from coopqp.errors import InvalidInputError
from coopqp.model.batch import ArmKinematics
from coopqp.model.shapes import Body
from coopqp.paths.path import LinePath
from coopqp.planning.check import PathCheck, check_path
from coopqp.planning.route.route import Route
from coopqp.spatial import Array
from coopqp.visualization.renderer import Solid, View, cell_solids, mesh_of, render
from coopqp.visualization.style import INK, RED, label, new_figure, plain

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_WIDTH, _PIXELS = 10.0, 760
#: Places of the object along the way that are drawn.
GHOSTS = 7
_OBJECT, _GHOST, _BODY = (0.20, 0.42, 0.68), (0.78, 0.85, 0.93), (0.80, 0.72, 0.58)
_WAY, _TREES = "#1f5fa8", ("#2e8b57", "#b06a00")


def route_figure(route: Route, *, azimuth: float = 60.0, elevation: float = 28.0) -> Figure:
    """The object along the way, pale between its ends; below, the least distance and joint margin over the way.

    The straight way is red, with the pair that touches on it; both trees are thin.

    Args:
        route: an answer with a way.
        azimuth, elevation: direction of the view [deg].

    Raises:
        InvalidInputError: there is no way, or its bodies are no :class:`coopqp.CollisionScene`.
        MissingExtraError: Matplotlib is not installed.
    """
    check, path = route.check, route.path
    if check is None or path is None or route.poses is None or route.joints is None or check.q_start is None:
        raise InvalidInputError("there is no way", "route_figure", "Give a route that is found.")
    scene = check.scene
    if not isinstance(scene, CollisionScene):
        raise InvalidInputError("its bodies are no CollisionScene", "route_figure", "Give a route among one.")
    start, goal = path.pose(0.0), path.pose(path.duration)
    line = LinePath(start, goal, duration=1.0)
    straight = check_path(check.cell, check.grasp, line, q_start=check.q_start, scene=scene)
    solids = _solids(scene, check, route)
    way = route.poses[:, 9:]
    ends = np.array([start.translation, goal.translation])
    view = View.around([solids], azimuth=azimuth, elevation=elevation)
    picture = render([solids], view, width=_PIXELS)[0]
    height, width = picture.shape[:2]
    shown = _WIDTH * height / width
    figure = new_figure(_WIDTH, shown + 2.6)
    axes = figure.add_axes((0.0, 2.6 / (shown + 2.6), 1.0, shown / (shown + 2.6)))
    axes.imshow(picture, aspect="auto", extent=(0.0, width, height, 0.0))
    axes.set(xlim=(0.0, width), ylim=(height, 0.0))
    axes.set_axis_off()

    def draw(points: Array, **style: Any) -> None:
        axes.plot(*view.pixels(points, width, height)[:, :2].T, **style)

    for edges, colour in zip(route.trees, _TREES, strict=False):
        for edge in edges:
            draw(edge, color=colour, lw=0.6)
    draw(ends, color=RED, lw=2.0, label=label(_blocked(straight), width=100))
    draw(way, color=_WAY, lw=2.4, label=f"way round, {route.length:.2f} m")
    axes.legend(loc="upper left", frameon=False, labelcolor=INK)
    _curves(figure, route, check, bottom=2.6 / (shown + 2.6))
    return figure


def _blocked(straight: PathCheck) -> str:
    """What is said of the straight way."""
    clearance = straight.clearance
    if clearance is None or clearance.stopped_by is None or clearance.pair is None:
        return f"straight way: {straight.verdict.value.lower()}"
    pair = clearance.pair
    return f"straight way: {pair.first} and {pair.second} {'touch' if pair.distance <= 0.0 else 'come too close'}"


def _solids(scene: CollisionScene, check: PathCheck, route: Route) -> list[Solid]:
    """The arms at the start, the bodies, and the object along the way."""
    assert route.poses is not None
    assert check.q_start is not None
    solids = cell_solids(check.cell, [check.q_start])[0]
    solids += [solid for body in scene.obstacles for solid in drawn_body(body, _BODY)]
    own = [solid for body in scene.carried for solid in drawn_body(body, _GHOST)]
    marks = np.unique(np.linspace(0, len(route.poses) - 1, GHOSTS).astype(int))
    for i, row in enumerate(route.poses[marks]):
        T = pin.SE3(row[:9].reshape(3, 3), row[9:])
        colour = _OBJECT if i in (0, len(marks) - 1) else _GHOST
        solids += [Solid(s.vertices, s.triangles, colour, s.name).placed(T) for s in own]
    return solids


def drawn_body(body: Body, colour: tuple[float, float, float]) -> Sequence[Solid]:
    """Solids of a body at its placement."""
    mesh = mesh_of(geometry_of(body.shape, body.name))
    return [] if mesh is None else [Solid(*mesh, colour, body.name).placed(pin.SE3(body.placement))]


def _curves(figure: Figure, route: Route, check: PathCheck, *, bottom: float) -> None:
    """The least distance, and the least joint margin of each arm, over the way."""
    assert route.path is not None
    assert route.joints is not None
    s = np.linspace(0.0, route.length, 400)
    clocks = route.path.clocks(s)
    left = figure.add_axes((0.08, 0.2 * bottom, 0.38, 0.68 * bottom))
    right = figure.add_axes((0.58, 0.2 * bottom, 0.38, 0.68 * bottom))
    if check.clearance is not None and check.clearance.pair is not None:
        at = np.interp(check.clearance.clocks, clocks, s)
        left.plot(at, 1e3 * check.clearance.distances, color=_WAY)
        left.axhline(1e3 * check.clearance.margin, color=RED, ls="--", lw=1.0)
    left.set(xlabel="way [m]", ylabel="least distance [mm]", ylim=(0.0, None))
    shares = np.linspace(0.0, route.length, len(route.joints))
    for arm, own in zip(check.cell.arms, check.cell.v_slices, strict=True):
        kinematics = ArmKinematics(arm)
        q = route.joints[:, own.start + kinematics.columns]
        right.plot(shares, np.rad2deg(kinematics.margins(q).min(axis=1)), label=label(arm.name))
    right.set(xlabel="way [m]", ylabel="least joint margin [deg]", ylim=(0.0, None))
    right.legend(frameon=False, fontsize=8)
    for panel in (left, right):
        plain(panel)
