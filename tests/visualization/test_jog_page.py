"""The operator's page without a browser: what it believes, what it passes on, and what it refuses."""

from __future__ import annotations

import json
import threading
import urllib.error
import urllib.request
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from coopqp import Recording, Status
from coopqp.cli.runs import obtain_task
from coopqp.drivers.real_time import RealTimeRun
from coopqp.errors import InvalidInputError
from coopqp.visualization.guarded import OwnScript
from coopqp.visualization.jog.link import PageLink
from coopqp.visualization.jog.page import JogPage
from coopqp.visualization.jog.seen import Seen


class Gui:
    """Stands for viser's handles: takes every call, and keeps the parts by their labels."""

    def __init__(self) -> None:
        self.parts: dict[str, Any] = {}

    def __getattr__(self, name: str) -> Any:
        if name.startswith("add_"):
            return self._add
        if name.startswith("on_"):
            return lambda call: setattr(self, "called", call)
        raise AttributeError(name)

    def _add(self, label: str, *_: Any, initial_value: Any = None, **__: Any) -> Any:
        part = self.parts[label] = Gui()
        part.value = initial_value
        part.wxyz, part.position = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        part.removed = False
        part.remove = lambda: setattr(part, "removed", True)
        return part


def _client(number: int) -> Any:
    return SimpleNamespace(client_id=number, gui=Gui(), scene=Gui())


@pytest.fixture(scope="module")
def at_start() -> Recording:
    return obtain_task("dual_arm7").at_start()


@pytest.fixture
def told() -> list[tuple[Any, ...]]:
    return []


@pytest.fixture
def page(at_start: Recording, told: list[tuple[Any, ...]]) -> Iterator[JogPage]:
    shown = JogPage(at_start, lambda *call, **named: told.append((*call, *named.values())), port=0)
    yield shown
    shown.close()


def _key(page: JogPage) -> str:
    return page._lead_key


def test_the_first_page_leads_and_the_next_one_follows_it(page: JogPage, told: list[tuple[Any, ...]]) -> None:
    first, second = _client(1), _client(2)
    page._came(first)
    page._came(second)
    assert "Pause" in first.gui.parts
    assert list(second.gui.parts) == ["Another page leads; this one watches."]
    key = _key(page)
    page._left(first)
    assert told == [("pause",)]  # a closed page is a pause
    assert "Pause" in second.gui.parts
    assert _key(page) != key
    page._left(second)
    assert page.lead is None
    assert told == [("pause",)] * 2
    page._left(second)  # it is gone


def test_buttons_and_slider_make_their_calls(page: JogPage, told: list[tuple[Any, ...]]) -> None:
    client = _client(1)
    page._came(client)
    parts = client.gui.parts
    parts["Pause"].called(None)
    for group, names in (("program", ("Run", "Back", "Step")), ("by hand", ("Return", "Reset"))):
        for name in names:
            parts[group].called(SimpleNamespace(target=SimpleNamespace(value=name)))
    parts["override [%]"].value = 40
    parts["override [%]"].called(None)
    names = ["pause", "forward", "reverse", "step_to_mark", "return_to_path", "reset"]
    assert told == [*((name,) for name in names), ("set_override", 0.4)]


def test_keys_lead_from_the_leading_page_alone(page: JogPage, told: list[tuple[Any, ...]]) -> None:
    client = _client(1)
    page._came(client)
    key = _key(page)
    for message in (
        "", "[", "7", "null", "[1]", json.dumps({"token": "another", "twist": [1.0] * 6}), json.dumps({"token": ""}),
        json.dumps({"twist": [1.0] * 6}), json.dumps({"token": key + "é"}), "[" * 900,
    ):  # fmt: skip
        page._take(message)
    assert told == []
    for twist in ([1.0, 2.0], ["a"] * 6, [None] * 6, {"a": 1}, [float("nan")] * 6, [[1.0] * 6]):
        page._take(json.dumps({"token": key, "twist": twist}))
    assert [call for call in told if call != ("beat",)] == []
    told.clear()
    client.gui.parts["hand [m/s]"].value, client.gui.parts["axes"].value = 0.2, "left"
    page._take(json.dumps({"token": key, "twist": [1.0, -9.0, 0.0, 0.0, 0.5, 0.0]}))
    page._take(json.dumps({"token": key, "call": "pause"}))
    page._take(json.dumps({"token": key, "call": "reset"}))  # keys make no other call
    assert told == [
        ("beat",), ("jog", [0.2, -0.2, 0.0, 0.0, 0.4, 0.0], "left"), ("beat",), ("pause",), ("beat",),
    ]  # fmt: skip


def _seen(page: JogPage, status: Status) -> Seen:
    q = page.stage.recording.q[0]
    return Seen(0.0, q, 1.0, 3.0, status.value, "text", (), 0.5, 1.0, (1e-3, 2e-3), "words")


def test_a_gizmo_leads_until_the_object_rests(
    page: JogPage, told: list[tuple[Any, ...]], monkeypatch: pytest.MonkeyPatch
) -> None:
    now = 100.0
    monkeypatch.setattr("coopqp.visualization.jog.page.time.monotonic", lambda: now)
    client = _client(1)
    page._came(client)
    gizmo = client.scene.parts["/hand"]
    page.show(_seen(page, Status.PAUSED))
    np.testing.assert_allclose(gizmo.position, page.pose.translation)  # it stands at the object

    def drag(phase: str) -> None:
        with pytest.raises(StopIteration):
            gizmo.called(SimpleNamespace(phase=phase)).send(None)

    drag("start")
    gizmo.position = page.pose.translation + np.array([0.0, 0.0, 0.1])
    drag("update")
    assert [call[0] for call in told] == ["engage", "target", "target"]
    np.testing.assert_allclose(told[-1][1][:3, 3], gizmo.position)
    told.clear()
    for _ in range(5):  # a still hand sends nothing: the page repeats its target
        now += 0.05
        page.show(_seen(page, Status.JOGGING))
    assert [call[0] for call in told] == ["target"] * 5
    drag("end")
    told.clear()
    now += 0.5
    page.show(_seen(page, Status.SLOWED))
    now += 0.7
    page.show(_seen(page, Status.JOGGING))
    assert told[-1] == ("release",)
    now += 0.1
    page.show(_seen(page, Status.JOGGING))
    np.testing.assert_allclose(gizmo.position, page.pose.translation)


def test_a_silent_page_repeats_no_target(
    page: JogPage, told: list[tuple[Any, ...]], monkeypatch: pytest.MonkeyPatch
) -> None:
    now = 100.0
    monkeypatch.setattr("coopqp.visualization.jog.page.time.monotonic", lambda: now)
    client = _client(1)
    page._came(client)
    with pytest.raises(StopIteration):
        client.scene.parts["/hand"].called(SimpleNamespace(phase="start")).send(None)
    told.clear()
    now += 5.0
    page.show(_seen(page, Status.JOGGING))
    assert told == []


def test_foreign_pages_get_neither_script_nor_socket(page: JogPage) -> None:
    for path, found in (("/coopqp.js", b"requestAnimationFrame"), ("/", b'/coopqp.js"></script></head>')):
        asked = urllib.request.Request(page.url + path, headers={"Accept-Encoding": "gzip"})
        with urllib.request.urlopen(asked, timeout=10) as answer:
            assert found in answer.read()
        foreign = urllib.request.Request(page.url + path, headers={"Origin": "http://example.com"})
        with pytest.raises(urllib.error.HTTPError, match="403"):
            urllib.request.urlopen(foreign, timeout=10)
    own_page, _, key = page.url.rpartition("/")
    socket = page.url.replace("http", "ws") + "/coopqp"
    for address, origin in (
        (socket, "http://example.com"), (socket.replace(key + "/", ""), own_page), (socket.replace(key, "x"), None),
    ):  # fmt: skip
        with pytest.raises(InvalidStatus, match="403"):
            connect(address, origin=origin)  # type: ignore[arg-type]
    with connect(socket, origin=own_page) as connection:  # type: ignore[arg-type]
        connection.send("x" * 5000)
        connection.send("{}")


def test_a_page_without_a_head_is_refused() -> None:
    script = OwnScript("", lambda connection: None)  # type: ignore[arg-type,return-value]
    with pytest.raises(Exception, match="no head"):
        script.into(SimpleNamespace(headers={}, body=b"<html>"), "key")


# -- in a process of its own ---------------------------------------------------------------------------------------


class Counted:
    """A run that counts its calls."""

    controller = SimpleNamespace(override=1.0)

    def __init__(self) -> None:
        self.calls: list[str] = []
        self.paused = threading.Event()

    def call(self, name: str, *values: Any, **named: Any) -> None:
        if name == "jog":
            raise InvalidInputError("six numbers", "jog", "Give them.")
        self.calls.append(name)
        if name == "pause":
            self.paused.set()

    def lateness(self, last: int) -> tuple[float, float, float]:
        return 0.0, 0.0, 0.0


@pytest.mark.slow
def test_a_page_that_falls_silent_or_ends_pauses_the_run(at_start: Recording) -> None:
    run = Counted()
    link = PageLink(run, at_start, port=0)
    try:
        link._take(0.0, "forward", (), {})
        link._take(0.0, "jog", (), {})
        assert "six numbers" in link._words
        assert run.calls == ["forward"]
        link._take(0.0, "beat", (), {})
        assert run.paused.wait(30.0)
        assert "silent" in link._words
        run.paused.clear()
        link._process.terminate()
        assert run.paused.wait(30.0)
        assert "ended" in link._words
    finally:
        link.close()


@pytest.mark.slow
def test_an_error_of_the_pages_process_is_raised_here(at_start: Recording) -> None:
    with pytest.raises(InvalidInputError, match="port is 70000"):
        PageLink(Counted(), at_start, port=70000)


def test_what_is_seen_is_said(page: JogPage) -> None:
    task = obtain_task("dual_arm7")
    run = RealTimeRun(task.controller(), task.q_start, task.plant())
    seen: list[Seen] = []

    def look(step: Any) -> None:
        seen.append(Seen.of(step, run.controller, time=1.0, late=(1e-3, 2e-3), words="refused: why"))
        run.stop()

    run.run(look)
    text = " ".join(seen[0].lines())
    assert "paused · clock 0.00 of 3 s" in text
    assert "late by 1.0 ms (p99), 2.0 ms at most" in text
    assert text.endswith("refused: why")
