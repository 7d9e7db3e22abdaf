"""Where things stand in the tree."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
#: Cell files of the pages.
CELL_FILES = DOCS / "examples" / "cells"
#: One of them: a bar that two arms carry beside bodies.
BAR = CELL_FILES / "bar.toml"
BENCHMARKS = ROOT / "benchmarks"
