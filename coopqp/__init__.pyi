from . import (
    baselines as baselines,
    collision as collision,
    control as control,
    drivers as drivers,
    errors as errors,
    files as files,
    forces as forces,
    model as model,
    output as output,
    paths as paths,
    planning as planning,
    programs as programs,
    scenarios as scenarios,
    simulation as simulation,
    solvers as solvers,
    spatial as spatial,
    studies as studies,
    visualization as visualization,
)
from .collision.clearance import Clearance as Clearance
from .collision.scene import CollisionScene as CollisionScene
from .constraints.cause import Cause as Cause
from .constraints.rate import Knot as Knot, RateBound as RateBound
from .constraints.velocity import Rank as Rank, VelocityConstraint as VelocityConstraint
from .control.interface import ControlStep as ControlStep, Status as Status
from .control.lookahead.options import PreviewOptions as PreviewOptions
from .control.monitoring.options import SupervisionOptions as SupervisionOptions
from .control.options import QPOptions as QPOptions
from .control.qp import QPController as QPController
from .errors import CoopqpError as CoopqpError, InvalidInputError as InvalidInputError
from .files.cellfile import load_cell_file as load_cell_file
from .forces.force_controller import ForceController as ForceController
from .forces.force_options import ForceOptions as ForceOptions
from .model.cell import Arm as Arm, JointLimits as JointLimits, Robot as Robot, RobotCell as RobotCell
from .model.common_error import CommonError as CommonError
from .model.grasp import Grasp as Grasp
from .model.inverse_kinematics import inverse_kinematics as inverse_kinematics
from .model.limits import BindingLimit as BindingLimit, LimitKind as LimitKind
from .model.posture import PostureOptions as PostureOptions
from .paths.path import (
    HoldPath as HoldPath,
    LinePath as LinePath,
    ObjectPath as ObjectPath,
    WaypointPath as WaypointPath,
)
from .paths.servo import ServoPath as ServoPath
from .paths.timed import TimedPath as TimedPath
from .planning.check import check_path as check_path
from .planning.planner import plan as plan
from .planning.route.finding import find_path as find_path
from .planning.route.replanner import Replanner as Replanner
from .planning.starts import find_start as find_start
from .programs.program import Phase as Phase, Program as Program
from .simulation.recording.recording import Recording as Recording
from .simulation.simulate import simulate as simulate

__version__: str
