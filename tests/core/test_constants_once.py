"""The constants that the core and Python share stand once."""

from __future__ import annotations

import ast
import re
import sys

from places import ROOT

from coopqp.core import _core

sys.path.insert(0, str(ROOT / "tests"))
import count


def test_python_reads_what_it_shares_with_the_core_and_has_no_copies() -> None:
    text = (ROOT / "coopqp" / "core" / "binding" / "constants.cpp").read_text(encoding="utf-8")
    shared, read = re.findall(r" READ\(([A-Z_]+)\)", text), set[str]()
    for file in (ROOT / "coopqp").rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.module == _core.__name__:
                read |= {name.name for name in node.names}
    assert read <= {*shared}
    constants = count.core_constants(ROOT)
    codes = {*shared} - {*constants}
    assert {*shared} - read <= codes
    assert {name: getattr(_core, name) for name in {*shared} - codes}.items() <= constants.items()
    assert count.constants_twice(ROOT) == {}
