"""One controller in two threads: the second call raises a named error, and the first one's step is what it would be."""

from __future__ import annotations

import copy
import pickle
import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from coopqp import CoopqpError, ForceController, InvalidInputError, LinePath, ObjectPath, QPController, ServoPath
from coopqp.baselines import IndependentQPController, PseudoInverseController
from coopqp.errors import BusyError
from coopqp.scenarios import Scenario
from coopqp.solvers import make_solver


def minding_forces(*arguments: Any, dt: float, options: dict[str, Any]) -> ForceController:
    """A controller whose arms relax the forces between them."""
    return ForceController(QPController(*arguments, dt=dt, options=options), {"stiffness": 1e5})


CONTROLLERS: dict[str, tuple[Callable[..., Any], dict[str, Any]]] = {
    "qp": (QPController, {}),
    "qp, a QP of DAQP at every step": (QPController, {"shortcut": False, "solver": "daqp"}),
    "pseudo-inverse": (PseudoInverseController, {"increment": "exact"}),
    "independent": (IndependentQPController, {}),
    "forces": (minding_forces, {}),
}


class Meeting(ObjectPath):
    """A path whose pose, once, lets another thread call the controller and waits until it has."""

    meet: Callable[[], None] | None

    def __init__(self, path: Any) -> None:
        self._path, self.meet = path, None

    @property
    def duration(self) -> float:
        return float(self._path.duration)

    def pose(self, clock: float) -> pin.SE3:
        if self.meet is not None:
            meet, self.meet = self.meet, None
            other = threading.Thread(target=meet)
            other.start()
            other.join(timeout=30)
        return self._path.pose(clock)

    def twist(self, clock: float) -> Any:
        return self._path.twist(clock)


@pytest.mark.parametrize("name", sorted(CONTROLLERS))
def test_the_second_thread_is_refused_before_anything_is_touched(name: str, paper: Scenario) -> None:
    kind, options = CONTROLLERS[name]
    errors: list[Exception | None] = []

    def run(disturbed: bool) -> list[Any]:
        path = Meeting(paper.path)
        made: Any = kind(paper.cell, paper.grasp, path, dt=0.0075, options=options)
        made.reset(paper.q_start)
        calls: list[Callable[[], Any]] = [made.step, lambda: made.reset(paper.q_start)]
        if kind is QPController:
            calls.append(lambda: copy.copy(made))

        def intrude() -> None:
            for call in calls:
                try:
                    call()
                    errors.append(None)
                except Exception as error:
                    errors.append(error)

        steps = []
        for i in range(6):
            path.meet = intrude if disturbed and i == 3 else None
            steps.append(made.step().q_next)
        return steps

    alone = run(disturbed=False)
    assert not errors
    np.testing.assert_array_equal(run(disturbed=True), alone)
    assert errors
    assert {type(error) for error in errors} == {BusyError}


@pytest.mark.parametrize("own", [True, False])
def test_what_an_operator_asks_for_from_another_thread_waits_for_the_next_step(own: bool, paper: Scenario) -> None:
    """The steps are those of a controller that its own thread asks between two steps."""

    def run(ask: Callable[[QPController], None], *, elsewhere: bool) -> list[Any]:
        path: Any = Meeting(paper.path) if own else paper.path
        made = QPController(paper.cell, paper.grasp, path, dt=0.0075)
        made.reset(paper.q_start)
        steps = []
        for i in range(40):
            if i == 10 and elsewhere and own:  # amid a step: it waits for the next one
                path.meet = lambda: ask(made)
            elif i == 11 and not (elsewhere and own):
                if elsewhere:
                    other = threading.Thread(target=ask, args=(made,))
                    other.start()
                    other.join(timeout=30)
                else:
                    ask(made)
            steps.append(made.step())
        return [(s.q_next.tolist(), s.status) for s in steps]

    def follow(c: QPController) -> None:
        c.follow(paper.path, clock=0.1)

    def pause_and_resume(c: QPController) -> None:
        c.pause()
        c.resume()
        c.set_override(0.3)

    asked: list[Callable[[QPController], None]] = [
        lambda c: c.pause(),
        lambda c: c.set_override(0.5),
        pause_and_resume,
        lambda c: c.shift_grasp(np.full((len(paper.cell), 6), 1e-5)),
        follow,
    ]
    for ask in asked:
        assert run(ask, elsewhere=True) == run(ask, elsewhere=False)


def elsewhere(call: Callable[[], object]) -> None:
    """Make calls in another thread."""
    other = threading.Thread(target=call)
    other.start()
    other.join(timeout=30)


def test_a_step_takes_the_calls_that_wait_when_it_begins(paper: Scenario) -> None:
    """A call that comes while they are made waits for the next step: a caller without a break holds no step."""
    made = QPController(paper.cell, paper.grasp, paper.path, dt=0.0075)
    made.reset(paper.q_start)
    made.step()
    counted = []

    def again(operator: Any) -> None:
        counted.append(made.program_clock)
        elsewhere(lambda: made.operate("pause", None, again))

    elsewhere(lambda: made.operate("pause", None, again))
    clocks = [made.step().clock for _ in range(5)]
    assert counted == clocks


def test_of_calls_that_decide_the_same_the_last_one_is_made(paper: Scenario) -> None:
    made = QPController(paper.cell, paper.grasp, paper.path, dt=0.0075)
    made.reset(paper.q_start)
    made.step()

    def ask() -> None:
        for i in range(1000):
            made.pause()
            made.set_override(0.001 * i)
            made.run_to(0.1 + 0.0001 * i)
            made.resume()

    elsewhere(ask)
    made.step()
    assert [(name, value) for name, value, _ in made.take_events()] == [
        ("set_override", 0.999), ("run_to", 0.1 + 0.0999), ("resume", None),
    ]  # fmt: skip
    assert not made.paused


def test_calls_that_look_at_other_paths_are_made_one_a_step_in_order(paper: Scenario) -> None:
    made = QPController(paper.cell, paper.grasp, paper.path, dt=0.0075)
    made.reset(paper.q_start)
    for _ in range(20):
        made.step()
    aside = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.001]))

    def ask() -> None:
        made.run_to(1.0)
        made.set_override(0.9)
        made.shift_path(aside, over=0.1)
        made.pause()

    elsewhere(ask)
    calls = []
    for _ in range(3):
        made.step()
        calls.append([name for name, _, _ in made.take_events()])
    assert calls == [["run_to", "set_override"], ["shift_path", "pause"], []]


def short_of(path: Any) -> LinePath:
    """A path from where another begins, too short for what is asked along that one."""
    return LinePath.displaced(path.pose(0.0), translation=(0.0, 0.0, 0.01), duration=0.3)


#: Calls that are right when they are made, and where another one ahead of them leaves no place for them.
TOO_LATE: dict[str, tuple[Callable[[Any], object], Callable[[Any], object]]] = {
    "run_to": (lambda c: c.follow(short_of(c.path)), lambda c: c.run_to(0.9)),
    "reverse": (lambda c: c.follow(short_of(c.path)), lambda c: c.reverse(0.2)),
    "run_to ": (lambda c: c.follow(short_of(c.path)), lambda c: c.step_to_mark()),
    "shift_path": (lambda c: c.follow(ServoPath(c.path.pose(0.0))), lambda c: c.shift_path(pin.SE3.Identity())),
}


@pytest.mark.parametrize("said", TOO_LATE)
@pytest.mark.parametrize("forces", [False, True])
def test_what_cannot_be_done_where_a_call_takes_effect_is_an_event(said: str, forces: bool, paper: Scenario) -> None:
    cell = paper.cell.with_limits(acceleration=5.0)
    inner = QPController(cell, paper.grasp, paper.path, dt=0.0075)
    made: Any = ForceController(inner, {"stiffness": 1e5}) if forces else inner
    made.reset(paper.q_start)
    while inner.program_clock < 0.4:
        inner.step()
    elsewhere(lambda: [call(made) for call in TOO_LATE[said]])
    for _ in range(20):
        made.step()
    events = made.take_events()
    assert [name for name, _, _ in events] == ["follow", "refused"]
    assert events[1][1].startswith(f"{said.strip()}: InvalidInputError: ")


def test_a_program_is_not_shifted_without_end(paper: Scenario) -> None:
    """Shifts at one place are one; of those along the way there are so many, then they are refused by name."""
    cell = paper.cell.with_limits(acceleration=5.0)
    path = LinePath.displaced(paper.path.pose(0.0), translation=(0.0, 0.0, 0.05), duration=20.0)
    made = QPController(cell, paper.grasp, path, dt=0.0075)
    made.reset(paper.q_start)
    step = pin.SE3(np.eye(3), np.array([1e-5, 0.0, 0.0]))
    made.pause()
    for _ in range(300):
        made.shift_path(step)
    away = made.path.pose(20.0).translation - path.pose(20.0).translation
    np.testing.assert_allclose(away, [3e-3, 0.0, 0.0], atol=1e-9)
    made.resume()

    def on_and_on() -> None:
        for _ in range(300):
            made.step()
            made.step()
            made.shift_path(step)

    with pytest.raises(InvalidInputError, match="shifted 50 times"):
        on_and_on()
    assert made.step().explain()


def test_a_target_for_a_path_that_is_no_servo_path_any_more_is_an_event(paper: Scenario) -> None:
    made = QPController(paper.cell, paper.grasp, ServoPath(paper.path.pose(0.0)), dt=0.0075)
    made.reset(paper.q_start)
    made.step()
    elsewhere(lambda: [made.follow(paper.path), made.retarget(paper.path.pose(0.0))])
    made.step()
    events = made.take_events()
    assert [name for name, _, _ in events] == ["follow", "refused"]
    assert events[1][1].startswith("retarget: InvalidInputError: ")


@pytest.mark.parametrize("call", ["reverse", "run_to", "shift_path", "jog", "return_to_path", "forward"])
def test_a_users_path_that_fails_while_a_call_waits_raises_in_no_step(call: str, paper: Scenario) -> None:
    class Fails(Meeting):
        fails = False

        def pose(self, clock: float) -> pin.SE3:
            if self.fails:
                raise OSError("no more poses")
            return super().pose(clock)

    cell, path = paper.cell.with_limits(acceleration=5.0), Fails(paper.path)
    made = QPController(cell, paper.grasp, path, dt=0.0075)
    made.reset(paper.q_start)
    for _ in range(60):
        made.step()
    if call in ("return_to_path", "forward"):
        made.jog([0.0, 0.0, 0.02, 0.0, 0.0, 0.0], deadman_s=0.2)
        for _ in range(40):
            made.step()
    given: dict[str, tuple[Any, ...]] = {
        "reverse": (0.1,), "run_to": (0.5,), "shift_path": (pin.SE3.Identity(),), "jog": ([0.0] * 5 + [0.1],),
    }  # fmt: skip
    elsewhere(lambda: getattr(made, call)(*given.get(call, ())))
    made.step()
    path.fails = True
    steps = [made.step() for _ in range(40)]
    assert np.isfinite([s.q_next for s in steps]).all()


def test_bad_input_from_another_thread_is_refused_there(paper: Scenario) -> None:
    made = QPController(paper.cell, paper.grasp, paper.path, dt=0.0075)
    made.reset(paper.q_start)
    made.step()
    errors: list[type] = []

    def ask() -> None:
        for call in (lambda: made.set_override(2.0), lambda: made.retarget(np.eye(4)), lambda: made.follow(None)):
            try:
                call()  # type: ignore[no-untyped-call]
            except CoopqpError as error:
                errors.append(type(error))

    other = threading.Thread(target=ask)
    other.start()
    other.join(timeout=30)
    assert len(errors) == 3
    assert made.step().rate == 1.0


def test_a_step_that_waits_for_its_solver_is_not_disturbed(paper: Scenario) -> None:
    """The path is known, so that nothing but the solver is Python."""

    class Meets(type(make_solver("daqp"))):  # type: ignore[misc]
        meet: Callable[[], None] | None = None

        def solve(self, problem: Any) -> Any:
            if self.meet is not None:
                meet, self.meet = self.meet, None
                other = threading.Thread(target=meet)
                other.start()
                other.join(timeout=30)
            return super().solve(problem)

    def run(disturbed: bool) -> tuple[list[Any], list[type]]:
        solver, errors = Meets("daqp"), []
        options = {"solver": solver, "shortcut": False}
        made = QPController(paper.cell, paper.grasp, paper.path, dt=0.0075, options=options)
        made.reset(paper.q_start)

        def intrude() -> None:
            for call in (made.step, lambda: made.reset(paper.q_start)):
                try:
                    call()
                except Exception as error:
                    errors.append(type(error))

        steps = []
        for i in range(6):
            solver.meet = intrude if disturbed and i == 3 else None
            steps.append(made.step().q_next)
        return steps, errors

    alone, errors = run(disturbed=False)
    assert not errors
    steps, errors = run(disturbed=True)
    np.testing.assert_array_equal(steps, alone)
    assert errors == [BusyError, BusyError]


@pytest.mark.parametrize("name", sorted(CONTROLLERS))
def test_threads_may_take_turns(name: str, paper: Scenario) -> None:
    """One after the other, also after an error in the middle of a step."""
    kind, options = CONTROLLERS[name]
    made: Any = kind(paper.cell, paper.grasp, paper.path, dt=0.0075, options=options)
    made.reset(paper.q_start)
    made.step()
    found: list[Any] = []
    other = threading.Thread(target=lambda: found.append(made.step(np.full(3, np.nan))))
    other.start()
    other.join(timeout=30)
    assert len(found) == 1
    made.step()
    with pytest.raises(CoopqpError):
        made.reset(np.zeros(3))
    again = threading.Thread(target=lambda: found.append(made.step()))
    again.start()
    again.join(timeout=30)
    assert len(found) == 2


def test_the_error_travels() -> None:
    assert "Give each thread its own" in str(pickle.loads(pickle.dumps(BusyError())))


class Asking(Meeting):
    """A path that first calls the controller in which it runs."""

    asks: Callable[[], object] | None = None

    def pose(self, clock: float) -> pin.SE3:
        if self.asks is not None:
            asks, self.asks = self.asks, None
            asks()
        return super().pose(clock)


@pytest.mark.parametrize("name", sorted(CONTROLLERS))
def test_a_call_within_a_call_lets_no_other_thread_in(name: str, paper: Scenario) -> None:
    kind, options = CONTROLLERS[name]
    path, outcomes = Asking(paper.path), []
    made: Any = kind(paper.cell, paper.grasp, path, dt=0.0075, options=options)
    made.reset(paper.q_start)

    def intrude() -> None:
        try:
            made.step()
            outcomes.append(None)
        except Exception as error:
            outcomes.append(type(error))

    path.asks, path.meet = lambda: copy.copy(made), intrude
    made.step()
    assert outcomes == [BusyError]
    other = threading.Thread(target=intrude)  # nobody works there now
    other.start()
    other.join(timeout=30)
    assert outcomes == [BusyError, None]
