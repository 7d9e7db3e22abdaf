"""The report is true, it is one small file, and no text in a recording can change its page."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from coopqp import (
    BindingLimit,
    InvalidInputError,
    LimitKind,
    QPController,
    Recording,
    RobotCell,
    Status,
    simulate,
)
from coopqp.errors import MissingExtraError, OutputError
from coopqp.scenarios import Scenario
from coopqp.simulation import RecordingError, SceneError, Tolerances, describe_object, evaluate, read_run
from coopqp.simulation.evaluation.assessment import run_figures, worst_status
from coopqp.visualization import write_report
from coopqp.visualization.report import report_html
from coopqp.visualization.timeline import bound_limits, timeline_figure


@pytest.fixture(scope="module")
def slowed(paper: Scenario) -> Recording:
    """The lift with binding speed limits."""
    cell = paper.cell.with_limits(velocity=0.25)
    controller = QPController(cell, paper.grasp, paper.path, dt=paper.path.duration / 60)
    metadata = {
        "scenario": "paper_lift",
        "object": describe_object(paper.object_size, paper.T_object_body),
        "settings": {"grasp": {"kind": "triangle"}, "arms": [{"name": "master"}], "path": {"poses": [1.5, 2.5]}},
    }
    return simulate(controller, q_start=paper.q_start, metadata=metadata)


def _bare(recording: Recording) -> Recording:
    """The run without the arms' shapes, which take long to draw."""
    metadata = json.loads(json.dumps(recording.metadata))
    for arm in metadata["scene"]["arms"]:
        arm["shapes"] = []
    return replace(recording, metadata=metadata)


class Page(HTMLParser):
    """Text, images, links and tags of a page."""

    VOID = ("meta", "img", "br")

    def __init__(self, document: str) -> None:
        super().__init__()
        self.text, self.tags, self.sources, self.open = "", [], [], []  # type: ignore[var-annotated]
        self.feed(document)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.sources += [value or "" for name, value in attrs if name in ("src", "href")]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data if "style" not in self.open else ""


# -- the page ------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_report_tells_what_happened(slowed: Recording, tmp_path: Path) -> None:
    told: list[str] = []
    file = write_report(slowed, tmp_path / "new" / "report.html", progress=told.append)
    document = file.read_text()
    assert len(document) < 5_000_000
    page = Page(document)
    assert page.open == []
    assert all(source.startswith("data:image/") for source in page.sources)  # nothing from elsewhere
    assert len(page.sources) == 3
    assert "script" not in page.tags
    for text in (
        "paper lift",
        "QPController; arms: master, slave_1, slave_2",
        "Everything held.",
        "Did the object arrive?",
        "largest ε_p",
        "worst statusslowed",
        "settings.grasp.kindtriangle",
        "settings.arms[0].namemaster",
        "settings.path.poses1.5, 2.5",
        "duration3.0",
        "Limits that bound",
    ):
        assert text in page.text
    bound = bound_limits(slowed)[0]
    assert f"{bound.limit.arm}/{bound.limit.joint} velocity" in page.text
    assert slowed.notes[0].split(": ", 1)[1] in page.text
    assert told == ["measuring the run", "drawing the plots"]
    assert [f.name for f in file.parent.iterdir()] == ["report.html"]


@pytest.mark.slow
def test_what_did_not_hold_is_said(baseline: Callable[..., Recording]) -> None:
    page = Page(report_html(_bare(baseline(40)), tolerances=Tolerances(chain_mm=1e-3)))
    assert "2 of 5 did not hold." in page.text
    assert re.search(
        r"NODo the arms agree on where the object is\?within [\d.]+ mm and [\d.]+° \(asked: 0.001 mm", page.text
    )
    assert "None: the object followed its path at full rate" in page.text


@pytest.mark.slow
def test_a_recording_cannot_change_the_page(baseline: Callable[..., Recording]) -> None:
    evil = "<script>alert(1)</script>'\"&"
    recording = _bare(baseline(40))
    metadata = {
        **recording.metadata,
        "scenario": evil,
        "controller": evil,
        "arms": [evil],
        "settings": {evil: {evil: [evil]}},
        evil: evil,
    }
    page = Page(report_html(replace(recording, metadata=metadata, notes=(evil, f"3: {evil}", "999999: x"))))
    assert "script" not in page.tags
    assert page.text.count(evil.replace("_", " ")) >= 8
    assert "999999: x" in page.text


@pytest.mark.slow
def test_long_runs_stay_small(slowed: Recording, monkeypatch: pytest.MonkeyPatch) -> None:
    """Thousands of samples, notes and settings."""
    monkeypatch.setattr("coopqp.visualization.report.MAX_SVG_BYTES", 100_000)
    k = 8
    T = slowed.n_steps

    def longer(x: Any) -> Any:
        return np.concatenate([np.tile(x[:-1], (k,) + (1,) * (x.ndim - 1)), x[-1:]])

    long = replace(
        slowed,
        time=np.linspace(0.0, 100.0, k * T + 1), clock=longer(slowed.clock), q=longer(slowed.q),
        q_command=longer(slowed.q_command), reference=longer(slowed.reference),
        velocity=np.tile(slowed.velocity, (k, 1)), rate=np.tile(slowed.rate, k), status=np.tile(slowed.status, k),
        notes=tuple(f"{i}: slowed" for i in range(3000)),
        metadata={**slowed.metadata, "settings": {f"key_{i}": i for i in range(1000)}},
    )  # fmt: skip
    document = report_html(_bare(long))
    assert len(document) < 5_000_000
    assert "2000 more" in document
    assert 'src="data:image/png' in document


@pytest.mark.slow
def test_measurements_are_drawn_and_not_listed(slowed: Recording) -> None:
    """Every run of a cell file carries its distances over time: pages of numbers under the settings."""
    times = np.linspace(0.0, 3.0, 189).tolist()
    clearance = {
        "closest_m": 0.01, "time_s": 1.5, "between": ["a", "b"], "left_out": [], "avoided": False, "margin_m": 0.0,
        "times_s": times, "distances_m": [0.0123456789] * 189, "points_m": [[[0.1, 0.2, 0.3]] * 2] * 189,
    }  # fmt: skip
    text = report_html(replace(_bare(slowed), metadata={**_bare(slowed).metadata, "clearance": clearance}))
    assert "0.0123456789" not in text
    assert text.count("189 values") == 3


@pytest.mark.slow
def test_arms_without_shapes_and_cells_that_are_given(baseline: Callable[..., Recording], paper: Scenario) -> None:
    recording = _bare(baseline(40))
    assert "no shapes to draw" in report_html(recording)
    unknown = replace(recording, metadata={})
    with pytest.raises(SceneError):
        report_html(unknown)
    without = RobotCell([replace(arm, visual=None) for arm in paper.cell.arms])
    page = Page(report_html(unknown, cell=without))
    assert "unknown controller; arms: unknown" in page.text
    with pytest.raises(InvalidInputError, match="for a cell with"):
        report_html(unknown, cell=RobotCell(paper.cell.arms[:2]))


def test_a_report_that_cannot_be_written_is_refused_first(baseline: Callable[..., Recording], tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="is a folder"):
        write_report(baseline(40), tmp_path)


def test_a_missing_matplotlib_names_the_extra(
    baseline: Callable[..., Recording], monkeypatch: pytest.MonkeyPatch
) -> None:
    def missing() -> None:
        raise MissingExtraError("plot", "matplotlib")

    monkeypatch.setattr("coopqp.visualization.report.require_matplotlib", missing)
    with pytest.raises(MissingExtraError, match=r"coopqp\[plot\]"):
        report_html(baseline(40))


# -- figures and limits --------------------------------------------------------------------------------------------


def test_figures_have_units(baseline: Callable[..., Recording], paper: Scenario) -> None:
    recording = baseline(400)
    figures = run_figures(paper.cell, recording, read_run(paper.cell, recording))
    assert figures["largest ε_p"] == "0.871 mm"
    assert figures["smallest rate σ"] == "100 %"
    assert figures["steps"] == "400 of 7.5 ms"
    assert figures["worst status"] == "ok"
    assert float(figures["smallest singular value"].split()[0]) >= 0.169


def test_limits_are_gathered_from_their_changes(baseline: Callable[..., Recording]) -> None:
    a, b = ["master", "joint_1", "velocity"], ["slave_1", "", "reach"]
    changes = [[2, [a]], [4, [a, b]], [6, [b]], [7, []], [30, [a]]]
    recording = baseline(40)
    bound = bound_limits(replace(recording, metadata={**recording.metadata, "binding": changes}))
    t = recording.time
    assert bound[0].limit == BindingLimit("master", "joint_1", LimitKind.VELOCITY)
    assert bound[0].spans == ((t[2], t[6]), (t[30], t[40]))  # the last ends with the run
    assert bound[1].spans == ((t[4], t[7]),)
    assert bound[0].seconds == pytest.approx(14 * 0.075)


@pytest.mark.parametrize("binding", [3, [3], [[1, [["a", "b"]]]], [[1, [["a", "b", "magic"]]]], [["x", []]]])
def test_damaged_limits_are_refused_by_name(baseline: Callable[..., Recording], binding: Any) -> None:
    recording = baseline(40)
    with pytest.raises(RecordingError, match="'binding' in the recording's metadata is damaged"):
        bound_limits(replace(recording, metadata={**recording.metadata, "binding": binding}))


def test_the_timeline_shows_statuses_and_limits(slowed: Recording, paper: Scenario) -> None:
    codes = slowed.status.copy()
    codes[5:9] = Status.BLOCKED.code
    recording = replace(slowed, status=codes)
    figure = timeline_figure(recording, read_run(paper.cell, recording))
    errors, rate, limits = figure.axes
    assert len(errors.lines) == 5  # three errors and two tolerances
    assert [float(line.get_ydata()[0]) for line in errors.lines[3:]] == [0.1, 1.0]
    assert [text.get_text() for text in rate.get_legend().get_texts()] == ["blocked"]
    assert len(limits.collections) == len(bound_limits(recording))
    bare = replace(slowed, metadata={**slowed.metadata, "binding": []})
    assert len(timeline_figure(bare, read_run(paper.cell, bare)).axes) == 2


def test_errors_of_rounding_are_said_and_their_tolerances_drawn(
    baseline: Callable[..., Recording], paper: Scenario
) -> None:
    """Not three curves on one line at the lower edge."""
    recording = baseline(40)
    small = np.full(41, 3.9e-14)
    readings = replace(read_run(paper.cell, recording), eps_p_mm=small, chain_mm=small, object_mm=small)
    errors = timeline_figure(recording, readings, tolerances=Tolerances(chain_mm=0.2)).axes[0]
    assert [float(line.get_ydata()[0]) for line in errors.lines] == [0.2, 1.0]
    assert all("below 1e-6 mm" in text.get_text() for text in errors.get_legend().get_texts())
    figures = run_figures(paper.cell, recording, replace(readings, eps_o_deg=small))
    assert (figures["largest ε_p"], figures["largest ε_o"]) == ("below 1e-9 mm", "below 1e-9°")
    quiet = replace(readings, chain_deg=small, object_deg=np.full(41, 0.1))
    answers = [finding.answer for finding in evaluate(paper.cell, recording, quiet)]
    assert answers[-2] == "below 1e-9 mm and below 1e-9° (asked: 0.1 mm, 0.1°)"
    assert answers[-1] == "below 1e-9 mm and within 0.1° (asked: 1 mm, 0.5°)"


def test_speeding_up_from_rest_and_braking_at_the_end_are_part_of_a_good_run(
    paper: Scenario, baseline: Callable[..., Recording]
) -> None:
    """The status of such a run is ok; a rate that falls on the way is not."""
    recording = baseline(40)
    rate, status = recording.rate.copy(), recording.status.copy()
    rate[:3], rate[-2:] = (0.2, 0.5, 0.8), (0.6, 0.1)
    status[:3] = status[-2:] = Status.SLOWED.code
    limits = [[0, [["slave_1", "joint_2", "acceleration"]]], [3, []], [38, [["", "", "path end"]]]]
    healthy = replace(recording, rate=rate, status=status, metadata={**recording.metadata, "binding": limits})
    assert worst_status(healthy) == "ok"
    assert verdict(paper.cell, healthy)[0][1].endswith("0 of 40 steps slowed, 3 to speed up, 2 to brake at the end")
    limits[0] = [0, [["slave_1", "joint_2", "velocity"]]]
    assert worst_status(replace(healthy, metadata={**recording.metadata, "binding": limits})) == "slowed"
    rate[1] = 0.1
    assert worst_status(replace(healthy, rate=rate)) == "slowed"
    middle = recording.status.copy()
    middle[20] = Status.SLOWED.code
    assert worst_status(replace(recording, status=middle)) == "slowed"


# -- the verdict ---------------------------------------------------------------------------------------------------


def verdict(cell: RobotCell, recording: Recording, **tolerances: float) -> list[tuple[bool, str]]:
    findings = evaluate(cell, recording, read_run(cell, recording), tolerances=Tolerances(**tolerances))
    return [(f.holds, f.answer) for f in findings]


def test_a_good_run_holds(baseline: Callable[..., Recording], paper: Scenario) -> None:
    held = verdict(paper.cell, baseline(400), chain_mm=2.0, object_mm=2.0)
    assert all(holds for holds, _ in held)
    assert held[0][1] == "3 s for a path of 3 s, 0 of 400 steps slowed"
    assert "no limit of acceleration" in held[2][1]


def test_a_run_that_did_not_arrive(baseline: Callable[..., Recording], paper: Scenario) -> None:
    recording = baseline(40)
    short = replace(recording, metadata={**recording.metadata, "finished": False})
    assert verdict(paper.cell, short)[0] == (False, "the object's clock stands at 3 s after 3 s for a path of 3 s")
    endless = replace(recording, metadata={**recording.metadata, "finished": False, "duration": float("inf")})
    assert verdict(paper.cell, endless)[0] == (True, "3 s, 0 of 40 steps slowed; the path has no end")
    codes = recording.status.copy()
    codes[7] = Status.HOLDING.code
    stopped = replace(recording, status=codes)
    assert verdict(paper.cell, stopped)[0] == (
        False,
        "3 s for a path of 3 s, 0 of 40 steps slowed, 1 steps stopped by a failure",
    )
    assert worst_status(stopped) == "holding"
    assert worst_status(short) == "tracking"
    assert worst_status(recording) == "ok"


def test_limits_that_were_not_kept_are_named(baseline: Callable[..., Recording], paper: Scenario) -> None:
    recording = baseline(40)
    q = recording.q_command
    j = 2
    upper = np.array(paper.cell.limits.upper)
    upper[j] = q[:, j].max() - np.deg2rad(2.0)
    tight = paper.cell.with_limits(upper=upper)
    assert verdict(tight, recording)[1] == (False, "master/joint_3 is 2° outside")
    speed = np.array(paper.cell.limits.velocity)
    speed[13] = np.abs(recording.velocity[:, 13]).max() / 1.5
    holds, answer = verdict(paper.cell.with_limits(velocity=speed), recording)[2]
    assert not holds
    assert "150 % of the limit (slave_2/joint_2)" in answer
    holds, answer = verdict(paper.cell.with_limits(acceleration=0.1), recording)[2]  # it starts with a jump
    assert not holds
    assert "acceleration ≤" in answer


def test_errors_beyond_the_tolerances(baseline: Callable[..., Recording], paper: Scenario) -> None:
    recording = baseline(40)
    assert not verdict(paper.cell, recording, chain_mm=1e-3)[3][0]
    assert not verdict(paper.cell, recording, chain_mm=100.0, chain_deg=1e-6)[3][0]
    assert not verdict(paper.cell, recording, object_mm=1e-3)[4][0]


def test_a_broken_run_never_looks_good(baseline: Callable[..., Recording], paper: Scenario) -> None:
    recording = baseline(40)
    q = recording.q_command.copy()
    q[20] = np.nan
    broken = replace(recording, q_command=q, q=q)
    held = verdict(paper.cell, broken)
    assert not any(holds for holds, _ in (held[1], held[3], held[4]))


def test_sliding_joints_are_told_in_millimetres(make_cell: Callable[..., RobotCell]) -> None:
    cell = make_cell(["gantry7"])
    low = cell.limits.lower.copy()
    x = np.where(np.isfinite(low), 0.5 * (low + cell.limits.upper), 0.0)
    x[0] = cell.limits.upper[0] + 0.003
    q = np.array([cell.configuration(x)] * 2)
    recording = Recording(
        time=np.array([0.0, 1.0]), q=q, q_command=q, velocity=np.zeros((1, 7)), clock=np.array([0.0, 1.0]),
        rate=np.ones(1), status=np.zeros(1), reference=np.tile(np.eye(4), (2, 1, 1)), T_object_tool=np.eye(4)[None],
        notes=(), metadata={"finished": True},
    )  # fmt: skip
    holds, answer = verdict(cell, recording)[1]
    assert (holds, answer) == (False, f"{cell.joint_names[0]} is 3 mm outside")
