"""The moving picture of a way round.  python docs/route_movie.py --out FOLDER

A bar on its way over a post: both trees thin, the straight way red, the way blue, the bar pale along it.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
from matplotlib import font_manager
from PIL import Image, ImageDraw, ImageFont

from coopqp import CollisionScene, find_path, inverse_kinematics
from coopqp.collision import Body, Capsule
from coopqp.planning import Route
from coopqp.scenarios import Scenario, dual_arm7
from coopqp.spatial import Array
from coopqp.visualization import Solid, View, box_solid, cell_solids, render

#: Frames per second, width [px], how much slower than the motion, ghosts, and how long the last frame stays [ms].
FPS, WIDTH, SLOWER, GHOSTS, REST_MS = 12, 800, 2.5, 5, 1500
_OBJECT, _GHOST, _POST = (0.20, 0.42, 0.68), (0.78, 0.85, 0.93), (0.80, 0.72, 0.58)
_TREES, _WAY, _RED, _INK = ("#2e8b57", "#b06a00"), "#1f5fa8", "#b00020", "#222222"
_HEIGHT, _RADIUS = 0.3, 0.03


def searched() -> tuple[Scenario, Route]:
    """Two seven-joint arms take their bar over a post."""
    task = dual_arm7()
    task = replace(task, cell=task.cell.with_limits(acceleration=10.0))
    start, goal = (pin.SE3(np.eye(3), np.array([0.0, y, 0.3])) for y in (-0.15, 0.15))
    post = Body("post", Capsule(_RADIUS, _HEIGHT), pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.15])))
    scene = CollisionScene.of(task, obstacles=[post])
    q_start = inverse_kinematics(task.cell, task.grasp, start, task.q_start)
    return task, find_path(task.cell, task.grasp, start, goal, scene, q_start=q_start, nodes=1000)


def samples(route: Route) -> tuple[Array, Array]:
    """Joint positions (K, nv) [rad] and poses (K, 12) of the object at even times."""
    path = route.timed().path
    assert route.joints is not None
    assert route.poses is not None
    count = round(FPS * SLOWER * path.duration) + 1
    s = np.array([path.at(clock)[0] for clock in np.linspace(0.0, path.duration, count).tolist()])
    steps = np.hstack([np.diff(route.poses[:, 9:], axis=0), 0.3 * np.diff(route.poses[:, :9], axis=0) / np.sqrt(2.0)])
    marks = np.append(0.0, np.cumsum(np.linalg.norm(steps, axis=1)))
    shares = s / s[-1] * marks[-1]
    x = np.array([np.interp(shares, marks, row) for row in route.joints.T]).T
    nearest = np.abs(marks[None] - shares[:, None]).argmin(axis=1)
    return x, route.poses[nearest]


def _placed(row: Array) -> pin.SE3:
    return pin.SE3(row[:9].reshape(3, 3), row[9:])


def frames(task: Scenario, route: Route) -> list[Image.Image]:
    """The pictures."""
    x, poses = samples(route)
    assert route.poses is not None
    every = np.unique(np.linspace(0, len(route.poses) - 1, GHOSTS).astype(int))
    post = box_solid(
        (2 * _RADIUS, 2 * _RADIUS, _HEIGHT + 2 * _RADIUS), pin.SE3(np.eye(3), np.array([0, 0, 0.15])), _POST
    )
    still: list[Solid] = [post]
    still += [box_solid(task.object_size, _placed(row) * task.T_object_body, _GHOST) for row in route.poses[every]]
    scenes = []
    drawn = cell_solids(task.cell, [task.cell.configuration(row) for row in x])
    for arms, row in zip(drawn, poses, strict=True):
        scenes.append([*arms, *still, box_solid(task.object_size, _placed(row) * task.T_object_body, _OBJECT)])
    view = View.around(scenes, azimuth=65.0, elevation=25.0)
    pictures = render(scenes, view, width=WIDTH)
    return [_annotated(Image.fromarray(picture), view, route) for picture in pictures]


def _annotated(image: Image.Image, view: View, route: Route) -> Image.Image:
    """With the trees, the straight way and the way."""
    width, height = image.size
    draw = ImageDraw.Draw(image)

    def line(points: Array, colour: str, thick: int) -> None:
        pixels = view.pixels(points, width, height)[:, :2]
        draw.line([tuple(map(float, p)) for p in pixels], fill=colour, width=thick)

    for edges, colour in zip(route.trees, _TREES, strict=False):
        for edge in edges:
            line(edge, colour, 1)
    assert route.poses is not None
    way = route.poses[:, 9:]
    line(way[[0, -1]], _RED, 3)
    line(way, _WAY, 3)
    font = ImageFont.truetype(font_manager.findfont("DejaVu Sans"), 18)
    draw.text((10, 8), f"a way round, {route.length:.2f} m, proved", fill=_INK, font=font)
    return image


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description="Draw the moving picture of a way round.")
    parser.add_argument("--out", type=Path, required=True)
    folder: Path = parser.parse_args().out
    folder.mkdir(parents=True, exist_ok=True)
    pictures = [picture.quantize(64) for picture in frames(*searched())]
    still = [round(1000 / FPS)] * (len(pictures) - 1) + [REST_MS]
    pictures[0].save(
        folder / "way_round.gif", save_all=True, append_images=pictures[1:], duration=still, loop=0, optimize=True
    )


if __name__ == "__main__":
    main()
