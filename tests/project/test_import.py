"""``import coopqp`` needs only the core dependencies: packages of extras are imported on use."""

from __future__ import annotations

import subprocess

import pytest
from marks import slow_but_first, slow_unless
from processes import output, python

OPTIONAL = (
    "matplotlib", "rich", "mujoco", "viser", "meshcat", "example_robot_data", "trimesh", "PIL", "pandas",
    "rosbags", "distributed", "dask", "pyarrow", "pydantic", "hypothesis", "pytest", "IPython", "daqp", "quadprog",
)  # fmt: skip
MODULES = (
    "coopqp",
    "coopqp.simulation.evaluation.assessment",
    "coopqp.model.cell",
    "coopqp.files.cellfile",
    "coopqp.model.chain",
    "coopqp.cli.main",
    "coopqp.control.interface",
    "coopqp.baselines.pseudo_inverse",
    "coopqp.control.qp",
    "coopqp.files.export",
    "coopqp.model.grasp",
    "coopqp.model.inverse_kinematics",
    "coopqp.control.step.velocity_bounds",
    "coopqp.simulation.evaluation.metrics",
    "coopqp.paths.path",
    "coopqp.simulation.plants",
    "coopqp.visualization.report",
    "coopqp.cli.runs",
    "coopqp.scenarios",
    "coopqp.simulation.recording.scene",
    "coopqp.simulation.simulate",
    "coopqp.spatial",
    "coopqp.model.state",
    "coopqp.studies",
    "coopqp.visualization.viewer",
)

CHECK = """
import importlib, sys
optional, names = {optional!r}, {names!r}
class Refuse:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in optional:
            raise ImportError(name + " is not installed here")
if {blocked}:
    sys.meta_path.insert(0, Refuse())
for name in names:
    importlib.import_module(name)
loaded = sorted({{name.split(".")[0] for name in sys.modules}} & set(optional))
print(",".join(loaded))
"""


def imported(names: tuple[str, ...], *, blocked: bool) -> subprocess.CompletedProcess[str]:
    code = CHECK.format(optional=OPTIONAL, names=names, blocked=blocked)
    return python("-c", code)


@pytest.mark.parametrize(
    "names", slow_unless(lambda names: names is not MODULES, [("coopqp",), MODULES]), ids=["the package", "its modules"]
)
def test_no_optional_package_is_imported(names: tuple[str, ...]) -> None:
    done = imported(names, blocked=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == ""


@pytest.mark.slow
def test_it_works_where_none_is_installed() -> None:
    done = imported(MODULES, blocked=True)
    assert done.returncode == 0, done.stderr


def test_a_control_program_starts_without_scipy() -> None:
    """SciPy's optimisers take longer to import than coopqp."""
    program = """
import sys
from coopqp import ForceController, Grasp, QPController, Recording, RobotCell, simulate
from coopqp.simulation import Monitor
from coopqp.scenarios import paper_lift
assert not [name for name in sys.modules if name.startswith("scipy.")]
"""
    output("-c", program)


def test_importing_says_nothing() -> None:
    done = python("-W", "error::DeprecationWarning:coopqp", "-c", "import coopqp")
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


@pytest.mark.parametrize(
    "first",
    slow_but_first(["coopqp.collision.clearance", "coopqp.control.core.loop"]),
)
def test_no_room_has_to_be_imported_before_another(first: str) -> None:
    """The command imports bodies before controllers, programs the other way round."""
    output("-c", f"import {first}")
