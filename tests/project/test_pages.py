"""Every command line and every block of code on the README and the pages runs as it stands.

Listings of files, and blocks that show the output of an example, are compared in test_docs. A block of an unknown kind,
or a line with an unknown program, fails: it cannot be left out.
"""

from __future__ import annotations

import contextlib
import io
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable
from importlib.metadata import metadata
from pathlib import Path

import pytest
from listings import LISTING
from places import CELL_FILES as CELLS, ROOT

from coopqp import ControlStep, Program, load_cell_file
from coopqp.cli import demo, main as cli
from coopqp.drivers.real_time import RealTimeRun
from coopqp.scenarios import robot_file
from coopqp.simulation import Tolerances
from coopqp.visualization import plots

PAGES = [ROOT / "README.md", ROOT / "benchmarks" / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
BLOCK = re.compile(r"^```(\S+)[^\n]*\n(.*?)^```$", re.M | re.S)
#: Languages that are shown only: outputs and diagrams.
SHOWN = {"text", "{eval-rst}", "{toctree}"}
#: Programs of others, with the lines in which they may stand.
OTHERS = {"qpbenchmark": "benchmarks/README.md", "cd": "benchmarks/README.md"}

#: What stands around a piece of a program: before it, and after it.
AROUND = {
    "tutorials/10-a-way-round.md": (
        "import numpy as np, pinocchio as pin\n"
        "from coopqp import Clearance, CollisionScene, QPController, Replanner\n"
        "from coopqp.collision import Body, Capsule\n"
        "from coopqp.scenarios import dual_arm7\n"
        "task = dual_arm7()\n"
        "T_world_cart = pin.SE3(np.eye(3), np.array([0.0, 0.0, -2.0]))\n"
        "cart = Body('cart', Capsule(0.03, 0.3), T_world_cart)\n"
        "scene = CollisionScene.of(task, moving=[cart])\n"
        "controller = QPController(task.cell, task.grasp, task.path, dt=0.01, constraints=[Clearance(scene)])\n"
        "controller.reset(task.q_start)\n"
        "step = controller.step()\n",
        "assert step.finished\n",
    ),
    "howto/reins.md": (
        "from coopqp import LinePath, QPController, Status\n"
        "from coopqp.scenarios import paper_lift\n"
        "lift = paper_lift(time_law='quintic')\n"
        "controller = QPController(lift.cell, lift.grasp, lift.path, dt=0.005)\n"
        "controller.reset(lift.q_start)\n"
        "here = lift.path.pose(0.0)\n"
        "here.translation[2] += 0.005\n"
        "path = LinePath.displaced(here, translation=(0.0, 0.0, 0.1), duration=1.0)\n",
        "while not (step := controller.step()).finished: pass\nassert step.status is Status.TRACKING\n",
    ),
    "howto/constraints.md": (
        "",
        "from coopqp import QPController, simulate\n"
        "from coopqp.scenarios import paper_lift\n"
        "lift = paper_lift(time_law='quintic')\n"
        "cell = lift.cell.with_limits(acceleration=5.0)\n"
        "free = simulate(QPController(cell, lift.grasp, lift.path, dt=0.01), q_start=lift.q_start)\n"
        "data, still = cell.model.createData(), np.zeros(cell.nv)\n"
        "weights = [np.abs(pin.rnea(cell.model, data, q, still, still)) for q in free.q]\n"
        "bound = Torques(cell, np.max(weights, axis=0) + 2.0)  # 2 N·m to move with\n"
        "slow = QPController(cell, lift.grasp, lift.path, dt=0.01, constraints=[bound])\n"
        "held = simulate(slow, q_start=lift.q_start)\n"
        "assert held.finished and held.time[-1] > free.time[-1]\n",
    ),
}


def blocks(page: Path) -> list[tuple[str, str]]:
    return BLOCK.findall(LISTING.sub("", page.read_text(encoding="utf-8")))


def name_of(page: Path) -> str:
    return page.relative_to(ROOT).as_posix().removeprefix("docs/")


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder like a checkout, with a cell of one's own; pictures are small, the demo draws none, nobody jogs long."""
    draw, serve = plots.render, RealTimeRun.run

    def serve_one_step(run: RealTimeRun, observe: Callable[[ControlStep], None]) -> None:
        serve(run, lambda step: (observe(step), run.stop())[0])

    monkeypatch.setattr(RealTimeRun, "run", serve_one_step)
    monkeypatch.setattr(plots, "render", lambda scene, view, *, width: draw(scene, view, width=min(width, 60)))
    monkeypatch.setattr(demo, "demo_pictures", lambda *_: {"picture.png": b""})
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "docs").symlink_to(ROOT / "docs")
    shutil.copyfile(CELLS / "bar.toml", tmp_path / "my_cell.toml")
    return tmp_path


def test_every_block_is_of_a_known_kind() -> None:
    for page in PAGES:
        kinds = {kind for kind, _ in blocks(page)}
        assert kinds <= {"sh", "python", "toml", *SHOWN}, name_of(page)


@pytest.mark.slow
@pytest.mark.parametrize("page", [p for p in PAGES if "sh" in dict(blocks(p))], ids=name_of)
def test_the_command_lines_of_a_page_run(page: Path, place: Path) -> None:
    for kind, block in blocks(page):
        for line in block.splitlines() if kind == "sh" else ():
            run_line(line, page)


def run_line(line: str, page: Path) -> None:
    words = shlex.split(line, comments=True)
    program, *arguments = words
    if program == "coopqp":
        run_coopqp(arguments, line)
    elif program == "make":
        assert shutil.which("make"), "make is not installed"
        subprocess.run([*words, "--dry-run"], cwd=ROOT, check=True, capture_output=True)
    elif program == "pip":
        assert arguments[0] == "install"
        known = metadata("coopqp").get_all("Provides-Extra") or []
        for extra in re.findall(r"[\w-]+", arguments[-1].partition("[")[2]):
            assert extra in known, line
    elif program in ("python", ".venv/bin/python"):
        knows_options(arguments, line)
    else:
        assert name_of(page) == OTHERS[program], line


def run_coopqp(arguments: list[str], line: str) -> None:
    redirect = arguments[arguments.index(">") + 1] if ">" in arguments else None
    if redirect:
        arguments = arguments[: arguments.index(">")]
    with contextlib.redirect_stdout(io.StringIO()) as out:
        assert cli.main(arguments) in (0, None), line
    if redirect:
        Path(redirect).write_text(out.getvalue(), encoding="utf-8")


def knows_options(arguments: list[str], line: str) -> None:
    """A script of the repository is there, and its help, or its source, knows the options of the line."""
    if arguments[:2] == ["-m", "pytest"]:
        texts = [file.read_text(encoding="utf-8") for file in (ROOT / arguments[2]).rglob("*.py")]
        assert texts, line
        said, options = "\n".join(texts), arguments[3:]
    else:
        script, *options = arguments
        asked = [sys.executable, str(ROOT / script), "--help"]
        if not any(option.startswith("--") for option in options):
            assert (ROOT / script).is_file(), line
            return
        said = subprocess.run(asked, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    for option in options:
        assert not option.startswith("--") or option in said, line


@pytest.mark.slow
@pytest.mark.parametrize("page", [p for p in PAGES if "python" in dict(blocks(p))], ids=name_of)
def test_the_programs_of_a_page_run(page: Path, place: Path) -> None:
    before, after = AROUND.get(name_of(page), ("", ""))
    for kind, block in blocks(page):
        if kind == "python":
            with contextlib.redirect_stdout(io.StringIO()):
                exec(compile(before + block + after, page.name, "exec"), {"__name__": "__main__"})


def run_cell_file(block: str, place: Path) -> None:
    """The tables of the page: those of the verdict have its defaults; phases are a program of the paper's arms."""
    if "[[phases]]" in block:
        text = (CELLS / "paper_lift.toml").read_text(encoding="utf-8")
        before, _, after = text.partition("[path]")
        file = place / "program.toml"
        file.write_text(before + after[after.index("[start]") :] + "\n" + block, encoding="utf-8")
        program = load_cell_file(file).scenario.path
        assert isinstance(program, Program)
        assert [phase.name for phase in program.phases] == ["lift", "regrasp"]
        return
    with_it = place / "with_verdict.toml"
    with_it.write_text((CELLS / "bar.toml").read_text(encoding="utf-8") + "\n" + block, encoding="utf-8")
    assert Tolerances(**load_cell_file(with_it).settings.verdict.model_dump()) == Tolerances()


def run_arm(block: str, place: Path) -> None:
    """The arm of the page in place of the first of two, with a robot's files where the page says."""
    urdf = place / "ws/src/my_robot_description/urdf/my_robot.urdf"
    urdf.parent.mkdir(parents=True)
    shutil.copyfile(robot_file("ur10"), urdf)
    text = (CELLS / "two_ur10.toml").read_text(encoding="utf-8")
    _, _, rest = text.partition('\n[[arms]]\nname = "right"')
    file = place / "mine.toml"
    mine = block + "geometry = false\n"
    file.write_text(f'name = "mine"\n{mine}\n[[arms]]\nname = "right"{rest}', encoding="utf-8")
    assert cli.main(["check", str(file), "--quiet"]) == 0


def run_driver(block: str, place: Path) -> None:
    """The table of the page is that of a simulated robot."""
    file = place / "driven.toml"
    file.write_text((CELLS / "bar.toml").read_text(encoding="utf-8") + "\n" + block, encoding="utf-8")
    assert load_cell_file(file).settings.drivers["left"].lag == 0.04


def make_driver(block: str, place: Path, cell: str = "two_ur10") -> None:
    """The table of the page makes a driver of an arm of a cell."""
    file = place / "driven.toml"
    right = block.replace("[drivers.left]", "[drivers.right]")
    text = (CELLS / f"{cell}.toml").read_text(encoding="utf-8")
    file.write_text(f"{text}\n{block}\n{right}", encoding="utf-8")
    assert set(load_cell_file(file).drivers()) == {"left", "right"}


def drive_robot(block: str, place: Path) -> None:
    """The tables of the page make the drivers of a robot with a lift and two arms."""
    file = place / "driven.toml"
    file.write_text((CELLS / "torso_lift.toml").read_text(encoding="utf-8") + "\n" + block, encoding="utf-8")
    assert set(load_cell_file(file).drivers()) == set(re.findall(r"^\[drivers\.(\w+)\]", block, flags=re.M))


def run_ros2(block: str, place: Path) -> None:
    """Tables of a driver, and that of the loop's own topics."""
    if block.startswith("[drivers"):
        make_driver(block, place)
        return
    file = place / "told.toml"
    file.write_text((CELLS / "two_ur10.toml").read_text(encoding="utf-8") + "\n" + block, encoding="utf-8")
    assert load_cell_file(file).settings.ros2.target_topic == "/hand"


TOML: dict[str, Callable[[str, Path], None]] = {
    "howto/cell-file.md": run_cell_file,
    "howto/drive.md": drive_robot,
    "howto/drivers.md": run_driver,
    "howto/ros2.md": run_ros2,
    "howto/ur.md": make_driver,
    "howto/four-cells.md": run_arm,
    "howto/franka.md": lambda block, place: make_driver(block, place, "bar"),
}


@pytest.mark.slow
@pytest.mark.parametrize("page", [p for p in PAGES if "toml" in dict(blocks(p))], ids=name_of)
def test_the_tables_of_a_page_are_read(page: Path, place: Path) -> None:
    for kind, block in blocks(page):
        if kind == "toml":
            TOML[name_of(page)](block, place)


@pytest.mark.slow
def test_the_messages_of_the_page_about_files_are_those_of_the_command(
    place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page = (ROOT / "docs/howto/cell-file.md").read_text(encoding="utf-8")
    bar = (CELLS / "bar.toml").read_text(encoding="utf-8")
    assert cli.main(["schema", "--example"]) == 0
    lift = capsys.readouterr().out.replace("report = true", "report = false")
    changed = {
        "bar.toml": (re.sub(r'^robot = "arm7".*$', 'robot = "arm7"\ntoolframe = "hand"', bar, flags=re.M), 2),
        "./bar.toml": (re.sub(r"durations_s = .*", "durations_s = [-1, 1]", bar), 2),
        "lift.toml": (lift.replace("0.30], rotation_vector_deg", "0.90], rotation_vector_deg"), 4),
    }
    messages = re.findall(r"^coopqp: .*$", page, flags=re.M)
    for (name, (text, status)), message in zip(changed.items(), messages, strict=True):
        Path(name).write_text(text, encoding="utf-8")
        assert cli.main(["run", Path(name).name, "--quiet"]) == status
        said = capsys.readouterr().err
        expected = message.removesuffix(" …")
        if status == 4:
            said, expected = (re.sub(r"\d\.\d{3} s", "# s", text) for text in (said, expected))
        assert expected in said


#: The commands of the page, for each of its cells; the first line of the page names the first.
STRANGERS = ("two_ur10", "panda_and_ur5", "pandas_and_ur5s", "gantry_and_ur5")


@pytest.mark.slow
@pytest.mark.parametrize("cell", STRANGERS[1:])  # the first one is on the page itself
def test_a_stranger_gets_from_files_to_a_checked_run_by_the_page_alone(cell: str, place: Path) -> None:
    """Check, run, plan and run of the plan. No number in these files was searched for: none of them has a start."""
    text = (CELLS / f"{cell}.toml").read_text(encoding="utf-8")
    assert "start]" not in text
    assert "positions" not in text
    page = (ROOT / "docs/howto/four-cells.md").read_text(encoding="utf-8")
    first, *lines = dict(BLOCK.findall(page))["sh"].replace("two_ur10", cell).replace(" --plots", "").splitlines()
    assert [line.split()[1] for line in (first, *lines)] == ["schema", "check", "run", "plan", "run"]
    run_coopqp(shlex.split(first)[1:], first)
    for line in lines:
        run_coopqp([*shlex.split(line)[1:], "--quiet"], line)
