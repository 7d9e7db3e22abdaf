from .bag_recorder import BagRecorder as BagRecorder
from .commissioning import commission_sensors_by_drivers as commission_sensors_by_drivers
from .driver import (
    Bodies as Bodies,
    Command as Command,
    Condition as Condition,
    DriverError as DriverError,
    LoopRecorder as LoopRecorder,
    RobotDriver as RobotDriver,
    RobotState as RobotState,
)
from .engine import EngineCell as EngineCell, EngineRobot as EngineRobot
from .franka import FrankaDriver as FrankaDriver, FrankaOptions as FrankaOptions
from .loop import ControlLoop as ControlLoop
from .options import LoopOptions as LoopOptions
from .real_time import RealTimeRun as RealTimeRun
from .recorder import MemoryRecorder as MemoryRecorder
from .report import LoopReport as LoopReport
from .ros2 import Ros2Driver as Ros2Driver, Ros2Options as Ros2Options
from .ros2_board import Ros2Board as Ros2Board, Ros2BoardOptions as Ros2BoardOptions
from .sim import SimDriver as SimDriver, SimOptions as SimOptions
from .simulated import ServoModel as ServoModel, SimulatedRobot as SimulatedRobot
from .timing import LoopTime as LoopTime, ManualTime as ManualTime, MonotonicTime as MonotonicTime
from .ur import UrDriver as UrDriver, UrOptions as UrOptions
