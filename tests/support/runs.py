"""Scenarios with other limits, and runs of controllers from their starts."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from coopqp import ControlStep, LinePath, ObjectPath, QPController, QPOptions, Status
from coopqp.baselines import PseudoInverseController, PseudoInverseOptions
from coopqp.control import Controller
from coopqp.paths import TimeLaw
from coopqp.scenarios import Scenario, paper_lift


def limited(task: Scenario, acceleration: Any = None, **limits: Any) -> Scenario:
    """The scenario with other limits of its joints; an acceleration is that of all [rad/s²]."""
    given = limits if acceleration is None else {"acceleration": acceleration, **limits}
    return replace(task, cell=task.cell.with_limits(**given))


@functools.cache
def limited_once(make: Callable[[], Scenario], acceleration: float) -> Scenario:
    """The scenario of a maker with another acceleration of all joints [rad/s²], made once for all tests."""
    return limited(make(), acceleration)


def hurried(task: Scenario, seconds: float, time_law: str = "quintic") -> Scenario:
    """The same line in other seconds: so few that limits bind on the way."""
    assert isinstance(task.path, LinePath)
    path = LinePath(task.path.start, task.path.goal, duration=seconds, time_law=TimeLaw(time_law))
    return replace(task, path=path)


def fast_lift(time_law: str = "quintic") -> Scenario:
    """The paper's lift in 0.6 s."""
    return hurried(paper_lift(), 0.6, time_law)


def cooperative(
    task: Scenario,
    *,
    path: ObjectPath | None = None,
    dt: float | None = None,
    constraints: Sequence[Any] = (),
    **options: Any,
) -> QPController:
    """The QP controller of a scenario, before its first reset.

    Args:
        task: whose cell, grasp, path and period.
        path: another path.
        dt: another period [s].
        constraints: of a user.
        options: of :class:`coopqp.QPOptions`.
    """
    return QPController(
        task.cell,
        task.grasp,
        task.path if path is None else path,
        dt=task.dt if dt is None else dt,
        options=QPOptions(**options),
        constraints=constraints,
    )


def built(task: Scenario, **options: Any) -> QPController:
    """:func:`cooperative`, at the scenario's start."""
    made = cooperative(task, **options)
    made.reset(task.q_start)
    return made


def of_the_paper(task: Scenario, steps: int, **options: Any) -> PseudoInverseController:
    """The paper's algorithm with a number of steps on a scenario's path, before its first reset.

    Args:
        task: whose cell, grasp and path.
        steps: how many the path takes.
        options: of :class:`coopqp.baselines.PseudoInverseOptions`.
    """
    made = PseudoInverseOptions(**options)
    return PseudoInverseController(task.cell, task.grasp, task.path, dt=task.path.duration / steps, options=made)


def drive(
    controller: Controller,
    steps: int = 6000,
    *,
    start: Any = None,
    rest: int | None = None,
    before: Callable[[Any, int], None] | None = None,
    measured: Callable[[ControlStep], Any] | None = None,
) -> list[ControlStep]:
    """At most this number of steps, to the end of the path.

    Args:
        controller: that has been reset, but if a start is given.
        steps: how many at most.
        start: a configuration (nq,) at which it is reset.
        rest: ends after so many steps BLOCKED one after the other.
        before: called with the controller and the number of the step, ahead of each.
        measured: the configuration (nq,) that is measured after a step; by default none is.
    """
    if start is not None:
        controller.reset(start)
    done: list[ControlStep] = []
    waited = 0
    while len(done) < steps and not (done and done[-1].finished):
        if before is not None:
            before(controller, len(done))
        done.append(controller.step(measured(done[-1]) if measured is not None and done else None))
        waited = waited + 1 if done[-1].status is Status.BLOCKED else 0
        if rest is not None and waited >= rest:
            break
    return done
