"""Long curves as they are drawn: fewer points, and none of their peaks is lost."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from coopqp.simulation.recording.recording import Recording
from coopqp.spatial import Array

#: Spans of time of a drawn curve, more than a page has pixels.
DRAWN_SPANS = 4000
#: Numbers beyond this are drawn there: Matplotlib cannot draw 1e300.
_FAR = 1e12


def drawn(time: Array, values: Array, *, spans: int = DRAWN_SPANS) -> tuple[Array, Array]:
    """Curves as they are drawn: of long ones the least and the largest value of each of many equal spans.

    Args:
        time: (T,) [s].
        values: (T,), or (T, n) for n curves.
        spans: number of spans, at least 1.
    """
    values = np.clip(values, -_FAR, _FAR)
    if len(time) <= 4 * spans:
        return time, values
    first = np.linspace(0, len(time), spans, endpoint=False).astype(int)
    ends = np.stack([np.fmin.reduceat(values, first), np.fmax.reduceat(values, first)], axis=1)
    return np.repeat(time[first], 2), ends.reshape(-1, *values.shape[1:])


def drawn_rows(recording: Recording, count: int, rows: Callable[[slice], Array]) -> tuple[Array, Array]:
    """Times and rows of ``count`` samples or steps as they are drawn, from ``rows(part)`` (T, n) of one part after the
    other.
    """
    if count <= 4 * DRAWN_SPANS:
        return recording.time[:count], np.clip(rows(slice(0, count)), -_FAR, _FAR)
    curves = [
        drawn(recording.time[part], rows(part), spans=max(1, (part.stop - part.start) * DRAWN_SPANS // count))
        for part in recording.parts(count)
    ]
    times, values = zip(*curves, strict=True)
    return np.concatenate(times), np.concatenate(values)
