"""Which tests look at a line: found by package, measured once, kept in a file, and asked for each mutant.

The tests of a package stand in the folder of its name. Behind them, in a second line, are all others.

The map is measured by coverage.py, file by file. A line outside of functions, which an import executes, is no test's
own; in the second line, and after a line's own tests, come those that spend the largest part of their lines on its
module.
"""

from __future__ import annotations

import ast
import json
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from mutants.copies import ROOT, Copy

#: Tests of a line that are kept in each folder, quick ones and those marked slow.
_KEPT = 60


def folders_of(package: str, root: Path = ROOT) -> tuple[list[str], list[str]]:
    """Folders with the tests of a package, and all others, which are its second line, both relative to the root."""
    folders = {f"tests/{file.parent.name}/" for file in root.glob("tests/*/test_*.py")} - {"tests/browser/"}
    own = f"tests/{package}/"
    return [own], sorted(folders - {own})


@dataclass
class Reach:
    """Tests of lines, the best first: those that take little time, and look at little else.

    Attributes:
        took: seconds that each test takes, with all its parameters.
        lines: names of tests, by module and the text of the line, which stays when other lines come and go.
        modules: names of tests, by module.
        costs: seconds times the lines that a test reaches over those in the module, by module.
        files: test files that were measured, with their marks.
    """

    took: dict[str, float] = field(default_factory=dict)
    lines: dict[str, dict[str, list[str]]] = field(default_factory=dict)
    modules: dict[str, list[str]] = field(default_factory=dict)
    costs: dict[str, dict[str, float]] = field(default_factory=dict)
    files: list[str] = field(default_factory=list)

    @classmethod
    def of(cls, file: Path) -> Reach:
        """What was kept in a file; nothing if there is none."""
        return cls(**json.loads(file.read_text(encoding="utf-8"))) if file.exists() else cls()

    def measure(self, copy: Copy, files: Iterable[str], mark: str, keep: Path) -> None:
        """Add the tests of files that have a mark, file by file, and write down what is known so far."""
        raw = copy.folder / "reached.json"
        for name in files:
            if f"{name} {mark}" in self.files:
                continue
            raw.unlink(missing_ok=True)
            status = copy.run([name], "-m", mark, limit=3600, covered=raw)
            print(f"{name}: {mark}: status {status}", flush=True)
            if status not in (0, 5):
                print((copy.folder / "said.txt").read_text(encoding="utf-8")[-1500:])
                continue
            found = json.loads(raw.read_text(encoding="utf-8"))
            self.took |= found["took"]
            self._add(found["reached"], copy.folder)
            self.files.append(f"{name} {mark}")
            keep.parent.mkdir(parents=True, exist_ok=True)
            keep.write_text(json.dumps(vars(self)), encoding="utf-8")

    def _add(self, reached: dict[str, dict[str, list[str]]], folder: Path) -> None:
        sources = {module: (folder / module).read_text(encoding="utf-8") for module in reached}
        every: Counter[str] = Counter()
        own: dict[str, Counter[str]] = defaultdict(Counter)
        for module, lines in reached.items():
            inside = in_functions(sources[module])
            for line, tests in lines.items():
                if int(line) in inside:
                    every.update(tests)
                    own[module].update(tests)
        for module, counted in own.items():
            cost = {t: self.took.get(t, 60.0) * every[t] / n for t, n in counted.items()}
            self.costs.setdefault(module, {}).update(cost)
            costs = self.costs[module]
            known, texts = self.lines.setdefault(module, {}), sources[module].splitlines()
            for line, tests in reached[module].items():
                text = texts[int(line) - 1].strip()
                those = {*known.get(text, ()), *(t for t in tests if t in cost)}
                known[text] = _best(those, costs)
            self.modules[module] = _best({*self.modules.get(module, ()), *cost}, costs)

    def tests(self, module: str, line: str, seconds: float, folders: Iterable[str] = ("",)) -> list[str]:
        """Tests in some folders for a line of a function, or "" for others, the best first; they take ``seconds``, but
        are three at least.
        """
        own = self.lines.get(module, {}).get(line.strip(), []) if line else []
        chosen: list[str] = []
        spent = 0.0
        for name in dict.fromkeys([*own, *self.modules.get(module, ())]):
            if not name.startswith(tuple(folders)):
                continue
            took = self.took.get(name, 60.0)
            if len(chosen) >= 3 and spent + took > seconds:
                continue
            chosen.append(name)
            spent += took
        return chosen


def _best(tests: Iterable[str], costs: Mapping[str, float]) -> list[str]:
    """Those that cost least, of each folder as many as are kept."""
    found, of_folder = [], Counter[str]()
    for name in sorted(tests, key=lambda name: costs.get(name, 1e9)):
        folder = name.partition("::")[0].rpartition("/")[0]
        of_folder[folder] += 1
        if of_folder[folder] <= _KEPT:
            found.append(name)
    return found


def in_functions(source: str) -> set[int]:
    """Lines of the bodies of functions."""
    return {
        line
        for node in ast.walk(ast.parse(source))
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef))
        for line in range(node.body[0].lineno, (node.end_lineno or 0) + 1)
    }
