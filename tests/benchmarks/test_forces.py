"""benchmarks/forces.py meets its figures in a quick run."""

from __future__ import annotations

import json
from pathlib import Path

import forces
import pytest


@pytest.mark.slow
def test_a_quick_run_meets_the_figures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert forces.main(["--quick", "--json", str(tmp_path / "forces.json")]) == 0
    assert "base_off_lift" in capsys.readouterr().out
    records = json.loads((tmp_path / "forces.json").read_text())
    assert all(tuple(one) == forces.KEYS for one in records)
    found = {(one["case"], one["variant"], one["controller"]): one for one in records}
    for noise, most in (("0", 1.0), ("0.0001", 15.0)):
        off = found["base_off_lift", f"slave_2, encoders ±{noise} rad", "calibrated"]
        assert off["rest_N"] <= most
        assert off["without_N"] > 200.0
        assert off["finished"]
    for (case, variant, _), one in found.items():
        if case == "palms":
            assert one["finished"], variant
            assert one["slip_mm"] <= 1.0, variant
            assert 0.5 < one["torque_use"] <= 1.0, variant
        elif case == "relaxed" and "sensor" in variant:
            assert one["status"] == "holding", variant
            assert one["peak_N"] <= 20.0
        elif case == "relaxed":
            assert one["finished"], variant
            assert one["peak_N"] <= (30.0 if "×" in variant or "gripped" in variant else 20.0), variant
            assert one["rest_N"] <= 3.0, variant
    shared, equal = (found["heavy_lift", "53 kg", controller] for controller in ("shared load", "equal parts"))
    assert shared["finished"]
    assert shared["torque_use"] <= 1.0 + 1e-9 < 1.05 < equal["torque_use"]
    assert shared["peak_N"] <= 50.0
    assert found["feed_forward", "20 kg in 1.2 s", "shared load"]["peak_N"] < 5.0
    assert found["fastest_lift", "40 kg", "load bound"]["finished"]
    for controller in ("observer", "observer, wrist sensors"):
        assert found["torque_drives", "both × 0.5", controller]["error_mm"] < 0.3
    assert found["torque_drives", "both × 0.5", "computed torque"]["error_mm"] > 5.0
    sensed, position = (
        found["torque_drives", "both × 0.5", drives] for drives in ("observer, wrist sensors", "position servos")
    )
    assert sensed["peak_N"] < 5.0
    assert position["peak_N"] > 50.0
    for (case, variant, drives), one in found.items():
        if case == "torque_drives":
            assert one["finished"]
            assert drives == "position servos" or one["torque_use"] <= 1.0, variant
