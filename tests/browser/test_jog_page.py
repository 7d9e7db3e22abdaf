"""The operator's page in Chromium: buttons, keys and gizmo move the object, a second page watches, closing pauses."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import Page, find_browser

from coopqp import ControlStep, Status
from coopqp.cli.runs import obtain_task
from coopqp.drivers.real_time import RealTimeRun
from coopqp.visualization.jog.link import PageLink


def text(page: Any) -> str:
    return str(page.evaluate("document.body ? document.body.innerText : ''"))


def click(page: Any, button: str) -> None:
    page.evaluate(f"[...document.querySelectorAll('button')].find(b => b.innerText === '{button}').click()")


def key(page: Any, kind: str, code: str) -> None:
    page.call("Input.dispatchKeyEvent", type=kind, code=code, key=code[-1].lower())


def drag(page: Any, begin: tuple[float, float], end: tuple[float, float]) -> None:
    """Grab what is at a point [px], and let it go at another."""
    for kind, share in (("Moved", 0.0), ("Pressed", 0.0), *(("Moved", 0.25 * i) for i in range(5)), ("Released", 1.0)):
        x, y = (a + share * (b - a) for a, b in zip(begin, end, strict=True))
        page.call("Input.dispatchMouseEvent", type=f"mouse{kind}", x=x, y=y, button="left", buttons=1, clickCount=1)


@pytest.mark.slow
def test_an_operator_leads_the_object(page: Any, tmp_path: Path) -> None:
    task = obtain_task("dual_arm7")
    run = RealTimeRun(task.controller(), task.q_start, task.plant())
    last: list[ControlStep] = []
    link = PageLink(run, task.at_start(), port=0, sticks=True)

    def observe(step: ControlStep) -> None:
        last[:] = [step]
        link.observe(step)

    def height() -> float:
        return float(run.controller.grasp.carried(last[0].state)[0].translation[2])

    thread = threading.Thread(target=run.run, args=(observe,), daemon=True)
    thread.start()
    try:
        page.open(link.url)
        page.wait_until(lambda: "Pause" in text(page) and "paused · clock" in text(page))

        def press(button: str, done: Any) -> None:
            """A loaded machine's page may be paused for its silence: then the button is pressed again."""
            page.wait_until(lambda: (click(page, button), done())[1], every=1.0)

        press("Run", lambda: last[0].clock > 0.3)
        press("Pause", lambda: last[0].status is Status.PAUSED)
        press("Back", lambda: last[0].status is Status.PAUSED and last[0].clock_next == 0.0)

        with Page(str(find_browser()), tmp_path / "second", width=640, height=420) as second:
            second.open(link.url)
            second.wait_until(lambda: "this one watches" in text(second))
            assert "Return" not in text(second)

        before = height()
        key(page, "keyDown", "KeyR")
        page.wait_until(lambda: height() > before + 0.01)
        key(page, "keyUp", "KeyR")
        page.wait_until(lambda: last[0].status is Status.JOGGING and np.abs(last[0].velocity).max() < 1e-4)
        press("Return", lambda: last[0].status is Status.PAUSED)
        assert page.errors == []
        assert all(
            url.startswith((link.url, link.url.replace("http", "ws"), "data:", "blob:")) for url in page.requests
        )
        press("Run", lambda: last[0].status is Status.TRACKING)
        page.open("about:blank")
        page.wait_until(lambda: last[0].status is Status.PAUSED)
    finally:
        run.stop()
        thread.join(30.0)
        link.close()
