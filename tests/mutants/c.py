"""Mutants of C++: another comparison, sign, constant or connective, a statement left out; how a copy is compiled."""

from __future__ import annotations

import re
import subprocess
import sys
from collections import defaultdict
from pathlib import Path
from typing import Any

#: Comments, preprocessor lines with their continuations, strings and characters: never changed.
_QUIET = re.compile(
    r"/\*.*?\*/|//[^\n]*|^[ \t]*#(?:[^\n\\]|\\.|\\\n)*|\"(?:[^\"\\\n]|\\.)*\"|'(?:[^'\\\n]|\\.)+'",
    re.DOTALL | re.MULTILINE,
)
_OPERAND = r"(?<=[\w)\]])"
#: Name of a kind, where it stands, and what takes its place.
_KINDS: dict[str, tuple[re.Pattern[str], dict[str, str]]] = {
    "comparison": (re.compile(r"(?<= )(<=|>=|==|!=|<|>)(?= )"),
                   {"<": ">=", ">": "<=", "<=": ">", ">=": "<", "==": "!=", "!=": "=="}),
    "connective": (re.compile(r"&&|\|\|"), {"&&": "||", "||": "&&"}),
    "sign": (re.compile(_OPERAND + r" ([+-]) (?=\S)"), {"+": "-", "-": "+"}),
    "update": (re.compile(r"(?<= )([+-]=)(?= )"), {"+=": "-=", "-=": "+="}),
    "factor": (re.compile(_OPERAND + r" ([*/]) (?=\S)"), {"*": "/", "/": "*"}),
    "minus": (re.compile(r"(?<=[(=,?:] )-(?=[\w(])|(?<=[(\[])-(?=[\w(])|(?<=return )-(?=[\w(])"), {"-": ""}),
    "not": (re.compile(r"!(?=[\w(])"), {"!": ""}),
    "extreme": (re.compile(r"\bf(?:min|max)\b"), {"fmin": "fmax", "fmax": "fmin"}),
    "constant": (re.compile(r"(?<![\w.])\d+(?:\.\d*)?(?:e-?\d+)?(?![\w.])"), {}),
    "jump": (re.compile(r"\b(?:break|continue)(?=;)"), {"break": "continue", "continue": "break"}),
    "statement": (re.compile(r"(?<=[;{}) ])(?:[a-z]\w*\([^;{}]*\)|[\w>.*\[\]+ -]+ [-+*/]?= [^;{}]*|"
                             r"\*?[\w>.-]+(?:\[[^;{}=]*\])+ = [^;{}]*)(?=;)"), {}),
}  # fmt: skip
#: First words of what looks like a statement and declares something, or leads away.
_DECLARES = re.compile(
    r"\s*(?:const|double|int|static|struct|char|size_t|Py_ssize_t|void|unsigned|return|for|if|[A-Z]\w* )"
)
#: Files that are compiled by themselves; they include the others.
SOURCES = (
    "binding/module.cpp", "binding/constants.cpp", "binding/structs.cpp", "binding/step.cpp", "binding/kinematics.cpp",
    "binding/distances.cpp", "nearby.cpp",
    "evasion.cpp", "edges.cpp", "limited_clock.cpp", "rounded.cpp", "unit.cpp", "values.cpp",
)  # fmt: skip


def _quiet(source: str) -> str:
    """The text with blanks where nothing is changed: as long as before."""
    return _QUIET.sub(lambda m: re.sub(r"[^\n]", " ", m.group()), source)


def _others(kind: str, found: str) -> str:
    """What takes the place of what was found."""
    if kind == "constant":
        whole = found.isdigit()
        return str(int(found) + 1) if whole else "2.0" if float(found) == 0.0 else f"{found} * 2"
    return "" if kind == "statement" else _KINDS[kind][1][found]


def _places(source: str) -> dict[str, list[tuple[int, int, str]]]:
    """Of each kind: from, to, and what takes the place."""
    text, found = _quiet(source), defaultdict(list)
    inside = [m.span() for m in re.finditer(r"^[^\s#/}][^;]*?\)\s*\{\n.*?^\}", text, re.DOTALL | re.MULTILINE)]
    for kind, (pattern, _) in _KINDS.items():
        for m in pattern.finditer(text):
            group = 1 if m.re.groups else 0
            start, end = m.span(group)
            if not any(a <= start and end <= b for a, b in inside):
                continue
            if kind == "statement" and (_DECLARES.match(m.group()) or text[:start].rstrip(" ")[-1:] not in "\n;{})"):
                continue
            line = text[text.rfind("\n", 0, start) + 1 : start]
            if kind == "constant" and (line.rstrip().endswith("[") and re.match(r"\s*(const |static )*double ", line)):
                continue  # a longer array is the same
            found[kind].append((start, end, _others(kind, m.group(group))))
    return dict(found)


def sites(source: str) -> dict[Any, list[tuple[str, int]]]:
    """The mutants of a file by the place (line, column) that they change: kind and its occurrence."""
    found = defaultdict(list)
    for kind, places in _places(source).items():
        for i, (start, _, _) in enumerate(places):
            row = source.count("\n", 0, start)
            found[row + 1, start - source.rfind("\n", 0, start) - 1].append((kind, i))
    return dict(found)


def write(source: str, kind: str, occurrence: int) -> str:
    """The file with one change."""
    start, end, other = _places(source)[kind][occurrence]
    return source[:start] + other + source[end:]


def compile_copy(folder: Path) -> bool:
    """Compile the module of the copy in ``folder``, what has changed of it; False if it cannot be.

    The arithmetic for AVX2 is left out: a module without it takes its own.
    """
    build = folder / "build" / "mutant"
    options = ("-DCMAKE_BUILD_TYPE=Release", "-DCMAKE_CXX_FLAGS_RELEASE=-O1 -DNDEBUG -w", "-DCOOPQP_AVX2=OFF")
    commands = [["--build", str(build), "--parallel"], ["--install", str(build), "--prefix", str(folder)]]
    if not (build / "CMakeCache.txt").exists():
        commands.insert(0, ["-S", str(folder), "-B", str(build), f"-DPython_EXECUTABLE={sys.executable}", *options])
    cmake = str(Path(sys.executable).with_name("cmake"))
    return all(subprocess.run([cmake, *one], capture_output=True, check=False).returncode == 0 for one in commands)
