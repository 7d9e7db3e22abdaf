"""A compiled part that is missing is said once, by the command and by a warning, and its definition takes its place."""

from __future__ import annotations

import subprocess
import sys
from importlib import metadata

import pytest
from marks import slow_but_first

from coopqp.errors import UnknownNameError
from coopqp.native import PARTS, available_kernels

WITHOUT = "import sys; sys.modules[{module!r}] = None\n"
WARNED = """
import warnings
from coopqp import QPController
from coopqp.errors import KernelWarning
from coopqp.native import available_kernels
from coopqp import Clearance, CollisionScene
from coopqp.model.batch import ArmKinematics
from coopqp.scenarios import paper_lift
assert available_kernels({part!r}) == ("plain",)
others = {others!r}
assert all(available_kernels(part) == ("compiled", "plain") for part in others)
lift = paper_lift()


def controller(**options):
    return QPController(lift.cell, lift.grasp, lift.path, dt=lift.dt, **options)


# What uses each part, with the kernel that is asked for by name and without.
used = {{
    "step": (lambda: controller(options={{"kernel": "plain"}}), controller),
    "kinematics": (
        lambda: ArmKinematics(lift.cell.arms[0], kernel="plain"), lambda: ArmKinematics(lift.cell.arms[0])
    ),
    "distances": (
        lambda: None, lambda: controller(constraints=[Clearance(CollisionScene.of(lift, carried=[]))])
    ),
}}
named, plain = used[{part!r}]
with warnings.catch_warnings(record=True) as said:
    warnings.simplefilter("always")
    named()
    assert not said, "asked for by name"
    made = [plain() for _ in range(2)]
(warning,) = said
assert warning.category is KernelWarning
assert "COOPQP_REQUIRE_KERNEL=1" in str(warning.message)
assert "compiled kernel for {part}, " in str(warning.message), warning.message
if hasattr(made[0], "reset"):
    made[0].reset(lift.q_start)
    assert made[0].step().status.name == "TRACKING"
"""
VERSION = "import sys; from coopqp.cli.main import main; sys.exit(main(['--version']))"
built = pytest.mark.skipif(any(len(available_kernels(p)) < 2 for p in PARTS), reason="there is no compiler here")


def ran(program: str) -> str:
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize("part", PARTS)
def test_the_kernel_that_was_built_is_the_one_that_runs(part: str) -> None:
    """A part that was built and cannot be imported would leave its tests out, and nothing else would fail."""
    wheel = metadata.distribution("coopqp").read_text("WHEEL")
    assert wheel is not None
    pure = "Root-Is-Purelib: true" in wheel
    assert pure == ("py3-none-any" in wheel)
    assert available_kernels(part) == (("plain",) if pure else ("compiled", "plain"))


@built
@pytest.mark.parametrize("part", slow_but_first(PARTS))
def test_a_missing_part_is_warned_of_once_and_named_by_the_command(part: str) -> None:
    without = WITHOUT.format(module=PARTS[part])
    said = ran(without + WARNED.format(part=part, others=[p for p in PARTS if p != part]) + VERSION)
    reason = "it was not built: there was no C compiler, or it failed"
    for other in PARTS:
        assert f"{other} plain ({reason})" in said if other == part else f"{other} compiled" in said


def test_a_part_that_there_is_not_is_refused() -> None:
    with pytest.raises(UnknownNameError, match="step"):
        available_kernels("steps")
