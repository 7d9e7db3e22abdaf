"""Gripped arms in the engine, wrenches to a force controller, and bodies that move by themselves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from coopqp import Clearance, CollisionScene, ForceController, InvalidInputError, QPController
from coopqp.drivers import ControlLoop, EngineCell, ManualTime, MemoryRecorder
from coopqp.forces import ForceOptions
from coopqp.model.shapes import Body, Sphere
from coopqp.scenarios import dual_arm7, paper_lift
from coopqp.simulation.engine import box_payload

pytestmark = pytest.mark.filterwarnings("ignore::coopqp.errors.StiffnessWarning")
_DT = 0.002


@pytest.fixture(scope="module")
def bar():
    scenario = dual_arm7(duration=0.8)
    return replace(scenario, cell=scenario.cell.with_limits(acceleration=15.0))


@pytest.fixture
def engine(bar):
    pytest.importorskip("mujoco")
    from coopqp.simulation import PhysicsPlant

    time = ManualTime()
    made = EngineCell(PhysicsPlant.of(bar), bar.q_start, time=time, period=_DT, lags=(0.0, 0.02))
    return made, time


@pytest.mark.slow
def test_a_gripped_arm_that_stops_and_goes_on_leaves_no_force(bar, engine):
    cell, time = engine
    robots = cell.robots()
    name = next(iter(robots))
    events = [(0.4, robots[name].servo.halt), (1.6, robots[name].servo.release), (1.8, lambda: loop.resume())]
    began = []

    class Recorder:
        def take(self, moment, measured, sent, step, clock):
            began.append(moment)
            while events and moment - began[0] >= events[0][0]:
                events.pop(0)[1]()

    loop = ControlLoop(
        QPController(bar.cell, bar.grasp, bar.path, dt=_DT), robots, recorder=Recorder(), time=time
    )  # fmt: skip
    report = loop.run()
    assert report.finished, report.reason
    assert report.stops == 1
    times, forces = np.array(cell.times) - began[0], np.array(cell.forces)
    rest = forces[-1]
    stands = (times > 1.2) & (times < 1.6)
    assert np.abs(forces[stands] - rest).max() <= 20.0
    assert report.acceleration <= 1.0 + 1e-9


@pytest.mark.slow
def test_a_force_controller_gets_the_robots_wrenches(bar, engine):
    cell, time = engine
    controller = ForceController(
        QPController(bar.cell, bar.grasp, bar.path, dt=_DT),
        ForceOptions(stiffness=cell.plant.stiffness, payload=box_payload(bar), presses=False),
    )
    report = ControlLoop(controller, cell.robots(), time=time).run()
    assert report.finished, report.reason
    assert report.largest_force == pytest.approx(float(np.array(cell.forces).max()), rel=0.2)


@pytest.mark.slow
def test_a_force_controller_without_wrenches_is_refused(bar, engine):
    cell, time = engine
    robots = cell.robots()
    robot = next(iter(robots.values()))
    read = robot.read
    robot.read = lambda: None if (state := read()) is None else replace(state, wrench=None)
    controller = ForceController(
        QPController(bar.cell, bar.grasp, bar.path, dt=_DT), ForceOptions(stiffness=cell.plant.stiffness)
    )
    said = ControlLoop(controller, robots, time=time).refused()
    assert len(said) == 1
    assert "tells no wrench" in said[0]


def test_bodies_reach_the_clearance_where_they_are_now():
    from robots import simulated_robots

    lift = paper_lift(time_law="quintic", duration=1.5)
    lift = replace(lift, cell=lift.cell.with_limits(acceleration=10.0))
    time = ManualTime()
    far = pin.SE3(np.eye(3), np.array([5.0, 0.0, 0.0]))
    scene = CollisionScene.of(lift, moving=[Body("cart", Sphere(0.1), far)])
    clearance = Clearance(scene)
    told = []
    clearance.move = lambda name, T, twist: told.append((time.now(), name, np.array(T.translation), np.array(twist)))

    class Camera:
        """Sees the cart 20 ms late; later not at all."""

        def read(self):
            stamp = min(time.now() - 0.02, 0.5)
            x = np.array([5.0 + 0.3 * stamp, 0.0, 0.0])
            return [("cart", pin.SE3(np.eye(3), x), (0.3, 0.0, 0.0, 0.0, 0.0, 0.0), stamp)]

    controller = QPController(lift.cell, lift.grasp, lift.path, dt=_DT, constraints=[clearance])
    robots = simulated_robots(lift.cell, lift.q_start, time, (0.0,) * 3)
    loop = ControlLoop(controller, robots, bodies=Camera(), time=time)
    report = loop.run()
    assert report.periods > 300
    assert len(told) > 200
    for now, name, x, twist in told:
        assert name == "cart"
        assert x[0] == pytest.approx(5.0 + 0.3 * now, abs=1e-9)
        assert twist[0] == 0.3
    assert told[-1][0] <= 0.5 + 0.1 + _DT  # too old after that: nothing is told
    plain = QPController(lift.cell, lift.grasp, lift.path, dt=_DT)
    with pytest.raises(InvalidInputError, match="without a Clearance"):
        ControlLoop(plain, robots, bodies=Camera(), time=time)


def test_a_run_on_robots_is_a_recording():
    from robots import simulated_robots

    lift = paper_lift(time_law="quintic", duration=0.6)
    cell = lift.cell.with_limits(acceleration=20.0)
    time = ManualTime()
    controller = QPController(cell, lift.grasp, lift.path, dt=_DT)
    recorder = MemoryRecorder(controller)
    robots = simulated_robots(cell, lift.q_start, time, (0.01, 0.0, 0.02))
    assert ControlLoop(controller, robots, recorder=recorder, time=time).run().finished
    run = recorder.recording({"scenario": "lift"})
    assert run.metadata["finished"]
    assert run.metadata["plant"] == "robots"
    assert (np.diff(run.time) > 0.0).all()
    assert run.clock[-1] == pytest.approx(lift.path.duration, abs=0.01)
    assert np.abs(run.q[-1] - run.q_command[-1]).max() < 1e-4
