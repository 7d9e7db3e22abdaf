"""The examples of the reference: `docs/reference/PAGE.py` has those of the classes of `docs/reference/PAGE.md`.

Such a file is a program in sections. ``# %% before`` stands at the head of the page, ``# %% NAME, NAME`` at the classes
that it names. `docs/conf.py` shows them, a test runs each file from the first line to the last.
"""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

FOLDER = Path(__file__).parent / "reference"
#: Name of the section at the head of a page.
BEFORE = "before"


@cache
def sections(page: str) -> dict[str, str]:
    """The code of each name of a page, ``control`` for instance; empty for a page without examples."""
    file = FOLDER / f"{page}.py"
    if not file.is_file():
        return {}
    parts = re.split(r"^# %% (.+)\n", file.read_text(encoding="utf-8"), flags=re.M)[1:]
    return {
        name: code.strip() for names, code in zip(parts[::2], parts[1::2], strict=True) for name in names.split(", ")
    }


def classes(page: str) -> list[str]:
    """The classes that a page of the reference describes."""
    return re.findall(r"^\.\. autoclass:: (\S+)$", (FOLDER / f"{page}.md").read_text(encoding="utf-8"), flags=re.M)


def example_of(name: str) -> str:
    """The example of a class by its full name; empty if it has none."""
    pages = sorted(file.stem for file in FOLDER.glob("*.py"))
    return next((sections(page)[name] for page in pages if name in sections(page)), "")
