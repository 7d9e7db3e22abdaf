"""pink and mink beside the obstacles that coopqp keeps from: known paths, no limits of acceleration.

Each runs in its own environment; see contestants.py.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import common  # first: it limits BLAS to one thread
import numpy as np
from common import Record
from contestants import Contestant, NotAvailable, hand_over
from peer_cases import Case

from coopqp import CollisionScene
from coopqp.model.chain import Chain
from coopqp.scenarios import Scenario
from coopqp.simulation import Closeness

#: The peers, and their ways to hold an object: tools as constraints among each other, or as tasks of one weight.
PEERS, MODES = ("pink", "mink"), ("hard daqp", "soft daqp")
BUDGET_S = 120.0  # of one run


def peers(
    cases: Sequence[tuple[str, Scenario, CollisionScene]], names: Sequence[str], cache: Path, *, install: bool
) -> Iterator[Record]:
    """What the peers' runs come to. A peer that cannot run is one record that says why."""
    for name in names:
        try:
            peer = Contestant.start(name, cache, install=install)
        except NotAvailable as error:
            yield {"case": "all", "controller": name, "status": str(error)}
            continue
        try:
            for case, task, scene in cases:
                yield from _runs(peer, case, task, scene)
        finally:
            peer.stop()


def _runs(peer: Contestant, case: str, task: Scenario, scene: CollisionScene) -> Iterator[Record]:
    steps = max(1, round(task.path.duration / task.dt))
    with tempfile.TemporaryDirectory() as folder:
        try:
            peer.load(hand_over(Case(case, task, steps), Path(folder) / "task", scene))
        except NotAvailable as error:
            yield {"case": case, "controller": peer.name, "status": str(error)}
            return
        for mode in MODES:
            name = f"{peer.name} {mode.split()[0]}"
            try:
                found = peer.ask(do="behave", mode=mode, steps=steps, budget=BUDGET_S, timeout=BUDGET_S + 60.0)
            except NotAvailable as error:
                yield {"case": case, "controller": name, "status": str(error)}
                continue
            yield {"case": case, "controller": name, **_judged(task, scene, found)}


def _judged(task: Scenario, scene: CollisionScene, found: dict[str, Any]) -> Record:
    """The figures of one run: the peer's commands, judged as coopqp's are."""
    q = np.array(found["q"])
    closest = Closeness(scene).closest(q, np.array([task.dt * i for i in range(len(q))]))
    assert closest is not None
    chain, apart, away = Chain(task.cell, task.grasp), 0.0, 0.0
    for i, row in enumerate(q):
        errors = chain.errors(chain.carried(row), task.path.pose(min(i * task.dt, task.path.duration)))[:, :3]
        apart = max(apart, *(float(np.linalg.norm(a - b)) for a in errors for b in errors))
        away = max(away, float(np.linalg.norm(errors, axis=1).max()))
    steps, failures = len(q) - 1, int(found["failures"])
    p = common.percentiles(found["us"])
    return {
        "clearance_mm": round(1e3 * closest.pair.distance, 6), "margin_mm": 1e3 * closest.margin,
        "chain_mm": 1e3 * apart, "path_mm": 1e3 * away,
        "status": f"{failures} of {steps} steps without an answer" if failures else "answers",
        "pair": f"{closest.pair.first} and {closest.pair.second}", "p50_us": p["p50_us"], "p99_us": p["p99_us"],
    }  # fmt: skip
