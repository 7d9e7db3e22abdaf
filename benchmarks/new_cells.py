"""From arms that nobody has placed to a certified cell file with its picture: `coopqp new`, then `coopqp check`.

Each pair of arms begins in an empty folder. URDFs that no package has are written from published kinematics. With
``--wheel FILE`` a wheel is installed into an empty environment first, with the extra ``robots``, and its command is the
one that is timed; without, that of this environment. See benchmarks/README.md.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import common
from common import Record
from written_urdfs import ARMS, urdf

KEYS = ("cell", "commands", "seconds", "cpu_s", "verdict", "least_margin", "picture", "target_s", "good")
#: The arms of each pair: URDF files that are written, or names of robots.
PAIRS = {
    "two_iiwa14": ("iiwa14", "iiwa14"),
    "two_xarm7": ("xarm7", "xarm7"),
    "gen3_and_ur5e": ("gen3", "ur5e"),
    "gantry_and_panda": ("gantry", "panda"),
}
QUICK = ("two_xarm7", "gantry_and_panda")
#: Targets: time without downloads [s], and commands.
MOST_S, MOST_COMMANDS = 60.0, 2


def environment(wheel: Path, folder: Path) -> tuple[Path, float]:
    """The command ``coopqp`` of a fresh environment with a wheel, and how long that took [s]."""
    began = time.perf_counter()
    uv = str(Path(sys.executable).with_name("uv"))
    subprocess.run([uv, "venv", "--quiet", "--python", sys.executable, str(folder)], check=True)
    python = folder / "bin" / "python"
    what = f"coopqp[robots] @ {wheel.resolve().as_uri()}"
    subprocess.run([uv, "pip", "install", "--quiet", "--python", str(python), what], check=True)
    return python.with_name("coopqp"), time.perf_counter() - began


def made(name: str, arms: tuple[str, ...], program: Path, folder: Path) -> Record:
    """The record of one pair, made in an empty folder."""
    asked = []
    for arm in arms:
        if arm in ARMS:
            (folder / f"{arm}.urdf").write_text(urdf(arm), encoding="utf-8")
        asked += ["--arm", f"{arm}.urdf" if arm in ARMS else arm]
    commands = [["new", name, *asked, "--quiet"], ["check", f"{name}.toml"]]
    before, began = os.times(), time.perf_counter()
    done = [
        subprocess.run([str(program), *command], cwd=folder, capture_output=True, text=True, check=False)
        for command in commands
    ]
    seconds, after = time.perf_counter() - began, os.times()
    lines = done[-1].stdout.splitlines() or [*done[0].stderr.splitlines(), *done[1].stderr.splitlines()][-1:]
    margins = [line.partition("least margin ")[2].partition(" (")[0] for line in lines if "least margin" in line]
    verdict, picture = lines[0], (folder / f"{name}.png").is_file()
    certified = verdict == "CERTIFIED" and not any(process.returncode for process in done)
    return {
        "cell": name,
        "commands": len(commands),
        "seconds": round(seconds, 1),
        "cpu_s": round(after.children_user + after.children_system - before.children_user - before.children_system, 1),
        "verdict": verdict,
        "least_margin": "; ".join(margins),
        "picture": picture,
        "target_s": MOST_S,
        "good": bool(certified and picture and seconds <= MOST_S and len(commands) <= MOST_COMMANDS),
    }


def main(argv: list[str] | None = None) -> int:
    """Make the cells and print their records. Returns 1 if one misses a target."""
    parser = common.arguments(__doc__.partition("\n")[0])
    parser.add_argument("--wheel", type=Path, metavar="FILE", help="a wheel of coopqp for an empty environment")
    options = parser.parse_args(argv)
    names = QUICK if options.quick else tuple(PAIRS)
    description = common.describe("New cells", {"pairs": len(names), "wheel": bool(options.wheel)})
    print(common.header(description))
    records: list[Record] = []
    with tempfile.TemporaryDirectory() as place:
        program = Path(sys.executable).with_name("coopqp")
        if options.wheel is not None:
            program, seconds = environment(options.wheel, Path(place) / "environment")
            print(f"the wheel was installed with what it needs in {seconds:.1f} s, downloads as far as not kept")
        for name in names:
            folder = Path(place) / name
            folder.mkdir()
            records.append(made(name, PAIRS[name], program, folder))
    table = common.markdown_table(records, KEYS)
    print(table)
    common.save(records, description, json_file=options.json, out=options.out, files={"new_cells.md": table.encode()})
    return int(not all(record["good"] for record in records))


if __name__ == "__main__":
    sys.exit(main())
