"""NaN and infinities in the input of a step, for every solver: the controller holds at once and recovers afterwards."""

from __future__ import annotations

import json
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
        for failures in ("raised", "violations", "not_holding", "not_going_on"):
            assert not tally[failures], tally[failures][:5]
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
        f"finite but absurd numbers (1e-310 … 1e300) in the QP; {solver}: raised, or limits broken",
        cases=wild["cases"],
        measured=len(wild["raised"]) + len(wild["violations"]),
        target=0,
        unit="steps",
        note="each goes on once the number is gone",
    )
