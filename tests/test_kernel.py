"""A kernel that is missing is said once, by the command and by a warning, and the plain definition takes its place."""

from __future__ import annotations

import subprocess
import sys
from importlib import metadata

from coopqp import available_kernels

WITHOUT = "import sys; sys.modules['coopqp.control.core._native'] = None\n"
WARNED = (
    WITHOUT
    + """
import warnings
from coopqp import KernelWarning, QPController, available_kernels
from coopqp.scenarios import paper_lift
assert available_kernels() == ("plain",)
lift = paper_lift()
with warnings.catch_warnings(record=True) as said:
    warnings.simplefilter("always")
    QPController(lift.cell, lift.grasp, lift.path, dt=lift.dt, options={"kernel": "plain"})
    assert not said, "asked for by name"
    for _ in range(2):
        controller = QPController(lift.cell, lift.grasp, lift.path, dt=lift.dt)
(warning,) = said
assert warning.category is KernelWarning
assert "COOPQP_REQUIRE_KERNEL=1" in str(warning.message)
controller.reset(lift.q_start)
assert controller.step().status.name == "TRACKING"
"""
)


def ran(program: str) -> str:
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_kernel_that_was_built_is_the_one_that_runs() -> None:
    """A core that was built and cannot be imported would leave tests/test_core.py out, and nothing else would fail."""
    built = metadata.distribution("coopqp").read_text("WHEEL")
    assert built is not None
    pure = "Root-Is-Purelib: true" in built
    assert pure == ("py3-none-any" in built)
    assert available_kernels() == (("plain",) if pure else ("compiled", "plain"))


def test_a_missing_kernel_is_warned_of_once() -> None:
    ran(WARNED)


def test_the_command_says_which_kernel_it_has_and_why() -> None:
    said = ran(WITHOUT + "from coopqp.app import cli; sys.exit(cli.main(['--version']))")
    assert "kernel plain (it was not built: there was no C compiler, or it failed)" in said
