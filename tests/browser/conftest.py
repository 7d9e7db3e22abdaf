"""A page in Chromium. Without Chromium these tests are skipped, or fail if COOPQP_BROWSER_TESTS is set."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from browser import NAMES, Page, find_browser


@pytest.fixture
def page(tmp_path: Path) -> Iterator[Page]:
    """A blank page in a separate browser."""
    program = find_browser()
    if program is None:
        reason = f"no browser ({', '.join(NAMES)}) on the path; 'make browser' installs one"
        if os.environ.get("COOPQP_BROWSER_TESTS"):
            pytest.fail(reason)
        pytest.skip(reason)
    with Page(program, tmp_path / "profile", width=640, height=420) as opened:
        yield opened
