"""The viewer in Chromium: the page loads without errors or requests, shows a scene, and scrubbing moves the arms."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from coopqp import Recording
from coopqp.visualization import LiveViewer, export_html

TRACK = "[class*=Slider-track]"


def changed(a: Any, b: Any) -> float:
    """Share of the pixels that differ visibly."""
    return float((np.abs(a - b).max(axis=2) > 40).mean())


def coloured(picture: Any) -> float:
    """Share of the pixels that are neither grey nor white: the arms and the object."""
    return float((np.ptp(picture, axis=2) > 60).mean())


def text(page: Any) -> str:
    return str(page.evaluate("document.body ? document.body.innerText : ''"))


@pytest.mark.slow
def test_the_page_plays_offline(page: Any, baseline: Callable[..., Recording], tmp_path: Path) -> None:
    file = export_html(baseline(40), tmp_path / "run.html")
    page.open(file.as_uri())
    page.wait_until(lambda: page.evaluate(f"!!document.querySelector('{TRACK}')"))
    page.wait_until(lambda: coloured(page.screenshot()) > 0.02)
    page.pause()  # not earlier: a page paused before its first message stays empty
    track = page.box(TRACK)

    def at(share: float) -> Any:
        page.press(track["left"] + share * track["width"], track["top"] + 0.5 * track["height"])
        return page.settled()

    start, end = at(0.01), at(0.66)
    assert coloured(start) > 0.02  # the scene is not empty
    assert changed(start, end) > 0.02  # scrubbing moves the arms
    assert changed(start, at(0.01)) < 0.005  # and back
    assert "pseudo" in page.evaluate("document.querySelector('#coopqp').innerText").lower()
    assert page.errors == []
    assert [url for url in page.requests if not url.startswith(("data:", "blob:", "file:"))] == []
    assert [url for url in page.requests if url.startswith("file:")] == [file.as_uri()]


@pytest.mark.slow
def test_the_live_viewer_is_shown(page: Any, baseline: Callable[..., Recording]) -> None:
    with LiveViewer(baseline(40), port=0, sticks=True) as viewer:
        page.open(viewer.url)
        page.wait_until(lambda: "ε_p" in text(page))
        page.wait_until(lambda: coloured(page.screenshot()) > 0.005)
        before = page.settled()
        assert viewer.update(1.95) == 26
        page.wait_until(lambda: "t = 1.95" in text(page))
        assert changed(before, page.settled()) > 0.003
        assert page.errors == []
        assert all(
            url.startswith((viewer.url, viewer.url.replace("http", "ws"), "data:", "blob:")) for url in page.requests
        )
