"""The moving picture of the README.  python docs/movie.py --out FOLDER

The same lift twice, too fast for joints of 0.3 rad/s: once each arm by itself, once together. The plate is drawn where
each arm has it.
"""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path

import numpy as np
import pinocchio as pin
from matplotlib import font_manager
from PIL import Image, ImageDraw, ImageFont

from coopqp import QPController, Recording, simulate
from coopqp.baselines import IndependentQPController
from coopqp.scenarios import Scenario, paper_lift
from coopqp.simulation import object_error, read_run, tool_placements
from coopqp.spatial import Array
from coopqp.visualization import Solid, View, box_solid, cell_solids, render

#: Frames per second, width of each half [px], and how long the last frame stays [ms].
FPS, WIDTH, REST_MS = 10, 400, 1500
#: The plate as the first, the second and the third arm has it.
COLOURS = ((0.30, 0.52, 0.75), (0.85, 0.45, 0.15), (0.75, 0.20, 0.25))
INK, RED, FAINT = "#222222", "#b00020", "#6a6f78"


def task() -> Scenario:
    """The paper's lift in 1 s instead of 3 s, with slow joints."""
    return paper_lift(time_law="quintic", duration=1.0)


def run(lift: Scenario, kind: type[QPController | IndependentQPController]) -> Recording:
    """The lift by a controller."""
    cell = lift.cell.with_limits(velocity=0.3, acceleration=5.0)
    return simulate(kind(cell, lift.grasp, lift.path, dt=0.005), q_start=lift.q_start)


def scenes(lift: Scenario, recording: Recording, times: Array) -> list[list[Solid]]:
    """The arms and their plates at each time; after the end, as at the end, the very same."""
    samples = np.minimum(np.searchsorted(recording.time, times), recording.n_steps)
    samples, of_time = np.unique(samples, return_inverse=True)
    drawn = cell_solids(lift.cell, recording.q[samples])
    for scene, tools in zip(drawn, tool_placements(lift.cell, recording.q[samples]), strict=True):
        views = [T * X.inverse() * lift.T_object_body for T, X in zip(tools, lift.grasp.T_object_tool, strict=True)]
        apart = any(np.linalg.norm(pin.log6(views[0].actInv(view)).vector) > 1e-4 for view in views)
        scene += map(partial(box_solid, lift.object_size), views if apart else views[:1], COLOURS)
    return [drawn[i] for i in of_time]


def drawn_once(side: list[list[Solid]], view: View) -> list[Array]:
    """A picture of each scene; of scenes that are the same, one."""
    scenes = {id(scene): scene for scene in side}
    pictures = dict(zip(scenes, render(list(scenes.values()), view, width=WIDTH), strict=True))
    return [pictures[id(scene)] for scene in side]


def words(lift: Scenario, recording: Recording, chain: Array, time: float) -> list[tuple[str, str]]:
    """What is written below a half at a time: (text, colour). ``chain``: how far the arms are apart [mm]."""
    k = min(int(np.searchsorted(recording.time, time)), recording.n_steps)
    tools = tool_placements(lift.cell, recording.q[k : k + 1])[0]
    goal, _ = object_error(tools, lift.grasp, lift.path.pose(lift.path.duration))
    worst = chain[: k + 1].max()
    parted = f"arms apart: {chain[k]:.0f} mm, at most {worst:.0f} mm" if worst > 0.1 else "arms apart: below 0.1 mm"
    rate = recording.rate[min(k, recording.n_steps - 1)]
    speed = f"rate {100 * rate:.0f} %" if k < recording.n_steps else f"{1e3 * goal:.1f} mm from the goal"
    return [(parted, RED if worst > 0.1 else INK), (f"{min(time, recording.time[-1]):.1f} s   {speed}", FAINT)]


def film(file: Path) -> Path:
    """Draw the moving picture."""
    lift = task()
    runs = {"each arm alone": run(lift, IndependentQPController), "coopqp": run(lift, QPController)}
    chains = {name: read_run(lift.cell, recording).chain_mm for name, recording in runs.items()}
    times = np.arange(0.0, max(r.time[-1] for r in runs.values()) + 1.0 / FPS, 1.0 / FPS)
    sides = {name: scenes(lift, recording, times) for name, recording in runs.items()}
    view = View.around([scene for side in sides.values() for scene in side[::8]], azimuth=125.0, elevation=22.0)
    pictures = {name: drawn_once(side, view) for name, side in sides.items()}
    height = pictures["coopqp"][0].shape[0]
    font = {
        bold: ImageFont.truetype(
            font_manager.findfont(font_manager.FontProperties(weight="bold" if bold else "normal")), 17 if bold else 14
        )
        for bold in (True, False)
    }
    frames = []
    for i, time in enumerate(times):
        frame = Image.new("RGB", (2 * WIDTH + 8, height + 74), "white")
        pen = ImageDraw.Draw(frame)
        for left, (name, recording) in zip((0, WIDTH + 8), runs.items(), strict=True):
            frame.paste(Image.fromarray(pictures[name][i]), (left, 30))
            pen.text((left + WIDTH / 2, 15), name, INK, font[True], anchor="mm")
            for line, (text, colour) in enumerate(words(lift, recording, chains[name], time)):
                pen.text((left + WIDTH / 2, height + 42 + 20 * line), text, colour, font[False], anchor="mm")
        frames.append(frame)
    palette = frames[len(frames) // 3].quantize(128)
    small = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    spans = [1000 // FPS] * (len(small) - 1) + [REST_MS]
    small[0].save(file, save_all=True, append_images=small[1:], duration=spans, loop=0, optimize=True)
    return file


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="The moving picture of the README.")
    parser.add_argument("--out", type=Path, required=True, metavar="FOLDER")
    film(parser.parse_args().out / "two_lifts.gif")
