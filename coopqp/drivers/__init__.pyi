from .driver import (
    Command as Command,
    Condition as Condition,
    DriverError as DriverError,
    RobotDriver as RobotDriver,
    RobotState as RobotState,
)
from .loop import ControlLoop as ControlLoop, LoopRecorder as LoopRecorder
from .options import LoopOptions as LoopOptions
from .report import LoopReport as LoopReport
from .simulated import ServoModel as ServoModel, SimulatedRobot as SimulatedRobot
from .timing import LoopTime as LoopTime, ManualTime as ManualTime, MonotonicTime as MonotonicTime
