"""The page in a process of its own, and its link to the loop that controls: drawing never delays a step."""

from __future__ import annotations

import contextlib
import math
import multiprocessing
import os
import signal
import threading
import time
from collections import deque
from multiprocessing.connection import Connection
from typing import Any, final

from coopqp.control.interface import ControlStep
from coopqp.drivers.ring import ObjectRing
from coopqp.errors import CoopqpError, said
from coopqp.simulation.recording.recording import Recording
from coopqp.visualization.jog.page import JogPage
from coopqp.visualization.jog.seen import SILENCE, Seen
from coopqp.visualization.viewer import require_viser

#: How often the link looks whether the page has fallen silent [s].
_LOOK = 0.05
#: Time from one drawing to the next, and how often the page's process looks for something new [s].
_DRAWN_EVERY, _READ_EVERY = 0.03, 0.005
#: What came of a refused call is shown so long [s].
_SHOWN = 6.0
#: The loop's lateness is looked at so often [s], over so many periods.
_LATE_EVERY, _LATE_OF = 1.0, 1000
#: Delays of calls that are kept.
_KEPT = 10_000
#: The page opens within this time, or not at all [s].
_OPENING = 60.0


@final
class PageLink:
    """A page for a run that another thread steps. A page that is silent for 1 s pauses the run.

    Args:
        run: takes calls: ``call(name, …)``; has ``controller`` and ``lateness(last)``, None where it is not known.
        recording: the cell at its start, as a run of one step.
        port: port to listen on; 0 for any free port.
        sticks: draw the arms as sticks instead of their shapes.

    Attributes:
        url: address for the browser. It has a key, without which the page's server answers nobody.
        delays: from when the page's process had a call until the controller had it [s].
        shown, told: how often the cell was drawn, and how often it was to be drawn.

    Raises:
        MissingExtraError: viser is not installed.
        CoopqpError: the page cannot be served.
    """

    def __init__(self, run: Any, recording: Recording, *, port: int = 8080, sticks: bool = False) -> None:
        require_viser()
        self._run = run
        self.delays: deque[float] = deque(maxlen=_KEPT)
        self.shown = self.told = 0
        self._began, self._due = time.monotonic(), -math.inf
        self._late: tuple[float, float] | None = None
        self._late_due = -math.inf
        self._words, self._words_until = "", -math.inf
        self._silent, self._heard = True, -math.inf
        self._closed = False
        self._ring = ObjectRing()
        context = multiprocessing.get_context("spawn")
        self._link, theirs = context.Pipe()
        self._process = context.Process(
            target=serve_page,
            args=(theirs, self._ring, recording, port, sticks, run.controller.override),
            daemon=True,
        )
        try:
            self._process.start()
            theirs.close()
            self.url = self._opened()
        except BaseException:
            self.close()
            raise
        threading.Thread(target=self._listen, daemon=True).start()

    def _opened(self) -> str:
        """The page's address, once it is there."""
        try:
            if not self._link.poll(_OPENING):
                raise CoopqpError("the page did not open within 60 s.")
            answer: str | CoopqpError = self._link.recv()
        except EOFError as error:
            raise CoopqpError(
                "the page's process ended before the page was there. It imports the script that started it: what opens "
                'the page has to stand under `if __name__ == "__main__":`.'
            ) from error
        if isinstance(answer, CoopqpError):
            raise answer
        return answer

    def close(self) -> None:
        """End the page's process; what is told later is left out."""
        self._closed = True
        self._ring.end()
        self._link.close()
        if self._process.pid is not None:  # it was started
            self._process.join(3.0)
            if self._process.is_alive():
                self._process.terminate()
                self._process.join()
        self._ring.close()

    # -- in the thread that steps ----------------------------------------------------------------------------------

    def observe(self, step: ControlStep) -> None:
        """Show a step, 33 times a second."""
        now = time.monotonic()
        if self._closed or now < self._due:
            return
        self._due = max(self._due + _DRAWN_EVERY, now)
        words = self._words if now < self._words_until else ""
        if now >= self._late_due:
            self._late_due = now + _LATE_EVERY
            late = self._run.lateness(_LATE_OF)
            self._late = None if late is None else late[1:]
        time_s = now - self._began
        self.told += 1
        self._ring.tell(Seen.of(step, self._run.controller, time=time_s, late=self._late, words=words))

    # -- in a thread of its own ------------------------------------------------------------------------------------

    def _listen(self) -> None:
        while not self._closed:
            try:
                message = self._link.recv() if self._link.poll(_LOOK) else None
            except (EOFError, OSError):
                message = None
                if not self._closed:
                    self._say("the page's process has ended; end with Ctrl-C")
                    self._run.call("pause")
                return
            if message is not None:
                self._take(*message)
            if not self._silent and time.monotonic() - self._heard > SILENCE:
                self._silent = True
                self._say("paused: the page fell silent")
                self._run.call("pause")

    def _take(self, sent: float, name: str, values: tuple[Any, ...], named: dict[str, Any]) -> None:
        if name == "shown":
            self.shown += 1
            return
        if name == "beat":
            self._heard, self._silent = time.monotonic(), False
            return
        try:
            self._run.call(name, *values, **named)
        except CoopqpError as error:
            self._say(f"refused: {error}")
        except Exception as error:  # whatever it is, a page that falls silent has to be noticed here
            self._say(f"failed: {said(error)}")
        self.delays.append(time.monotonic() - sent)

    def _say(self, words: str) -> None:
        self._words, self._words_until = words, time.monotonic() + _SHOWN


def serve_page(
    link: Connection, ring: ObjectRing, recording: Recording, port: int, sticks: bool, override: float
) -> None:
    """Serve the page until the ring ends, or the run's process: the whole of its own process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the run ends it
    parent, lock = os.getppid(), threading.Lock()

    def tell(name: str, *values: Any, **named: Any) -> None:
        with lock, contextlib.suppress(OSError, ValueError):
            link.send((time.monotonic(), name, values, named))

    try:
        page = JogPage(recording, tell, port=port, sticks=sticks, override=override)
    except CoopqpError as error:
        link.send(error)
        return
    link.send(page.url)
    while not ring.ended and os.getppid() == parent:
        seen = ring.newest()
        if seen is None:
            time.sleep(_READ_EVERY)
        else:
            page.show(seen)
            tell("shown")
    page.close()
