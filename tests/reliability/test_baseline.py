"""A10: the paper's pseudo-inverse, judged by the same monitor, breaks the promises that the QP keeps."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Any

import pytest
from checks import cooperative, drive, judged, limited
from marks import slow_but_first

from coopqp.baselines import PseudoInverseController
from coopqp.scenarios import Scenario, at_limit, at_singularity, fast_lift, paper_lift
from coopqp.simulation import Breach

TASKS: dict[str, tuple[Callable[[], Scenario], set[Breach]]] = {
    "the paper's lift": (paper_lift, {Breach.CHAIN}),
    "faster than the joints": (
        lambda: limited(fast_lift(), acceleration=5.0),
        {Breach.VELOCITY, Breach.ACCELERATION, Breach.CHAIN},
    ),
    "into the joint limits": (at_limit, {Breach.POSITION, Breach.ACCELERATION, Breach.CHAIN, Breach.PATH}),
    "into a stretched elbow": (
        lambda: at_singularity("elbow", 1, acceleration=5.0),
        {Breach.POSITION, Breach.VELOCITY, Breach.ACCELERATION, Breach.CHAIN, Breach.PATH},
    ),
}


@pytest.mark.parametrize("name", slow_but_first(TASKS))
def test_the_oracle_sees_what_the_baseline_breaks(name: str, catalogue: Any) -> None:
    build, expected = TASKS[name]
    task = build()
    counts: dict[str, Counter[Breach]] = {}
    steps = 0
    for who, controller in (
        ("baseline", PseudoInverseController(task.cell, task.grasp, task.path, dt=task.dt)),
        ("cooperative", cooperative(task)),
    ):
        done = drive(controller, task.q_start, 1500, rest=20)
        counts[who] = Counter(judged(task, done).counts)
        steps += len(done)
    assert set(counts["baseline"]) >= expected, "an oracle that does not see these is worth nothing"
    found = ", ".join(f"{n:,} {breach.value}" for breach, n in counts["baseline"].most_common())
    catalogue.row(
        "A10",
        f"{name}: violations by the cooperative QP",
        cases=steps,
        measured=counts["cooperative"].total(),
        target=0,
        note=f"by the baseline: {found}",
    )
