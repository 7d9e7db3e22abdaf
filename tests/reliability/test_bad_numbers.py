"""NaN and infinities in the input of a step, for every solver: the controller holds at once and recovers afterwards."""

from __future__ import annotations

import json
import statistics
from pathlib import Path
from typing import Any

import pytest
from processes import output

from coopqp.solvers import available_solvers

PROGRAM = Path(__file__).with_name("programs") / "bad_numbers.py"
#: Time after which a solver counts as hanging [s]; all cases of a solver normally take about 10.
HARD_TIMEOUT = 180.0


def ran(solver: str) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(output(PROGRAM, solver, timeout=HARD_TIMEOUT).splitlines()[-1])
    return found


@pytest.mark.slow
@pytest.mark.parametrize("solver", available_solvers())
def test_bad_numbers_hold_and_are_forgotten(solver: str, catalogue: Any) -> None:
    found = ran(solver)
    bad, wild = found["bad"], found["wild"]
    for tally in (bad, wild):
        assert not tally["raised"], tally["raised"][:5]
        assert not tally["violations"], tally["violations"][:5]
        assert not tally["not_going_on"], tally["not_going_on"][:5]
    catalogue.row(
        "A6",
        f"NaN, ±inf in q, dt, target, each QP array; {solver}: not held",
        cases=bad["cases"],
        measured=len(bad["not_holding"]),
        target=0,
        unit="steps",
        note="each goes on once the number is gone",
    )
    catalogue.row(
        "A6",
        f"NaN, ±inf: thread CPU time of the step; {solver}",
        cases=bad["cases"],
        measured=max(bad["cpu_ms"]),
        target=10.0,
        unit="ms",
        note=f"the slowest case, the middle one of three tries; median case {statistics.median(bad['cpu_ms']):.2f} ms, "
        f"longest try {bad['longest_ms']:.2f} ms",
    )
    catalogue.row(
        "A6",
        f"finite but absurd numbers (1e-310 … 1e300) in the QP; {solver}",
        cases=wild["cases"],
        measured=wild["longest_ms"],
        target=1000.0,
        unit="ms",
        note="longest try; no exception, command within the limits",
    )
