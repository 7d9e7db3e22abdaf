from .geometry import MotionBounds as MotionBounds, PathGeometry as PathGeometry, Piece as Piece
from .joint_path import JointPath as JointPath
from .path import (
    HoldPath as HoldPath,
    LinePath as LinePath,
    ObjectPath as ObjectPath,
    WaypointPath as WaypointPath,
)
from .section import Section as Section
from .servo import ServoPath as ServoPath
from .shifted import ShiftedPath as ShiftedPath
from .time_law import TimeLaw as TimeLaw
from .timed import SpeedProfile as SpeedProfile, TimedPath as TimedPath
