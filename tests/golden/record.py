"""Record golden runs anew: ``record.py CASE…`` those whose test or parameters contain one of the words, else all.

A case that is as it was recorded keeps its file. ``--disturbed 1e-12`` writes nothing: it names the cases whose steps
leave their bounds when the configuration that they start at is moved by as much.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent / "support")]

import golden as runs  # noqa: E402


class Recorder(runs.Session):
    """What is made is kept, where it differs from what is there."""

    def __init__(self) -> None:
        super().__init__()
        self.made: set[tuple[str, str]] = set()

    def end(self, made: runs.Golden) -> None:
        self.made.add((made.name, made.case))
        try:
            known = made.kept()
        except (OSError, KeyError):
            known = []
        if why := made.differs(known):
            made.write()
            print(f"recorded: {made.name}[{made.case}]: {why}" if known else f"recorded: {made.name}[{made.case}]")

    def forget_others(self) -> None:
        """Leave out what was recorded of cases that are no more."""
        for file in runs.KEPT.glob("*.zip"):
            entries = runs.entries(file)
            left = {name: kept for name, kept in entries.items() if (file.stem, name.rpartition(".")[0]) in self.made}
            if not left:
                file.unlink()
            elif len(left) < len(entries):
                runs.write(file, left)


class Only:
    """Of the tests those with golden runs."""

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        items[:] = [item for item in items if "golden" in getattr(item, "fixturenames", ())]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", nargs="*", metavar="CASE", help="part of the name of a test or of its parameters")
    parser.add_argument("--disturbed", type=float, default=0.0, help="compare runs from starts that are moved [rad, m]")
    parser.add_argument("--seed", type=int, default=0, help="where they are moved")
    args = parser.parse_args()
    chosen = ["-k", " or ".join(args.cases)] if args.cases else []
    files = [str(file) for file in sorted(HERE.parent.rglob("test_*.py")) if "golden: Golden" in file.read_text()]
    options = [*files, *chosen, "--tb=line", "-rf", "-p", "no:cacheprovider", "-p", "no:xdist"]
    if args.disturbed:
        runs.SESSION = runs.Session(disturbed=args.disturbed, seed=args.seed)
        return int(pytest.main(options, plugins=[Only()]))
    runs.SESSION = recorder = Recorder()
    status = int(pytest.main([*options, "-s"], plugins=[Only()]))
    if not args.cases and not status:
        recorder.forget_others()
    return status


if __name__ == "__main__":
    sys.exit(main())
