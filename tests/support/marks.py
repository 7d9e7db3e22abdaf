"""Which cases of a test ``make check`` runs."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import pytest


def slow_unless(quick: Callable[[Any], bool], values: Iterable[Any]) -> list[Any]:
    """Parameters of a test, marked slow but for those that are ``quick``: the ones that ``make check`` runs."""
    return [value if quick(value) else pytest.param(value, marks=pytest.mark.slow) for value in values]


def slow_but_first(values: Iterable[Any]) -> list[Any]:
    """Parameters of a test, marked slow but for the first."""
    first, *others = values
    return [first, *(pytest.param(value, marks=pytest.mark.slow) for value in others)]
