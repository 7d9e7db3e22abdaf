"""A million steps in one process: its own memory, open files and objects do not grow, and rotations stay valid."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from processes import output

PROGRAM = Path(__file__).with_name("programs") / "soak.py"
ROUND = 100_000
#: Rounds before the comparison: they import modules, fill caches and grow the heap.
WARM_UP = 2
MIB = 2**20


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="reads /proc")
@pytest.mark.timeout(3600)
def test_a_million_steps_leave_nothing_behind(count: Callable[[int], int], catalogue: Any) -> None:
    rounds = count(10)
    found = json.loads(output(PROGRAM, rounds, timeout=3500))
    samples = found["samples"][WARM_UP - 1 :]
    assert len(samples) == rounds - WARM_UP + 1
    resident, files, objects = (np.array([s[name] for s in samples]) for name in ("resident", "files", "objects"))
    steps = rounds * ROUND
    catalogue.row(
        "G",
        "soak: growth of resident memory after warm-up",
        cases=steps,
        measured=(resident.max() - resident[0]) / MIB,
        target=1.0,
        unit="MiB",
        note=f"warm-up of {WARM_UP * ROUND:,} steps; {resident[-1] / MIB:.0f} MiB in all",
    )
    catalogue.row(
        "G", "soak: change of the number of open files", cases=steps, measured=np.ptp(files), target=0, unit="files"
    )
    catalogue.row(
        "G",
        "soak: growth of the number of objects",
        cases=steps,
        measured=objects.max() - objects[0],
        target=0,
        unit="objects",
        note=f"{objects[0]:,} that Python tracks, after a collection, at the same place of each round",
    )
    catalogue.row(
        "G",
        "soak: reported placements from rotations, |R Rᵀ − I|",
        cases=steps // 997,
        measured=found["defect"],
        target=1e-12,
        note="tools, object and reference of one step in 997; also the circle of continuous joints",
    )
