from . import (
    baselines as baselines,
)
from . import (
    collision as collision,
)
from . import (
    control as control,
)
from . import (
    errors as errors,
)
from . import (
    files as files,
)
from . import (
    forces as forces,
)
from . import (
    model as model,
)
from . import (
    native as native,
)
from . import (
    output as output,
)
from . import (
    paths as paths,
)
from . import (
    planning as planning,
)
from . import (
    scenarios as scenarios,
)
from . import (
    simulation as simulation,
)
from . import (
    solvers as solvers,
)
from . import (
    spatial as spatial,
)
from . import (
    studies as studies,
)
from . import (
    visualization as visualization,
)
from .collision.clearance import Clearance as Clearance
from .collision.scene import CollisionScene as CollisionScene
from .constraints.cause import Cause as Cause
from .constraints.rate import Knot as Knot
from .constraints.rate import RateBound as RateBound
from .constraints.velocity import Rank as Rank
from .constraints.velocity import VelocityConstraint as VelocityConstraint
from .control.interface import ControlStep as ControlStep
from .control.interface import Status as Status
from .control.lookahead.options import PreviewOptions as PreviewOptions
from .control.monitoring.options import SupervisionOptions as SupervisionOptions
from .control.options import QPOptions as QPOptions
from .control.qp import QPController as QPController
from .errors import CoopqpError as CoopqpError
from .errors import InvalidInputError as InvalidInputError
from .files.cellfile import load_cell_file as load_cell_file
from .forces.force_controller import ForceController as ForceController
from .forces.force_options import ForceOptions as ForceOptions
from .model.cell import Arm as Arm
from .model.cell import JointLimits as JointLimits
from .model.cell import RobotCell as RobotCell
from .model.common_error import CommonError as CommonError
from .model.grasp import Grasp as Grasp
from .model.inverse_kinematics import inverse_kinematics as inverse_kinematics
from .model.limits import BindingLimit as BindingLimit
from .model.limits import LimitKind as LimitKind
from .model.posture import PostureOptions as PostureOptions
from .paths.path import (
    HoldPath as HoldPath,
)
from .paths.path import (
    LinePath as LinePath,
)
from .paths.path import (
    ObjectPath as ObjectPath,
)
from .paths.path import (
    WaypointPath as WaypointPath,
)
from .paths.servo import ServoPath as ServoPath
from .paths.timed import TimedPath as TimedPath
from .planning.check import check_path as check_path
from .planning.planner import plan as plan
from .planning.starts import find_start as find_start
from .simulation.recording.recording import Recording as Recording
from .simulation.simulate import simulate as simulate

__version__: str
