"""What an installation can do with its extras, and what it says of those that are missing. Needs no other package.

``python tests/installed.py [--extras] [EXTRA …]`` tries everything that needs an extra: it works if the extra was
given; else the error names it, before any work is done. Cell files are run, checked, planned and drawn without any;
``--extras`` leaves out what needs none.
"""

from __future__ import annotations

import argparse
import os
import platform
import subprocess
import sys
import tempfile
import warnings
from importlib import metadata
from pathlib import Path

#: What makes the recording that other commands read.
RECORDS = "a table and a recording"
#: Name: command, and the extras that it needs. Commands run one after the other in one folder.
COMMANDS: dict[str, tuple[list[str], set[str]]] = {
    "versions": (["--version"], set()),
    "the demo": (["demo", "--steps", "4", "--out", "demo"], set()),
    RECORDS: (["export", "paper_lift", "--csv", "run.csv", "--npz", "run.npz"], set()),
    "the check of a path": (["check", "paper_lift"], set()),
    "an example": (["schema", "--example", "paper_baseline"], set()),
    "robots": (["schema", "--robots"], set()),
    "examples": (["examples"], set()),
    "a cell file": (["run", "cell.toml", "--out", "cell", "--report", "--plots"], set()),
    "the check of a cell file": (["check", "cell.toml", "--out", "check"], set()),
    "a cell of one's own": (["new", "pair", "--arm", "rx90l", "--arm", "arm7", "--out", "new"], set()),
    "a plan": (["plan", "cell.toml", "--out", "plan"], {"planning"}),
    "a sweep": (["sweep", "study.toml", "--workers", "1", "--out", "sweep", "--quiet"], {"studies"}),
    "a report": (["report", "run.npz", "--out", "report.html"], set()),
    "a page": (["view", "run.npz", "--html", "page.html"], {"viewer"}),
    "a bag": (["export", "run.npz", "--bag", "bag"], {"bags"}),
    "a bag of a run": (["export", "paper_lift", "--bag", "other_bag"], {"bags"}),
}
#: The newest Python that what an extra brings has wheels for.
WHEELS_UP_TO = {"franka": (3, 12), "ur": (3, 12), "ros2": (3, 13)}
#: Name: program, and the extras that it needs.
PROGRAMS: dict[str, tuple[str, set[str]]] = {
    "an arm of example-robot-data": (
        "from coopqp.scenarios import robot_arm; assert robot_arm('panda').model.nv >= 7",
        {"robots"},
    ),
    "the solver quadprog": ("from coopqp.solvers import make_solver; make_solver('quadprog')", {"solvers"}),
    "the physics": (
        "from coopqp.simulation import PhysicsPlant; from coopqp.scenarios import paper_lift; l = paper_lift(); "
        "PhysicsPlant(l.cell, l.grasp, object_size=l.object_size, object_mass=l.object_mass).reset(l.q_start)",
        {"mujoco"},
    ),
    "the driver ur": ("from coopqp.drivers import UrDriver; UrDriver('abcdef', {'address': 'nowhere'})", {"ur"}),
    "the driver ros2": ("from coopqp.drivers import Ros2Driver; Ros2Driver('a', {'command_topic': '/a'})", {"ros2"}),
    "the driver franka": (
        "from coopqp.drivers import FrankaDriver; FrankaDriver('abcdefg', {'address': 'nowhere'})",
        {"franka"},
    ),
    "the public names": (
        "import coopqp; [getattr(coopqp, name) for name in coopqp.__all__]; coopqp.simulation.Disturbances",
        set(),
    ),
}


def done(command: list[str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)


def told(needs: set[str], given: set[str], result: subprocess.CompletedProcess[str]) -> str:
    """What is wrong with a result; empty if nothing is."""
    text = result.stdout + result.stderr
    missing = needs - given
    if not missing:
        return "" if result.returncode == 0 else f"ended with {result.returncode}: {text[-1500:]}"
    named = any(f"coopqp[{extra}]" in text for extra in missing)
    if result.returncode == 0 or not named:
        return f"does not name the missing {sorted(missing)}: {text[-1500:]}"
    return "it ran before it was refused" if "running" in text else ""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("extras", nargs="*", metavar="EXTRA")
    parser.add_argument("--extras", dest="alone", action="store_true", help="try only what needs an extra")
    arguments = parser.parse_args()
    extras = {e for e in metadata.metadata("coopqp").get_all("Provides-Extra") or [] if e not in ("dev", "mutation")}
    given = extras if "all" in arguments.extras else set(arguments.extras)
    given |= {"studies"}  # OSQP brings joblib
    if (sys.platform, platform.machine()) == ("linux", "x86_64"):
        given |= {"planning"}  # toppra has wheels there
    for extra, newest in WHEELS_UP_TO.items():
        if sys.version_info[:2] > newest:
            given -= {extra}
    assert given <= extras, (given, extras)
    warnings.simplefilter("ignore")
    import coopqp

    assert "site-packages" in coopqp.__file__, coopqp.__file__
    wrong = {}
    program = str(Path(sys.executable).with_name("coopqp"))
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        example = done([program, "schema", "--example"]).stdout
        limited = example.replace('robot = "rx90l"', 'robot = "rx90l"\nlimits = { acceleration_deg_per_s2 = 600 }')
        Path("cell.toml").write_text(limited.replace("report = true", ""), encoding="utf-8")
        study = 'name = "s"\nscenario = "paper_lift"\nset = { steps = 4 }\n'
        Path("study.toml").write_text(study, encoding="utf-8")
        for name, (command, needs) in COMMANDS.items():
            if arguments.alone and not needs and name != RECORDS:
                continue
            result = done([program, *command])
            wrong[name] = told(needs, given, result)
            if name == "the demo" and not wrong[name]:
                pictures = len(list(Path("demo").glob("*.png"))) if Path("demo").exists() else 0
                if "pseudo_inverse" not in result.stdout or not pictures:
                    wrong[name] = f"{pictures} pictures, says {result.stderr!r}"
        for name, (program_text, needs) in PROGRAMS.items():
            wrong[name] = told(needs, given, done([sys.executable, "-c", program_text]))
        os.chdir("/")
    for name, what in wrong.items():
        print(f"{'NO ' if what else 'yes'}  {name}{': ' + what if what else ''}")
    return int(any(wrong.values()))


if __name__ == "__main__":
    sys.exit(main())
