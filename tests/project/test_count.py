"""The tool that counts the package, ``tests/count.py``, keeps its rules and knows where things are."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest
from places import ROOT

sys.path.insert(0, str(ROOT / "tests"))
import count

PYTHON = '''"""What it does.

More of it.
"""
# a comment
from a.core import one

SHARE, _STILL = 0.5, -1e-5  # counted once


class A:
    """Documented."""

    TEXT = """two
lines"""
'''
NATIVE = """/* a comment
 * of two lines */
int a; /* code */
// "no text"
const char *b = "/* text */";

#define C 1
"""
CONTRACT = """
[[tool.importlinter.contracts]]
type = "layers"
layers = ["high", "left | right", "low"]
"""


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A checkout of a package whose modules import each other upwards, aside and in a circle."""
    (tmp_path / "pyproject.toml").write_text(CONTRACT)
    for name, text in {
        "__init__": "",
        "low/base": "def get():\n    return import_module('coopqp.high.top')\n",
        "left/one": "import coopqp.low.base\nfrom coopqp.left import two\n",
        "left/two": "if TYPE_CHECKING:\n    from coopqp.left.one import One\n",
        "left/__init__": "",
        "right/other": "def late():\n    from coopqp.left.one import One\n",
        "high/top": "import coopqp.right.other\n",
        "core/constants.h": "constexpr double SHARE = 0.5; /* of it */\nconstexpr double STILL_COMMAND = -1e-5;\n"
        "constexpr int OTHER = 6 * SHARE;\n",
    }.items():
        file = tmp_path / "coopqp" / (name if name.endswith(".h") else f"{name}.py")
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    return tmp_path


def test_lines_without_comments_and_docstrings_count() -> None:
    assert count.python_lines(PYTHON) == {6, 8, 11, 14, 15}
    assert count.native_lines(NATIVE) == 3


def test_a_constant_stands_twice_where_its_name_has_its_value_again(tree: Path) -> None:
    (tree / "coopqp" / "low" / "values.py").write_text(PYTHON)
    (tree / "coopqp" / "low" / "same.py").write_text("SHARE = constants.SHARE\nOTHER = 4\n")
    assert count.core_constants(tree) == {"SHARE": 0.5, "STILL_COMMAND": -1e-5, "OTHER": 3}
    assert count.constants_twice(tree) == {
        "SHARE": ["coopqp/low/values.py: SHARE"],
        "STILL_COMMAND": ["coopqp/low/values.py: _STILL"],
    }


def test_imports_in_functions_and_for_types_point_up_or_aside_and_close_circles(tree: Path) -> None:
    graph = count.imports(tree)
    assert count.upward(tree, graph) == [
        ("coopqp.low.base", "coopqp.high.top"),
        ("coopqp.right.other", "coopqp.left.one"),
    ]
    small, large = count.circles(graph), [["coopqp.left.one", "coopqp.left.two"]]
    assert small == [sorted({*large[0], "coopqp.low.base", "coopqp.high.top", "coopqp.right.other"})]
    assert count.late_imports(tree, small[0], graph) == [
        ("coopqp.left.two", "coopqp.left.one"),
        ("coopqp.low.base", "coopqp.high.top"),
        ("coopqp.right.other", "coopqp.left.one"),
    ]
    graph["coopqp.low.base"].clear()
    assert count.circles(graph) == large


@pytest.mark.slow
def test_it_counts_this_package(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    count.main(["--json", str(tmp_path / "figures.json")])
    told, found = capsys.readouterr().out, json.loads((tmp_path / "figures.json").read_text())
    for name in ("lines of code", "glue of the core", "stand twice", "names at the top", "imports upwards", "circles"):
        assert name in told
    parts = found["lines by package"]
    assert found["lines"] == sum(sum(lines.values()) for lines in parts.values()) > 10_000
    assert (
        found["numerical native lines"]
        + sum(lines for name, lines in found["glue by file"].items() if name.endswith(count.NATIVE))
        == found["native lines"]
    )
    assert not found["constants twice"]
    assert found["names at the top"] <= 50
    assert not found["imports upwards"]
    assert not found["circles"]


def test_each_file_of_the_glue_is_there() -> None:
    glue = count.glue_lines(count.ROOT)
    assert list(glue) == list(count.GLUE), "a file of the glue has moved: tests/count.py lists them"
