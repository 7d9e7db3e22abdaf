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
