"""That the compiled module is missing is said once, by the command and by a warning; its definition takes its place."""

from __future__ import annotations

from importlib import metadata

import pytest
from marks import slow_but_first
from processes import output

from coopqp.native import MODULE, available_kernels

WITHOUT = f"import sys; sys.modules[{MODULE!r}] = None\n"
WARNED = """
import warnings
from coopqp import QPController
from coopqp.errors import KernelWarning
from coopqp.native import available_kernels
from coopqp import Clearance, CollisionScene
from coopqp.model.batch import ArmKinematics
from coopqp.scenarios import paper_lift
assert available_kernels() == ("plain",)
lift = paper_lift()


def controller(**options):
    return QPController(lift.cell, lift.grasp, lift.path, dt=lift.dt, **options)


# What uses it, with the kernel that is asked for by name and without.
used = {{
    "step": (lambda: controller(options={{"kernel": "plain"}}), controller),
    "kinematics": (
        lambda: ArmKinematics(lift.cell.arms[0], kernel="plain"), lambda: ArmKinematics(lift.cell.arms[0])
    ),
    "distances": (
        lambda: None, lambda: controller(constraints=[Clearance(CollisionScene.of(lift, carried=[]))])
    ),
}}
named, plain = used[{use!r}]
with warnings.catch_warnings(record=True) as said:
    warnings.simplefilter("always")
    named()
    assert not said, "asked for by name"
    made = [plain() for _ in range(2)]
(warning,) = said
assert warning.category is KernelWarning
assert "COOPQP_REQUIRE_KERNEL=1" in str(warning.message)
assert "without its compiled kernel" in str(warning.message), warning.message
if hasattr(made[0], "reset"):
    made[0].reset(lift.q_start)
    assert made[0].step().status.name == "TRACKING"
"""
VERSION = "import sys; from coopqp.cli.main import main; sys.exit(main(['--version']))"
built = pytest.mark.skipif(len(available_kernels()) < 2, reason="there is no compiler here")


def test_the_kernel_that_was_built_is_the_one_that_runs() -> None:
    """A module that was built and cannot be imported would leave its tests out, and nothing else would fail."""
    wheel = metadata.distribution("coopqp").read_text("WHEEL")
    assert wheel is not None
    pure = "Root-Is-Purelib: true" in wheel
    assert pure == ("py3-none-any" in wheel)
    assert available_kernels() == (("plain",) if pure else ("compiled", "plain"))


@built
@pytest.mark.parametrize("use", slow_but_first(("step", "kinematics", "distances")))
def test_a_missing_module_is_warned_of_once_and_named_by_the_command(use: str) -> None:
    said = output("-c", WITHOUT + WARNED.format(use=use) + VERSION)
    assert "kernel: plain (it was not built: there was no C++ compiler, or it failed)" in said
