"""The notebooks of the pages: run again, they print and show what they have kept."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from execute_notebooks import FOLDER, Output, as_markdown, executed, load, text_of

NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[+-]?\d+)?")


def test_there_are_two_and_each_picture_has_a_text() -> None:
    assert len(NOTEBOOKS) >= 2
    for file in NOTEBOOKS:
        page = as_markdown(load(file), file.name)
        assert re.findall(r"<img(?![^>]*alt=\"[^\"]{5,}\")[^>]{0,80}", page) == [], file.name


@pytest.mark.slow
@pytest.mark.parametrize("file", NOTEBOOKS, ids=lambda file: file.stem)
def test_a_notebook_shows_what_it_has_kept(file: Path) -> None:
    notebook = load(file)
    kept = [cell["outputs"] for cell in notebook["cells"] if cell["cell_type"] == "code"]
    for number, (before, now) in enumerate(zip(kept, executed(notebook), strict=True), start=1):
        assert [output["output_type"] for output in now] == [output["output_type"] for output in before]
        for old, new in zip(map(said, before), map(said, now), strict=True):
            assert NUMBER.sub("#", new) == NUMBER.sub("#", old), f"{file.name}, cell {number}"
            for a, b in zip(map(float, NUMBER.findall(old)), map(float, NUMBER.findall(new)), strict=True):
                assert abs(a - b) <= 0.05 * abs(a) or max(abs(a), abs(b)) < 1e-3, f"{file.name}, cell {number}: {new}"


def said(output: Output) -> str:
    """The words of an output; of HTML those between the tags."""
    if output["output_type"] == "stream":
        return text_of(output, "text")
    data = output["data"]
    if "text/html" in data:
        return " ".join(re.sub(r"<[^>]*>", " ", text_of(data, "text/html")).split())
    return re.sub(r"0x[0-9a-f]+", "", text_of(data, "text/plain"))
