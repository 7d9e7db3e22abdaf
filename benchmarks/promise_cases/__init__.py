"""The cases of ``benchmarks/promises.py``: a module has a generator ``promises(quick)`` of :class:`Promise`."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Promise:
    """A measured value and its bound.

    Attributes:
        case: what was measured, in words.
        value: the measured value, in ``unit``.
        bound: the largest value that keeps the promise.
        unit: unit of both.
    """

    case: str
    value: float
    bound: float
    unit: str
