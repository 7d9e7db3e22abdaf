"""The report in Chromium: it opens offline, draws every picture, and sends no requests."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from coopqp import Recording
from coopqp.visualization import write_report


@pytest.mark.slow
def test_the_report_opens_offline(page: Any, baseline: Callable[..., Recording], tmp_path: Path) -> None:
    file = write_report(baseline(40), tmp_path / "report.html")
    assert file.stat().st_size < 5_000_000
    page.open(file.as_uri())
    page.wait_until(lambda: page.evaluate("document.readyState == 'complete' && document.images.length == 3"))
    sizes = page.evaluate("Promise.all([...document.images].map(i => i.decode().then(() => i.naturalWidth)))")
    assert min(sizes) > 300
    assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")  # no horizontal overflow
    assert page.errors == []
    assert [url for url in page.requests if not url.startswith("data:")] == [file.as_uri()]


@pytest.mark.slow
def test_the_report_holds_the_scene_and_is_dark_for_who_wants_it(
    page: Any, baseline: Callable[..., Recording], tmp_path: Path
) -> None:
    file = write_report(baseline(40), tmp_path / "report.html", scene=True)
    assert file.stat().st_size < 5_000_000
    inside = "document.querySelector('iframe').contentDocument"
    page.open(file.as_uri())
    page.wait_until(lambda: page.evaluate("document.readyState == 'complete' && document.images.length == 2"))
    bright = page.screenshot().mean()
    page.wait_until(lambda: page.evaluate(f"!!{inside}.querySelector('[class*=Slider-trackContainer]')"), timeout=60)
    assert page.evaluate(f"{inside}.querySelector('[data-slot=clock]').textContent").startswith("t = ")
    page.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": "dark"}])
    assert page.screenshot().mean() < 0.4 * bright
    assert page.errors == []
    assert [url for url in page.requests if not url.startswith(("data:", "blob:", "about:"))] == [file.as_uri()]
