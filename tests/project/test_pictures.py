"""Each picture of the pages is drawn by a program of `docs/pictures.py`, and this program still draws it so."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest
from browser import find_browser
from pictures import MOST_PIXELS, NEEDS_BROWSER, PROGRAMS, ROOT, difference, draw, drawn_alike
from PIL import Image

KINDS = ("png", "gif", "webp", "jpg", "svg")
PAGES = [ROOT / "README.md", *sorted(p for p in (ROOT / "docs").rglob("*.md") if "_build" not in p.parts)]


def shown() -> set[str]:
    """Paths from the root of all pictures that the README and the pages show."""
    found = set()
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        names = re.findall(r"!\[[^\]]*\]\(([^)\s]+)", text) + re.findall(r"\{(?:image|figure)\} (\S+)", text)
        names += re.findall(r"<img[^>]*\bsrc=\"([^\"]+)\"", text)
        local = [name for name in names if not name.startswith(("http:", "https:", "data:"))]
        found |= {(page.parent / name).resolve().relative_to(ROOT).as_posix() for name in local}
    return found


def test_every_picture_of_the_pages_has_a_program_and_every_program_a_place_on_a_page() -> None:
    listed = [picture for pictures in PROGRAMS.values() for picture in pictures]
    assert len(listed) == len(set(listed))
    files = {p.relative_to(ROOT).as_posix() for kind in KINDS for p in (ROOT / "docs").rglob(f"*.{kind}")}
    assert set(listed) == shown() == {file for file in files if "_build" not in file}


@pytest.mark.slow  # the examples draw their pictures in test_docs, where their output is read too
@pytest.mark.parametrize("program", [program for program in PROGRAMS if "docs/examples/" not in program])
def test_a_program_draws_the_pictures_of_the_pages(program: str, tmp_path: Path) -> None:
    if NEEDS_BROWSER in program and find_browser() is None and not os.environ.get("COOPQP_BROWSER_TESTS"):
        pytest.skip("no browser; 'make browser' installs one")  # else the program fails
    for picture, drawn in zip(PROGRAMS[program], draw(program, tmp_path), strict=True):
        assert not drawn_alike() or difference(ROOT / picture, drawn) <= MOST_PIXELS, picture


def test_a_picture_differs_by_the_share_of_its_changed_pixels(tmp_path: Path) -> None:
    plain = Image.new("RGB", (20, 10), "white")
    spot, blue = plain.copy(), Image.new("RGB", plain.size, "blue")
    spot.paste("red", (2, 2, 6, 7))
    for name, images in {"a": [plain], "b": [spot], "c": [plain, blue], "d": [spot, blue]}.items():
        images[0].save(tmp_path / f"{name}.webp", save_all=True, append_images=images[1:], lossless=True)
    plain.resize((10, 10)).save(tmp_path / "e.png")
    moved = plain.copy()
    moved.paste("red", (3, 3, 7, 8))
    moved.save(tmp_path / "f.webp", lossless=True)
    names = {name: tmp_path / f"{name}.webp" for name in "abcdf"} | {"e": tmp_path / "e.png"}
    assert difference(names["a"], names["a"]) == 0.0
    assert difference(names["a"], names["b"]) == pytest.approx(0.1)
    assert difference(names["b"], names["f"]) == 0.0  # moved by one pixel
    assert difference(names["c"], names["d"]) == pytest.approx(0.05)
    assert difference(names["a"], names["e"]) == 1.0
