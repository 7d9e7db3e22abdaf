"""Cases of planning.py: the check of a path, from a given start and from any start."""

from __future__ import annotations

import time
from collections.abc import Sequence

import common  # first: it limits BLAS to one thread
import numpy as np
from common import Record

from coopqp import check_path
from coopqp.planning import find_remedies
from coopqp.scenarios import at_limit, at_singularity, paper_lift, ring


def checks(rings: Sequence[int], rounds: int, progress: common.Progress) -> list[Record]:
    """Median time of a check and its verdict; of the paper's lift, of rings, near a wrist, and with remedies."""
    lift, wrist, limit = paper_lift(), at_singularity(miss=0.01), at_limit()
    tasks = [("paper_lift", lift, True), ("paper_lift", lift, False), ("wrist at 0.01 rad", wrist, True)]
    tasks += [(f"ring of {arms}", ring(arms=arms), True) for arms in rings]
    records = []
    for name, task, given in tasks:
        times, verdict = [], ""
        for _ in range(max(rounds, 2)):
            began = time.perf_counter()
            answer = check_path(task.cell, task.grasp, task.path, q_start=task.q_start if given else None)
            times.append(time.perf_counter() - began)
            verdict = answer.verdict.value
        method = "check_path, given start" if given else "check_path, any start"
        records.append(_record(f"check: {name}", method, len(task.cell), float(np.median(times)), verdict))
        progress.advance()
    began = time.perf_counter()
    remedies = find_remedies(check_path(limit.cell, limit.grasp, limit.path))
    kinds = ", ".join(remedy.kind for remedy in remedies) or "none"
    seconds = time.perf_counter() - began
    return [*records, _record("check: at_limit", "find_remedies", len(limit.cell), seconds, f"remedies: {kinds}")]


def _record(case: str, method: str, arms: int, time_s: float, verdict: str) -> Record:
    return {"case": case, "method": method, "arms": arms, "time_s": time_s, "plan_ms": 1e3 * time_s, "verdict": verdict}
