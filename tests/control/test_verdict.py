"""What is said of a step, from its numbers alone."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from coopqp import BindingLimit, LimitKind, QPOptions, Status
from coopqp.control.interface import NOTHING, off_path
from coopqp.control.step.priorities import StepAnswer
from coopqp.control.step.state import LoopState
from coopqp.control.step.verdict import away_from_path, given_up, slow_status

DT, BLOCKED_FROM = 0.01, 1e-3
POSITION, ACCELERATION, VELOCITY = (
    (BindingLimit("arm", "joint", kind),) for kind in (LimitKind.POSITION, LimitKind.ACCELERATION, LimitKind.VELOCITY)
)


def state(rate: float = 1.0, **values: Any) -> LoopState:
    return LoopState(np.zeros(6), np.zeros(6), np.zeros(6), rate=rate, clock=1.0, **values)


class Ahead:
    """A look-ahead that knows whether the object stops for good, and one corner."""

    def __init__(self, *, ends: bool = False, corner: float = np.inf) -> None:
        self.ends, self.corner = ends, corner

    def reaches_corner(self, clock: float, way: float) -> bool:
        return clock < self.corner <= clock + way


def verdict(rate: float, binding: Any, before: float = 1.0, ahead: Any = None, *, outside: bool = False) -> Status:
    return slow_status(state(before), rate, binding, ahead, BLOCKED_FROM, outside=outside, dt=DT)


@pytest.mark.parametrize("binding", [(), POSITION, ACCELERATION, VELOCITY])
def test_an_object_that_goes_on_is_slowed(binding: Any) -> None:
    for rate in (0.5, 10.0 * BLOCKED_FROM):
        assert verdict(rate, binding) is Status.SLOWED
        assert verdict(rate, binding, ahead=Ahead(ends=True)) is Status.SLOWED


def test_an_object_that_a_limit_stops_is_blocked() -> None:
    below = 0.99 * BLOCKED_FROM
    assert verdict(below, VELOCITY) is Status.BLOCKED
    assert verdict(BLOCKED_FROM, VELOCITY) is Status.SLOWED
    assert verdict(below, VELOCITY, before=0.0) is Status.BLOCKED  # its rate rises, but by no acceleration
    assert verdict(below, ()) is Status.SLOWED  # no limit: it is on its way
    for rate in (0.0, below):
        assert verdict(rate, POSITION) is Status.BLOCKED


def test_an_object_that_stops_for_good_is_blocked_a_little_before() -> None:
    near = 9.9 * BLOCKED_FROM
    assert verdict(near, POSITION) is Status.BLOCKED
    assert verdict(near, VELOCITY, ahead=Ahead(ends=True)) is Status.BLOCKED
    assert verdict(near, VELOCITY) is Status.SLOWED
    assert verdict(near, VELOCITY, ahead=Ahead()) is Status.SLOWED
    assert verdict(near, POSITION, before=0.5 * near) is Status.SLOWED  # it speeds up
    assert verdict(near, POSITION, before=near) is Status.BLOCKED
    assert verdict(near, POSITION, outside=True) is Status.SLOWED  # a joint is on its way back in
    assert verdict(near, POSITION + VELOCITY) is Status.BLOCKED  # one that ends it is enough


def test_an_object_that_speeds_up_from_rest_is_not_blocked() -> None:
    below = 0.5 * BLOCKED_FROM
    assert verdict(below, ACCELERATION, before=0.0) is Status.SLOWED
    assert verdict(below, ACCELERATION, before=1.0) is Status.BLOCKED
    assert verdict(below, ACCELERATION, before=below) is Status.BLOCKED
    assert verdict(below, ACCELERATION, before=1.0, outside=True) is Status.SLOWED
    assert verdict(below, VELOCITY, before=0.0, outside=True) is Status.BLOCKED


def test_joints_that_stop_slowly_at_a_corner_do_not_block_the_object() -> None:
    below = 0.5 * BLOCKED_FROM
    for away, status in ((-1.5, "BLOCKED"), (-0.5, "SLOWED"), (0.5, "SLOWED"), (1.5, "BLOCKED")):
        corner = Ahead(corner=1.0 + away * DT)
        assert verdict(below, VELOCITY, ahead=corner) is Status[status]
        assert verdict(0.0, VELOCITY, ahead=corner) is Status.BLOCKED  # it does not go on
        assert verdict(below, POSITION, ahead=corner) is Status.BLOCKED  # nor past this limit


def test_how_far_the_object_is_off_its_path_is_said_from_the_tolerances_on(rng: np.random.Generator) -> None:
    options = QPOptions()
    far, turned = options.off_path_distance, options.off_path_angle
    for way in rng.normal(size=(10, 6)):
        way[:3] /= np.linalg.norm(way[:3])
        way[3:] /= np.linalg.norm(way[3:])
        for d, a in ((0.99, 0.99), (1.5, 0.5), (0.5, 1.5), (2.0, 3.0)):
            error = way * np.repeat([d * far, a * turned], 3)
            distance = float(np.linalg.norm(pin.exp6(error).translation))
            said = off_path(distance if d > 1.0 else 0.0, a * turned if a > 1.0 else 0.0) if max(d, a) > 1.0 else ""
            assert (said != "") == (max(d, a) > 1.0)
            drift = rng.normal(size=6)
            for common, measured in ((error, None), (error - drift, drift)):  # what is measured besides counts
                found: Any = SimpleNamespace(common=common)
                assert away_from_path(state(drift=measured), found, options) == said


def test_what_was_given_up_is_what_is_missing() -> None:
    off = np.arange(6.0)
    answer = StepAnswer(np.zeros(6), 0.4, grasp_share=0.7, path_share=0.2, off_path=off, chain=0.05)
    lost = given_up(SimpleNamespace(answer=answer), 0.4, ("arm",))  # type: ignore[arg-type]
    assert (lost.chain, lost.off_path, lost.restricted) == (0.05, tuple(off), ("arm",))
    assert (lost.grasp, lost.path, lost.rate) == pytest.approx((0.3, 0.8, 0.6))
    nothing: Any = SimpleNamespace(answer=StepAnswer(np.zeros(6), 1.0, exact=True))
    assert given_up(nothing, 1.0, ()) == NOTHING
    assert given_up(nothing, 0.5, ()).rate == 0.5
    assert given_up(nothing, 1.0, ("arm",)).restricted == ("arm",)
