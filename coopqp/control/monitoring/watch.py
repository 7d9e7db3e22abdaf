"""What one look of the supervision finds, and how the cap on the rate falls."""

from __future__ import annotations

from dataclasses import dataclass

from coopqp.constraints.cause import Cause
from coopqp.native.constants import CAP_FALLS


@dataclass(slots=True)
class Watch:
    """Result of the supervision in one step: a rate cap, and why it is below 1, in a sentence and in a word."""

    rate_cap: float = 1.0
    hold: bool = False
    fault: bool = False
    arm: int = -1
    reason: str = ""
    cause: Cause | None = None

    @staticmethod
    def holding(reason: str, cause: Cause = Cause.INPUT, *, fault: bool = False) -> Watch:
        """The arms hold."""
        return Watch(rate_cap=0.0, hold=True, fault=fault, reason=reason, cause=cause)

    def lower(self, seen: Watch) -> None:
        """Take another finding if it is stricter; a fault stays as it is."""
        if self.fault:
            return
        if seen.rate_cap < self.rate_cap or seen.fault:
            self.rate_cap, self.hold, self.fault = seen.rate_cap, seen.hold, seen.fault
            self.arm, self.reason, self.cause = seen.arm, seen.reason, seen.cause


def fall_gently(watch: Watch, last: float, dt: float) -> None:
    """Let the cap fall from the ``last`` one within a time: a jolt is a force of its own. A fault holds at once."""
    least = last - dt / CAP_FALLS
    if not watch.fault and least > watch.rate_cap:
        watch.rate_cap, watch.hold = least, False
