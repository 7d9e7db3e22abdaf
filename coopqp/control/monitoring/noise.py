"""Noise in measurements, from their second differences, which motion hardly has."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from coopqp.spatial import Array


def noise_seen(
    values: Array, last: Array, step: Array, mean_square: Array, samples: float, counts: Any = True
) -> float:
    """Largest noise of rows of ``values`` (n, m) [m, rms].

    Args:
        values: one sample.
        last, step: the last sample, and its difference from the one before (n, m); they are renewed.
        mean_square: of the second differences of each row (n,); it is renewed.
        samples: number of samples, or of those that the mean is taken over.
        counts: rows whose noise counts (n,); by default all.
    """
    bend = values - last - step
    step[:], last[:] = values - last, values
    if samples > 2.0:  # the first differences are with nothing
        # With long steps the averaging time holds few samples: the latest then counts for all.
        mean_square += (np.square(bend).sum(axis=1) - mean_square) / max(samples - 2.0, 1.0)
    return math.sqrt(float(mean_square.max(initial=0.0, where=counts)) / 6.0)
