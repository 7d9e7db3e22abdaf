"""How many cases a run of the catalogue takes: ``count(n)`` is n, in the ``nightly`` profile ten times as many."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from hypothesis import settings

NIGHTLY_FACTOR = 10


@pytest.fixture(scope="session")
def count() -> Callable[[int], int]:
    factor = NIGHTLY_FACTOR if settings.get_current_profile_name() == "nightly" else 1
    return lambda cases: cases * factor
