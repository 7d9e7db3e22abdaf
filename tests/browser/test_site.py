"""The site that ``make docs`` builds: no warnings, no dead links; searches find their pages; all can read them."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from collections.abc import Iterator
from functools import partial
from html.parser import HTMLParser
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from importlib import resources
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urldefrag

import numpy as np
import pytest
from browser import Page
from places import DOCS

#: What people search for, and the page that they have to find first or second.
SEARCHES = {
    "impedance": "tutorials/9-hold-without-squeezing.html",
    "admittance": "tutorials/9-hold-without-squeezing.html",
    "teleoperation": "tutorials/11-stop-back-aside.html",
    "conveyor": "tutorials/12-conveyor.html",
    "dual-arm": "tutorials/14-one-robot-two-arms.html",
    "bimanual": "faq.html",
    "closed chain": "derivations.html",
    "load sharing": "howto/load.html",
    "ROS": "howto/ros2.html",
}
#: Pages of every kind, for the tests of what a reader with a disability meets.
READ = (
    "index.html", "faq.html", "troubleshooting.html", "derivations.html", "notation.html", "beside.html",
    "tutorials/1-paper-lift.html", "tutorials/8-nothing-touches.html", "howto/cell-file.html", "howto/look.html",
    "gallery.html", "notebooks/first_cell.html", "reference.html", "reference/model.html", "reference/control.html",
)  # fmt: skip
SEARCHED = "!!document.querySelector('.search-summary')?.innerText.match(/\\d|not/)"
RESULTS = "[...document.querySelectorAll('#search-results li > a')].map(a => a.getAttribute('href'))"


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The pages as HTML; warnings are errors."""
    out = tmp_path_factory.mktemp("site")
    line = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-b", "html", str(DOCS), str(out)]
    done = subprocess.run(line, capture_output=True, text=True, timeout=500, check=False)
    assert done.returncode == 0, done.stderr
    return out


class _Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *_: Any) -> None:
        """Nothing is printed."""


@pytest.fixture
def address(site: Path) -> Iterator[str]:
    """Where a server on this machine shows the site."""
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(_Quiet, directory=str(site))) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()


class _Links(HTMLParser):
    """Links, names of places, and pictures of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: list[str] = []
        self.places: set[str] = set()
        self.nameless: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = dict(attrs)
        self.places |= {found[key] or "" for key in ("id", "name") if key in found}
        self.links += [found[key] or "" for key in ("href", "src") if key in found]
        if tag == "img" and not found.get("alt"):
            self.nameless.append(found.get("src") or "")


@pytest.mark.slow
def test_the_pages_build_and_no_link_is_dead(site: Path) -> None:
    pages = {file: _Links(file.read_text(encoding="utf-8")) for file in site.rglob("*.html")}
    assert site / "tutorials" / "1-paper-lift.html" in pages
    dead = []
    for file, page in pages.items():
        for link in page.links:
            path, place = urldefrag(link)
            if path.startswith(("http:", "https:", "mailto:", "data:")):
                continue
            target = (file.parent / unquote(path.partition("?")[0])).resolve() if path else file
            if not target.exists() or (place and target in pages and unquote(place) not in pages[target].places):
                dead.append(f"{file.relative_to(site)}: {link}")
        assert not page.nameless, f"{file.relative_to(site)}: a picture without an alternative text"
    assert dead == []


@pytest.mark.slow
def test_no_page_shows_how_sphinx_names_an_alias(site: Path) -> None:
    assert [file.name for file in site.rglob("*.html") if "TypeAliasForwardRef" in file.read_text("utf-8")] == []


@pytest.mark.slow
def test_the_front_page_plays_without_a_server(site: Path, page: Page) -> None:
    """Opened from its folder: the frame loads its page and the viewer beside it, and nothing else."""
    page.open((site / "index.html").as_uri())
    page.wait_until(lambda: page.evaluate("!!document.querySelector('iframe.plays')"))
    page.evaluate("document.querySelector('iframe.plays').scrollIntoView()")
    played = site / "3d" / "bar_over_post.html"
    wanted = {played.as_uri(), (played.parent / "viewer.js").as_uri()}
    page.wait_until(lambda: page.screenshot() is not None and wanted <= set(page.requests))
    assert [url for url in page.requests if not url.startswith(("file:", "data:", "blob:"))] == []


@pytest.mark.slow
def test_a_page_of_the_gallery_plays_without_a_server(site: Path, page: Page) -> None:
    """The viewer stands beside it in a file of its own."""
    file = site / "3d" / "bar.html"
    page.open(file.as_uri())
    page.wait_until(lambda: page.evaluate("!!document.querySelector('[class*=Slider-track]')"))
    page.wait_until(lambda: (np.ptp(page.screenshot(), axis=2) > 60).mean() > 0.01)  # arms and object have colours
    clock = "document.querySelector('[data-slot=clock]').textContent"
    first = page.evaluate(clock)
    page.wait_until(lambda: page.screenshot() is not None and page.evaluate(clock) != first)
    assert page.errors == []
    wanted = {file.as_uri(), (file.parent / "viewer.js").as_uri()}
    assert {url for url in page.requests if not url.startswith(("data:", "blob:"))} == wanted


def test_the_overview_for_language_models_names_pages_that_exist() -> None:
    lines = (DOCS / "llms.txt").read_text(encoding="utf-8").split("](")[1:]
    pages = [line.partition(")")[0].removesuffix(".html") for line in lines]
    assert len(pages) > 10
    assert [page for page in pages if not (DOCS / f"{page}.md").exists()] == []


@pytest.mark.slow
def test_every_search_finds_its_page_first_or_second(address: str, page: Page) -> None:
    missed = {}
    for words, wanted in SEARCHES.items():
        page.open(f"{address}/search.html?q={words.replace(' ', '+')}")
        page.wait_until(lambda: page.evaluate(SEARCHED))
        found = list(dict.fromkeys(href.partition("#")[0].partition("?")[0] for href in page.evaluate(RESULTS)))
        if wanted not in found[:2]:
            missed[words] = found[:4]
    assert missed == {}


@pytest.mark.slow
def test_no_reader_is_kept_out(address: str, page: Page) -> None:
    """axe-core finds nothing serious, and no page is wider than a telephone."""
    axe = resources.files("axe_core_python").joinpath("axe.min.js").read_text(encoding="utf-8")
    serious, wide = {}, []
    for name in READ:
        page.open(f"{address}/{name}")
        whole = f"location.pathname === '/{name}' && document.readyState === 'complete'"
        page.wait_until(lambda whole=whole: page.evaluate(whole))  # half of a list would be no list
        page.evaluate(axe + "; true")
        page.evaluate("window.found = null; true")
        page.evaluate("axe.run({resultTypes: ['violations']}).then(r => { window.found = r.violations }); true")
        page.wait_until(lambda: page.evaluate("window.found !== null"))
        violations = json.loads(page.evaluate("JSON.stringify(window.found)"))
        bad = [
            f"{rule['id']}: {rule['nodes'][0]['html'][:120]}"
            for rule in violations
            if rule["impact"] in ("serious", "critical")
        ]
        if bad:
            serious[name] = bad
        page.call("Emulation.setDeviceMetricsOverride", width=360, height=640, deviceScaleFactor=1, mobile=True)
        if page.evaluate("document.documentElement.scrollWidth") > 361:
            wide.append(name)
        page.call("Emulation.clearDeviceMetricsOverride")
    assert serious == {}
    assert wide == []
