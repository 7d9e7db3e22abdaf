"""The constants that the core and Python share stand once."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from pathlib import Path

from coopqp.core import constants


def test_python_reads_what_it_shares_with_the_core_and_has_no_copies() -> None:
    listed, read = {name: value for name, value in vars(constants).items() if name.isupper()}, set()
    for file in Path(constants.__file__).parents[1].rglob("*.py"):
        tree = ast.parse(file.read_text(encoding="utf-8"))
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and node.module == constants.__name__:
                read |= {name.name for name in node.names}
        for node in tree.body if file.name != "constants.py" else ():
            if isinstance(node, ast.Assign) and isinstance(node.value, ast.Constant):
                for name in (target.id.strip("_") for target in node.targets if isinstance(target, ast.Name)):
                    assert name not in listed or listed[name] != node.value.value, (file, name)
    assert read == set(listed)


def test_no_constant_is_named_twice() -> None:
    names = re.findall(r"^([A-Z_]+) = ", Path(constants.__file__).read_text(encoding="utf-8"), re.MULTILINE)
    assert len(names) == len(set(names))


def test_the_header_has_every_constant() -> None:
    program = Path(constants.__file__).with_name("header.py")
    said = subprocess.run([sys.executable, "-I", str(program)], capture_output=True, text=True, check=True).stdout
    lines = set(said.splitlines())
    listed = {name: value for name, value in vars(constants).items() if name.isupper()}
    assert {f"#define {name} {value!r}" for name, value in listed.items()} <= lines
    assert len(listed) > 50
