"""Row I1: redundant arms finish paths that are feasible by construction, although joints meet limits on the way."""

from __future__ import annotations

import json
from typing import Any

import look_ahead
import pytest

pytestmark = pytest.mark.slow

#: Cells of a part; parts run side by side.
PARTS = 3


@pytest.mark.parametrize("part", range(PARTS))
def test_feasible_paths_of_redundant_arms_are_finished(part: int, catalogue: Any) -> None:
    recorded = json.loads(look_ahead.RECORDED.read_text(encoding="utf-8"))
    before = {r["number"]: r for r in recorded if r["case"] == "redundant"}
    cells = [(i, make) for kind, i, make in look_ahead.tasks() if kind == "redundant"][part::PARTS]
    runs = [(look_ahead.measured("redundant", i, make()), before[i]) for i, make in cells]
    both = [(now, then) for now, then in runs if now["finished"] and then["finished"]]
    name, count = f"redundant arms, feasible paths, {part + 1} of {PARTS}", len(runs)
    unfinished = sum(not now["finished"] for now, _ in runs)
    lost = sum(then["finished"] and not now["finished"] for now, then in runs)
    slower = max(now["time_s"] / then["time_s"] for now, then in both)
    note = f"version 0.1 finished {sum(then['finished'] for _, then in runs)}"
    catalogue.row("I1", f"{name}: not finished", cases=count, measured=unfinished, target=0.03 * count, note=note)
    catalogue.row("I1", f"{name}: lost since version 0.1", cases=count, measured=lost, target=0)
    catalogue.row("I1", f"{name}: time over that of version 0.1", cases=len(both), measured=slower, target=1.2)
    off = max(max(now["chain_um"], now["path_um"]) for now, _ in runs)
    catalogue.row("I1", f"{name}: chain and path", cases=count, measured=off, target=0.5, unit="µm")
