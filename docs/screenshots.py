"""Screenshots for the pages: what a browser shows of a run.  python docs/screenshots.py viewer --out FOLDER

``jog`` is a moving picture of the operator's page: a run in simulation is shown on it step by step.
"""

from __future__ import annotations

import argparse
import itertools
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from browser import NAMES, Page, Picture, find_browser
from PIL import Image

from coopqp import ControlStep, QPController, Recording, simulate
from coopqp.cli.main import main as coopqp_command
from coopqp.cli.runs import obtain_task
from coopqp.scenarios import at_limit
from coopqp.simulation import Event, describe_object, operating
from coopqp.visualization import export_html
from coopqp.visualization.jog.page import JogPage
from coopqp.visualization.jog.seen import Seen

TRACK = "[class*=Slider-track]"
#: Where frames are slow viser draws more coarsely, unless the address says how finely.
_FINELY = "?fixedDpr=1"
#: Time between two looks at a page, each of which draws it [s].
_SELDOM = 0.7


def run_at_limit() -> Recording:
    """Three arms that stop because a joint of one is at its limit."""
    task = at_limit()
    box = describe_object(task.object_size, task.T_object_body)
    controller = QPController(task.cell, task.grasp, task.path, dt=task.dt)
    metadata = {"scenario": task.name, "object": box}
    return simulate(controller, q_start=task.q_start, duration=1.5, metadata=metadata)


def view_at_limit(file: Path) -> Path:
    """The same cell before it runs, as `coopqp view` writes it."""
    if coopqp_command(["view", "at_limit", "--html", str(file), "--quiet"]):
        raise SystemExit("coopqp view failed")
    return file


def _drawn(picture: Picture) -> bool:
    """True if there is a scene in the middle of the page."""
    height, width = picture.shape[:2]
    middle = picture[height // 3 : -height // 5, width // 4 : -width // 4]
    return bool(middle.std() > 5.0)


def _browser() -> str:
    program = find_browser()
    if program is None:
        raise SystemExit(f"no browser ({', '.join(NAMES)}); 'make browser' installs one")
    return program


def _without_notes(page: Page) -> None:
    """Close what the browser says of its graphics."""
    page.evaluate("document.querySelectorAll('[class*=Notification-root] button').forEach(b => b.click())")


def operated() -> list[Seen]:
    """A run that is stopped, led by hand and led back, as the page shows it: a picture each 0.3 s."""
    task, seen = obtain_task("dual_arm7"), list[Seen]()
    controller = task.controller()
    every, dt = round(0.3 / controller.dt), controller.dt
    twists = [(1.6, (0.0, 0.0, 0.12, 0.0, 0.0, 0.0)), (2.4, (0.08, 0.0, 0.0, 0.0, 0.0, 0.4))]
    calls = [(0.8, "pause", None), (3.6, "return_to_path", None), (4.6, "forward", None)]
    calls += [(begin + 0.04 * i, "jog", [list(v), "world", 0.1]) for begin, v in twists for i in range(20)]
    events = [Event(round(time / dt), call, value) for time, call, value in calls]
    steps = 0

    def observe(step: ControlStep) -> None:
        nonlocal steps
        if steps % every == 0:
            seen.append(Seen.of(step, controller, time=steps * dt))
        steps += 1

    simulate(controller, q_start=task.q_start, duration=7.0, observe=observe, operate=operating(events))
    return seen


def _palette() -> Image.Image:
    """Grey values, then colours at even distances: the same for each run, unlike one that is made from the pictures."""
    greys = [(v, v, v) for v in np.linspace(0, 255, 76).round().astype(int).tolist()]
    red, green, blue = (np.linspace(0, 255, n).round().astype(int).tolist() for n in (6, 6, 5))
    image = Image.new("P", (1, 1))
    image.putpalette([v for colour in (*greys, *itertools.product(red, green, blue)) for v in colour])
    return image


def shoot_jog(picture: Path, *, width: int = 880, height: int = 470) -> None:
    """The operator's page while an object is led, as a moving picture."""
    frames: list[Picture] = []
    shown = JogPage(obtain_task("dual_arm7").at_start(), lambda *_, **__: None, port=0)
    with (
        tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder,
        Page(_browser(), Path(folder) / "profile", width=width, height=height) as page,
    ):
        page.open(shown.url + _FINELY)
        page.wait_until(lambda: page.evaluate("document.body?.innerText.includes('Return')"))
        page.wait_until(lambda: _drawn(page.screenshot()), timeout=90)
        _without_notes(page)
        page.settled()

        def wait_for_text(text: str) -> None:
            page.wait_until(lambda: text in page.evaluate("document.body.innerText"))

        for seen in operated():
            shown.show(seen)
            wait_for_text(seen.lines()[0])
            frames.append(page.settled(every=0.3))
    shown.close()
    images = [Image.fromarray(frame.astype("uint8")) for frame in frames]
    palette = _palette()
    small = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    spans = [300] * (len(small) - 1) + [1500]
    small[0].save(picture, save_all=True, append_images=small[1:], duration=spans, loop=0, optimize=True)


def shoot(
    write: Callable[[Path], Path], picture: Path, *, share: float | None, width: int = 1100, height: int = 640
) -> None:
    """A picture of a page, with the slider at a share of its time; None for a page that stands still.

    Args:
        write: writes the page to a file.
        picture: the picture's file.
    """
    program = _browser()
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:  # the browser ends later
        file = write(Path(folder) / "page.html")
        with Page(program, Path(folder) / "profile", width=width, height=height) as page:
            drawn = _shot(page, file, share)
        Image.fromarray(drawn.astype("uint8")).quantize(200).save(picture, optimize=True)


def _shot(page: Page, file: Path, share: float | None) -> Picture:
    page.open(file.as_uri() + _FINELY)
    page.wait_until(lambda: page.evaluate(f"!!document.querySelector('{TRACK}')"))
    page.wait_until(lambda: page.evaluate("!!document.querySelector('canvas')"))
    page.wait_until(lambda: _drawn(page.screenshot()), timeout=90, every=_SELDOM)
    _without_notes(page)
    if share is not None:
        page.pause()
        track = page.box(TRACK)
        page.press(track["left"] + share * track["width"], track["top"] + 0.5 * track["height"])
    return page.settled(every=_SELDOM)


#: Pictures by the name of the command.
PICTURES: dict[str, Callable[[Path], None]] = {
    "viewer": lambda out: shoot(lambda file: export_html(run_at_limit(), file), out / "viewer.png", share=0.3),
    "cell": lambda out: shoot(view_at_limit, out / "view_cell.png", share=None),
    "jog": lambda out: shoot_jog(out / "jog.gif"),
}

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Screenshots for the pages.")
    parser.add_argument("picture", choices=PICTURES)
    parser.add_argument("--out", type=Path, required=True, metavar="FOLDER")
    parser.add_argument("--if-browser", action="store_true", help="draw nothing where no browser is")
    arguments = parser.parse_args()
    if find_browser() is not None or not arguments.if_browser:
        PICTURES[arguments.picture](arguments.out)
