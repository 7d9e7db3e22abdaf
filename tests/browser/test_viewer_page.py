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
CLOCK = "document.querySelector('[data-slot=clock]').textContent"


def changed(a: Any, b: Any) -> float:
    """Share of the pixels that differ visibly."""
    return float((np.abs(a - b).max(axis=2) > 40).mean())


def coloured(picture: Any) -> float:
    """Share of the pixels that are neither grey nor white: the arms and the object."""
    return float((np.ptp(picture, axis=2) > 60).mean())


def text(page: Any) -> str:
    """The words on the page, after a frame: without a screenshot the browser draws none."""
    page.screenshot()
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

    start = at(0.01)
    page.wait_until(lambda: page.evaluate(CLOCK).startswith("t = 0.0"), timeout=20)
    end = at(0.66)
    page.wait_until(lambda: page.evaluate(CLOCK).startswith("t = 3.00 s"), timeout=20)
    place = page.evaluate("getComputedStyle(document.documentElement).getPropertyValue('--coopqp-at')")
    assert float(place) > 0.9  # the line through the plots has moved along
    band = page.evaluate(
        "getComputedStyle(document.querySelector('[class$=Slider-track]'), '::before').backgroundImage"
    )
    assert "linear-gradient" in band
    assert coloured(start) > 0.02  # the scene is not empty
    assert changed(start, end) > 0.02  # scrubbing moves the arms
    assert changed(start, at(0.01)) < 0.005  # and back
    assert "pseudo" in page.evaluate("document.querySelector('#coopqp').innerText").lower()
    assert page.errors == []
    assert [url for url in page.requests if not url.startswith(("data:", "blob:", "file:"))] == []
    assert [url for url in page.requests if url.startswith("file:")] == [file.as_uri()]


@pytest.mark.slow
def test_plots_stand_beside_a_wide_scene_and_move_it(
    page: Any, baseline: Callable[..., Recording], tmp_path: Path
) -> None:
    """A narrow page has one line in their place, until they are asked for; a press on a plot moves the run there."""
    file = export_html(baseline(40), tmp_path / "run.html", sticks=True)
    page.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": "dark"}])
    page.open(file.as_uri())
    page.wait_until(lambda: page.evaluate(f"!!document.querySelector('{TRACK}')"))
    page.wait_until(lambda: "follows its path" in text(page))
    page.wait_until(lambda: coloured(page.screenshot()) > 0.001)
    page.pause()
    shown = "getComputedStyle(document.querySelector('#coopqp-panel')).display"
    assert page.evaluate(shown) == "none"
    button = page.box("#coopqp-toggle")
    page.press(button["left"] + 5.0, button["top"] + 5.0)
    assert page.evaluate(shown) == "block"
    page.call("Emulation.setDeviceMetricsOverride", width=1000, height=600, deviceScaleFactor=1, mobile=False)
    plot = page.box(".coopqp-plot")
    assert page.box("#root")["width"] <= plot["left"]
    page.press(plot["left"] + 0.5 * plot["width"], plot["top"] + 0.5 * plot["height"])
    page.wait_until(lambda: text(page) and page.evaluate(CLOCK).startswith(("t = 1.4", "t = 1.5")), timeout=30)
    assert page.settled().mean() < 90.0  # a dark page for a reader who wants one
    assert page.errors == []


@pytest.mark.slow
def test_the_live_viewer_is_shown(page: Any, baseline: Callable[..., Recording]) -> None:
    with LiveViewer(baseline(40), port=0, sticks=True) as viewer:
        page.open(viewer.url)
        page.wait_until(lambda: "chain error" in text(page))
        page.wait_until(lambda: coloured(page.screenshot()) > 0.005)
        before = page.settled()
        assert viewer.update(1.95) == 26
        page.wait_until(lambda: "t = 1.95" in text(page))
        assert changed(before, page.settled()) > 0.003
        assert page.errors == []
        assert all(
            url.startswith((viewer.url, viewer.url.replace("http", "ws"), "data:", "blob:")) for url in page.requests
        )
