"""What is said of a step, from its numbers alone."""

from __future__ import annotations

from coopqp import BindingLimit, LimitKind

DT, BLOCKED_FROM = 0.01, 1e-3
POSITION, ACCELERATION, VELOCITY = (
    (BindingLimit("arm", "joint", kind),) for kind in (LimitKind.POSITION, LimitKind.ACCELERATION, LimitKind.VELOCITY)
)
