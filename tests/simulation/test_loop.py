"""The control loop with a controller that follows a script: when a run ends, and what its recording says of it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from cells import cart

from coopqp import (
    BindingLimit,
    ControlStep,
    Grasp,
    InvalidInputError,
    LimitKind,
    LinePath,
    Recording,
    RobotCell,
    Status,
    simulate,
)
from coopqp.paths.grasp_motion import GraspMotion, GraspPiece
from coopqp.simulation import KinematicPlant
from coopqp.simulation.simulate import begin, refuse_for_plant
from coopqp.spatial import Array

DT = 0.125


def at(*p: float) -> pin.SE3:
    return pin.SE3(np.eye(3), np.array(p))


CELL = RobotCell([cart("left"), cart("right", T_world_base=at(0.0, 1.0, 0.0))])
GRASP = Grasp((at(0.0, -0.5, 0.0), at(0.0, 0.5, 0.0)))
START = CELL.configuration(np.zeros(4))
T, S, B, H, F, P, O, J, W = (
    Status.TRACKING, Status.SLOWED, Status.BLOCKED, Status.HOLDING, Status.FAULT, Status.PAUSED, Status.OFF_PATH,
    Status.JOGGING, Status.WAITING,
)  # fmt: skip


def line(duration: float = 1.0) -> LinePath:
    return LinePath(at(0.0, 0.5, 0.0), at(1.0, 0.5, 0.0), duration=duration, time_law="linear")


class Scripted:
    """A controller whose steps have statuses in order, the last one for ever; its clock advances as it tracks."""

    def __init__(self, statuses: Sequence[Status] = (T,), path: Any = None, rate: float = 1.0, **more: Any) -> None:
        self.cell, self.grasp, self.dt, self.path = CELL, GRASP, DT, line() if path is None else path
        self._statuses, self._rate, self._more = list(statuses), rate, more
        self.heard: list[Any] = []
        self.started: list[Array] = []

    def reset(self, q: Any) -> None:
        self.started.append(np.array(q))
        self.q, self.clock, self.done = np.array(q), 0.0, 0

    def step(self, q_measured: Any = None, *, dt: float | None = None, wrenches: Any = None) -> ControlStep:
        self.heard.append(wrenches)
        status = self._statuses[min(self.done, len(self._statuses) - 1)]
        moves = status in (T, S) and self.clock < self.path.duration - 1e-12
        clock = min(self.clock + DT * moves, self.path.duration)
        v = np.array([0.1, 0.0, 0.1, 0.0]) * moves
        q_next = np.asarray(pin.integrate(CELL.model, self.q, v * DT))
        binding = self._more.get("bindings", {}).get(self.done, ())
        made = ControlStep(
            cell=CELL, grasp=GRASP, path=self.path, q=self.q, q_next=q_next, velocity=v, dt=DT, clock=self.clock,
            clock_next=clock, rate=self._rate * moves if status is not O else self._rate, status=status,
            binding=binding,
        )  # fmt: skip
        self.q, self.clock, self.done = q_next, clock, self.done + 1
        return made


def steps_of(statuses: Sequence[Status], rate: float = 1.0, **options: Any) -> int:
    return simulate(Scripted(statuses, rate=rate), q_start=START, **options).n_steps


def test_a_run_ends_with_its_path_and_what_it_is_to_settle() -> None:
    for settle, steps in ((0.0, 8), (0.125, 9), (0.3, 11)):
        made = simulate(Scripted(), q_start=START, settle=settle)
        assert (made.n_steps, made.finished) == (steps, True)
        assert made.metadata["settle"] == settle
    totals: list[tuple[int, int]] = []
    simulate(Scripted(), q_start=START, settle=0.5, progress=lambda *seen: totals.append(seen))
    assert totals == [(k + 1, 12) for k in range(12)]
    assert simulate(Scripted([P]), q_start=START).time[-1] == pytest.approx(10.0), "ten times the path by default"
    assert simulate(Scripted([P]), q_start=START).metadata["longest"] == 10.0
    assert steps_of([T], duration=0.35) == 3
    assert steps_of([T], duration=0.25) == 2


@pytest.mark.parametrize(
    ("status", "rate", "ends"),
    [(B, 1.0, True), (H, 1.0, True), (F, 1.0, True), (O, 0.0, True), (O, 1e-3, False), (P, 1.0, False), (J, 1.0, False),
     (W, 1.0, False)],
)  # fmt: skip
def test_an_object_that_stands_without_its_operator_s_will_ends_the_run(
    status: Status, rate: float, ends: bool
) -> None:
    """After a second by default; after what is told, from the beginning of the standstill; never without patience."""
    most = 50
    for patience, expected in ((1.0, 11), (0.35, 6), (None, most)):
        found = steps_of([T, T, T, status], rate, duration=most * DT, patience=patience)
        assert found == (expected if ends else most)
    assert steps_of([T, T, T, status], rate, duration=most * DT) == (11 if ends else most)
    again = [T, *[status] * 5, T, *[status] * 5, T, status]
    assert steps_of(again, rate, duration=most * DT, patience=0.7) == (19 if ends else most), "it counts anew"


def test_things_that_are_no_controller_or_plant_are_named() -> None:
    other: Any = 3
    kind: Any = Scripted
    cases: tuple[tuple[Any, Any, str], ...] = (
        (kind, None, "simulate: controller: the class Scripted itself.*reset and step"),
        (other, None, "simulate: controller: a int.*reset and step"),
        (Scripted(), KinematicPlant, "simulate: plant: the class KinematicPlant itself.*reset and apply"),
        (Scripted(), other, "simulate: plant: a int.*reset and apply"),
        (Scripted(), Scripted(), "simulate: plant: a Scripted.*reset and apply"),
    )
    for controller, plant, said in cases:
        with pytest.raises(InvalidInputError, match=said):
            simulate(controller, plant, q_start=START)


def test_failures_and_changes_of_limits_are_recorded_by_their_steps() -> None:
    rail = BindingLimit("left", "rail", LimitKind.VELOCITY)
    post = BindingLimit("left", "", LimitKind.COLLISION, between=("object", "post"))
    mine = BindingLimit("right", "table", LimitKind.CONSTRAINT, name="my own")
    made = Scripted([T, S, S, H, F, S, T], bindings={1: (rail,), 2: (rail,), 5: (post, mine), 6: (mine,)})
    run = simulate(made, q_start=START)
    assert run.metadata["failures"] == 2
    assert run.bindings[:8] == [(), (rail,), (rail,), (), (), (post, mine), (mine,), ()]
    assert run.metadata["binding"][0] == [1, [["left", "rail", "velocity"]]]
    assert [step for step, _ in run.metadata["binding"]] == [1, 3, 5, 6, 7]
    assert run.statuses[:7] == [T, S, S, H, F, S, T]
    assert [note.partition(":")[0] for note in run.notes] == ["1", "3", "4", "5", "6", "7"]


def test_the_recording_says_with_what_it_was_made() -> None:
    run = simulate(Scripted(), q_start=START, metadata={"mine": [1, 2], "plant": "another"})
    told = run.metadata
    assert (told["controller"], told["plant"], told["gripped"], told["dt"]) == ("Scripted", "another", False, DT)
    assert (told["duration"], told["mine"], told["begun"]) == (1.0, [1, 2], {"override": 1.0, "paused": False})
    assert (told["calls"], told["finished"], told["failures"]) == ([], True, 0)
    assert (told["arms"], told["joints"]) == (["left", "right"], list(CELL.joint_names))
    assert "phases" not in told
    assert (run.shift, run.wrenches, run.torques) == (None, None, None)
    np.testing.assert_allclose(run.reference[3], line().pose(0.375).homogeneous)
    np.testing.assert_allclose(run.q_command[:, 0], 0.0125 * np.arange(9))


class Felt:
    """A plant with wrenches and noisy encoders: it holds the object."""

    gripped = True

    def __init__(self) -> None:
        self.q, self.readings = START, 0

    def reset(self, q: Any) -> Any:
        self.q, self.readings = np.array(q), 0
        return CELL.configuration([0.5, 0.0, 0.0, 0.0])

    def measure(self) -> Any:
        self.readings += 1
        return CELL.configuration([0.5 if self.readings % 2 == 0 else 0.1, 0.0, 0.0, 0.0])

    def apply(self, step: ControlStep) -> Any:
        self.q = step.q_next
        return self.q

    def measured_wrenches(self) -> Array:
        return np.full((2, 6), float(self.q[0]))

    def sensed_wrenches(self) -> Array:
        return np.full((2, 6), 7.0 + float(self.q[0]))

    @property
    def joint_torques(self) -> Array:
        return np.arange(4.0) + float(self.q[0])


def test_a_run_begins_at_the_mean_of_a_hundred_readings_at_rest() -> None:
    """Half of them 0.5 m, half 0.1 m."""
    controller, plant = Scripted(), Felt()
    measured = begin(controller, plant, START)
    assert plant.readings == 99
    assert measured[0] == 0.5
    assert controller.started[0][0] == pytest.approx(0.3)


def test_wrenches_go_to_a_controller_that_needs_them_and_loads_into_the_recording() -> None:
    controller = Scripted()
    run = simulate(controller, Felt(), q_start=START, loads=True)
    assert controller.heard == [None] * 8
    assert run.wrenches is not None
    assert run.torques is not None
    np.testing.assert_allclose(run.wrenches[:, 1, 5], 7.0 + run.q_command[1:, 0])
    np.testing.assert_allclose(run.torques[:, 3], 3.0 + run.q_command[1:, 0])
    assert run.metadata["gripped"] is True
    needs: Any = Scripted()
    needs.needs_wrenches = True
    without = simulate(needs, Felt(), q_start=START)
    assert without.wrenches is None
    assert [w[0, 0] for w in needs.heard] == pytest.approx([0.0, *without.q_command[1:-1, 0]])
    with pytest.raises(InvalidInputError, match="a KinematicPlant has no force sensors"):
        simulate(needs, q_start=START)
    with pytest.raises(InvalidInputError, match="a KinematicPlant has no forces"):
        simulate(Scripted(), q_start=START, loads=True)
    needs.needs_servos = True
    torques: Any = Felt()
    simulate(needs, torques, q_start=START)
    torques.servoed = False
    with pytest.raises(InvalidInputError, match="not by torque-controlled drives"):
        simulate(needs, torques, q_start=START)


# -- grasps that move or give way --------------------------------------------------------------------------------------


def sliding() -> LinePath:
    """The right tool slides back by 0.2 m/s on the object, which both hold."""
    slide = LinePath(at(0.0, 0.0, 0.0), at(-0.2, 0.0, 0.0), duration=1.0, time_law="linear")
    piece = GraspPiece(pin.SE3.Identity(), pin.SE3.Identity(), np.asarray(slide.packed())[3:])
    path = line()
    path.grasps = GraspMotion(((), (piece,)), ((0.0, (True, True)),))
    return path


def test_where_the_tools_are_on_the_object_is_recorded() -> None:
    """As the program moves them; with what gives way on top; and zero where a controller only may give way."""
    expected = np.zeros((8, 2, 6))
    expected[:, 1, 0] = -0.025 * np.arange(1, 9)
    np.testing.assert_allclose(moved(Scripted(path=sliding())), expected, atol=1e-12)
    both: Any = Scripted(path=sliding())
    both.shift = np.zeros((2, 6))
    both.shift[:, 1] = [0.3, 0.5]
    expected[:, :, 1] = [0.3, 0.5]
    np.testing.assert_allclose(moved(both), expected, atol=1e-12)
    alone: Any = Scripted()
    alone.shift = both.shift
    np.testing.assert_allclose(moved(alone), np.broadcast_to(both.shift, (8, 2, 6)))


def moved(controller: Any) -> Array:
    run: Recording = simulate(controller, q_start=START)
    assert run.shift is not None
    held = [X.translation for X in run.grasps_at(5)]
    np.testing.assert_allclose(
        held, [X.translation + d[:3] for X, d in zip(GRASP.T_object_tool, run.shift[4], strict=True)]
    )
    return np.asarray(run.shift)


def test_where_a_run_goes_on_along_a_path_that_moves_no_tool_no_motion_is_recorded() -> None:
    class Turned(Scripted):
        def step(self, *given: Any, **more: Any) -> ControlStep:
            made = super().step(*given, **more)
            return made if self.done <= 4 else made.replaced(path=line())

    run = simulate(Turned(path=sliding()), q_start=START)
    assert run.shift is not None
    np.testing.assert_allclose(run.shift[:, 1, 0], [-0.025, -0.05, -0.075, -0.1, 0.0, 0.0, 0.0, 0.0], atol=1e-12)


class Gripping:
    """A plant with grips that stay closed, or follow a program's contact."""

    def __init__(self, follows: bool) -> None:
        self.grasp, self.follows_contact = GRASP, follows


def test_paths_that_a_plant_s_grips_cannot_follow_are_refused() -> None:
    refuse_for_plant(sliding(), KinematicPlant(CELL))
    refuse_for_plant(sliding(), Felt())
    for follows in (True, False):
        refuse_for_plant(line(), Gripping(follows))
    with pytest.raises(InvalidInputError, match="moves on the object while it holds it, and the object is rigid"):
        refuse_for_plant(sliding(), Gripping(True))
    with pytest.raises(InvalidInputError, match="the grips of this one stay closed"):
        refuse_for_plant(sliding(), Gripping(False))
    lets_go = line()
    lets_go.grasps = GraspMotion(((), ()), ((0.0, (True, True)), (0.5, (True, False))))
    refuse_for_plant(lets_go, Gripping(True))
    with pytest.raises(InvalidInputError, match="stay closed"):
        refuse_for_plant(lets_go, Gripping(False))
