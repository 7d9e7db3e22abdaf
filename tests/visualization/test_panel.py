"""What stands beside the scene: curves, statuses, the sentence why, joints; the same words live and on a page."""

from __future__ import annotations

import html
import itertools
import json
import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from coopqp import BindingLimit, LimitKind, Recording, Status
from coopqp.files.cellfile import example_path, load_cell_task
from coopqp.scenarios import Scenario
from coopqp.simulation import SceneError, read_run
from coopqp.visualization.binding_words import Why, limit_words
from coopqp.visualization.panel_page import (
    band_piece,
    curve_piece,
    head_piece,
    joints_piece,
    panel_page,
    panel_style,
    plot_piece,
)
from coopqp.visualization.run_panel import RunPanel, length_text
from coopqp.visualization.style import STATUS_COLOURS


@pytest.fixture
def run(baseline: Callable[..., Recording]) -> Recording:
    """Steps 10 to 19 slowed by a joint, 20 to 29 stopped by two bodies, with their distances."""
    recording = baseline(40)
    status, rate = recording.status.copy(), recording.rate.copy()
    status[10:20], rate[10:20] = Status.SLOWED.code, 0.25
    status[20:30], rate[20:30] = Status.BLOCKED.code, 0.0
    joint = ["slave_2", "joint_3", "velocity"]
    near = ["", "", "collision", "", ["slave_1/forearm_link", "post"]]
    times = recording.time[::4]
    clearance = {
        "times_s": times.tolist(), "distances_m": np.linspace(0.2, 0.01, len(times)).tolist(), "avoided": True,
        "margin_m": 0.01, "pairs": [["slave_1/forearm_link", "post"]] * len(times),
    }  # fmt: skip
    extra = {"binding": [[10, [joint]], [20, [near]], [30, []]], "clearance": clearance}
    return replace(recording, status=status, rate=rate, metadata={**recording.metadata, **extra})


@pytest.fixture
def panel(run: Recording, paper: Scenario) -> RunPanel:
    return RunPanel(paper.cell, run, read_run(paper.cell, run))


def test_curves_have_the_values_of_the_run(panel: RunPanel, run: Recording, paper: Scenario) -> None:
    curves = {curve.title: curve for curve in panel.curves}
    assert list(curves) == ["path speed σ", "chain error", "nearest pair"]
    speed, chain, nearest = curves.values()
    np.testing.assert_allclose(speed.values[:-1, 0], 100.0 * run.rate)
    np.testing.assert_allclose(chain.values[:, 0], read_run(paper.cell, run).chain_mm)
    assert (chain.unit, nearest.unit) == ("mm", "mm")
    assert nearest.bound == pytest.approx(10.0)
    assert speed.text(float(run.time[15])) == "25 %"
    assert nearest.text(float(run.time[-1])) == "10 mm, slave 1/forearm link – post"
    for curve in curves.values():
        assert curve.bottom <= curve.values.min() <= curve.values.max() < curve.top


def test_the_statuses_cover_the_run(panel: RunPanel, run: Recording) -> None:
    spans = panel.statuses
    assert [status for status, _, _ in spans] == [Status.TRACKING, Status.SLOWED, Status.BLOCKED, Status.TRACKING]
    assert spans[0][1] == 0.0
    assert all(a[2] == b[1] for a, b in itertools.pairwise(spans))
    assert spans[-1][2] == panel.end == run.time[-1]
    assert spans[1][1:] == (run.time[10], run.time[20])


def test_one_sentence_says_what_binds(panel: RunPanel) -> None:
    assert panel.moment(5).why == "The object follows its path at full speed; no limit binds."
    slowed = "The object is slowed to 25 % of its path's speed: joint 3 of slave 2 is at its largest speed."
    assert panel.moment(15).why == slowed
    stopped = "The object cannot go on: slave 1/forearm link and post are as near as they may be."
    assert panel.moment(25).why == stopped


@pytest.mark.parametrize("kind", LimitKind)
def test_every_kind_of_limit_has_words(kind: LimitKind) -> None:
    """They name the joint and the arm, but for those of the path, and are no template."""
    words = limit_words(BindingLimit("left_arm", "elbow_joint", kind, name="mine"))
    assert "{" not in words
    assert "_" not in words
    own = (LimitKind.PATH_END, LimitKind.OVERRIDE, LimitKind.PATH_JUMP)
    assert kind in (*own, LimitKind.CONSTRAINT) or "elbow joint of left arm" in words


def test_many_limits_are_counted_and_notes_explain_the_rest(run: Recording) -> None:
    many = [["slave_1", f"joint_{j}", "velocity"] for j in range(1, 6)]
    why = Why(replace(run, metadata={**run.metadata, "binding": [[0, many]]}))
    assert why(15).endswith("and joint 3 of slave 1 is at its largest speed, and 2 more.")
    status = run.status.copy()
    status[5:] = Status.HOLDING.code
    notes = ("5: All arms brake together and hold; the positions are not finite.", "no number: nothing")
    held = Why(replace(run, status=status, notes=notes, metadata={**run.metadata, "binding": []}))
    assert held(8) == "All arms brake together and hold; the positions are not finite."


def test_joints_stand_between_their_limits(panel: RunPanel, run: Recording, paper: Scenario) -> None:
    limits = paper.cell.limits
    moment = panel.moment(15)
    expected = (2.0 * run.q_command[15] - limits.upper - limits.lower) / (limits.upper - limits.lower)
    np.testing.assert_allclose(moment.joints, expected)
    assert [paper.cell.joint_names[j] for j in moment.bound] == ["slave_2/joint_3"]
    assert [len(joints) for _, joints in panel.arms] == [6, 6, 6]
    piece = joints_piece(panel, moment)
    assert piece.count('class="coopqp-bar') - piece.count('class="coopqp-bars') == 18
    assert piece.count("coopqp-bound") == 1


def test_joints_that_arms_share_have_bars_of_their_own() -> None:
    """Each joint of the cell has one bar, in the order of the moments; a lift of two arms stands by itself."""
    task = load_cell_task(example_path("torso_lift"))
    q = task.cell.configuration(np.zeros(task.cell.nv))
    rest = Recording(
        time=np.array([0.0, 1.0]), q=np.array([q, q]), q_command=np.array([q, q]), velocity=np.zeros((1, task.cell.nv)),
        clock=np.array([0.0, 1.0]), rate=np.ones(1), status=np.zeros(1), reference=np.tile(np.eye(4), (2, 1, 1)),
        T_object_tool=np.array([T.homogeneous for T in task.grasp.T_object_tool]), notes=(), metadata={},
    )  # fmt: skip
    panel = RunPanel(task.cell, rest, read_run(task.cell, rest))
    names = [f"{owner}/{joint.name}" for owner, joints in panel.arms for joint in joints]
    assert names == list(task.cell.joint_names)
    assert [(owner, len(joints)) for owner, joints in panel.arms] == [("lift", 1), ("left", 6), ("right", 6)]
    moment = panel.moment(0)
    assert joints_piece(panel, moment).count("--p:") == len(moment.joints) == task.cell.nv


def _held(page: str) -> dict[str, Any]:
    found = re.search(r'id="coopqp-moments">(.*?)</script>', page, re.S)
    assert found is not None
    held: dict[str, Any] = json.loads(found[1])
    return held


def test_page_and_live_viewer_say_the_same(panel: RunPanel) -> None:
    """The page has the words and places that the live viewer's pieces have, for each of its moments."""
    moments = [panel.moment(sample) for sample in range(41)]
    page = panel_page(panel, moments, until=panel.end + 1.5)
    held = _held(page)
    for moment, entry in zip(moments, held["moments"], strict=True):
        head = html.unescape(head_piece(moment))
        word, colour = held["statuses"][entry["status"]]
        assert all(text in head for text in (word, colour, held["why"][entry["why"]], entry["clock"]))
        for curve, value, text in zip(panel.curves, moment.values, entry["values"], strict=True):
            assert text == value
            assert text in html.unescape(curve_piece(curve, value))
        np.testing.assert_allclose(np.array(entry["joints"]) / 100.0, moment.joints, atol=0.005)
        assert entry["bound"] == list(moment.bound)
    assert [entry["at"] for entry in held["moments"]] == pytest.approx([m.time / panel.end for m in moments], abs=1e-4)
    same = [band_piece(panel), head_piece(moments[0]), joints_piece(panel, moments[0])]
    same += [plot_piece(panel, curve, last=k == 2) for k, curve in enumerate(panel.curves)]
    assert all(piece in page for piece in same)


def test_names_in_the_panel_stay_text(run: Recording, paper: Scenario) -> None:
    hostile = "</script><script>alert(1)</script>"
    clearance = {**run.metadata["clearance"], "pairs": [[hostile, "post"]] * len(run.metadata["clearance"]["times_s"])}
    notes = (f"20: {hostile}",)
    extra = {"clearance": clearance, "binding": [[10, [["", "", "constraint", hostile]]]]}
    recording = replace(run, notes=notes, metadata={**run.metadata, **extra})
    panel = RunPanel(paper.cell, recording, read_run(paper.cell, recording))
    page = panel_page(panel, [panel.moment(0), panel.moment(15)], until=4.0)
    assert "alert(1)" in page
    assert "<script>alert" not in page
    assert hostile in str(_held(page))


def test_the_slider_has_a_band_of_statuses(panel: RunPanel) -> None:
    style = panel_style(panel, until=2.0 * panel.end)
    for status, start, end in panel.statuses:
        a, b = 50.0 * start / panel.end, 50.0 * end / panel.end
        assert f"{STATUS_COLOURS[status]} {a:.2f}% {b:.2f}%" in style


@pytest.mark.parametrize("damage", [{"distances_m": [0.1]}, {"pairs": [["one"]]}, {"times_s": "soon"}])
def test_damaged_distances_are_refused(run: Recording, paper: Scenario, damage: dict[str, Any]) -> None:
    broken = replace(run, metadata={**run.metadata, "clearance": {**run.metadata["clearance"], **damage}})
    with pytest.raises(SceneError, match="nearest pairs are damaged"):
        RunPanel(paper.cell, broken, read_run(paper.cell, broken))


@pytest.mark.parametrize(
    ("mm", "text"), [(8.7, "8.7 mm"), (0.0043, "4.3 µm"), (2e-9, "below 0.001 µm"), (float("nan"), "nan mm")]
)
def test_lengths_are_told_in_a_fitting_unit(mm: float, text: str) -> None:
    assert length_text(mm) == text


# -- colours -----------------------------------------------------------------------------------------------------------

#: Linear RGB as dichromats see it: Machado, Oliveira, Fernandes (2009), severity 1.
_SEEN = {
    "all cones": np.eye(3),
    "no red cones": np.array([[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216],
                              [-0.003882, -0.048116, 1.051998]]),
    "no green cones": np.array([[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413],
                                [-0.011820, 0.042940, 0.968881]]),
    "no blue cones": np.array([[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602],
                               [0.004733, 0.691367, 0.303900]]),
}  # fmt: skip
_XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])


def _lab(colour: str, seen: Any) -> Any:
    """CIELAB of a colour as it is seen, D65."""
    c = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255.0
    linear = np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)
    x = _XYZ @ np.clip(seen @ linear, 0.0, 1.0) / (0.9505, 1.0, 1.089)
    f = np.where(x > 0.008856, np.cbrt(x), 7.787 * x + 16.0 / 116.0)
    return np.array([116.0 * f[1] - 16.0, 500.0 * (f[0] - f[1]), 200.0 * (f[1] - f[2])])


@pytest.mark.parametrize("seen", _SEEN)
def test_statuses_can_be_told_apart_by_colour_blind_readers(seen: str) -> None:
    assert set(STATUS_COLOURS) == set(Status)
    labs = [_lab(colour, _SEEN[seen]) for colour in STATUS_COLOURS.values()]
    assert min(float(np.linalg.norm(a - b)) for a, b in itertools.combinations(labs, 2)) > 20.0
