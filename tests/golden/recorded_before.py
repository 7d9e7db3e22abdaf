"""What any test may ask for: ``golden``. Its runs are compared with recorded ones when the test has done its checks."""

from __future__ import annotations

from collections.abc import Iterator

import golden as runs
import pytest


@pytest.fixture
def golden(request: pytest.FixtureRequest) -> runs.Golden:
    """Starts runs. They are compared at the end of the test."""
    return runs.SESSION.begin(request.node.nodeid)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Iterator[None]:
    """The test, and then the comparison."""
    yield
    made = getattr(item, "funcargs", {}).get("golden")
    if isinstance(made, runs.Golden):
        runs.SESSION.end(made)
