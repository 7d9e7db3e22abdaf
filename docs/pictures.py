"""Every picture of the pages, and the program that draws it.

    python docs/pictures.py                 draw all pictures anew
    python docs/pictures.py figure5.png     draw one, and those that come with it
    python docs/pictures.py --check         draw them elsewhere, and say how much they differ

A new picture is one more line in PROGRAMS. `tests/project/test_pictures.py` draws all of them and compares. Other
versions of what draws them change letters and edges: DRAWN_WITH holds the versions, and only with these pixels are
compared.
"""

from __future__ import annotations

import argparse
import json
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import version
from pathlib import Path

import numpy as np
from gallery import ENTRIES
from numpy.typing import NDArray
from PIL import Image, ImageSequence

ROOT = Path(__file__).parents[1]

#: The pictures that a program writes into the folder {out}. It runs in the root of the repository.
PROGRAMS: Mapping[str, tuple[str, ...]] = {
    "coopqp demo --quiet --out {out}": ("docs/images/paper_lift.png", "docs/images/figure5.png"),
    "coopqp new new_cell --arm panda --arm xarm7 --quiet --out {out}": ("docs/howto/new_cell.png",),
    "python docs/gallery.py --out {out}": tuple(f"docs/images/gallery_{e.name}.webp" for e in ENTRIES),
    "python docs/movie.py --out {out}": ("docs/images/two_lifts.gif",),
    "python docs/route_movie.py --out {out}": ("docs/images/way_round.gif",),
    "python docs/screenshots.py viewer --out {out}": ("docs/images/viewer.png",),
    "python docs/screenshots.py cell --out {out}": ("docs/images/view_cell.png",),
    "python docs/screenshots.py jog --out {out}": ("docs/images/jog.gif",),
    "python docs/examples/01_paper_lift.py --out {out}": ("docs/tutorials/paper_drift.png",),
    "python docs/examples/02_your_own_arms.py --out {out}": ("docs/tutorials/your_own_arms.png",),
    "python docs/examples/03_redundant_arms.py --out {out}": ("docs/tutorials/elbows.png",),
    "python docs/examples/04_at_a_limit.py --out {out}": ("docs/tutorials/at_a_limit.png",),
    "python docs/examples/05_real_loop.py --out {out}": ("docs/tutorials/real_loop.png",),
    "python docs/examples/06_servo_path.py --out {out}": ("docs/tutorials/servo_path.png",),
    "python docs/examples/07_fault_and_reset.py --out {out}": ("docs/tutorials/fault_and_reset.png",),
    "python docs/examples/08_choose_a_solver.py --out {out}": ("docs/howto/solvers.png",),
    "python docs/examples/09_choose_gains.py --out {out}": ("docs/howto/gains.png",),
    "python docs/examples/10_why_slow.py --out {out}": ("docs/howto/why_slow.png",),
    "python docs/examples/11_export.py --out {out}": ("docs/howto/export.png",),
    "python docs/examples/12_cumulative_errors.py --out {out}": ("docs/images/cumulative_errors.png",),
    "python docs/examples/13_physics.py --out {out}": ("docs/howto/physics.png",),
    "python docs/examples/15_find_a_start.py --out {out}": ("docs/howto/branches.png",),
    "python docs/examples/16_constraints.py --out {out}": ("docs/howto/constraints.png",),
    "python docs/examples/17_reins.py --out {out}": ("docs/howto/reins.png",),
    "python docs/examples/18_can_my_arms.py --out {out}": ("docs/tutorials/can_my_arms.png",),
    "python docs/examples/19_bases_and_rolls.py --out {out}": ("docs/howto/bases.png",),
    "python docs/examples/20_as_fast_as_possible.py --out {out}": ("docs/tutorials/speed_profile.png",),
    "python docs/examples/21_four_cells.py --out {out}": ("docs/howto/four_cells.png",),
    "python docs/examples/22_cell_file.py --out {out}": ("docs/howto/cell_file.png",),
    "python docs/examples/23_nothing_touches.py --out {out}": ("docs/tutorials/nothing_touches.png",),
    "python docs/examples/24_share_the_load.py --out {out}": ("docs/howto/load_use.png",),
    "python docs/examples/25_calibrate.py --out {out}": ("docs/howto/calibration.png",),
    "python docs/examples/26_hold_without_squeezing.py --out {out}": ("docs/tutorials/forces.png",),
    "python docs/examples/27_sweep.py --out {out}": (
        "docs/howto/gains_and_noise.png",
        "docs/howto/speed_and_grasp.png",
    ),
    "python docs/examples/28_place_the_bases.py --out {out}": ("docs/howto/h_and_b.png",),
    "python docs/examples/29_palms.py --out {out}": ("docs/howto/palms.png",),
    "python docs/examples/30_torque_drives.py --out {out}": ("docs/howto/torque_drives.png",),
    "python docs/examples/31_a_way_round.py --out {out}": ("docs/tutorials/way_round.png",),
    "python docs/examples/32_operator.py --out {out}": ("docs/tutorials/operator.png",),
    "python docs/examples/33_conveyor.py --out {out}": ("docs/tutorials/conveyor.png",),
    "python docs/examples/37_pliers.py --out {out}": ("docs/tutorials/pliers.png",),
    "python docs/examples/38_draw_on_a_plate.py --out {out}": ("docs/tutorials/draw_on_a_plate.png",),
    "python docs/examples/39_grasp_again.py --out {out}": ("docs/tutorials/grasp_again.png",),
    "python docs/examples/40_positioner.py --out {out}": ("docs/tutorials/positioner.png",),
    "python docs/examples/34_slowest_arm.py --out {out}": ("docs/howto/drive.png",),
    "python docs/examples/36_one_robot.py --out {out}": ("docs/tutorials/one_robot.png",),
}
#: Programs of this kind need Chromium (`make browser`).
NEEDS_BROWSER = "docs/screenshots.py"
#: Versions of what drew the pictures, as a file.
DRAWN_WITH = ROOT / "docs" / "images" / "drawn_with.json"
#: Largest accepted share of pixels that differ, and the difference of a colour [of 255] from which a pixel does.
MOST_PIXELS, VISIBLE = 0.01, 16


def draw(program: str, into: Path) -> list[Path]:
    """Run a program of :data:`PROGRAMS`. Returns its pictures in ``into``, in their order.

    Raises:
        RuntimeError: the program fails, or it does not write one of its pictures.
    """
    run(program, into)
    drawn = [into / Path(picture).name for picture in PROGRAMS[program]]
    missing = [file.name for file in drawn if not file.is_file()]
    if missing:
        raise RuntimeError(f"{program} does not write {', '.join(missing)}")
    return drawn


def run(program: str, into: Path) -> str:
    """Run a program with ``into`` for {out}. Returns what it prints.

    Raises:
        RuntimeError: the program fails.
    """
    command = [word.format(out=into) for word in shlex.split(program)]
    if command[0] == "coopqp":
        command = ["python", "-c", "import sys; from coopqp.cli.main import main; sys.exit(main())", *command[1:]]
    environment = {**os.environ, "MPLBACKEND": "Agg", "OMP_NUM_THREADS": "1", "PYTHONIOENCODING": "utf-8"}
    done = subprocess.run(
        [sys.executable, *command[1:]],
        cwd=ROOT, env=environment, capture_output=True, text=True, encoding="utf-8", timeout=900, check=False,
    )  # fmt: skip
    if done.returncode:
        raise RuntimeError(f"{program}: {done.stderr or done.stdout}")
    return done.stdout


def versions() -> dict[str, str]:
    """What draws pictures here, and the engine they tell of: each with the first two numbers of its version."""
    return {name: ".".join(version(name).split(".")[:2]) for name in ("matplotlib", "viser", "mujoco")}


def drawn_alike() -> bool:
    """Whether the pictures of the pages were drawn with the versions that are installed."""
    kept: dict[str, str] = json.loads(DRAWN_WITH.read_text(encoding="utf-8"))
    return kept == versions()


def difference(one: Path, other: Path) -> float:
    """Share of the pixels that differ visibly, over all images of a moving picture; 1 for other sizes.

    An edge that has moved by one pixel, as from one browser's run to the next, is no difference.
    """
    a, b = _pixels(one), _pixels(other)
    if a.shape != b.shape:
        return 1.0
    return float(max(np.mean([_unlike(i, j) for i, j in zip(*pair, strict=True)]) for pair in ((a, b), (b, a))))


def _unlike(image: NDArray[np.int16], other: NDArray[np.int16]) -> float:
    """Share of an image's pixels to which no pixel of another is alike, at the same place or beside it."""
    height, width = image.shape[:2]
    around = np.pad(other, ((1, 1), (1, 1), (0, 0)), mode="edge")
    shifts = [around[y : y + height, x : x + width] for y in range(3) for x in range(3)]
    return float(np.mean(np.min([np.abs(image - s).max(axis=-1) for s in shifts], axis=0) >= VISIBLE))


def _pixels(file: Path) -> NDArray[np.int16]:
    """Colours on white (images, height, width, 3)."""
    with Image.open(file) as picture:
        images = [image.convert("RGBA") for image in ImageSequence.Iterator(picture)]
    whites = (Image.new("RGBA", image.size, "white") for image in images)
    flat = [Image.alpha_composite(w, i).convert("RGB") for w, i in zip(whites, images, strict=True)]
    return np.stack([np.asarray(image, dtype=np.int16) for image in flat])


def _main(arguments: argparse.Namespace) -> int:
    known = {Path(picture).name: program for program, pictures in PROGRAMS.items() for picture in pictures}
    unknown = [name for name in arguments.names if name not in known]
    if unknown:
        print(f"no picture '{unknown[0]}'; known: {', '.join(known)}", file=sys.stderr)
        return 2
    wanted = list(dict.fromkeys(known[name] for name in arguments.names or known))
    worst = 0.0
    if not arguments.check and not arguments.names:
        DRAWN_WITH.write_text(json.dumps(versions(), indent=1) + "\n", encoding="utf-8")
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(2) as pool:
        drawn = pool.map(lambda n: draw(wanted[n], _made(Path(folder) / str(n))), range(len(wanted)))
        for old, new in _pairs(wanted, drawn):
            share = difference(old, new) if old.exists() else 1.0
            worst = max(worst, share)
            print(f"{old.relative_to(ROOT)}: {100.0 * share:.2f} % of its pixels differ", flush=True)
            if not arguments.check and share > 0.0:
                _keep(new, old)
    return 1 if arguments.check and worst > MOST_PIXELS else 0


def _keep(new: Path, old: Path) -> None:
    """Put a new picture in its place; a PNG with 256 colours, which makes it small."""
    if new.suffix != ".png":
        shutil.copyfile(new, old)
        return
    with Image.open(new) as picture:
        picture.convert("RGB").quantize(256, dither=Image.Dither.NONE).save(old, optimize=True)


def _pairs(programs: Iterable[str], drawn: Iterable[list[Path]]) -> Iterable[tuple[Path, Path]]:
    for program, files in zip(programs, drawn, strict=True):
        yield from ((ROOT / old, new) for old, new in zip(PROGRAMS[program], files, strict=True))


def _made(folder: Path) -> Path:
    folder.mkdir()
    return folder


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Draw the pictures of the pages anew.")
    parser.add_argument("names", nargs="*", metavar="NAME", help="file names of pictures (all)")
    parser.add_argument("--check", action="store_true", help="change nothing; fail if a picture differs")
    sys.exit(_main(parser.parse_args()))
