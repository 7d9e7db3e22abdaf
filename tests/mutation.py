"""Mutation testing: would a test fail if the code said something else?  ``make mutation``, or ``mutation.py --help``.

Places are sampled in each package and in the C++ code. At each, one change is made in a copy of the tree, and tests run
until one fails. Python is changed and run by cosmic-ray (``mutants/python.py``): a mutant meets the tests in the folder
that is named like its package, then all others. C++ is changed by ``mutants/c.py``: a mutant is compiled and meets the
quick tests marked ``core``, those first that killed the most until then, then golden runs and the oracle, then the
others.

A mutant that survives lacks a test, or is equivalent: then ``mutants/equivalent.py`` says why. A mutant that makes the
tests run for ever is killed by its time.

``--resume`` goes on where a file of results of C++ ends: new tests meet the old survivors. Sessions of cosmic-ray are
always gone on with: remove them after a change (``out/mutation``).
"""

from __future__ import annotations

import argparse
import difflib
import json
import os
import random
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from mutants import c
from mutants.copies import ROOT, Copy
from mutants.equivalent import ANY, EQUIVALENT

#: What is sampled: a package, or the C++ code.
GROUPS = (
    "control", "planning", "model", "paths", "constraints", "solvers", "baselines", "collision", "forces", "studies",
    "files", "simulation", "C",
)  # fmt: skip
#: Tests of the compiled code, and the folders whose tests it meets first.
CORE = "core and not slow"
FIRST = ("tests/golden/", "tests/oracle/")


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
    killer: str = ""
    seconds: float = 0.0

    @property
    def outcome(self) -> str:
        return "killed" if self.killer else "equivalent" if self.why_equivalent else "survived"

    def note(self, diff: Sequence[str]) -> None:
        """Keep the changed lines of a diff."""
        self.before, self.after = (
            " ".join(line[1:].strip() for line in diff if line.startswith(sign) and not line.startswith(3 * sign))
            for sign in "-+"
        )

    def write(self, root: Path = ROOT) -> str:
        """The text of the file of C++, in a tree, with this change, which is noted."""
        source = (root / self.module).read_text(encoding="utf-8")
        mutated = c.write(source, self.operator, self.occurrence)
        self.note(list(difflib.unified_diff(source.splitlines(), mutated.splitlines(), lineterm="", n=0)))
        return mutated

    @property
    def why_equivalent(self) -> str | None:
        found = ((module, self.before, self.after) for module in (self.module, ANY))
        return next((EQUIVALENT[key] for key in found if key in EQUIVALENT), None)

    @property
    def key(self) -> tuple[str, str, str, str]:
        """The same change of the same line, wherever that line stands now."""
        return self.module, self.operator, self.before, self.after


def chosen(number: int, seed: int) -> list[Mutant]:
    """Mutants at ``number`` places of the C++ code, one a place; any place is as likely as any other.

    What is chosen stays chosen when other lines change, and a smaller number chooses the first ones of a larger.
    """
    drawn = []
    for module in sorted(str(file.relative_to(ROOT)) for file in (ROOT / "coopqp").rglob("*.cpp")):
        source = (ROOT / module).read_text(encoding="utf-8")
        lines = source.splitlines()
        for start, ways in c.sites(source).items():
            rng = random.Random(f"{seed} {module} {start[1]} {lines[start[0] - 1]}")
            drawn.append((rng.random(), module, start, rng.choice(ways)))
    drawn.sort()
    print(f"C: {len(drawn)} places", flush=True)
    mutants = [Mutant("C", module, *way, start[0]) for _, module, start, way in drawn[:number]]
    for m in mutants:
        m.write()
    return mutants


class Trial:
    """Mutants of C++ meet their tests, in one copy of the tree; files of tests that are ``without`` are met by none."""

    def __init__(self, copy: Copy, without: Sequence[str]) -> None:
        self._copy, self._kills = copy, Counter[str]()
        files = {str(f.relative_to(ROOT)) for f in (ROOT / "tests").rglob("test_*.py") if f.parent.name != "browser"}
        core = [f for f in files - set(without) if "mark.core" in (ROOT / f).read_text(encoding="utf-8")]
        self._core = sorted(core, key=lambda file: (not file.startswith(FIRST), file))

    def test(self, mutant: Mutant) -> None:
        """Write the mutant, run its tests, put the file back."""
        started = time.monotonic()
        with self._copy.changed(mutant.module, mutant.write(self._copy.folder)) as compiled:
            mutant.killer = self._killer() if compiled else "the compiler"
        mutant.seconds = round(time.monotonic() - started, 1)

    def first_failure(self) -> str:
        """The test of the compiled code that fails without any mutation, or ""."""
        return self._copy.killer(self._core, "-m", CORE, limit=3600)

    def _killer(self) -> str:
        first = [name for name, _ in self._kills.most_common(12)]
        killer = self._copy.killer(first, limit=120) or self._copy.killer(self._core, "-m", CORE, limit=300)
        if "::" in killer:
            self._kills[killer.partition("[")[0]] += 1
        return killer


def of_python(packages: Sequence[str], copy: Copy, number: int, seed: int, seconds: float) -> list[Mutant]:
    """Mutants of packages that cosmic-ray has run in the copy."""
    from mutants import python

    os.environ.update(copy.environment)
    sessions = ROOT / "out" / "mutation"
    sessions.mkdir(parents=True, exist_ok=True)
    tested = []
    os.chdir(copy.folder)
    for package in packages:
        for entry in python.run(package, sessions, number=number, seed=seed, seconds=seconds):
            diff = entry.pop("diff").splitlines()
            tested.append(Mutant(package, **entry))
            tested[-1].note(diff)
    os.chdir(ROOT)
    return tested


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
    parser = argparse.ArgumentParser(description="Mutation testing of every package and of the C++ code.")
    parser.add_argument("--number", type=int, default=60, help="mutants of each group (default 60)")
    parser.add_argument("--seed", type=int, default=1, help="choice of the mutants (default 1)")
    parser.add_argument("--only", nargs="+", choices=GROUPS, metavar="GROUP", default=GROUPS, help="default all")
    parser.add_argument("--least", type=float, default=0.9, help="share to be killed in each group (default 0.9)")
    parser.add_argument("--seconds", type=float, default=3600.0, help="after which Python runs for ever (default 3600)")
    parser.add_argument("--json", type=Path, help="write each mutant of C++ and what came of it to this file")
    parser.add_argument("--without", nargs="+", metavar="FILE", default=(), help="tests that no mutant of C++ meets")
    parser.add_argument("--resume", action="store_true", help="leave out what the file of --json says was killed")
    args = parser.parse_args()
    if args.resume and not args.json:
        parser.error("--resume goes on with the file of --json: name it")
    kept = json.loads(args.json.read_text(encoding="utf-8")) if args.resume and args.json.exists() else []
    known = {m.key: m for m in (Mutant(**entry) for entry in kept) if m.outcome != "survived"}
    mutants = chosen(args.number, args.seed) if "C" in args.only else []
    tested = [known[m.key] for m in mutants if m.key in known]
    mutants = [m for m in mutants if m.key not in known]
    print(f"{len(tested)} were killed before or are equivalent, {len(mutants)} are left", flush=True)
    with tempfile.TemporaryDirectory() as folder:
        copy = Copy(Path(folder) / "tree")
        trial = Trial(copy, args.without)
        if mutants and (killer := trial.first_failure()):
            print(f"without any mutation {killer} fails")
            return 2
        for m in mutants:
            trial.test(m)
            tested.append(m)
            print(f"{m.seconds:5.0f} s {m.outcome:10} {m.module}:{m.line} {m.operator} {m.killer}", flush=True)
            if args.json:
                args.json.parent.mkdir(parents=True, exist_ok=True)
                args.json.write_text(json.dumps([asdict(m) for m in tested], indent=1) + "\n", encoding="utf-8")
        packages = [group for group in args.only if group != "C"]
        tested += of_python(packages, copy, args.number, args.seed, args.seconds)
    share = report(tested)
    print(f"\n{share:.1%} killed where the fewest were, {args.least:.0%} asked")
    return int(share < args.least)


if __name__ == "__main__":
    sys.exit(main())
