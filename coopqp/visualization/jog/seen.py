"""What the control process tells the page."""

from __future__ import annotations

import textwrap
from dataclasses import dataclass
from typing import Any

from coopqp.control.interface import ControlStep
from coopqp.model.limits import BindingLimit
from coopqp.spatial import Array

#: A page that is not heard of for so long counts as closed [s].
SILENCE = 1.0
#: Longest line in characters.
_LINE = 52


@dataclass(frozen=True, eq=False)
class Seen:
    """The run at a moment.

    Attributes:
        time: since it began [s].
        q: commanded configuration (nq,).
        clock, duration: of the program [s].
        status, text: of the last step, in a word and in a sentence.
        binding: the limits that it runs against.
        rate: σ.
        override: the largest rate that is asked for.
        late: p99 and largest lateness of the control loop [s]; None where it is not measured.
        words: what came of the last call, where it was refused, and whether the page fell silent.
    """

    time: float
    q: Array
    clock: float
    duration: float
    status: str
    text: str
    binding: tuple[BindingLimit, ...]
    rate: float
    override: float
    late: tuple[float, float] | None = None
    words: str = ""

    @staticmethod
    def of(
        step: ControlStep, controller: Any, *, time: float, late: tuple[float, float] | None = None, words: str = ""
    ) -> Seen:
        """What a step looks like."""
        return Seen(
            time=time, q=step.q_next, clock=step.clock_next, duration=float(controller.path.duration),
            status=step.status.value, text=step.explain(), binding=step.binding, rate=step.rate,
            override=controller.override, late=late, words=words,
        )  # fmt: skip

    def lines(self) -> list[str]:
        """In a few lines."""
        late = ""
        if self.late is not None:
            p99, most = (1e3 * value for value in self.late)
            late = f" · control loop late by {p99:.1f} ms (p99), {most:.1f} ms at most"
        texts = [
            f"{self.status} · clock {self.clock:.2f} of {self.duration:.4g} s · σ = {100.0 * self.rate:.3g} %",
            self.text,
            f"t = {self.time:.0f} s{late}",
            self.words,
        ]
        return [line for text in texts if text for line in textwrap.wrap(text, _LINE, break_on_hyphens=False)]
