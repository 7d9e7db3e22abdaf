"""The reference has an example for each class, and each of them runs."""

from __future__ import annotations

import contextlib
import io
import warnings
from pathlib import Path

import pytest
from class_examples import BEFORE, FOLDER, classes, sections

PAGES = sorted(file.stem for file in FOLDER.glob("*.md"))


@pytest.mark.parametrize("page", PAGES)
def test_each_class_has_an_example(page: str) -> None:
    assert [name for name in classes(page) if not sections(page).get(name)] == []
    assert set(sections(page)) <= {BEFORE, *classes(page)}


@pytest.mark.slow
@pytest.mark.parametrize("page", [page for page in PAGES if sections(page)])
def test_the_examples_of_a_page_run(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    file = FOLDER / f"{page}.py"
    with contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        exec(compile(file.read_text(encoding="utf-8"), str(file), "exec"), {"__name__": "__main__"})
