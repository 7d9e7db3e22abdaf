from .geometry import MotionBounds as MotionBounds
from .geometry import PathGeometry as PathGeometry
from .geometry import Piece as Piece
from .path import (
    HoldPath as HoldPath,
)
from .path import (
    LinePath as LinePath,
)
from .path import (
    ObjectPath as ObjectPath,
)
from .path import (
    TimeLaw as TimeLaw,
)
from .path import (
    WaypointPath as WaypointPath,
)
from .servo import ServoPath as ServoPath
from .timed import SpeedProfile as SpeedProfile
from .timed import TimedPath as TimedPath
