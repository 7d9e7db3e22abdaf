from .engine import engine_controller as engine_controller
from .engine import engine_plant as engine_plant
from .engine import run_in_engine as run_in_engine
from .evaluation.assessment import Finding as Finding
from .evaluation.assessment import Tolerances as Tolerances
from .evaluation.assessment import judge as judge
from .evaluation.calibration_runs import calibrate_runs as calibrate_runs
from .evaluation.closeness import Closeness as Closeness
from .evaluation.closeness import Closest as Closest
from .evaluation.metrics import (
    chain_error as chain_error,
)
from .evaluation.metrics import (
    limit_excess as limit_excess,
)
from .evaluation.metrics import (
    object_error as object_error,
)
from .evaluation.metrics import (
    path_error as path_error,
)
from .evaluation.metrics import (
    relative_orientation_error as relative_orientation_error,
)
from .evaluation.metrics import (
    relative_positioning_error as relative_positioning_error,
)
from .evaluation.metrics import (
    tool_placements as tool_placements,
)
from .evaluation.monitor import Monitor as Monitor
from .evaluation.monitor import check_run as check_run
from .evaluation.monitored import Monitored as Monitored
from .evaluation.readings import Readings as Readings
from .evaluation.readings import read_run as read_run
from .evaluation.violations import (
    Breach as Breach,
)
from .evaluation.violations import (
    Verdict as Verdict,
)
from .evaluation.violations import (
    Violation as Violation,
)
from .evaluation.wrench_bounds import WrenchBounds as WrenchBounds
from .evaluation.wrenches import RunLoads as RunLoads
from .evaluation.wrenches import read_loads as read_loads
from .plants.disturbances import Disturbances as Disturbances
from .plants.disturbances import misplaced as misplaced
from .plants.disturbed import DisturbedPlant as DisturbedPlant
from .plants.kinematic import KinematicPlant as KinematicPlant
from .plants.kinematic import Plant as Plant
from .plants.physics import PhysicsError as PhysicsError
from .plants.physics import PhysicsPlant as PhysicsPlant
from .plants.physics_options import Interpolation as Interpolation
from .plants.physics_options import PhysicsOptions as PhysicsOptions
from .plants.replay import (
    Motion as Motion,
)
from .plants.replay import (
    Replay as Replay,
)
from .plants.replay import (
    exact_motion as exact_motion,
)
from .plants.replay import (
    recorded_motion as recorded_motion,
)
from .recording.recording import Recording as Recording
from .recording.recording import RecordingError as RecordingError
from .recording.scene import SceneError as SceneError
from .recording.scene import describe_object as describe_object
from .simulate import simulate as simulate
