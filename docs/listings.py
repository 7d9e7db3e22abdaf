"""Write programs and cell files into the pages that show them, below a mark that names the file.

    python docs/listings.py

``<!-- listing: docs/examples/01_paper_lift.py -->`` shows a file, a program without what draws its picture;
``<!-- listing: FILE from "A" to "B" -->`` shows the lines from the first one with A to the last one before B.
"""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGES = sorted((ROOT / "docs").rglob("*.md"))
#: A mark and the block below it.
LISTING = re.compile(
    r'^(?P<mark><!-- listing: (?P<file>\S+)(?: from "(?P<first>[^"]+)")?(?: to "(?P<behind>[^"]+)")? -->)\n'
    r"```\w+\n.*?^```$",
    re.M | re.S,
)
LANGUAGES = {".py": "python", ".toml": "toml", ".txt": "text"}
#: What draws the picture of a program begins here.
DRAWS = '\nif "--out"'


def listing(found: re.Match[str]) -> str:
    """The mark with the block that belongs below it."""
    file = ROOT / found["file"]
    text = file.read_text(encoding="utf-8").partition(DRAWS)[0]
    first, behind = found["first"] or "", found["behind"]
    begin = text.rindex("\n", 0, text.index(first)) + 1 if first else 0
    end = text.index(behind, begin) if behind else len(text)
    return f"{found['mark']}\n```{LANGUAGES[file.suffix]}\n{text[begin:end].strip()}\n```"


def main() -> None:
    """Write every listing of every page."""
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        page.write_text(LISTING.sub(listing, text), encoding="utf-8")


if __name__ == "__main__":
    main()
