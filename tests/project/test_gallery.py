"""The gallery: its page is what its script writes, pictures are small, and `coopqp check` says what stands there."""

from __future__ import annotations

import gallery
import pytest
from PIL import Image
from places import DOCS

from coopqp.files.cellfile import CELLS
from coopqp.scenarios import SCENARIOS


def test_the_page_is_what_the_script_writes() -> None:
    assert gallery.page_text(gallery.verdicts_of_page()) == gallery.PAGE.read_text(encoding="utf-8")


def test_it_has_many_cells_and_each_can_be_had() -> None:
    names = [entry.name for entry in gallery.ENTRIES]
    assert len(set(names)) == len(names) >= 15
    assert [name for name in names if name not in {*CELLS, *SCENARIOS}] == []


def test_thumbnails_are_small_and_wide_enough() -> None:
    for entry in gallery.ENTRIES:
        file = DOCS / "images" / f"gallery_{entry.name}.webp"
        assert file.stat().st_size < 20_000, file.name
        with Image.open(file) as picture:
            assert picture.size == gallery.SIZE


@pytest.mark.slow
@pytest.mark.parametrize("entry", gallery.ENTRIES, ids=lambda entry: entry.name)
def test_check_says_what_stands_on_the_page(entry: gallery.Entry) -> None:
    assert gallery.verdict(entry) == gallery.verdicts_of_page()[entry.name]


def test_the_program_of_the_viewer_is_taken_out_whole() -> None:
    loader = 'const d=document.currentScript.dataset; run("</b>");'
    document = f'<head><title>Viser</title><script data-p="a\\\\b" data-ss="1">{loader}</script></head><body></body>'
    page, program = gallery.split_viewer(document)
    assert page == '<head><title>Viser</title><script src="viewer.js"></script></head><body></body>'
    assert '{"p": "a\\\\\\\\b", "ss": "1"}' in program
    with pytest.raises(RuntimeError, match="another form"):
        gallery.split_viewer("<head></head>")
