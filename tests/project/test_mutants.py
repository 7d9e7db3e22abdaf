"""The parts of tests/mutation.py that need no other package: what is changed in C++."""

from __future__ import annotations

import sys

from places import ROOT

sys.path.insert(0, str(ROOT / "tests"))
from mutants import c

SOURCE = """/* if (a < b) nothing; */
#define TWICE(x) (2 * (x))
static const char *TEXT = "a < b && c";

static double share(double a, double b) {
    double sum = 0.5; // a < b
    if (a < b && b > 0.0) return -a;
    for (int i = 0; i < 3; i++) sum += a * b;
    clear(&sum);
    return fmin(sum, b - a);
}
"""
#: Of each kind the lines that it makes of this source.
CHANGED = {
    "comparison": ["a >= b &&", "b <= 0.0)", "i >= 3;"],
    "connective": ["a < b || b > 0.0"],
    "sign": ["b + a)"],
    "update": ["sum -= a * b"],
    "factor": ["+= a / b"],
    "minus": ["return a;"],
    "extreme": ["fmax(sum"],
    "constant": ["sum = 0.5 * 2", "b > 2.0", "int i = 1;", "i < 4;"],
    "statement": ["i++);", "    ;"],
}


def test_each_kind_changes_one_place_of_the_code_and_no_text() -> None:
    found: dict[str, list[tuple[int, str]]] = {}
    for place, ways in c.sites(SOURCE).items():
        for kind, occurrence in ways:
            changed = c.write(SOURCE, kind, occurrence)
            lines = [(a, b) for a, b in zip(SOURCE.splitlines(), changed.splitlines(), strict=True) if a != b]
            assert len(lines) == 1, (kind, lines)
            assert SOURCE.splitlines()[place[0] - 1] == lines[0][0]
            assert place[0] > 5
            found.setdefault(kind, []).append((occurrence, lines[0][1]))
    assert set(found) == set(CHANGED)
    for kind, parts in CHANGED.items():
        assert len(found[kind]) == len(parts), (kind, found[kind])
        for part, (_, line) in zip(parts, sorted(found[kind]), strict=True):
            assert part in line


def test_every_source_in_cpp_has_places_and_is_compiled_or_included() -> None:
    files = {file.relative_to(ROOT / "coopqp" / "core").as_posix(): file for file in (ROOT / "coopqp").rglob("*.cpp")}
    included = "".join(file.read_text(encoding="utf-8") for file in files.values())
    for name, file in files.items():
        assert name in c.SOURCES or f'#include "{name}"' in included
        assert c.sites(file.read_text(encoding="utf-8")) or file.stat().st_size < 2500, file
    assert {*c.SOURCES} < {*files}


def test_every_package_has_a_folder_of_tests() -> None:
    """Where mutation runs find them."""
    packages = {folder.name for folder in (ROOT / "coopqp").iterdir() if (folder / "__init__.py").exists()}
    assert {name for name in packages if not list((ROOT / "tests" / name).glob("test_*.py"))} == set()
