"""The benchmark of new cells: its records are complete, and the arms it writes have their makers' kinematics."""

from __future__ import annotations

import json
from pathlib import Path

import new_cells
import numpy as np
import pinocchio as pin
import pytest
from written_urdfs import ARMS, urdf


@pytest.mark.slow
def test_a_pair_is_made_and_recorded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(new_cells, "QUICK", ("gen3_and_ur5e",))
    monkeypatch.setattr(new_cells, "MOST_S", 600.0)  # times are no matter of tests
    file = tmp_path / "new_cells.json"
    assert new_cells.main(["--quick", "--json", str(file), "--out", str(tmp_path / "out")]) == 0
    (record,) = json.loads(file.read_text(encoding="utf-8"))
    assert set(record) == set(new_cells.KEYS)
    assert (record["verdict"], record["picture"], record["commands"]) == ("CERTIFIED", True, 2)
    assert (tmp_path / "out" / "new_cells.md").is_file()


def tool(name: str, q: np.ndarray, tmp_path: Path) -> pin.SE3:
    file = tmp_path / f"{name}.urdf"
    file.write_text(urdf(name), encoding="utf-8")
    model = pin.buildModelFromUrdf(str(file))
    data = model.createData()
    pin.framesForwardKinematics(model, data, pin.integrate(model, pin.neutral(model), q))
    return data.oMf[model.getFrameId(ARMS[name].tool)]


def denavit_hartenberg(a: float, alpha: float, d: float, theta: float) -> np.ndarray:
    c, s, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
    return np.array([[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]])


def test_the_ur5e_has_the_denavit_hartenberg_parameters_of_its_maker(tmp_path: Path) -> None:
    rows = (
        (0, np.pi / 2, 0.1625), (-0.425, 0, 0), (-0.3922, 0, 0),
        (0, np.pi / 2, 0.1333), (0, -np.pi / 2, 0.0997), (0, 0, 0.0996),
    )  # fmt: skip
    q = np.random.default_rng(0).uniform(-3.0, 3.0, 6)
    T = np.linalg.multi_dot([denavit_hartenberg(*row, angle) for row, angle in zip(rows, q, strict=True)])
    np.testing.assert_allclose(tool("ur5e", q, tmp_path).homogeneous, T, atol=1e-8)


@pytest.mark.parametrize(("name", "height"), [("iiwa14", 1.306), ("gen3", 1.1873)])
def test_the_others_stand_as_high_as_their_makers_say(name: str, height: float, tmp_path: Path) -> None:
    """Stretched out, at zero."""
    assert tool(name, np.zeros(7), tmp_path).translation[2] == pytest.approx(height, abs=1e-4)
