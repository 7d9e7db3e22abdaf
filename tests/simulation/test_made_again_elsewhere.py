"""Recorded runs beside bodies and with forces are made again bit for bit in another process."""

from __future__ import annotations

import pytest
from promise_cases import made_again


@pytest.mark.slow
def test_they_are_the_same_runs() -> None:
    assert list(made_again.elsewhere([("bodies", 1), ("forces", 2)])) == [None, None]


def test_the_runs_have_calls_of_many_kinds() -> None:
    calls = [call for seed in range(3) for _, call, *_ in made_again.recorded("free", seed).metadata["calls"]]
    assert len(set(calls)) >= 6
