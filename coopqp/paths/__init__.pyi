from .geometry import MotionBounds as MotionBounds, PathGeometry as PathGeometry, Piece as Piece
from .path import (
    HoldPath as HoldPath,
    LinePath as LinePath,
    ObjectPath as ObjectPath,
    TimeLaw as TimeLaw,
    WaypointPath as WaypointPath,
)
from .servo import ServoPath as ServoPath
from .timed import SpeedProfile as SpeedProfile, TimedPath as TimedPath
