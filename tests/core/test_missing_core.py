"""Without the compiled core nothing runs, and one error says what to install."""

from __future__ import annotations

import importlib
import pickle
import subprocess
import sys

import pytest

from coopqp.errors import CoopqpError, MissingCoreError, RemovedNameError

#: As if there were no such file.
NONE = """
import sys

class Hidden:
    @staticmethod
    def find_spec(name, *_):
        if name == "coopqp.core._core":
            raise ModuleNotFoundError(f"No module named {name!r}")

sys.meta_path.insert(0, Hidden)
import coopqp
"""
DEMO = "from coopqp.cli.main import main; sys.exit(main(['demo', '--out', 'never_written']))"
REMEDY = "pip install --force-reinstall coopqp"


@pytest.mark.parametrize(
    "use",
    [
        "coopqp.QPController", "coopqp.CollisionScene", "import coopqp.model.batch",
        "coopqp.solvers.make_solver('auto')", DEMO,
    ],
    ids=["step", "distances", "kinematics", "solver", "command"],
)  # fmt: skip
def test_a_missing_core_is_one_error_that_says_what_to_install(use: str) -> None:
    """From what needs it; ``import coopqp`` needs nothing of it."""
    found = subprocess.run([sys.executable, "-c", NONE + use], capture_output=True, text=True, timeout=60, check=False)
    last = found.stderr.strip().splitlines()[-1]
    assert found.returncode != 0
    assert "the compiled core of coopqp is missing" in last
    assert REMEDY in last
    assert ("Traceback" in found.stderr) == (use is not DEMO)


def test_the_error_of_a_missing_core_is_an_import_error_that_can_be_sent() -> None:
    error = MissingCoreError("no file")
    assert isinstance(error, ImportError)
    assert isinstance(error, CoopqpError)
    assert str(pickle.loads(pickle.dumps(error))) == str(error)


def test_a_name_that_is_gone_says_what_replaces_it() -> None:
    with pytest.raises(RemovedNameError, match=r"coopqp.errors\.KernelWarning is gone: .*MissingCoreError"):
        exec("from coopqp.errors import KernelWarning")
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        getattr(importlib.import_module("coopqp.errors"), "nothing")  # noqa: B009
