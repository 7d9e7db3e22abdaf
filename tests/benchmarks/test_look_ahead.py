"""The look-ahead against the fastest motion and version 0.1, on a share of the cases of benchmarks/look_ahead.py."""

from __future__ import annotations

from typing import Any

import common
import look_ahead
import numpy as np
import pytest

#: One case in so many.
EVERY = 6


@pytest.fixture(scope="module")
def pairs() -> list[tuple[dict[str, Any], dict[str, Any]]]:
    return list(look_ahead.compare(EVERY, common.Progress(1)))


def ratios(pairs: Any, key: str, *kinds: str) -> Any:
    return np.array([now[key] for now, _ in pairs if now["case"] in kinds and now[key] is not None])


@pytest.mark.slow
def test_random_paths_take_little_more_than_the_shortest_time(pairs: Any) -> None:
    assert np.median(ratios(pairs, "ratio", "paths, linear")) < 1.05
    assert np.median(ratios(pairs, "ratio", "paths, quintic")) < 1.12


@pytest.mark.slow
def test_near_limits_and_singularities_nothing_is_lost(pairs: Any) -> None:
    """No cell is slower than with version 0.1, or less exact; the QP answers only where it did then."""
    kinds = ("near a limit", "along a limit", "past a wrist", "into a singularity")
    assert ratios(pairs, "to_0_1", *kinds).max() < 1.01
    count = 0
    for now, before in pairs:
        if now["case"] not in kinds:
            continue
        count += 1
        assert now["finished"] >= before["finished"], now
        assert now["chain_um"] < 2.0 * before["chain_um"] + 1.0, now
        assert now["path_um"] < 2.0 * before["path_um"] + 1.0, now
        assert not now["qp"] or before["qp"], now
    assert count > 15
