"""A simulation in real time: a controller is stepped by the clock, and takes an operator's calls from other threads."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any, final

import numpy as np

from coopqp.control.interface import ControlStep
from coopqp.drivers.contained import Contained, name_of
from coopqp.drivers.process import as_priority, keeps_scheduler, prepare_process
from coopqp.drivers.timing import LoopTime, MonotonicTime
from coopqp.errors import CoopqpError, InvalidInputError
from coopqp.simulation.plants.kinematic import KinematicPlant, Plant
from coopqp.simulation.recording.recording import Recording
from coopqp.simulation.simulate import RunRecorder, begin
from coopqp.spatial import Array

#: Calls that :meth:`RealTimeRun.call` passes on.
CALLS = (
    "pause", "resume", "forward", "reverse", "run_to", "step_to_mark", "set_override", "jog", "return_to_path",
    "engage", "target", "release", "reset",
)  # fmt: skip
#: Periods whose lateness is kept.
_KEPT = 30_000


@final
class RealTimeRun:
    """A controller on a plant, a step in each period of the machine's clock, until :meth:`stop`. It begins paused.

    Args:
        controller: a QPController.
        q_start: where it begins (nq,).
        plant: the plant; an ideal one by default.
        records: keep the run for :meth:`recording`.
        realtime: priority of the FIFO scheduler that :meth:`run` asks for, 1 to 99; None for the ordinary one.
        time: the clock; the machine's by default.

    Attributes:
        steps, missed: steps so far, and periods that were left out after overruns.
        scheduler: what came of asking for the FIFO scheduler, in words.
        outside: what others raised, as the page; the run went on.
    """

    def __init__(
        self,
        controller: Any,
        q_start: Array,
        plant: Plant | None = None,
        *,
        records: bool = False,
        realtime: int | None = None,
        time: LoopTime | None = None,
    ) -> None:
        if getattr(controller, "needs_wrenches", False) or not callable(getattr(controller, "jog", None)):
            what = f"a {type(controller).__name__}"
            raise InvalidInputError(what, "RealTimeRun: controller", "Give a QPController.")
        self.controller, self._q_start = controller, np.array(q_start)
        self._plant = KinematicPlant(controller.cell) if plant is None else plant
        self._records, self._time = records, MonotonicTime() if time is None else time
        self._calls: deque[Callable[[], None]] = deque()
        self.outside = Contained()
        self._stopped = False
        self._late = np.zeros(_KEPT)
        self._realtime, self.scheduler = as_priority(realtime, "RealTimeRun: realtime"), "ordinary"
        self.steps = self.missed = 0
        controller.pause()
        self._begin()

    def _begin(self) -> None:
        """At the start, at rest."""
        self._measured = begin(self.controller, self._plant, self._q_start)
        self._record_from_here()

    def _record_from_here(self) -> None:
        self._recorder = RunRecorder(self.controller, self._measured) if self._records else None

    def call(self, name: str, *values: Any, **named: Any) -> None:
        """Make an operator's call, from any thread; it takes effect in the next step.

        ``reset`` ends a fault where the arms are, or begins the run again where the object is not on its program; the
        object then rests until it is told to go on, and a recording begins anew.

        Raises:
            InvalidInputError: no such call, or a bad value; nothing changes.
        """
        if name not in CALLS:
            raise InvalidInputError(f"there is no call '{name}'", "call", f"Calls are {', '.join(CALLS)}.")
        if name == "reset":
            self._calls.append(self._reset)
        else:
            getattr(self.controller, name)(*values, **named)

    def _reset(self) -> None:
        controller = self.controller
        controller.pause()
        try:
            controller.reset(controller.commanded, clock=controller.program_clock)
        except CoopqpError:  # it is not on its program
            self._begin()
        else:
            self._record_from_here()

    def stop(self) -> None:
        """End the run after the present step; from any thread, and from signals."""
        self._stopped = True

    def run(self, observe: Callable[[ControlStep], None] | None = None) -> None:
        """Step until :meth:`stop`, once at least; ``observe`` is called with each step."""
        with keeps_scheduler():
            if self._realtime is not None:
                self.scheduler = prepare_process(realtime=self._realtime, lock_memory=False, core=None)["realtime"]
            self._steps(observe)

    def _steps(self, observe: Callable[[ControlStep], None] | None) -> None:
        time, h = self._time, self.controller.dt
        deadline = time.now()
        while True:
            for _ in range(len(self._calls)):
                self.outside.call("reset", self._calls.popleft())
            step = self.controller.step(self._measured)
            self._measured = self._plant.apply(step)
            if self._recorder is None:
                self.controller.take_events()
            else:
                self._recorder.take(step, self._measured)
            if observe is not None:
                self.outside.call(name_of(observe), observe, step)
            deadline += h
            time.sleep_until(deadline)
            late = time.now() - deadline
            self._late[self.steps % _KEPT] = late
            self.steps += 1
            if late > h:  # no catching up
                left_out = int(late / h)
                self.missed += left_out
                deadline += left_out * h
            if self._stopped:
                break

    def lateness(self, last: int = _KEPT) -> tuple[float, float, float]:
        """Of the beginnings of so many last periods: p50, p99 and the largest [s]."""
        n = min(last, self.steps, _KEPT)
        if n == 0:
            return 0.0, 0.0, 0.0
        late = self._late[np.arange(self.steps - n, self.steps) % _KEPT]
        return float(np.median(late)), float(np.percentile(late, 99.0)), float(late.max())

    @property
    def recorded(self) -> int:
        """Steps that :meth:`recording` has."""
        return 0 if self._recorder is None else self._recorder.steps

    def recording(self, metadata: dict[str, Any] | None = None) -> Recording:
        """The run since it began, or since the last reset.

        Args:
            metadata: entries of the recording; must be JSON.

        Raises:
            InvalidInputError: nothing is kept, or no step was made.
        """
        recorder = self._recorder
        if recorder is None or self.recorded == 0:
            raise InvalidInputError("nothing was kept", "recording", "Give records=True, and run it.")
        lasts = recorder.steps * self.controller.dt
        held = {"plant": type(self._plant).__name__, "gripped": getattr(self._plant, "gripped", None)}
        return recorder.recording({**held, "settle": lasts, "longest": lasts, **(metadata or {})})
