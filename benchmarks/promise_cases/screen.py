"""What commands, pictures and pages say. The cases are those of the tests, which look inside the package."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

from promise_cases import Promise

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "reliability"))
statements = import_module("statements").statements


def promises(quick: bool) -> Iterator[Promise]:
    """The promises of this module; ``quick`` for a part of the cases."""
    for case, false in statements(quick):
        yield Promise(case, false, 0.0, "")
