"""The operator's page in Chromium: how late the control loop is beside it, how soon calls arrive, how it is drawn.

A cell runs at 500 Hz in real time: alone, and with the page, its drawing and a recording, in turn. On the page a script
drags the gizmo, leads with a key, and presses Return and Run. Records have the keys ``figure``,
``alone``, ``page``, ``bound`` and ``unit``. Chain and path are those of the verdict of the recorded run.
"""

from __future__ import annotations

import sys
import tempfile
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import common  # first: it limits BLAS to one thread
import numpy as np
import pinocchio as pin

from coopqp import ControlStep, QPController, Recording, Status, simulate
from coopqp.drivers import RealTimeRun
from coopqp.scenarios import Scenario, dual_arm7
from coopqp.simulation import describe_object, read_run
from coopqp.visualization import PageLink

sys.path.insert(0, str(Path(__file__).parents[1] / "docs"))
from browser import Page, find_browser  # type: ignore[import-not-found]

KEYS = ("figure", "alone", "page", "bound", "unit")
_WIDTH, _HEIGHT = 900, 520
#: Of the FIFO scheduler, as ``coopqp jog`` asks for it.
_PRIORITY = 20
#: Where the gizmo's upper arrow is at the start, as shares of the picture, and how far it is dragged [px].
_ARROW, _DRAGGED = (0.521, 0.518), 30.0


class Session:
    """A run in a thread of its own, and what was seen of it."""

    def __init__(self, task: Scenario, *, records: bool) -> None:
        self.run = RealTimeRun(_controller(task), task.q_start, records=records, realtime=_PRIORITY)
        self.last: ControlStep | None = None
        self.observe: Callable[[ControlStep], None] | None = None
        self._thread = threading.Thread(target=lambda: self.run.run(self._step), daemon=True)
        self._ends = threading.Event()

    def _step(self, step: ControlStep) -> None:
        self.last = step
        if self.observe is not None:
            self.observe(step)

    def __enter__(self) -> Session:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.run.stop()
        self._thread.join(30.0)

    def wait(self, seconds: float) -> None:
        """Let it go on."""
        self._ends.wait(seconds)

    @property
    def pose(self) -> pin.SE3:
        """Where the object is."""
        assert self.last is not None
        return self.run.controller.grasp.carried(self.last.state)[0]

    def rests(self) -> bool:
        """Whether nothing moves."""
        return self.last is not None and float(np.abs(self.last.velocity).max()) < 1e-4


def _controller(task: Scenario) -> QPController:
    """A controller of the cell, with acceleration limits of 10 rad/s²."""
    return QPController(task.cell.with_limits(acceleration=10.0), task.grasp, task.path, dt=task.dt)


def _metadata(task: Scenario) -> dict[str, Any]:
    return {"scenario": task.name, "object": describe_object(task.object_size, task.T_object_body)}


def _lead(session: Session, page: Page) -> None:
    """What an operator does."""

    def click(button: str) -> None:
        page.evaluate(f"[...document.querySelectorAll('button')].find(b => b.innerText === '{button}').click()")

    def until(done: Callable[[], Any]) -> None:
        page.wait_until(done, every=0.05, timeout=60.0)

    box = page.box("canvas")
    begin = box["left"] + _ARROW[0] * box["width"], box["top"] + _ARROW[1] * box["height"]
    before = session.pose.translation.copy()
    for kind, share in (("Moved", 0.0), ("Pressed", 0.0), *(("Moved", 0.1 * i) for i in range(11)), ("Released", 1.0)):
        x, y = begin[0], begin[1] - share * _DRAGGED
        page.call("Input.dispatchMouseEvent", type=f"mouse{kind}", x=x, y=y, button="left", buttons=1, clickCount=1)
        session.wait(0.05)
    until(session.rests)
    session.wait(1.0)
    print(f"dragged by {1e3 * np.linalg.norm(session.pose.translation - before):.0f} mm", flush=True)
    for kind in ("keyDown", "keyUp"):
        page.call("Input.dispatchKeyEvent", type=kind, code="KeyA", key="a")
        session.wait(0.8)
    until(session.rests)
    click("Return")
    until(lambda: session.last is not None and session.last.status is Status.PAUSED)
    click("Run")
    until(lambda: session.last is not None and session.last.finished)


def _led(task: Scenario) -> tuple[Session, PageLink, Recording]:
    program = find_browser()
    if program is None:
        raise SystemExit("no browser; 'make browser' installs one")
    session = Session(task, records=True)
    begun = simulate(_controller(task), q_start=task.q_start, duration=task.dt, metadata=_metadata(task))
    link = PageLink(session.run, begun, port=0, sticks=True)
    session.observe = link.observe
    with (
        tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder,
        session,
        Page(program, Path(folder) / "profile", width=_WIDTH, height=_HEIGHT) as page,
    ):
        page.open(link.url)
        page.wait_until(lambda: page.evaluate("document.body?.innerText.includes('Return')"))
        session.wait(2.0)
        _lead(session, page)
    link.close()
    return session, link, session.run.recording(_metadata(task))


def records(rounds: int) -> list[common.Record]:
    """The figures, lateness as medians over rounds."""
    task, alone, beside, delays, chain, path, drawn = dual_arm7(), [], [], list[float](), 0.0, 0.0, []
    for _ in range(rounds):
        with Session(task, records=False) as session:
            session.wait(8.0)
        alone.append(session.run.lateness()[1])
        session, link, run = _led(task)
        beside.append(session.run.lateness()[1])
        delays += link.delays
        drawn.append(link.shown / (session.run.steps * session.run.controller.dt))
        readings = read_run(run.cell(shapes=False), run)
        chain, path = max(chain, readings.chain_mm.max()), max(path, readings.object_mm.max())
    rows: list[tuple[str, float, float, float, str]] = [
        ("lateness of the loop, p99", 1e3 * float(np.median(alone)), 1e3 * float(np.median(beside)), 2.0, "ms"),
        ("a call, from the page's process to the controller, p99", np.nan, 1e3 * float(np.percentile(delays, 99)),
         10.0, "ms"),
        ("drawn", np.nan, float(np.median(drawn)), 30.0, "1/s"),
        ("arms apart over drag, key, return and run", np.nan, 1e3 * chain, 0.5, "µm"),
        ("object off its way", np.nan, 1e3 * path, 0.5, "µm"),
    ]  # fmt: skip
    return [dict(zip(KEYS, row, strict=True)) for row in rows]


def main(arguments: Sequence[str] | None = None) -> int:
    parser = common.arguments(__doc__.splitlines()[0])
    given: Any = parser.parse_args(arguments)
    description = common.describe("the operator's page", {"quick": given.quick})
    print(common.header(description))
    found = records(1 if given.quick else 3)
    for record in found:
        alone, page = (f"{record[name]:8.3g}" for name in ("alone", "page"))
        print(f"{record['figure']:58} {alone} {page}   ({record['bound']:g} {record['unit']})")
    table = common.markdown_table(found, KEYS).encode()
    common.save(found, description, json_file=given.json, out=given.out, files={"jog_page.md": table})
    return 0


if __name__ == "__main__":
    sys.exit(main())
