"""The benchmark of ways round: its records have the keys that they should, and what is left out is named."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import ompl_routes
import pytest
import route_cases
import routes


@pytest.mark.slow
def test_the_records_have_their_keys_and_the_peer_is_named_where_it_is_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(routes, "PROBLEMS", {"posts3": route_cases.posts3})
    monkeypatch.setattr(
        routes, "QUICK", routes.Plan(seeds=2, shelves=1, scenes=1, ahead=1, peer_seeds=0, time_limit=5.0)
    )
    block = route_cases.posts3()
    monkeypatch.setattr(routes, "impossible", lambda: {"out of reach": block._replace(goal=far(block.goal))})
    monkeypatch.setattr(ompl_routes, "available", lambda: False)
    file = tmp_path / "routes.json"
    assert routes.main(["--quick", "--json", str(file)]) == 0
    records = json.loads(file.read_text())
    assert [set(record) for record in records] == [set(routes.KEYS)] * 8
    for record in records[:2]:
        assert record["found"]
        assert record["check"] == "CERTIFIED"
        assert record["first_s"] <= record["total_s"]
        assert record["clearance_mm"] >= 10.0
    for record in records[2:5]:
        assert record["problem"].startswith("shelves, ")
        assert record["check"] == "CERTIFIED"
    assert not records[-2]["found"]
    assert records[-2]["check"] == "INFEASIBLE"
    assert records[-1]["check"] != "TOUCHED"
    assert records[-1]["clearance_mm"] >= 9.9
    assert "Left out: the rows of ompl" in capsys.readouterr().out


def far(T: object) -> object:
    moved = T.copy()  # type: ignore[attr-defined]
    moved.translation += np.array([0.0, 0.0, 3.0])
    return moved
