"""What a notebook shows of an object: small, complete in itself, escaped, and never an error."""

from __future__ import annotations

import builtins
import importlib.util
from collections.abc import Callable
from dataclasses import replace
from html.parser import HTMLParser
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from coopqp import Arm, HoldPath, LinePath, QPController, Recording, RobotCell, ServoPath, Status
from coopqp.baselines import IndependentQPController, PseudoInverseController
from coopqp.scenarios import Scenario, robot_path

MOST_BYTES = 250_000


class Page(HTMLParser):
    """Tags and addresses of a page; every tag is closed."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.sources: list[str] = []
        self.open: list[str] = []
        self.text = ""
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.sources += [value or "" for name, value in attrs if name in ("src", "href")]
        if tag not in ("br", "img"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)

    def handle_data(self, data: str) -> None:
        self.text += data


def shown(thing: Any) -> Page:
    text = thing._repr_html_()
    assert text is not None
    assert len(text) < MOST_BYTES
    page = Page(text)
    assert all(source.startswith("data:image/png;base64,") for source in page.sources)
    assert "script" not in page.tags
    return page


@pytest.mark.slow
def test_cell_scenario_and_step_have_a_picture_and_a_table(paper: Scenario) -> None:
    controller = QPController(paper.cell, paper.grasp, paper.path, dt=paper.dt)
    controller.reset(paper.q_start)
    for thing in (paper.cell, paper, controller.step(paper.q_start)):
        page = shown(thing)
        assert page.tags.count("img") == 1
        for arm in paper.cell.arm_names:
            assert arm in page.text
    assert "The object follows its path." in page.text


def test_a_recording_shows_its_rate_its_statuses_and_its_limits(baseline: Callable[..., Recording]) -> None:
    run = baseline(40)
    codes = run.status.copy()
    codes[5:9] = Status.BLOCKED.code
    limits = [[5, [["slave_2", "joint_3", "position"]]], [9, []]]
    page = shown(replace(run, status=codes, metadata={**run.metadata, "binding": limits}))
    assert {"svg", "polyline", "rect"} <= set(page.tags)
    assert "slave_2/joint_3 position" in page.text
    assert "worst status blocked" in page.text


def test_names_are_escaped(baseline: Callable[..., Recording]) -> None:
    evil = "<script>alert(1)</script>\x1b[2J"
    arm = Arm.from_urdf("<img src=x>", robot_path("arm5"), tool_frame="tool", geometry=False)
    assert "<img src=x>" in shown(RobotCell([arm])).text
    run = baseline(40)
    metadata = {**run.metadata, "scenario": evil, "controller": evil, "arms": [evil]}
    page = shown(replace(run, metadata=metadata))
    assert "<script>" in page.text
    assert "\x1b" not in page.text


def test_without_matplotlib_or_shapes_there_is_the_table(
    paper: Scenario, make_cell: Callable[..., RobotCell], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert "img" not in shown(make_cell(["arm7"])).tags
    find, load = importlib.util.find_spec, builtins.__import__

    def refuse(name: str, *arguments: Any, **options: Any) -> Any:
        if name.startswith("matplotlib"):
            raise ImportError(name)
        return load(name, *arguments, **options)

    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name, *a: None if name.startswith("matplotlib") else find(name, *a)
    )
    monkeypatch.setattr(builtins, "__import__", refuse)
    page = shown(paper.cell)
    assert "img" not in page.tags
    assert "master" in page.text


def test_damaged_data_give_no_html_and_no_error(baseline: Callable[..., Recording], paper: Scenario) -> None:
    run = baseline(40)
    assert replace(run, metadata={"binding": [["?"]]})._repr_html_() is None
    assert replace(paper, q_start=np.full(3, np.nan))._repr_html_() is None
    assert replace(paper, object_size=(pin.SE3.Identity(), 1.0, 1.0))._repr_html_() is None  # type: ignore[arg-type]


def test_texts_are_short_and_say_what_it_is(paper: Scenario, baseline: Callable[..., Recording]) -> None:
    assert repr(baseline(40)) == "Recording(PseudoInverseController, 3 arms, 40 steps, 3 s, finished)"
    assert repr(paper).startswith("Scenario(paper_lift: RobotCell(master: 6 joints, ")
    assert repr(paper.cell.arms[0]).startswith("Arm(master: 6 joints, tool flange, ")


def test_controllers_and_paths_say_what_they_are(paper: Scenario) -> None:

    path = HoldPath(paper.path.pose(0.0))
    assert (repr(paper.path), repr(path), repr(ServoPath(paper.path.pose(0.0)))) == (
        "LinePath(3 s)", "HoldPath(1 s)", "ServoPath(no end)",
    )  # fmt: skip
    assert "LinePath()" in repr(LinePath.__new__(LinePath)), "also before it is built"
    for make in (QPController, PseudoInverseController, IndependentQPController):
        controller = make(paper.cell, paper.grasp, paper.path, dt=0.002)
        assert repr(controller) == f"{make.__name__}(3 arms, dt 0.002 s, LinePath(3 s))"
