from .cell import Arm as Arm, JointLimits as JointLimits, Robot as Robot, RobotCell as RobotCell
from .chain import Chain as Chain
from .common_error import CommonError as CommonError
from .free_directions import FreedCell as FreedCell, freed_cell as freed_cell, refuse_loose as refuse_loose
from .grasp import (
    Free as Free,
    Grasp as Grasp,
    plate_from_centroid as plate_from_centroid,
    plate_from_points as plate_from_points,
)
from .inverse_kinematics import inverse_kinematics as inverse_kinematics
from .limits import BindingLimit as BindingLimit, LimitKind as LimitKind
from .posture import PostureOptions as PostureOptions
from .state import CellState as CellState
