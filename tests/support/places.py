"""Where things stand in the tree."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
#: Cell files that come with coopqp; the pages show them.
CELL_FILES = ROOT / "coopqp" / "scenarios" / "cells"
#: One of them: a bar that two arms carry beside bodies.
BAR = CELL_FILES / "bar.toml"
BENCHMARKS = ROOT / "benchmarks"
