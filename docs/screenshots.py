"""Screenshots for the pages: what a browser shows of a run.  python docs/screenshots.py viewer --out FOLDER"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable
from pathlib import Path

from browser import NAMES, Page, Picture, find_browser
from PIL import Image

from coopqp import QPController, Recording, simulate
from coopqp.cli.main import main as coopqp_command
from coopqp.scenarios import at_limit
from coopqp.simulation import describe_object
from coopqp.visualization import export_html

TRACK = "[class*=Slider-track]"


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


def shoot(
    write: Callable[[Path], Path], picture: Path, *, share: float | None, width: int = 1100, height: int = 640
) -> None:
    """A picture of a page, with the slider at a share of its time; None for a page that stands still.

    Args:
        write: writes the page to a file.
        picture: the picture's file.
    """
    program = find_browser()
    if program is None:
        raise SystemExit(f"no browser ({', '.join(NAMES)}); 'make browser' installs one")
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:  # the browser ends later
        file = write(Path(folder) / "page.html")
        with Page(program, Path(folder) / "profile", width=width, height=height) as page:
            page.open(file.as_uri())
            page.wait_until(lambda: page.evaluate(f"!!document.querySelector('{TRACK}')"))
            page.wait_until(lambda: page.evaluate("!!document.querySelector('canvas')"))
            page.wait_until(lambda: _drawn(page.screenshot()), timeout=90)
            page.evaluate("document.querySelectorAll('[class*=Notification-root] button').forEach(b => b.click())")
            if share is not None:
                page.pause()
                track = page.box(TRACK)
                page.press(track["left"] + share * track["width"], track["top"] + 0.5 * track["height"])
            Image.fromarray(page.settled().astype("uint8")).quantize(200).save(picture, optimize=True)


#: Pictures by the name of the command.
PICTURES: dict[str, Callable[[Path], None]] = {
    "viewer": lambda out: shoot(lambda file: export_html(run_at_limit(), file), out / "viewer.png", share=0.3),
    "cell": lambda out: shoot(view_at_limit, out / "view_cell.png", share=None),
}

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Screenshots for the pages.")
    parser.add_argument("picture", choices=PICTURES)
    parser.add_argument("--out", type=Path, required=True, metavar="FOLDER")
    arguments = parser.parse_args()
    PICTURES[arguments.picture](arguments.out)
