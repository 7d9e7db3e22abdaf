"""Examples of the classes of this page: each section is shown at the classes that it names; all are run by a test."""

# %% before
import numpy as np

from coopqp import QPController
from coopqp.scenarios import dual_arm7

task = dual_arm7(duration=0.6)
cell = task.cell.with_limits(acceleration=15.0)
x = cell.positions(task.q_start)
joints = {arm: [name.partition("/")[2] for name in cell.joint_names[own]] for arm, own in cell.blocks.items()}


def controller():
    return QPController(cell, task.grasp, task.path, dt=0.002)


# %% coopqp.drivers.RealTimeRun
from coopqp.drivers import ManualTime, RealTimeRun

live = RealTimeRun(controller(), task.q_start, time=ManualTime())
live.run(lambda step: live.stop() if live.steps > 50 else None)  # calls of other threads act between two steps

# %% coopqp.drivers.LoopTime, coopqp.drivers.ManualTime, coopqp.drivers.MonotonicTime
from coopqp.drivers import MonotonicTime

time = ManualTime()  # goes on when it is waited for; robots need MonotonicTime()
time.sleep_until(1.0)
assert time.now() == 1.0
assert MonotonicTime().now() > 0.0

# %% coopqp.drivers.SimulatedRobot, coopqp.drivers.ServoModel
from coopqp.drivers import SimulatedRobot

robots = {arm: SimulatedRobot(joints[arm], x[own], time=time, lag=0.02) for arm, own in cell.blocks.items()}
robots["left"].servo.limit(3.0)  # its servo goes no faster [rad/s]

# %% coopqp.drivers.RobotState, coopqp.drivers.Condition
from coopqp.drivers import Condition

robots["left"].connect()
state = robots["left"].read()
assert state.condition is Condition.RUNNING
assert np.allclose(state.q, x[cell.blocks["left"]])

# %% coopqp.drivers.ControlLoop, coopqp.drivers.LoopReport
from coopqp.drivers import ControlLoop

report = ControlLoop(controller(), robots, time=time).run()
print(report.reason, f"{report.time:.2f} s, arms apart by at most {1e3 * report.apart:.2f} mm")

# %% coopqp.drivers.LoopOptions
from coopqp.drivers import LoopOptions

patient = LoopOptions(gone_after=0.2, start_tolerance=0.01)


# %% coopqp.drivers.LoopRecorder
class Last:
    """A recorder of one's own: gets each period of the loop."""

    def take(self, moment, measured, sent, step, clock):
        self.clock = clock


# %% coopqp.drivers.MemoryRecorder
from coopqp.drivers import MemoryRecorder

lead = controller()
memory = MemoryRecorder(lead)
loop = ControlLoop(lead, {a: SimulatedRobot(joints[a], x[o], time=time) for a, o in cell.blocks.items()},
                   recorder=memory, time=time)  # fmt: skip
loop.run()
run = memory.recording({"name": "a drive"})

# %% coopqp.drivers.RobotDriver, coopqp.drivers.Command
from coopqp.drivers import Command, RobotState


class MyDriver:
    """A driver of one's own; here the robot is where it is told to be."""

    period, lag, delay, commands = 0.002, 0.0, 0.0, "position"

    def __init__(self, joint_names, q):
        self.joint_names, self.q = tuple(joint_names), np.asarray(q)

    def connect(self):
        pass

    def read(self):
        return RobotState(self.q, np.zeros_like(self.q), time.now())

    def send(self, command):
        self.q = command.q

    def stop(self):
        pass


mine = MyDriver(joints["left"], x[cell.blocks["left"]])
mine.send(Command(mine.q + 0.001, np.zeros(7), time.now()))

# %% coopqp.drivers.SimDriver, coopqp.drivers.SimOptions
from coopqp.drivers import SimDriver, SimOptions

late = SimDriver(joints["left"], x[cell.blocks["left"]], SimOptions(lag=0.02, latency=0.004))  # on the machine's time
late.close()

# %% coopqp.drivers.BagRecorder
from coopqp.drivers import BagRecorder

bag = BagRecorder(cell.joint_names, "out/bag")  # ControlLoop(…, recorder=bag)
bag.close()

# %% coopqp.drivers.UrOptions, coopqp.drivers.UrDriver
from coopqp.drivers import UrOptions

ur = UrOptions(address="192.168.0.10", lookahead=0.05)  # UrDriver(joint_names, ur) takes them: extra ur

# %% coopqp.drivers.FrankaOptions, coopqp.drivers.FrankaDriver
from coopqp.drivers import FrankaOptions

franka = FrankaOptions(address="172.16.0.2")  # FrankaDriver(joint_names, franka): extra franka

# %% coopqp.drivers.Ros2Options, coopqp.drivers.Ros2Driver
from coopqp.drivers import Ros2Options

ros2 = Ros2Options(command_topic="/arm_controller/joint_trajectory")  # Ros2Driver(joint_names, ros2): extra ros2


# %% coopqp.drivers.Bodies
class Cart:
    """Bodies that move, as a camera sees them: name, placement, twist, stamp on the loop's clock."""

    def read(self):
        placement = np.eye(4)
        placement[0, 3] = 2.0
        return [("cart", placement, np.zeros(6), time.now())]


cart = Cart()  # ControlLoop(…, bodies=cart), where the controller has a Clearance of a scene with moving bodies


# %% coopqp.drivers.EngineCell, coopqp.drivers.EngineRobot
from coopqp.drivers import EngineCell
from coopqp.scenarios import paper_lift
from coopqp.simulation import PhysicsPlant

lift = paper_lift(time_law="quintic")
engine = EngineCell(PhysicsPlant.of(lift), lift.q_start, time=time, period=0.002, lags=(0.01, 0.01, 0.01))
in_engine = engine.robots()  # drivers of arms in the physics engine, for a ControlLoop

# %% coopqp.drivers.Ros2BoardOptions, coopqp.drivers.Ros2Board
from coopqp.drivers import Ros2BoardOptions

topics = Ros2BoardOptions(target_topic="/hand", frame="world")  # Ros2Board(loop, "lift", topics): extra ros2
