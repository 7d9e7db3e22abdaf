"""Row I2: targets that move, in and out of reach, streamed with noise and jumps: the object never leaves its path.

All seeds run in benchmarks/targets.py; here there is one, and every night ten, beside those that once went wrong.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import target_cases as cases

pytestmark = pytest.mark.slow

MM = 1e-3
#: Runs that once went wrong: cell, seed, targets a second. A way that needs a rate above its cap was taken; past the
#: end of the reach an arm was seen ahead on its other branch; a joint jumped as the object went over; an arm came too
#: close to the end of its reach on a way along it; self-motion stopped at once where a way began at rest.
WENT_WRONG = {
    (cases.IN_REACH, 5.0): [("mixed_cell", 2, 100)],
    (cases.IN_REACH, np.inf): [("mixed_cell", 10, 100)],
    (cases.OUT_OF_REACH, np.inf): [
        ("mixed_cell", 1, 1000), ("panda_bar", 1, 1000), ("panda_bar", 13, 100), ("dual_arm7", 8, 1000),
        ("dual_arm7", 11, 1000), ("dual_arm7", 18, 100), ("mixed_cell", 8, 1000), ("paper_lift", 7, 100),
        ("ur5_table", 5, 100), ("ring of 8", 6, 100),
    ],
}  # fmt: skip


@pytest.mark.parametrize("acceleration", [5.0, np.inf], ids=["5 rad/s²", "no acceleration limits"])
@pytest.mark.parametrize("kind", [cases.IN_REACH, cases.OUT_OF_REACH])
def test_targets_are_chased_on_the_path(
    kind: str, acceleration: float, count: Callable[[int], int], catalogue: Any
) -> None:
    tasks = [(name, seed, hertz) for seed in range(count(1)) for name in cases.CELLS for hertz in cases.STEPS_PER_S]
    tasks += [task for task in WENT_WRONG.get((kind, acceleration), []) if task not in tasks]
    runs = [cases.chase(cases.CELLS[name](), kind, acceleration, hertz, seed) for name, seed, hertz in tasks]
    name = f"targets {kind}, {'5 rad/s²' if np.isfinite(acceleration) else 'no acceleration limits'}"
    steps = sum(round(cases.SECONDS * cases.STEPS_PER_S[hertz]) for _, _, hertz in tasks)

    def row(test: str, measured: float, target: float, unit: str = "") -> None:
        catalogue.row("I2", f"{name}: {test}", cases=steps, measured=measured, target=target, unit=unit)

    row("chain error", max(r.apart for r in runs) / MM, 0.004, "mm")
    row("off the path", max(r.off for r in runs) / MM, 0.01, "mm")
    row("changes of velocity beyond a·dt or v/8", sum(r.flips for r in runs), 0)
    row("stops without a name", sum(r.nameless for r in runs), 0)
    row("swing while blocked", max(r.swing for r in runs) / MM, 0.007, "mm")
    if kind == cases.IN_REACH and np.isfinite(acceleration):
        lags = np.concatenate([r.lags for r in runs])
        row("median lag behind 0.2 m/s", float(np.median(lags)) / MM, 20.0, "mm")
