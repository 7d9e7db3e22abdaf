"""Where an arm's reach ends: what the chain says of it, and targets that are streamed along it."""

from __future__ import annotations

import numpy as np
import pytest
import target_cases as cases

from coopqp.scenarios import dual_arm7, mixed_cell, paper_lift, ur5_table

CELLS = [paper_lift, dual_arm7, mixed_cell, ur5_table]


#: Once a joint jumped: an arm came too close to the end of its reach on a way along it; a redundant arm was seen ahead
#: on its other branch; self-motion stopped at once where a way began at rest; a large jump led to a larger one.
JUMPED = [
    ("paper_lift", cases.OUT_OF_REACH, 100, 7),
    ("dual_arm7", cases.OUT_OF_REACH, 100, 12),
    ("mixed_cell", cases.IN_REACH, 100, 10),
    ("panda_bar", cases.OUT_OF_REACH, 100, 13),
]


@pytest.mark.core
@pytest.mark.parametrize(("name", "kind", "hertz", "seed"), JUMPED)
@pytest.mark.slow
def test_no_joint_without_acceleration_limit_jumps(name: str, kind: str, hertz: int, seed: int) -> None:
    seen = cases.chase(cases.CELLS[name](), kind, np.inf, hertz, seed)
    assert (seen.flips, seen.nameless) == (0, 0)
    assert max(seen.apart, seen.off, seen.swing) <= 1e-5
