"""What leads a control loop by name: calls, refusals, and robots that stand."""

from __future__ import annotations

from concurrent.futures import Future
from types import SimpleNamespace
from typing import Any

import pytest

from coopqp import InvalidInputError
from coopqp.drivers.led_loop import LedLoop


class Loop:
    """Stands for a control loop: keeps its calls; one of them is refused, one is never answered."""

    def __init__(self) -> None:
        self.stands, self.calls = False, list[tuple[Any, ...]]()
        self.controller = SimpleNamespace(pause=lambda: self.calls.append(("first a pause",)))

    def __getattr__(self, name: str) -> Any:
        def call(*values: Any, **named: Any) -> Future[None]:
            self.calls.append((name, *values, *named.values()))
            future: Future[None] = Future()
            if name == "run_to":
                future.set_exception(InvalidInputError("it lies ahead", "run_to", "Another one."))
            elif name != "release":
                future.set_result(None)
            return future

        return call


def test_calls_are_passed_on_and_refusals_raised() -> None:
    loop = Loop()
    led: Any = LedLoop(loop)  # type: ignore[arg-type]
    led.call("jog", [0.0] * 6, frame="world")
    led.call("forward")
    led.call("release")  # no answer in time
    with pytest.raises(InvalidInputError, match="it lies ahead"):
        led.call("run_to", 9.0)
    with pytest.raises(InvalidInputError, match="no call 'stop_drivers'"):
        led.call("stop_drivers")
    with pytest.raises(InvalidInputError, match="no robot has stopped"):
        led.call("reset")
    assert loop.calls == [
        ("first a pause",), ("jog", [0.0] * 6, "world"), ("forward",), ("release",), ("run_to", 9.0),
    ]  # fmt: skip
    assert led.lateness(5) is None


def test_arms_that_stand_go_on_by_hand() -> None:
    loop = Loop()
    led = LedLoop(loop)  # type: ignore[arg-type]
    loop.stands = True
    led.call("reset")
    led.call("forward")
    led.call("reverse")
    assert loop.calls[1:] == [("resume",), ("resume",), ("forward",), ("reverse",)]
