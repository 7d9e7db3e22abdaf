"""The gallery of the pages: one list of cells and tasks, and all that is drawn and written of them.

    python docs/gallery.py --out FOLDER     draw the thumbnails (python docs/pictures.py puts them in their place)
    python docs/gallery.py --page           write docs/gallery.md, with what `coopqp check` says now
    python docs/gallery.py                  make the pages in 3D (make docs does this)

A new cell is one more line in ENTRIES. A run gives a thumbnail and a page in 3D, which are kept below build; those that
are up to date stay. The pages in 3D are no part of the repository. Viser's program, nine tenths of such a page, stands
once beside them all, in viewer.js: also a page that is opened from a folder, without a server, loads it from there.
"""

from __future__ import annotations

import argparse
import contextlib
import fcntl
import hashlib
import io
import itertools
import json
import os
import re
import shutil
import warnings
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from PIL import Image, ImageDraw

import coopqp
from coopqp import Recording
from coopqp.cli.main import main as coopqp_command
from coopqp.cli.runs import obtain_run
from coopqp.errors import StartWarning
from coopqp.files.cellfile import CELLS, example_path
from coopqp.simulation import tool_placements
from coopqp.simulation.recording.scene import read_object, read_path
from coopqp.spatial import Array
from coopqp.visualization import View, cell_solids, render
from coopqp.visualization.renderer import body_solids, object_solids
from coopqp.visualization.viewer import run_page

DOCS = Path(__file__).parent
PAGE = DOCS / "gallery.md"
#: What the pages take with them, its pages in 3D below it, and the thumbnails.
BUILT = DOCS.parent / "build" / "gallery"
PAGES_3D, THUMBNAILS = BUILT / "3d", BUILT.with_name("gallery_thumbnails")
#: Width and height of a thumbnail [px], of lines in it, and how many times finer lines are drawn.
SIZE, LINE, FINER = (640, 400), 3, 3
_OBJECT, _WAY, _ENDS, _MARKS = (0.20, 0.42, 0.68), "#d1495b", "#4a4f57", "#ffc53d"
#: A tool that moves by less on the object holds it [m].
_HOLDS = 1e-3
#: Corners of the upper face of a box, as a closed line.
_FACE = (1, 3, 7, 5, 1)


@dataclass(frozen=True)
class Entry:
    """A cell or a task of the gallery.

    Attributes:
        name: of a cell file that comes with coopqp, or of a scenario.
        robots: its arms; entries of the same robots stand together.
        title: what it shows, in the field's words.
        sentence: what happens.
        more: a page about it, with its title, as Markdown.
        share: of the run, at which it is drawn.
        azimuth, elevation: direction to the camera [deg].
    """

    name: str
    robots: str
    title: str
    sentence: str
    more: str
    share: float = 0.7
    azimuth: float = 125.0
    elevation: float = 22.0

    @property
    def source(self) -> str:
        """What the commands take: a cell file, or the name of a scenario."""
        return str(example_path(self.name)) if self.name in CELLS else self.name


RX90, SEVEN, RAILS = "Stäubli RX-90L", "Seven-joint arms", "Torso, rail and gantry"
MAKES, KNOWN, FEW = "KUKA, ABB, and makes together", "Franka Panda and Universal Robots", "Four and five joints"
ENTRIES = (
    Entry("paper_lift", RX90, "Cooperative manipulation: three arms, one plate",
          "Three arms lift a plate by 30 cm and turn it by 40° in 3 s.", "[Tutorial 1](tutorials/1-paper-lift.md)"),
    Entry("at_limit", RX90, "Joint limits: the object stops before the arms part",
          "The path leads beyond a joint's range; all arms brake together ahead of it.",
          "[At a limit](tutorials/4-at-a-limit.md)"),
    Entry("plate_and_post", RX90, "Collision avoidance on the path",
          "A post hangs above the plate, which stops below it.",
          "[Collision avoidance](tutorials/8-nothing-touches.md)"),
    Entry("palm_box", RX90, "Friction grasp: a box between open palms",
          "Two arms press a box between their palms and lift it in the physics engine.",
          "[Frictional contacts](howto/palms.md)"),
    Entry("base_off_lift", RX90, "Force control: hold without squeezing",
          "A base stands off its place; the arms measure the forces that follow and give way.",
          "[Force control](tutorials/9-hold-without-squeezing.md)"),
    Entry("bar_with_pins", RX90, "Passive joints: grips that turn",
          "Two arms turn a bar on upright pins by 86°, further than with rigid grips.",
          "[A part that opens](tutorials/15-a-part-that-opens.md)"),
    Entry("pliers", RX90, "Articulated object: open a part in flight",
          "Three arms lift a part of two halves, open it round its pin on the way, and close it.",
          "[A part that opens](tutorials/15-a-part-that-opens.md)"),
    Entry("draw_on_plate", RX90, "Process on a carried part",
          "Two arms carry a plate, a third draws a square on it meanwhile.",
          "[Work on a carried part](tutorials/16-work-on-a-carried-part.md)"),
    Entry("regrasp_plate", RX90, "Regrasping: let go and grasp again",
          "An arm lets go of the plate, takes it at another place, and all three lift it.",
          "[Let go, and grasp again](tutorials/17-grasp-again.md)"),
    Entry("positioner", RX90, "Positioner: weld a seam on a turntable",
          "A turntable turns the part under a torch, which goes along by a quarter of the angle.",
          "[A positioner](tutorials/18-a-positioner.md)", azimuth=60.0, elevation=35.0),
    Entry("conveyor", RX90, "Conveyor tracking",
          "A belt carries a part past an arm, which goes along and draws a line on it.",
          "[A conveyor sets the pace](tutorials/12-conveyor.md)", azimuth=60.0, elevation=35.0),
    Entry("ring", RX90, "Eight arms round one plate",
          "Eight arms at equal distances lift one plate; each carries its part.",
          "[Load distribution](howto/load.md)", elevation=35.0),
    Entry("kuka_lift", MAKES, "Three KUKA KR 16-2",
          "The paper's lift by larger robots, on the same path.", "[Your own arms](tutorials/2-your-own-arms.md)"),
    Entry("mixed_lift", MAKES, "A KUKA, a Stäubli and an ABB",
          "A KR 16-2, an RX-90L and an IRB 1600 on pedestals lift one plate.",
          "[Your own arms](tutorials/2-your-own-arms.md)"),
    Entry("mixed_cell", MAKES, "Four different arms, one on a rail",
          "Arms of six joints, of seven, and of six on a rail move one plate.",
          "[Redundant arms](tutorials/3-redundant-arms.md)"),
    Entry("bar", SEVEN, "Waypoints: a bar along two legs",
          "Two arms carry a bar along two legs, every joint limited to 60 °/s.",
          "[Describe a cell in a file](howto/cell-file.md)"),
    Entry("bar_over_post", SEVEN, "Path planning: a way round an obstacle",
          "A post stands in the straight way of the bar; a way over it is searched and proved.",
          "[A way round](tutorials/10-a-way-round.md)", azimuth=65.0, share=0.5),
    Entry("elbow_and_knob", SEVEN, "Null-space motion: an elbow evades a knob",
          "The bar keeps to its path, and the elbow of one arm makes room.",
          "[Collision avoidance](tutorials/8-nothing-touches.md)"),
    Entry("panda_and_ur5", KNOWN, "A Panda and a UR5 face each other",
          "They turn a board while they lift it.", "[Four cells](howto/four-cells.md)"),
    Entry("pandas_and_ur5s", KNOWN, "Two Pandas and two UR5 on a table top",
          "They hold it near its corners, lift it and tilt it.", "[Four cells](howto/four-cells.md)"),
    Entry("two_ur10", KNOWN, "Two UR10 carry a bar",
          "A bar of 0.8 m goes up and to the side.", "[Four cells](howto/four-cells.md)"),
    Entry("ur5_table", KNOWN, "Four UR5 and a table top of 12 kg",
          "They stand along its long sides and move it.", "[Load distribution](howto/load.md)"),
    Entry("torso_lift", RAILS, "Dual-arm robot with a lift",
          "Lift and arms together raise a bar by 1.5 m: more than the arms can at any one height.",
          "[Dual-arm robots](tutorials/14-one-robot-two-arms.md)"),
    Entry("two_on_a_rail", RAILS, "Two arms on one rail",
          "They face each other and carry a bar along the rail by 1.6 m and up.",
          "[Dual-arm robots](tutorials/14-one-robot-two-arms.md)"),
    Entry("gantry_and_ur5", RAILS, "A rail of 2 m beside a UR5",
          "An arm on a rail and a UR5 move a bar along the rail, up and round.", "[Four cells](howto/four-cells.md)"),
    Entry("scara_pair", FEW, "Two SCARA-like arms of four joints",
          "They shift, lift and turn a bar, which stays level.", "[Can my arms?](tutorials/6-can-my-arms.md)"),
)  # fmt: skip


def entry(name: str) -> Entry:
    """The entry of a name."""
    return next(e for e in ENTRIES if e.name == name)


@cache
def run_of(name: str) -> Recording:
    """The run of an entry, made once in a process."""
    return obtain_run(entry(name).source)


# -- thumbnails -----------------------------------------------------------------------------------------------------


def thumbnail(e: Entry) -> Image.Image:
    """Arms and object in mid-run; dashed: the object at its start and its end; the path of its frame in red.

    Where tools move on the object, their ways on it are yellow.
    """
    run = run_of(e.name)
    cell = run.cell()
    sample = round(e.share * run.n_steps)
    samples = sorted({0, sample, run.n_steps})
    drawn = dict(zip(samples, cell_solids(cell, run.q[samples]), strict=True))
    poses = dict(zip(samples, (_pose(run, cell, i) for i in samples), strict=True))
    size, T_object_body = read_object(run.metadata, run.T_object_tool)
    carried, corners = object_solids(run.metadata, size, T_object_body, _OBJECT)
    for i in samples:
        drawn[i] += [*(solid.placed(poses[i]) for solid in carried), *body_solids(run.metadata)]
    path = read_path(run.metadata) or [pin.SE3(T) for T in run.reference]
    view = _widened(View.around(list(drawn.values()), azimuth=e.azimuth, elevation=e.elevation))
    picture = Image.fromarray(render([drawn[sample]], view, width=SIZE[0])[0]).resize(SIZE)
    lines = Image.new("RGBA", (FINER * SIZE[0], FINER * SIZE[1]))
    draw = ImageDraw.Draw(lines)
    for T in (path[0], path[-1]):
        face = view.pixels(corners[list(_FACE)] @ T.rotation.T + T.translation, *lines.size)[:, :2]
        _dashed(draw, face, _ENDS, FINER * LINE // 2)
    for points in _ways_on_object(run):
        marks = view.pixels(points @ poses[sample].rotation.T + poses[sample].translation, *lines.size)[:, :2]
        draw.line([tuple(point) for point in marks.tolist()], fill=_MARKS, width=FINER * LINE, joint="curve")
    way = view.pixels(np.array([T.translation for T in path]), *lines.size)[:, :2]
    draw.line([tuple(point) for point in way.tolist()], fill=_WAY, width=FINER * LINE, joint="curve")
    _arrow_head(draw, way)
    small = lines.resize(SIZE, Image.Resampling.LANCZOS)
    return Image.alpha_composite(picture.convert("RGBA"), small).convert("RGB")


def _pose(run: Recording, cell: Any, sample: int) -> pin.SE3:
    """T_world_object in the hand of the first arm."""
    tool = tool_placements(cell, run.q[sample : sample + 1])[0][0]
    pose: pin.SE3 = tool * run.grasps_at(sample)[0].inverse()
    return pose


def _ways_on_object(run: Recording) -> Iterable[Array]:
    """The way (K, 3) [m] of each tool that moves on the object, in the object frame."""
    samples = range(0, run.n_steps + 1, max(run.n_steps // 200, 1))
    places = np.array([[T.translation for T in run.grasps_at(i)] for i in samples])
    return [way for way in places.swapaxes(0, 1) if np.ptp(way, axis=0).max() > _HOLDS]


def _widened(view: View) -> View:
    """The view with the ratio of width and height of all thumbnails, and a rim."""
    ratio = SIZE[0] / SIZE[1]
    wide, high = view.right - view.left, view.top - view.bottom
    more_x, more_y = max(ratio * high - wide, 0.0) / 2.0, max(wide / ratio - high, 0.0) / 2.0
    return replace(
        view, left=view.left - more_x, right=view.right + more_x, bottom=view.bottom - more_y, top=view.top + more_y
    )


def _dashed(draw: ImageDraw.ImageDraw, points: Array, colour: str, width: int, *, dash: float = 24.0) -> None:
    for a, b in itertools.pairwise(points):
        n = max(round(float(np.linalg.norm(b - a)) / dash), 1)
        for i in range(n):
            ends = [tuple(a + (i + s) / n * (b - a)) for s in (0.2, 0.8)]
            draw.line(ends, fill=colour, width=width)


def _arrow_head(draw: ImageDraw.ImageDraw, way: Array, *, size: float = 11.0 * LINE) -> None:
    """The tip of the path, along its last stretch that can be seen."""
    apart = np.linalg.norm(way - way[-1], axis=1)
    before = np.flatnonzero(apart > size)
    if not len(before):
        return
    along = (way[-1] - way[before[-1]]) / apart[before[-1]]
    across, tip = np.array([-along[1], along[0]]), way[-1] + 0.4 * size * along
    corners = [tip, tip - size * along + 0.45 * size * across, tip - size * along - 0.45 * size * across]
    draw.polygon([tuple(c) for c in corners], fill=_WAY)


# -- the page -------------------------------------------------------------------------------------------------------


def verdict(e: Entry) -> str:
    """What `coopqp check` says of an entry: the verdict, and what is in the way."""
    with contextlib.redirect_stdout(io.StringIO()) as said, contextlib.redirect_stderr(io.StringIO()):
        coopqp_command(["check", e.source])
    word, first, *more = said.getvalue().splitlines()
    if word == "CERTIFIED":
        return "**certified**, distances too" if "keep their distances" in first else "**certified**"
    if word == "INFEASIBLE":
        first = "`" + next(line for line in more if "follows the path" not in line) + "`"
    return f"**{word.lower()}**: {first}"


def page_text(verdicts: dict[str, str]) -> str:
    """The page of the gallery; ``verdicts`` by name."""
    lines = [PAGE.read_text(encoding="utf-8").partition("\n## ")[0].rstrip()]
    for robots in dict.fromkeys(e.robots for e in ENTRIES):
        lines += ["", f"## {robots}"]
        for e in (e for e in ENTRIES if e.robots == robots):
            lines += ["", *_card(e, verdicts[e.name])]
    return "\n".join(lines) + "\n"


def _card(e: Entry, said: str) -> Iterable[str]:
    file = f"../coopqp/scenarios/cells/{e.name}.toml"
    text = f"[TOML]({file})" if e.name in CELLS else f"`coopqp view {e.name}`"
    yield f"### {e.title}"
    yield ""
    yield f"![{e.title}](images/gallery_{e.name}.webp)"
    yield ""
    yield e.sentence
    yield ""
    yield f"`coopqp check`: {said}"
    yield ""
    yield f"<!-- 3d: {e.name} -->{text} · {e.more}"


def verdicts_of_page() -> dict[str, str]:
    """The verdicts that stand on the page."""
    text = PAGE.read_text(encoding="utf-8")
    said = re.findall(r"^`coopqp check`: (.*)\n\n<!-- 3d: (\w+) -->", text, flags=re.M)
    return {name: words for words, name in said}


# -- pages in 3D and thumbnails ---------------------------------------------------------------------------------------


def split_viewer(document: str) -> tuple[str, str]:
    """A page of viser without its program, which it loads from beside it, and that program (viewer.js).

    The program is one script element with its data in attributes. The file makes this element again: pages from a
    folder may load such a file, but no module.
    """
    found = re.search(r"<script((?: data-\w+=\"[^\"]*\")+)>(.*?)</script>", document, flags=re.S)
    if found is None:
        raise RuntimeError("viser's page has another form than that of viser 1.1: see docs/gallery.py")
    attributes = dict(re.findall(r" data-(\w+)=\"([^\"]*)\"", found[1]))
    script = (
        "(() => { const script = document.createElement('script');\n"
        f"Object.assign(script.dataset, {json.dumps(attributes)});\n"
        f"script.textContent = {json.dumps(found[2])};\n"
        "document.head.appendChild(script); })();\n"
    )
    return document[: found.start()] + '<script src="viewer.js"></script>' + document[found.end() :], script


@cache
def made_with() -> str:
    """A digest of all that a page in 3D is made with: this script, the package, and viser."""
    digest = hashlib.sha256(f"{version('viser')} {version('pin')}".encode())
    package = Path(coopqp.__file__).parent
    kinds = ("*.py", "*.toml", "*.cpp", "*.h", "*.html", "*.css", "*.js", "*.urdf")
    for file in (Path(__file__), *sorted(file for kind in kinds for file in package.rglob(kind))):
        digest.update(file.read_bytes())
    return digest.hexdigest()


def files_of(name: str) -> tuple[Path, Path]:
    """The page in 3D of an entry, and its thumbnail."""
    return PAGES_3D / f"{name}.html", THUMBNAILS / f"gallery_{name}.webp"


def make(name: str) -> None:
    """Run an entry; write its page in 3D, and its thumbnail as WebP, below 20 kB."""
    warnings.simplefilter("ignore", StartWarning)  # where an arm starts off its grasp, that is the point
    page, program = split_viewer(run_page(run_of(name)))
    in_3d, picture = files_of(name)
    _write(PAGES_3D / "viewer.js", program)
    _write(in_3d, page)
    thumbnail(entry(name)).save(picture, quality=60, method=6)


def _write(file: Path, text: str) -> None:
    """Write a file whole, or not at all: two processes may do so."""
    beside = file.with_name(f"{file.name}.{os.getpid()}")
    beside.write_text(text, encoding="utf-8")
    beside.replace(file)


def make_all(names: Sequence[str] = ()) -> list[str]:
    """Make pages in 3D and thumbnails that are not up to date. Returns their names.

    A second process that wants the same waits for the first.
    """
    noted = BUILT.with_suffix(".json")
    for folder in (PAGES_3D, THUMBNAILS):
        folder.mkdir(parents=True, exist_ok=True)
    with BUILT.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        known = json.loads(noted.read_text(encoding="utf-8")) if noted.is_file() else {}
        wanted = [e.name for e in ENTRIES if not names or e.name in names]
        stale = [n for n in wanted if known.get(n) != made_with() or not all(f.is_file() for f in files_of(n))]
        with ProcessPoolExecutor(2) as pool:
            for name, _ in zip(stale, pool.map(make, stale), strict=True):
                known[name] = made_with()
                _write(noted, json.dumps(known, indent=1))
        for file in PAGES_3D.glob("*.html"):
            if file.stem not in {e.name for e in ENTRIES}:
                file.unlink()
    return stale


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="The gallery of the pages.")
    parser.add_argument("names", nargs="*", metavar="NAME", help="entries (all)")
    parser.add_argument("--out", type=Path, metavar="FOLDER", help="draw the thumbnails")
    parser.add_argument("--page", action="store_true", help="write docs/gallery.md")
    arguments = parser.parse_args()
    if arguments.page:
        PAGE.write_text(page_text({e.name: verdict(e) for e in ENTRIES}), encoding="utf-8")
    if arguments.out is not None or not arguments.page:
        print("\n".join(make_all(arguments.names)))
    if arguments.out is not None:
        for name in arguments.names or [e.name for e in ENTRIES]:
            shutil.copy(files_of(name)[1], arguments.out)
