"""Mutation testing: would a test fail if the code said something else?  ``make mutation``, or ``mutation.py --help``.

Places are sampled in each package and in the C code. At each, one change is made (``mutants/python.py``,
``mutants/c.py``) in a copy of the tree, and tests run until one fails. Which ones: those in the folder that is named
like the package, then all others; of both those that execute the line, the quickest and the most particular first, up
to a number of seconds. The map of lines and tests is measured once, folder by folder as it is needed, with coverage.py,
and kept (``--map``; remove the file after larger changes); what a test does in another process is not in it. A mutant
of C is compiled and meets the quick tests marked ``core``, those first that killed the most until then, then golden
runs and the oracle, then the others.

A mutant that survives lacks a test, or is equivalent: then ``mutants/equivalent.py`` says why. A mutant that makes the
tests run for ever is killed by its share of processor time, which another program's work does not use up.

``--resume`` goes on where a file of results ends: new tests meet the old survivors.
"""

from __future__ import annotations

import argparse
import difflib
import json
import random
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from mutants import c, python
from mutants.copies import ROOT, Copy
from mutants.equivalent import ANY, EQUIVALENT
from mutants.reach import Reach, folders_of, in_functions

#: What is sampled: a package, or the C code of all of them.
GROUPS = (
    "control", "planning", "model", "paths", "constraints", "solvers", "baselines", "collision", "forces", "studies",
    "files", "simulation", "C",
)  # fmt: skip
#: Tests of the compiled code, and the folders whose tests it meets first.
CORE = "core and not slow"
FIRST = ("tests/golden/", "tests/oracle/")


def modules_of(group: str) -> list[str]:
    """Files of a group, relative to the root."""
    found = (ROOT / "coopqp").rglob("*.cpp") if group == "C" else (ROOT / "coopqp" / group).rglob("*.py")
    return sorted(str(file.relative_to(ROOT)) for file in found)


@dataclass
class Mutant:
    """One change of one file, and what came of it."""

    group: str
    module: str
    operator: str
    occurrence: int
    line: int
    before: str = ""
    after: str = ""
    outcome: str = ""
    killer: str = ""
    seconds: float = 0.0

    def write(self, root: Path = ROOT) -> str:
        """The text of the file, in a tree, with this change, which is noted."""
        source = (root / self.module).read_text(encoding="utf-8")
        mutated = (c if self.group == "C" else python).write(source, self.operator, self.occurrence)
        assert mutated != source, self
        lines = list(difflib.unified_diff(source.splitlines(), mutated.splitlines(), lineterm="", n=0))[2:]
        self.before, self.after = (
            " ".join(line[1:].strip() for line in lines if line.startswith(sign)) for sign in "-+"
        )
        return mutated

    @property
    def why_equivalent(self) -> str | None:
        found = ((module, self.before, self.after) for module in (self.module, ANY))
        return next((EQUIVALENT[key] for key in found if key in EQUIVALENT), None)

    @property
    def key(self) -> tuple[str, str, str, str]:
        """The same change of the same line, wherever that line stands now."""
        return self.module, self.operator, self.before, self.after


def chosen(group: str, number: int, seed: int) -> list[Mutant]:
    """Mutants at ``number`` places of a group, one a place; any place is as likely as any other.

    What is chosen stays chosen when other lines change, and a smaller number chooses the first ones of a larger.
    """
    sites: Callable[[str], dict[Any, list[tuple[str, int]]]] = c.sites if group == "C" else python.sites
    drawn = []
    for module in modules_of(group):
        source = (ROOT / module).read_text(encoding="utf-8")
        lines = source.splitlines()
        for start, ways in sites(source).items():
            rng = random.Random(f"{seed} {module} {start[1]} {lines[start[0] - 1]}")
            drawn.append((rng.random(), module, start, rng.choice(ways)))
    drawn.sort()
    print(f"{group}: {len(drawn)} places", flush=True)
    return [Mutant(group, module, *way, start[0]) for _, module, start, way in drawn[:number]]


class Trial:
    """Mutants meet their tests, in one copy.

    Args:
        copy: of the tree.
        map_file: which test executes which line; what is missing is measured when it is asked for.
        seconds: of tests that a mutant meets in each of the two lines.
        slow: tests marked slow in the package's folder, too.
        without: files of tests that no mutant meets.
    """

    def __init__(self, copy: Copy, map_file: Path, *, seconds: float, slow: bool, without: Sequence[str] = ()) -> None:
        self._copy, self._reach, self._map_file, self._seconds = copy, Reach.of(map_file), map_file, seconds
        self._marks = ("not slow", "slow") if slow else ("not slow",)
        files = (f for f in (ROOT / "tests").rglob("test_*.py") if f.parent.name != "browser")
        self._files = sorted({str(f.relative_to(ROOT)) for f in files} - set(without))
        core = [f for f in self._files if "mark.core" in (ROOT / f).read_text(encoding="utf-8")]
        self._core = sorted(core, key=lambda file: not file.startswith(FIRST))
        self._kills = Counter[str]()

    def test(self, mutant: Mutant) -> None:
        """Write the mutant, run its tests, put the file back."""
        started = time.monotonic()
        own, others = folders_of(mutant.group) if mutant.group != "C" else ([], [])
        for folders, marks in ((own, self._marks), (others, ("not slow",))):
            files = [f for f in self._files if f.startswith(tuple(folders))]
            for mark in marks:  # before the file is changed
                self._reach.measure(self._copy, files, mark, self._map_file)
            tests = self._tests(mutant, folders)
            with self._copy.changed(mutant.module, mutant.write(self._copy.folder)) as compiled:
                mutant.killer = self._killer(mutant, tests) if compiled else "the compiler"
            if mutant.killer or not others:
                break
        mutant.outcome = "killed" if mutant.killer else "equivalent" if mutant.why_equivalent else "survived"
        mutant.seconds = round(time.monotonic() - started, 1)

    def first_failure(self) -> str:
        """The test of the compiled code that fails without any mutation, or ""."""
        return self._copy.killer(self._core, "-m", CORE, limit=3600)

    def _tests(self, mutant: Mutant, folders: list[str]) -> list[str]:
        """Tests of some folders for the line that the mutant changes, which is in place as yet; none for C.

        Of the package's own folder all quick ones for a line that an import executes.
        """
        if mutant.group == "C":
            return []
        source = (self._copy.folder / mutant.module).read_text(encoding="utf-8")
        line = source.splitlines()[mutant.line - 1] if mutant.line in in_functions(source) else ""
        if not line and len(folders) == 1:
            return folders
        return self._reach.tests(mutant.module, line, self._seconds, folders)

    def _killer(self, mutant: Mutant, tests: list[str]) -> str:
        if mutant.group == "C":
            first = [name for name, _ in self._kills.most_common(12)]
            killer = self._copy.killer(first, limit=120) or self._copy.killer(self._core, "-m", CORE, limit=300)
            if "::" in killer:
                self._kills[killer.partition("[")[0]] += 1
            return killer
        marks = ("-m", "not slow") if len(self._marks) == 1 else ()
        return self._copy.killer(tests, *marks, limit=int(60 + 6 * self._seconds))


def report(mutants: list[Mutant]) -> float:
    """Print what came out; share of those killed that can be, of the group with the smallest [1]."""
    for m in mutants:
        if m.outcome == "survived":
            print(f"\nsurvived: {m.module}:{m.line} {m.operator}\n- {m.before}\n+ {m.after}")
    print(f"\n{'':12}{'killed':>8}{'survived':>10}{'equivalent':>12}")
    shares = [1.0]
    for group in GROUPS:
        n = Counter(m.outcome for m in mutants if m.group == group)
        if n:
            shares.append(n["killed"] / max(1, n["killed"] + n["survived"]))
            print(f"{group:12}{n['killed']:>8}{n['survived']:>10}{n['equivalent']:>12}{shares[-1]:>8.0%}")
    return min(shares)


def main() -> int:
    parser = argparse.ArgumentParser(description="Mutation testing of every package and of the C code.")
    parser.add_argument("--number", type=int, default=60, help="mutants of each group (default 60)")
    parser.add_argument("--seed", type=int, default=1, help="choice of the mutants (default 1)")
    parser.add_argument("--only", nargs="+", choices=GROUPS, metavar="GROUP", default=GROUPS, help="default all")
    parser.add_argument("--least", type=float, default=0.9, help="share to be killed in each group (default 0.9)")
    parser.add_argument("--seconds", type=float, default=20.0, help="of tests that a mutant meets, twice (default 20)")
    parser.add_argument("--slow", action="store_true", help="tests of the package marked slow, too")
    default = ROOT / "out" / "mutation_map.json"
    parser.add_argument("--map", type=Path, default=default, help="which test executes which line: made if missing")
    parser.add_argument("--json", type=Path, help="write each mutant and what came of it to this file")
    parser.add_argument("--without", nargs="+", metavar="FILE", default=(), help="test files that no mutant meets")
    parser.add_argument("--resume", action="store_true", help="leave out what the file of --json says was killed")
    parser.add_argument("--list", action="store_true", help="print the mutants, and test none")
    args = parser.parse_args()
    if args.resume and not args.json:
        parser.error("--resume goes on with the file of --json: name it")
    mutants = [m for group in args.only for m in chosen(group, args.number, args.seed)]
    for m in mutants:
        m.write()
    if args.list:
        for m in mutants:
            print(f"{m.module}:{m.line} {m.operator}\n- {m.before}\n+ {m.after}")
        return 0
    kept = (
        [Mutant(**m) for m in json.loads(args.json.read_text(encoding="utf-8"))]
        if args.resume and args.json.exists()
        else []
    )
    known = {m.key: m for m in kept if m.outcome == "killed" or m.why_equivalent}
    tested = [known[m.key] for m in mutants if m.key in known]
    for m in tested:
        m.outcome = "equivalent" if m.why_equivalent else m.outcome
    others = [m for m in kept if m.group not in args.only]
    mutants = [m for m in mutants if m.key not in known]
    print(f"{len(tested)} were killed before or are equivalent, {len(mutants)} are left", flush=True)
    with tempfile.TemporaryDirectory() as folder:
        trial = Trial(Copy(Path(folder) / "tree"), args.map, seconds=args.seconds, slow=args.slow, without=args.without)
        if "C" in args.only and (killer := trial.first_failure()):
            print(f"without any mutation {killer} fails")
            return 2
        for m in mutants:
            trial.test(m)
            tested.append(m)
            print(f"{m.seconds:5.0f} s {m.outcome:10} {m.module}:{m.line} {m.operator} {m.killer}", flush=True)
            if args.json:
                args.json.parent.mkdir(parents=True, exist_ok=True)
                args.json.write_text(
                    json.dumps([asdict(m) for m in others + tested], indent=1) + "\n", encoding="utf-8"
                )
    share = report(tested)
    print(f"\n{share:.1%} killed where the fewest were, {args.least:.0%} asked")
    return int(share < args.least)


if __name__ == "__main__":
    sys.exit(main())
